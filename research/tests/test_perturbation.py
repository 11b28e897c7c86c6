"""Perturbed worlds: drawn by number, physical where they say so, and of the operator's bones."""

from dataclasses import replace

import numpy as np
import pytest

from smooth_operator.baselines.joint_angle import joint_angles
from smooth_operator.errors import ConfigError
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import BASES, BONES, LANDMARKS, TIPS
from smooth_operator.retargeting.palm import palm_axes
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.scenes.scene import OBJECT
from smooth_operator.simulation.tasks import FIXED_WRIST, TASKS
from smooth_operator.synthetic.tracker import tracker_model
from smooth_operator_research.demonstrations.demonstration import (
    DemonstrationLandmarks,
    load_demonstration,
)
from smooth_operator_research.demonstrations.perturbation import (
    RANGES,
    Perturbation,
    PerturbationRanges,
    PerturbedLandmarks,
    draw_perturbation,
)

pytestmark = [pytest.mark.weekly, pytest.mark.usefixtures("elsewhere")]

HAND = load_hand("mimic_p050")


def test_a_world_depends_on_its_seed_and_number_alone():
    first, again, other = (draw_perturbation(3, seed) for seed in (0, 0, 1))
    assert repr(first) == repr(again)
    assert first.mass != other.mass != draw_perturbation(4).mass
    fewer = draw_perturbation(3, 0, replace(RANGES, friction=0.0), "headset")
    assert fewer.friction == 1.0
    assert fewer.tracker == tracker_model("headset", first.tracker.seed)
    assert (fewer.mass, fewer.tracker.seed) == (first.mass, first.tracker.seed)
    with pytest.raises(ConfigError, match="friction"):
        PerturbationRanges(friction=-0.1)


def test_worlds_fill_their_ranges_and_world_0_is_unperturbed():
    worlds = [draw_perturbation(k) for k in range(1, 201)]
    bones = np.array([world.bones for world in worlds])
    assert 0.9 <= bones.min() < 0.92
    assert 1.08 < bones.max() <= 1.1
    assert max(abs(world.shift).max() for world in worlds) == pytest.approx(0.002, rel=0.05)
    none, points = draw_perturbation(0), np.random.default_rng(0).normal(size=(21, 3))
    scene = scene_for("card", HAND)
    np.testing.assert_array_equal(none.scene(scene).start[0], scene.start[0])
    np.testing.assert_array_equal(none.scene(scene).start[1], scene.start[1])
    np.testing.assert_allclose(none.operator(points), points, atol=1e-12)
    source = DemonstrationLandmarks(load_demonstration("card"))
    physics = ScenePhysics(HAND, scene)
    seen = PerturbedLandmarks(source, none).landmarks(1.0, physics.observe(), physics)
    np.testing.assert_allclose(seen, source.at(1.0), atol=1e-12)


@pytest.mark.parametrize("task", FIXED_WRIST)
def test_the_object_is_where_and_as_heavy_as_the_world_says(task):
    world = replace(draw_perturbation(1), mass=1.2, friction=0.9)
    plain = ScenePhysics(HAND, scene_for(task, HAND))
    scene = world.scene(scene_for(task, HAND))
    physics = ScenePhysics(HAND, scene)
    world.prepare(physics)
    np.testing.assert_allclose(
        physics.observe().position - plain.observe().position, [*world.shift, 0.0], atol=1e-9
    )
    body = physics.model.body(OBJECT).id
    assert physics.model.body_mass[body] == pytest.approx(1.2 * plain.model.body_mass[body])
    assert physics.model.body_subtreemass[body] == pytest.approx(
        1.2 * plain.model.body_subtreemass[body]
    )
    moved = physics.model.geom_bodyid == body
    np.testing.assert_allclose(
        physics.model.geom_friction[moved, 0], 0.9 * plain.model.geom_friction[moved, 0]
    )
    np.testing.assert_array_equal(
        physics.model.geom_friction[~moved], plain.model.geom_friction[~moved]
    )
    # It starts at rest as a trial sees it: not turned yet, not lost.
    assert physics.advance(0.05)
    run = TASKS[task].scorer(scene).observe(physics.observe())
    assert run.assessment.score == 0.0
    assert not run.assessment.dropped


def test_an_object_that_waits_for_the_hand_is_solid_afterwards():
    """The thumb of this hand starts in the cube's place."""
    hand = load_hand("orca_v2")
    physics = ScenePhysics(hand, scene_for("cube", hand))
    assert not physics.observe().placed
    replace(draw_perturbation(0), mass=1.1).prepare(physics)
    physics.command(hand.full_configuration(hand.limits[:, 0]))
    physics.advance(1.0)
    state = physics.observe()
    assert state.placed
    weight = 9.81 * float(physics.model.body_mass[physics.model.body(OBJECT).id])
    assert state.support == pytest.approx(weight, rel=0.05)


def test_another_operator_shows_the_same_angles_with_other_bones():
    world = draw_perturbation(5)
    points = DemonstrationLandmarks(load_demonstration("cube")).at(1.0)
    longer = world.operator(points)
    angles = [joint_angles(p, palm_axes(p, "right")) for p in (points, longer)]
    np.testing.assert_allclose(angles[0], angles[1], atol=1e-6)
    for parent, child in BONES:
        finger = next(k for k, base in enumerate(BASES) if base <= child < base + 4)
        factor = world.palm if child in BASES else world.bones[finger]
        ratio = np.linalg.norm(longer[child] - longer[parent]) / np.linalg.norm(
            points[child] - points[parent]
        )
        assert ratio == pytest.approx(factor), LANDMARKS[child]


def test_frames_come_late_and_at_the_trackers_rate_with_its_shake():
    base = draw_perturbation(2, tracker="headset")
    world = replace(base, tracker=replace(base.tracker, frame_loss=0.1, frame_loss_burst=0.1))
    source = DemonstrationLandmarks(load_demonstration("card"))
    physics = ScenePhysics(HAND, scene_for("card", HAND))
    state = physics.observe()

    def frames(world: Perturbation, times: np.ndarray) -> list[np.ndarray | None]:
        tracked = PerturbedLandmarks(source, world)
        return [tracked.landmarks(float(time), state, physics) for time in times]

    times = -100.0 + 0.01 * np.arange(9000)  # the hand is still
    points = frames(world, times)
    seen = np.array([frame for frame in points if frame is not None])
    assert len(seen) == pytest.approx(0.9 * 30.0 * 90.0, rel=0.03)
    shake = seen[:, TIPS] - world.operator(source.at(-100.0))[list(TIPS)]
    assert shake.std() == pytest.approx(world.tracker.shake, rel=0.05)
    for one, two in zip(points, frames(world, times[:300]), strict=False):
        np.testing.assert_array_equal(one, two)
    still = replace(base, tracker=replace(base.tracker, shake=0.0))
    moving = 0.01 * np.arange(200)
    for time, frame in zip(moving, frames(still, moving), strict=True):
        if frame is not None:
            late = source.at(time - base.tracker.delay)
            np.testing.assert_allclose(frame, base.operator(late), atol=1e-12)

"""Tasks with a moving wrist: the free wrist, the scene and the scores of ``relocate``."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from smooth_operator import poses
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.arms.arm import HandMount, matrix_of, pose_of
from smooth_operator.simulation.arms.free_wrist import SPEED, TURN_SPEED, FreeWrist
from smooth_operator.simulation.physics import FURNISHED
from smooth_operator.simulation.scenes import Scene, ScenePhysics, SceneState, scene_for
from smooth_operator.simulation.scenes.physics import draw_variation, draw_wrist_variation
from smooth_operator.simulation.scenes.relocate import SHAPES, relocate_scene
from smooth_operator.simulation.scenes.table_scene import grasp_centre
from smooth_operator.simulation.tasks import TASKS, TaskRun

HANDS = ("mimic_p050", "leap_hand", "shadow_dexee")


def on_free_wrist(name: str, **options) -> ScenePhysics:
    hand = load_hand(name)
    scene = relocate_scene(hand, **options)
    return ScenePhysics(hand, scene, carried=scene.free_wrist(hand))


def wrist_of(physics: ScenePhysics) -> np.ndarray:
    palm = physics.data.body(FURNISHED + physics.hand.spec.palm)
    pose = np.concatenate([palm.xpos, palm.xquat])
    return pose_of(matrix_of(pose) @ HandMount(physics.hand).palm_to_wrist)


@pytest.mark.parametrize("name", HANDS)
def test_a_free_wrist_goes_to_a_pose_of_the_wrist_frame(name):
    physics = on_free_wrist(name)
    wrist = physics.carried
    np.testing.assert_allclose(wrist_of(physics), wrist.start, atol=1e-6)
    turn = poses.from_rotation_vectors(np.array([0.5, -0.6, 0.7]))
    goal = poses.compose(wrist.start, np.concatenate([[-0.05, 0.06, 0.07], turn]))
    targets = wrist.targets(goal, wrist.home, np.inf)
    np.testing.assert_allclose(poses.separation(wrist.pose(targets), goal), 0.0, atol=1e-9)
    physics.put_away()
    physics.command_arm(targets)
    assert physics.advance(1.0)
    distance, angle = poses.separation(wrist_of(physics), goal)
    assert distance < 0.001
    assert angle < 0.01


def test_targets_of_a_free_wrist_move_within_the_speed_limits():
    hand = load_hand("mimic_p050")
    wrist = FreeWrist(hand, np.array([0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]))
    goal = np.array([0.3, 0.4, 0.3, np.cos(0.5), 0.0, 0.0, np.sin(0.5)])
    step = wrist.targets(goal, wrist.home, 0.1)
    assert np.linalg.norm(step[:3]) == pytest.approx(0.1 * SPEED)
    assert np.linalg.norm(step[3:]) == pytest.approx(0.1 * TURN_SPEED)
    np.testing.assert_allclose(step[:3] / np.linalg.norm(step[:3]), [0.6, 0.8, 0.0], atol=1e-12)


@pytest.mark.parametrize("name", HANDS)
@pytest.mark.parametrize("shape", list(SHAPES))
def test_the_object_lies_on_the_table_below_the_grasp_centre(name, shape):
    physics = on_free_wrist(name, shape=shape)
    scene = physics.scene
    centre = scene.mount.world(grasp_centre(physics.hand))
    np.testing.assert_allclose(centre[:2], scene.start[0][:2], atol=1e-9)
    assert physics.advance(0.4)
    state = physics.observe()
    assert state.placed
    assert np.linalg.norm(state.position - scene.start[0]) < 1e-4
    assert state.support == pytest.approx(9.81 * SHAPES[shape][2], rel=0.02)
    np.testing.assert_allclose(physics.arm_positions, 0.0, atol=1e-6)  # no weight of the hand


def test_a_scaled_object_has_the_mass_of_its_volume():
    physics = on_free_wrist("mimic_p050", shape="cube", scale=1.2)
    body = physics.model.body("object").id
    assert float(physics.model.body_mass[body]) == pytest.approx(SHAPES["cube"][2] * 1.2**3)
    assert physics.scene.start[0][2] == pytest.approx(0.02 + 1.2 * 0.02)


def test_worlds_differ_and_are_the_same_for_all_hands():
    first, second = (
        [draw_wrist_variation(np.random.default_rng(seed)).scene(scene) for seed in range(20)]
        for scene in (scene_for("relocate", load_hand(name)) for name in HANDS[:2])
    )
    assert {scene.shape for scene in first} == set(SHAPES)
    for one, other in zip(first, second, strict=True):
        assert one.shape == other.shape
        for part in range(2):
            np.testing.assert_array_equal(one.start[part], other.start[part])
        np.testing.assert_array_equal(one.target, other.target)
    places = np.array([scene.start[0][:2] for scene in first])
    assert (np.abs(places) <= 0.02).all()
    assert np.ptp(places, axis=0).min() > 0.02
    card = scene_for("card", load_hand("mimic_p050"))
    varied = draw_variation(np.random.default_rng(0)).scene(card)
    np.testing.assert_array_equal(varied.start[0][2], card.start[0][2])


@cache
def observed() -> tuple[Scene, SceneState]:
    physics = on_free_wrist("mimic_p050")
    return physics.scene, physics.observe()


def trial(*moments: tuple[float, tuple[float, float, float], dict]) -> TaskRun:
    """A trial whose object is at the given times at places relative to the target, held by a
    finger."""
    scene, state = observed()
    run = TaskRun(TASKS["relocate"], scene).go(0.0)
    force = state.force.copy()
    force[1] = 1.0
    held = replace(state, force=force, support=0.0, velocity=np.zeros(3))
    for time, place, changes in moments:
        position = scene.target + place
        run = run.observe(replace(held, time=time, position=position, **changes))
    return run


FAST = {"velocity": np.array([0.1, 0.0, 0.0])}
LOOSE = {"force": np.zeros(5)}


@pytest.mark.parametrize(
    ("place", "changes", "score"),
    [
        ((0.0, 0.02, 0.02), {}, 1.0),
        ((0.0, 0.02, 0.03), {}, 0.5),
        ((0.0, 0.0, 0.02), FAST, 0.5),
        ((0.0, 0.09, 0.0), {}, 0.5),
        ((0.0, 0.11, 0.0), {}, 0.0),
        ((0.0, 0.0, 0.0), LOOSE, 0.0),
        ((0.0, 0.0, 0.0), {"support": 0.5}, 0.0),
    ],
)
def test_relocate_is_done_by_an_object_held_still_at_the_target(place, changes, score):
    run = trial(*((k / 10, place, changes) for k in range(8)))
    assert run.assessment.score == score
    assert (run.outcome is not None) == (score == 1.0)
    assert TASKS["relocate"].task.line(run.assessment.line).score == score


def test_relocate_needs_half_a_second_without_a_break():
    there, away = (0.0, 0.0, 0.0), (0.0, 0.0, 0.04)
    run = trial((0.0, there, {}), (0.4, there, {}), (0.5, away, {}), (0.9, there, {}))
    assert run.outcome is None
    assert run.assessment.line == "near"


@pytest.mark.parametrize(("carried", "score"), [((0.0, 0.0, 0.2), 0.0), ((0.0, 0.0, 0.05), 0.5)])
def test_an_object_that_falls_ends_the_trial(carried, score):
    run = trial((0.0, carried, {}), (0.1, (2.0, 0.0, 0.0), LOOSE))
    assert run.outcome.ended == "drop"
    assert run.outcome.score == score

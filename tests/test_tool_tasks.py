"""Tasks with a tool: the physics of nail and tongs, and the scores of ``hammer`` and ``tongs``."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.scenes import ScenePhysics, SceneState
from smooth_operator.simulation.scenes.physics import ObjectVariation
from smooth_operator.simulation.scenes.tools import (
    ARM,
    GAPS,
    HAMMER_MASSES,
    HEAD,
    HINGE_AT,
    NAIL,
    NAIL_FRICTION,
    SQUEEZE,
    TONGS_MASSES,
    hammer_scene,
    tongs_scene,
)
from smooth_operator.simulation.tasks import TASKS, TaskRun

HAND = "mimic_p050"
TOOLS = ("hammer", "tongs")
UP = np.array([0.0, 0.0, 0.01])


def new_physics(task: str, scale: float = 1.0) -> ScenePhysics:
    hand = load_hand(HAND)
    scene = {"hammer": hammer_scene, "tongs": tongs_scene}[task](hand, scale)
    return ScenePhysics(hand, scene, carried=scene.free_wrist(hand))


cached_physics = cache(new_physics)


def physics_of(task: str, scale: float = 1.0) -> ScenePhysics:
    physics = cached_physics(task, scale)
    physics.restart()
    return physics


def total_mass(physics: ScenePhysics) -> float:
    model = physics.model
    return float(model.body_subtreemass[model.body("object").id])


@pytest.mark.parametrize("task", TOOLS)
@pytest.mark.parametrize("scale", [1.0, 0.85])
def test_a_tool_lies_still_on_its_stand(task, scale):
    physics = physics_of(task, scale)
    before = physics.observe()
    assert before.placed
    assert physics.advance(0.3)
    state = physics.observe()
    assert np.linalg.norm(state.position - physics.scene.start[0]) < 0.001
    assert np.linalg.norm(state.velocity) < 0.01
    mass = (sum(HAMMER_MASSES) if task == "hammer" else 2 * sum(TONGS_MASSES)) * scale**3
    assert total_mass(physics) == pytest.approx(mass, rel=1e-4)
    assert state.support == pytest.approx(9.81 * mass, rel=0.1)
    assert state.mechanism == pytest.approx(before.mechanism, abs=0.01)


def pushed_nail(force: float) -> float:
    """Depth of the nail after a tenth of a second of a force on it [m]."""
    physics = physics_of("hammer")
    data = physics.data
    data.qfrc_applied[physics.model.joint("nail").dofadr[0]] = force
    physics.advance(0.1)
    return physics.observe().mechanism


def test_the_nail_resists_up_to_its_friction():
    assert pushed_nail(0.9 * NAIL_FRICTION) < 0.001
    assert pushed_nail(1.5 * NAIL_FRICTION) == pytest.approx(NAIL, abs=0.001)


def test_a_hammer_that_falls_on_the_nail_drives_it_in_by_its_energy():
    physics = physics_of("hammer")
    scene, data, model = physics.scene, physics.data, physics.model
    joint = model.joint("object")
    drop, weight = 0.12, 9.81 * total_mass(physics)
    body = model.body("object").id
    grip = data.xipos[body] - data.xpos[body]  # the centre of mass goes over the nail
    bottom = scene.target[2] + NAIL + HEAD[1] / 2
    data.qpos[joint.qposadr[0] : joint.qposadr[0] + 3] = (*(scene.target - grip)[:2], bottom + drop)
    assert physics.advance(0.35)
    depth = weight * drop / (NAIL_FRICTION - weight)
    assert physics.observe().mechanism == pytest.approx(depth, rel=0.25)  # 1.5 m/s in steps of 2 ms


@pytest.mark.parametrize(("share", "gap"), [(0.8, GAPS[0]), (1.1, GAPS[1])])
def test_tongs_are_open_below_the_first_force_and_shut_above_the_second(share, gap):
    physics = physics_of("tongs")
    force = share * (SQUEEZE[0] if gap == GAPS[0] else SQUEEZE[1])
    model, data = physics.model, physics.data
    joint = model.joint("tongs").dofadr[0]
    data.qfrc_applied[joint] = -force * HINGE_AT
    physics.advance(0.5)
    scene = physics.scene
    assert scene.gap(physics.observe().mechanism) == pytest.approx(gap, abs=0.001)


def test_every_part_of_a_tool_counts_as_the_object():
    physics = new_physics("tongs")
    arms = ("thumb_arm", "finger_arm")
    moving = {part.name for part in physics.parts() if part.moves}
    assert moving == {*arms, *(f"{arm}_jaw" for arm in arms)}
    model = physics.model
    softness = [tuple(model.geom(arm).solref) for arm in arms]
    assert softness[0] == softness[1] != tuple(model.geom("platform").solref)
    friction = [float(model.geom(arm).friction[0]) for arm in arms]
    ObjectVariation(friction=0.75, mass=1.2).prepare(physics)
    assert total_mass(physics) == pytest.approx(1.2 * 2 * sum(TONGS_MASSES), rel=1e-4)
    assert [float(model.geom(arm).friction[0]) for arm in arms] == pytest.approx(
        [0.75 * value for value in friction]
    )


def test_a_tool_is_drawn_where_its_parts_are():
    physics = physics_of("tongs")
    scene, data = physics.scene, physics.data
    data.qfrc_applied[physics.model.joint("tongs").dofadr[0]] = -1.0
    physics.advance(0.5)
    mujoco.mj_kinematics(physics.model, data)
    places = {part.name: part.position for part in physics.parts()}
    apart = np.linalg.norm(places["finger_arm"] - places["thumb_arm"])
    assert apart == pytest.approx(GAPS[1] + ARM[0], abs=5e-4)
    assert scene.start[0][2] > places["post0"][2]


def test_the_mechanism_is_reset_with_the_object():
    physics = physics_of("hammer")
    physics.data.qpos[physics.model.joint("nail").qposadr[0]] = 0.03
    assert physics.observe().mechanism == pytest.approx(0.03)
    physics.reset_object()
    assert physics.observe().mechanism == 0.0


@cache
def seen(task: str) -> SceneState:
    """A state in which one finger alone holds the tool at its target."""
    physics = physics_of(task)
    state = physics.observe()
    force = np.zeros_like(state.force)
    force[1] = 1.0
    return replace(state, force=force, support=0.0, position=physics.scene.target + UP)


def trial(task: str, *moments: dict) -> TaskRun:
    """A trial that sees a state every 0.3 s."""
    run = TaskRun(TASKS[task], physics_of(task).scene).go(0.0)
    for number, changes in enumerate(moments):
        run = run.observe(replace(seen(task), time=0.3 * number, **changes))
    return run


LOST = {"position": np.array([2.0, 0.0, 0.0]), "force": np.zeros(5)}
ON_THE_NAIL = {"support": 20.0}


@pytest.mark.parametrize(
    ("moments", "line", "ended"),
    [
        ([{"mechanism": 0.041}] * 3, "done", "success"),
        ([{"mechanism": 0.041} | ON_THE_NAIL] * 9, "partly", None),
        ([{"mechanism": 0.039}] * 9, "partly", None),
        ([{"mechanism": 0.041}, {"mechanism": 0.041} | LOST], "partly", "drop"),
        ([{"mechanism": 0.016}, {"mechanism": 0.016} | LOST], "partly", "drop"),
        ([{"mechanism": 0.014}] * 9, "not-done", None),
        ([{"mechanism": 0.014}, {"mechanism": 0.014} | LOST], "dropped", "drop"),
    ],
)
def test_hammer_is_done_by_a_nail_that_is_in_and_a_hammer_that_is_held(moments, line, ended):
    run = trial("hammer", *moments)
    assert run.assessment.line == line
    assert run.assessment.score == TASKS["hammer"].task.line(line).score
    assert (run.outcome.ended if run.outcome else None) == ended


def angle(gap: float) -> dict:
    return {"mechanism": (gap - GAPS[1]) / 0.2}


ONCE = [angle(0.019), angle(0.031)]
LOW = {"position": np.zeros(3)}


@pytest.mark.parametrize(
    ("moments", "line", "ended"),
    [
        (3 * ONCE, "done", "success"),
        (2 * ONCE + [angle(0.019)], "partly", None),
        (3 * [angle(0.019), angle(0.029)], "partly", None),
        (3 * [angle(0.021), angle(0.031)], "not-done", None),
        (3 * [moment | LOW for moment in ONCE], "not-done", None),
        ([*ONCE, LOST], "partly", "drop"),
        ([angle(0.06), LOST], "dropped", "drop"),
    ],
)
def test_tongs_are_shut_and_opened_three_times_in_the_air(moments, line, ended):
    run = trial("tongs", *moments)
    assert run.assessment.line == line
    assert run.assessment.score == TASKS["tongs"].task.line(line).score
    assert (run.outcome.ended if run.outcome else None) == ended

"""The study's tasks in simulation: scenes, scores, trials, and that they can be done."""

from dataclasses import replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from live_time import until
from ticks import make_tick

from smooth_operator.errors import (
    ConfigError,
    HandModelError,
    SinkError,
    StudyError,
    UnknownNameError,
)
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.scenes import SCENES, ScenePhysics, SceneState, scene_for
from smooth_operator.simulation.scenes.scene import opposition
from smooth_operator.simulation.scenes.task_scenes import CARD
from smooth_operator.simulation.tasks import (
    FIXED_WRIST,
    TASKS,
    Phase,
    TaskRun,
    TaskSession,
    TrialRecord,
    read_trial,
    rescore,
    task_named,
    write_trial,
)
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator_research.demonstrations.demonstration import load_demonstration, play

pytestmark = pytest.mark.usefixtures("elsewhere")

STEP = 0.02  # between two moments of a scripted path [s]
INTO = 3e-5  # how far an object that lies on something is in it, or it would not touch [m]


@cache
def physics_of(task: str) -> ScenePhysics:
    """The scene around the mimic hand, which touches nothing: scripts say what fingers do."""
    hand = load_hand("mimic_p050")
    physics = ScenePhysics(hand, scene_for(task, hand))
    own = [g for g in range(physics.model.ngeom) if physics.model.geom(g).name.startswith("hand/")]
    physics.model.geom_contype[own] = physics.model.geom_conaffinity[own] = 0
    return physics


def by(x: float, y: float, z: float) -> np.ndarray:
    return np.array([x, y, z])


def turned(axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    half = np.radians(degrees) / 2
    unit = np.array(axis, float) / np.linalg.norm(axis)
    return np.concatenate([[np.cos(half)], np.sin(half) * unit])


def after(second: np.ndarray, first: np.ndarray) -> np.ndarray:
    out = np.zeros(4)
    mujoco.mju_mulQuat(out, second, first)
    return out


class Script:
    """Moves the object itself along a path; what supports it is what the physics finds there."""

    def __init__(self, task: str) -> None:
        self.physics = physics_of(task)
        self.scene = self.physics.scene
        self.physics.reset_object()
        self.start, self.upright = (np.array(part) for part in self.scene.start)
        self.position, self.quaternion = self.start - (0, 0, INTO), self.upright
        self.time = 0.0
        self.run = TaskRun(TASKS[task], self.scene).go(0.0)

    def state(self, fingers: dict[int, float], **changes: object) -> SceneState:
        """The scene with the object where it is, and fingers on its faces at z = +-."""
        data, model = self.physics.data, self.physics.model
        joint = model.joint("object")
        data.qpos[joint.qposadr[0] :][:7] = np.concatenate([self.position, self.quaternion])
        data.qvel[joint.dofadr[0] :][:6] = 0.0
        mujoco.mj_forward(model, data)
        seen = self.physics.observe()
        assert not seen.force.any()
        force, touch = seen.force.copy(), seen.touch.copy()
        for finger, z in fingers.items():
            force[finger], touch[finger] = 1.0, (0.0, 0.0, z)
        return replace(seen, time=self.time, force=force, touch=touch, **changes)

    def to(
        self,
        position: np.ndarray | None = None,
        quaternion: np.ndarray | None = None,
        seconds: float = 0.2,
        fingers: dict[int, float] | None = None,
        step: float = STEP,
        **changes: object,
    ) -> TaskRun:
        """Goes somewhere in a straight line, and says how the trial is then."""
        begin, turn = self.position, self.quaternion
        end = begin if position is None else np.asarray(position, float)
        goal = turn if quaternion is None else quaternion
        count = max(1, round(seconds / step))
        difference = np.zeros(3)
        mujoco.mju_subQuat(difference, goal, turn)
        for k in range(1, count + 1):
            self.position = begin + (end - begin) * k / count
            self.quaternion = turn.copy()
            mujoco.mju_quatIntegrate(self.quaternion, difference, k / count)
            self.time += step
            moving = {"spin": difference / seconds, **changes}
            self.run = self.run.observe(self.state(fingers or {}, **moving))
        return self.run

    def rest(
        self, seconds: float = 0.6, fingers: dict[int, float] | None = None, **changes: object
    ) -> TaskRun:
        return self.to(seconds=seconds, fingers=fingers, **changes)


def ended(run: TaskRun | None) -> tuple[float, str, str]:
    """Score, line of the rubric and why it ended; the score is that of the line."""
    assert run.outcome is not None, run.assessment
    assert run.task.task.line(run.outcome.line).score == run.outcome.score
    return run.outcome.score, run.outcome.line, run.outcome.ended


PINCH = {0: -CARD[2] / 2, 1: CARD[2] / 2}


def over_the_edge(script: Script) -> np.ndarray:
    return script.start - (0.02, 0.0, INTO)


# Task A: the lines of the rubric, best first.


def test_card_slid_over_the_edge_and_pinched():
    script = Script("card")
    script.to(over_the_edge(script), seconds=1.0, fingers={1: 0.001})
    assert script.run.assessment.reason == "over the edge"
    script.to(script.position + by(0, 0, 0.01), seconds=0.2, fingers=PINCH)
    run = script.rest(0.6, PINCH)
    assert ended(run) == (1.0, "done", "success")
    assert run.outcome.seconds == pytest.approx(1.0 + 0.2 + 0.5, abs=0.25)


def test_card_after_a_reset_is_worth_half():
    script = Script("card")
    script.to(over_the_edge(script), seconds=0.4)
    script.run = script.run.reset()
    script.to(script.start - (0, 0, INTO), seconds=STEP)
    script.to(over_the_edge(script), seconds=0.4)
    script.to(script.position + by(0, 0, 0.01), fingers=PINCH)
    run = script.rest(0.6, PINCH)
    assert ended(run) == (0.5, "done-after-reset", "success")
    assert run.outcome.seconds > 1.0  # the clock went on


def test_card_lifted_without_the_edge_is_worth_half():
    script = Script("card")
    script.to(script.start + by(0.01, 0, 0.01), fingers=PINCH)
    run = script.rest(0.6, PINCH)
    assert ended(run) == (0.5, "no-edge", "success")


def test_what_went_before_a_reset_does_not_count_after_it():
    script = Script("card")
    script.to(over_the_edge(script), seconds=0.4)
    script.run = script.run.reset()
    script.to(script.start + by(0, 0, 0.01), seconds=STEP, fingers=PINCH)
    run = script.rest(0.6, PINCH)
    assert ended(run) == (0.5, "no-edge", "success")


@pytest.mark.parametrize("away", [(0.08, 0.0), (0.0, 0.08), (0.0, -0.08)])
def test_card_flicked_out_of_reach_needs_the_reset(away):
    script = Script("card")
    run = script.to(script.start + by(*away, -INTO), seconds=0.2)
    assert run.phase is Phase.RUNNING
    assert run.assessment.stuck
    script.run = run.reset()
    script.to(script.start - (0, 0, INTO), seconds=STEP)
    assert not script.run.assessment.stuck
    script.to(over_the_edge(script), seconds=0.4)
    script.to(script.position + by(0, 0, 0.01), fingers=PINCH)
    assert ended(script.rest(0.6, PINCH)) == (0.5, "out-of-reach", "success")


@pytest.mark.parametrize("to", [(-0.02, 0.0, -0.12), (0.2, 0.0, 0.0), (-0.14, 0.0, 0.02)])
def test_card_that_leaves_the_workspace_has_failed(to):
    script = Script("card")
    script.to(over_the_edge(script), seconds=0.4)
    run = script.to(script.start + to, seconds=0.2)
    assert ended(run) == (0.0, "dropped", "drop")


def test_time_runs_out():
    script = Script("card")
    run = script.to(seconds=59.0, step=1.0)
    assert run.phase is Phase.RUNNING
    run = script.to(seconds=1.0, step=1.0)
    assert ended(run) == (0.0, "not-done", "timeout")
    assert run.outcome.seconds == 60.0


@pytest.mark.parametrize(
    "fingers",
    [{0: -0.001}, {1: 0.001, 2: -0.001}, {0: 0.001, 1: 0.001}, {0: 0.0, 1: 0.001}, {}],
    ids=["thumb alone", "two fingers", "one side", "at its edge", "nothing"],
)
def test_what_is_no_pinch(fingers):
    script = Script("card")
    script.to(over_the_edge(script), seconds=0.4)
    script.to(script.position + by(0, 0, 0.01), fingers=fingers)
    assert script.rest(1.0, fingers).phase is Phase.RUNNING


def test_a_pinch_has_to_last_and_to_be_clear_of_the_table():
    script = Script("card")
    script.to(over_the_edge(script), seconds=0.4)
    assert script.rest(1.0, PINCH).phase is Phase.RUNNING  # still on the table
    for _ in range(3):
        script.to(over_the_edge(script) + by(0, 0, 0.01), seconds=0.1, fingers=PINCH)
        assert script.rest(0.3, PINCH).phase is Phase.RUNNING
        script.to(over_the_edge(script), seconds=0.1)


@pytest.mark.parametrize("degrees", [90, -90, 76, 104])
def test_cube_turned_by_a_right_angle(degrees):
    script = Script("cube")
    script.to(quaternion=turned((0, 0, 1), degrees), seconds=1.0)
    assert script.run.phase is Phase.RUNNING  # it has to rest
    run = script.rest(0.7, spin=np.zeros(3))
    assert ended(run) == (1.0, "done", "success")


@pytest.mark.parametrize("degrees", [0, 60, 73, 107, 150])
def test_cube_turned_too_little_or_too_far(degrees):
    script = Script("cube")
    for share in (0.5, 1.0):
        script.to(quaternion=turned((0, 0, 1), share * degrees), seconds=1.0)
    run = script.rest(1.0, spin=np.zeros(3))
    assert run.phase is Phase.RUNNING
    assert f"{degrees}°" in run.assessment.reason
    assert ended(run.finish(script.time)) == (0.0, "not-done", "finished")


@pytest.mark.parametrize(
    ("turns", "lift", "spin"),
    [((60, 120, 180, 240, 270), -INTO, 0.0), ((45, 90), -INTO, 1.0), ((45, 90), 0.01, 0.0)],
    ids=["three quarters", "still moving", "in the air"],
)
def test_cube_that_is_turned_but_not_done(turns, lift, spin):
    script = Script("cube")
    for degrees in turns:
        script.to(script.start + by(0, 0, lift), turned((0, 0, 1), degrees), seconds=0.5)
    assert script.rest(1.0, spin=np.array([0.0, 0.0, spin])).phase is Phase.RUNNING


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, -1, 0)])
def test_cube_that_flips_on_the_way_is_worth_half(axis):
    script = Script("cube")
    onto = turned(axis, 90)
    script.to(script.start + by(0, 0, 0.02), seconds=0.2)
    script.to(quaternion=onto, seconds=0.6)
    script.to(script.start - (0, 0, INTO), seconds=0.2)
    assert "flipped" in script.run.assessment.reason
    script.to(quaternion=after(turned((0, 0, 1), 45), onto), seconds=0.5)
    script.to(quaternion=after(turned((0, 0, 1), 90), onto), seconds=0.5)
    run = script.rest(0.7, spin=np.zeros(3))
    assert ended(run) == (0.5, "flipped", "success")


def test_cube_that_is_misaligned_needs_the_reset():
    script = Script("cube")
    script.to(script.start + by(0, 0, 0.004), turned((1, 0, 0), 25), seconds=0.5)
    run = script.rest(1.2, spin=np.zeros(3))
    assert run.assessment.stuck
    script.run = run.reset()
    script.to(script.start - (0, 0, INTO), script.upright, seconds=STEP)
    script.to(quaternion=turned((0, 0, 1), 90), seconds=1.0)
    run = script.rest(0.7, spin=np.zeros(3))
    assert ended(run) == (0.5, "misaligned", "success")


@pytest.mark.parametrize("to", [(0.1, 0.0, 0.0), (0.0, -0.1, 0.0), (0.06, 0.0, -0.06)])
def test_cube_that_falls_has_failed(to):
    script = Script("cube")
    run = script.to(script.start + to, seconds=0.4)
    assert ended(run) == (0.0, "dropped", "drop")


def pivoted(script: Script, from_down: float) -> np.ndarray:
    """The screwdriver's rotation at so many degrees from down, about the palm's normal."""
    blade = script.scene.mount.directions[:, 1]
    axis = np.cross(blade, (0.0, 0.0, -1.0))
    return after(turned(tuple(axis), 90 - from_down), script.upright)


HELD: dict[str, object] = {"fixed": False, "spin": np.zeros(3)}
GRIP = {0: 0.0, 1: 0.0}


@pytest.mark.parametrize("degrees", [0, 8, -8])
def test_screwdriver_pivoted_until_it_points_down(degrees):
    script = Script("screwdriver")
    script.to(quaternion=pivoted(script, degrees), seconds=1.0, fingers=GRIP, fixed=False)
    run = script.rest(0.6, GRIP, **HELD)
    assert ended(run) == (1.0, "done", "success")


@pytest.mark.parametrize(("degrees", "score"), [(13, 0.5), (28, 0.5), (33, 0.0), (90, 0.0)])
@pytest.mark.parametrize("how", ["finished", "timeout"])
def test_screwdriver_close_to_down_at_the_end(degrees, score, how):
    script = Script("screwdriver")
    script.to(quaternion=pivoted(script, degrees), seconds=1.0, fingers=GRIP, fixed=False)
    run = script.rest(0.6, GRIP, **HELD)
    assert run.phase is Phase.RUNNING
    if how == "finished":
        run = run.finish(script.time)
    else:
        run = script.to(seconds=60.0, step=1.0, fingers=GRIP, **HELD)
    assert ended(run) == (score, "nearly" if score else "not-done", how)


def test_screwdriver_after_a_reset_is_worth_half():
    script = Script("screwdriver")
    script.run = script.run.reset()
    script.to(quaternion=pivoted(script, 0), seconds=1.0, fingers=GRIP, fixed=False)
    run = script.rest(0.6, GRIP, **HELD)
    assert ended(run) == (0.5, "done-after-reset", "success")


def test_screwdriver_that_falls_has_failed():
    script = Script("screwdriver")
    run = script.to(script.start - (0, 0, 0.2), seconds=0.5, fixed=False)
    assert ended(run) == (0.0, "dropped", "drop")


@pytest.mark.parametrize(
    ("fingers", "changes"),
    [
        (GRIP, {"fixed": True, "spin": np.zeros(3)}),
        ({}, HELD),
        (GRIP, {"fixed": False, "spin": np.array([2.0, 0.0, 0.0])}),
    ],
    ids=["in the fixture", "in nothing", "swinging"],
)
def test_screwdriver_points_down_and_that_is_not_enough(fingers, changes):
    script = Script("screwdriver")
    script.to(quaternion=pivoted(script, 0), seconds=1.0, fixed=True)
    assert script.rest(1.0, fingers, **changes).phase is Phase.RUNNING


def test_a_trial_starts_with_go_and_has_one_reset():
    script = Script("card")
    scene, state = script.scene, script.state({})
    run = TaskRun(TASKS["card"], scene)
    assert run.observe(state) is run
    assert run.assessment.score == 0.0
    for early in (run.reset, lambda: run.finish(0.0)):
        with pytest.raises(StudyError, match="ready"):
            early()
    going = run.go(3.0)
    assert run.phase is Phase.READY  # a value: what it was stays
    with pytest.raises(StudyError, match="running"):
        going.go(4.0)
    again = going.reset()
    with pytest.raises(StudyError, match="one reset"):
        again.reset()
    done = again.finish(5.0)
    assert (done.outcome.seconds, done.outcome.ended) == (2.0, "finished")
    assert done.observe(state) is done
    with pytest.raises(StudyError, match="done"):
        done.reset()


def test_nothing_happens_to_an_object_that_waits_for_the_hand():
    script = Script("cube")
    run = script.to(script.start + by(0.2, 0, 0), seconds=0.2, placed=False)
    assert run.phase is Phase.RUNNING
    assert script.to(seconds=120.0, step=10.0, placed=False).outcome.ended == "timeout"


def test_every_task_has_a_scene_and_a_rubric_for_each_score():
    assert set(TASKS) == set(SCENES)
    for simulated in TASKS.values():
        assert {line.score for line in simulated.task.rubric} == {0.0, 0.5, 1.0}
        assert simulated.task.line(simulated.after_stuck).score == 0.5
        assert simulated.task.line(simulated.after_reset).score == 0.5
        assert task_named(simulated.task.name) is task_named(simulated.name) is simulated
    with pytest.raises(UnknownNameError, match="card"):
        task_named("cart")


@pytest.mark.parametrize("task", FIXED_WRIST)
@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("mimic_p050", "left"),
        ("allegro_hand", "right"),
        pytest.param("shadow_hand", "left", marks=pytest.mark.weekly),
        pytest.param("schunk_svh", "right", marks=pytest.mark.weekly),
    ],
)
def test_scenes_stand_around_hands(task, name, side):
    """The object lies still with its weight on what carries it, once the hand lets it."""
    hand = load_hand(name, side)
    physics = ScenePhysics(hand, scene_for(task, hand))
    away = physics.hand.limits[:, 0].copy()
    assert physics.advance(0.2)
    waiting = not physics.observe().placed
    if waiting:  # the neutral pose is in the object's place: open the hand
        physics.command(hand.full_configuration(np.clip(away, *hand.limits.T)))
        assert physics.advance(0.8)
    state = physics.observe()
    assert np.linalg.norm(state.position - physics.scene.start[0]) < 0.002
    body = physics.model.body("object")
    weight = 9.81 * float(physics.model.body_mass[body.id])
    assert 0.004 < weight / 9.81 < 0.1
    if not state.placed:
        assert waiting
    elif task != "screwdriver" and not state.force.any() and not state.palm:
        assert state.support == pytest.approx(weight, rel=0.02)
    else:
        assert state.fixed or state.force.any() or state.palm


def test_a_hand_that_is_too_small_is_refused():
    with pytest.raises(HandModelError, match="300 mm thick"):
        opposition(load_hand("mimic_p050"), "index", 0.3)
    with pytest.raises(UnknownNameError, match="screwdriver"):
        scene_for("screw", load_hand("mimic_p050"))


def test_an_object_waits_until_the_hand_is_out_of_its_place():
    hand = load_hand("mimic_p050")
    physics = ScenePhysics(hand, scene_for("card", hand))
    assert physics.observe().placed
    press = load_demonstration("card").pose(1.5)
    physics.command(hand.full_configuration(press))
    physics.advance(1.0)
    assert physics.observe().force.any()
    physics.reset_object()
    physics.advance(0.3)
    state = physics.observe()
    assert not state.placed
    assert not state.force.any()
    np.testing.assert_array_equal(state.position, physics.scene.start[0])
    physics.command(hand.full_configuration(hand.neutral))
    physics.advance(0.8)
    assert physics.observe().placed


def test_the_fixture_holds_until_thumb_and_two_fingers_do():
    hand = load_hand("mimic_p050")
    physics = ScenePhysics(hand, scene_for("screwdriver", hand))
    physics.advance(2.0)
    state = physics.observe()
    assert state.fixed
    assert np.linalg.norm(state.position - physics.scene.start[0]) < 5e-4
    demonstration = load_demonstration("screwdriver")
    freed = False
    while physics.time < 5.0 and not freed:
        physics.command(hand.full_configuration(demonstration.pose(physics.time - 2.0)))
        physics.advance(0.01)
        freed = not physics.observe().fixed
    assert freed
    force = physics.observe().force
    assert force[0] > 0.0
    assert (force[1:] > 0.0).sum() >= 2
    physics.reset_object()
    assert physics.observe().fixed


def softer(physics: ScenePhysics) -> None:
    """The object 1 mm off, and 5 % more slippery."""
    joint = physics.model.joint("object")
    if not physics.scene.fixture:
        physics.data.qpos[joint.qposadr[0] :][:2] += 0.001
    physics.model.geom_friction[:, 0] *= 0.95


@pytest.mark.parametrize(
    ("side", "disturb"),
    [("right", None), ("left", None), ("right", softer)],
    ids=["as found", "mirrored", "disturbed"],
)
@pytest.mark.parametrize("task", FIXED_WRIST)
def test_a_hand_can_do_it(task, side, disturb):
    demonstration = replace(load_demonstration(task), side=side)
    *_, (state, run) = play(demonstration, disturb=disturb)
    assert ended(run) == (1.0, "done", "success")
    assert run.outcome.seconds == pytest.approx(state.time)


@pytest.mark.parametrize("task", FIXED_WRIST)
def test_a_hand_that_does_nothing_does_not_do_it(task):
    demonstration = load_demonstration("card")
    idle = replace(
        demonstration, task=task, poses=0 * demonstration.poses + load_hand("mimic_p050").neutral
    )
    *_, (_, run) = play(idle)
    assert run.phase is Phase.RUNNING
    assert run.assessment.score == 0.0


def test_a_trial_that_was_recorded_scores_again_the_same(tmp_path):
    demonstration = load_demonstration("card")
    hand = load_hand("mimic_p050")
    record = TrialRecord("card", hand.name, "right", hand.joint_names, events=[(0.0, "go")])
    run = None
    for state, run in play(demonstration):  # noqa: B007
        record.add(state, hand.full_configuration(demonstration.pose(state.time)))
    record.outcome, record.about = run.outcome, {"operator": "P01", "condition": "sbr"}
    path = tmp_path / "trial.npz"
    write_trial(path, record)
    back = read_trial(path)
    assert back.outcome == record.outcome
    assert (back.about, back.joint_names, back.events) == (
        record.about,
        record.joint_names,
        record.events,
    )
    again = rescore(TASKS["card"], scene_for("card", hand), back.states, back.events)
    assert again.outcome == record.outcome
    late = [*back.events, (1.0, "reset")]
    capped = rescore(TASKS["card"], scene_for("card", hand), back.states, late)
    assert capped.outcome.score == 0.5
    (tmp_path / "bad.npz").write_bytes(b"no zip")
    with pytest.raises(StudyError, match=r"bad\.npz"):
        read_trial(tmp_path / "bad.npz")


def test_a_trial_that_ended_before_its_first_moment_is_read_back(tmp_path):
    record = TrialRecord("card", "mimic_p050", "right", ("a", "b"), about={"trial": 1})
    write_trial(tmp_path / "empty.npz", record)
    back = read_trial(tmp_path / "empty.npz")
    assert (back.states, back.positions, back.about) == ([], [], {"trial": 1})


def test_any_source_of_commands_can_do_it_in_the_running_simulation():
    """The demonstration through the sink, in real time: commands and steps don't keep step."""
    demonstration, hand = load_demonstration("cube"), load_hand("mimic_p050")
    sim = build_sink("mujoco:task=cube")
    sim.open({"right": hand}, {})
    session = TaskSession(sim, "right")
    tick = make_tick(hand)

    def follow(state: SceneState, positions: np.ndarray) -> None:
        """By the scene's clock: a busy machine's simulation is slower than life."""
        session.observe(state, positions)
        command = hand.full_configuration(demonstration.pose(session.seconds + 0.01))
        sim.send(replace(tick, command=replace(tick.command, joint_positions=command)))

    sim.watch("right", follow)
    session.go()
    end = float(demonstration.times[-1])
    until(lambda: bool(session.outcomes) or session.seconds > end)
    sim.close()
    session.close()  # after the simulation: nothing to look at any more
    (outcome,) = session.outcomes
    assert (outcome.score, outcome.ended) == (1.0, "success")


def test_a_paused_scene_stands_still_and_goes_on():
    hand = load_hand("mimic_p050")
    sim = Simulation(task="card")
    sim.open({"right": hand}, {})
    session = TaskSession(sim, "right")
    session.go()
    until(lambda: session.seconds > 0.05)
    session.pause(True)

    def heard() -> Any:
        """The next state of the hand."""
        before = sim.state("right").time
        until(lambda: sim.state("right").time > before)
        return sim.state("right")

    heard()  # what was under way
    hand_at = heard()
    seconds, state = session.seconds, sim.scene_state("right")
    for _ in range(10):
        sim.send(make_tick(hand))
    later = heard()
    np.testing.assert_array_equal(later.positions, hand_at.positions)
    assert session.seconds == seconds
    session.reset()  # the object may be put back meanwhile
    until(lambda: sim.scene_state("right").starts > state.starts)
    assert session.seconds == seconds
    session.pause(False)
    until(lambda: session.seconds > seconds + 0.05)
    session.close()
    sim.close()


def test_a_folder_keeps_its_trials(tmp_path):
    """A second session on the same folder numbers on."""
    for expected in (1, 2):
        sim = Simulation(task="card")
        sim.open({"right": load_hand("mimic_p050")}, {})
        session = TaskSession(sim, "right", tmp_path)
        session.go()
        session.finish()
        until((tmp_path / f"card-{expected:03d}.npz").exists)
        sim.close()
    assert len(list(tmp_path.glob("*.npz"))) == 2


def test_a_trial_with_the_keys_of_teleop(tmp_path, capsys):
    from smooth_operator.cli.console import Progressing
    from smooth_operator.teleop.control.task_trials import TaskTrials, with_task

    assert with_task(("table",), None) == ("table",)
    with pytest.raises(ConfigError, match="--task card"):
        with_task(("mujoco:rate=500",), "card")
    sinks = [build_sink(text) for text in with_task((), "screwdriver")]
    trials = TaskTrials(
        sinks, ("right",), Progressing(False), task="screwdriver", folder=tmp_path / "trials"
    )
    sinks[0].open({"right": load_hand("mimic_p050")}, {})
    trials.begin()  # nobody is there to start it: it starts by itself
    for action in ("reset", "reset", "done"):
        trials.actions[action]()
    sinks[0].close()
    trials.end()
    said = capsys.readouterr().err
    assert "Screwdriver pivot: Hold" in said
    assert "a trial has only one reset" in said
    assert "right: 0 after" in said
    (outcome,) = trials.summary()["trials"]["right"]
    assert (outcome["ended"], outcome["resets"]) == ("finished", 1)
    until((tmp_path / "trials" / "screwdriver-001.npz").exists)
    back = read_trial(tmp_path / "trials" / "screwdriver-001.npz")
    assert [word for _, word in back.events] == ["go", "reset", "finish"]
    scene = scene_for("screwdriver", load_hand("mimic_p050"))
    again = rescore(TASKS["screwdriver"], scene, back.states, back.events)
    assert again.outcome == back.outcome
    nothing = TaskTrials(sinks, ("right",), Progressing(False))
    nothing.begin()
    assert (nothing.actions, nothing.summary()) == ({}, {})


def test_without_a_task_there_is_no_scene():
    sim = Simulation()
    sim.open({"right": load_hand("mimic_p050")}, {})
    assert sim.scene_state("right") is None
    with pytest.raises(SinkError, match="task=card"):
        sim.reset_object("right")
    sim.close()
    with pytest.raises(ConfigError, match="card"):
        build_sink("mujoco:task=chess")

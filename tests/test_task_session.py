"""Trials in a simulation that is stepped by hand: when the clock starts, and what is kept."""

import re
from typing import Any

import mujoco
import numpy as np
import pytest
from live_time import until

from smooth_operator.errors import StudyError
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.tasks import TaskSession, read_trial
from smooth_operator.simulation.tasks.task_session import CLEAR_S, TrialRunner
from smooth_operator.teleop.control.reporter import LoggingReporter
from smooth_operator.teleop.control.task_trials import TaskTrials
from smooth_operator.teleop.pages.live import live_texts


class Stepped:
    """A live simulation of one hand at the cube, without a thread."""

    task_now, world_number = "cube", 1

    def __init__(self) -> None:
        self.hand = load_hand("mimic_p050")
        self.physics = ScenePhysics(self.hand, scene_for("cube", self.hand))
        self.watcher: Any = None
        self.frozen = False
        self.open_hand = self.hand.full_configuration(np.clip(0.0, *self.hand.limits.T))
        self.to(self.open_hand)

    def to(self, positions: np.ndarray) -> None:
        """The hand is there, and stays."""
        model, data = self.physics.model, self.physics.data
        data.qpos[[model.joint(f"hand/{n}").qposadr[0] for n in self.hand.joint_names]] = positions
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        self.physics.command(positions)

    def run(self, seconds: float) -> None:
        for _ in range(0 if self.frozen else round(seconds / 0.01)):
            self.physics.advance(0.01)
            if self.watcher is not None:
                self.watcher(self.physics.observe(), self.physics.positions)

    def watch(self, side: str, watcher: Any) -> None:
        self.watcher = watcher

    def scene_of(self, side: str) -> Any:
        return self.physics.scene

    def hand_of(self, side: str) -> Any:
        return self.hand

    def scene_state(self, side: str) -> Any:
        return self.physics.observe()

    def reset_object(self, side: str) -> int:
        self.physics.reset_object()
        return self.physics.starts

    def freeze(self, side: str, frozen: bool) -> None:
        self.frozen = frozen

    def put_away(self, side: str) -> None:
        self.physics.put_away()


@pytest.fixture
def simulation(tmp_path, monkeypatch) -> Stepped:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into the working folder
    return Stepped()


def closed(simulation: Stepped) -> np.ndarray:
    """A fist, in which the cube's place is."""
    hand = simulation.hand
    return hand.full_configuration(0.3 * hand.limits[:, 0] + 0.7 * hand.limits[:, 1])


def test_a_trial_waits_until_the_hand_is_clear(simulation):
    begun: list[float] = []
    session = TaskSession(simulation, "right", begun=lambda: begun.append(simulation.physics.time))
    simulation.physics.put_away()
    simulation.to(closed(simulation))
    session.go(when_clear=True, limit_s=7.0, operator="P01")
    simulation.run(1.0)
    report = session.report()
    assert (report["phase"], report["elapsed_s"], begun) == ("waiting", 0.0, [])
    assert not report["placed"]
    with pytest.raises(StudyError, match="running"):
        session.go()
    simulation.to(simulation.open_hand)
    left = simulation.physics.time
    simulation.run(CLEAR_S + 0.1)
    assert session.report()["phase"] == "running"
    assert left + CLEAR_S <= begun[0] <= left + CLEAR_S + 0.1
    simulation.run(7.1 - (simulation.physics.time - begun[0]))
    (outcome,) = session.outcomes
    assert (outcome.ended, outcome.seconds) == ("timeout", pytest.approx(7.0, abs=0.02))


def test_what_is_swept_away_before_the_start_is_put_back(simulation):
    session = TaskSession(simulation, "right")
    session.go(when_clear=True)
    simulation.run(0.1)
    starts = simulation.physics.starts
    simulation.to(closed(simulation))  # through the cube
    simulation.run(0.1)
    assert session.report()["phase"] == "waiting"
    assert simulation.physics.starts > starts
    simulation.to(simulation.open_hand)
    simulation.run(2 * CLEAR_S)
    assert session.report()["phase"] == "running"
    start = simulation.physics.scene.start[0]
    assert simulation.physics.observe().position == pytest.approx(start, abs=1e-3)
    session.cancel()
    assert session.report()["phase"] == "ready"


def test_in_free_movement_nothing_can_be_touched(simulation):
    runner = TrialRunner(simulation, ("right",))
    assert runner.object_there
    runner.change("cube", with_object=False)
    assert not runner.object_there
    simulation.to(closed(simulation))
    simulation.run(0.3)
    state = simulation.physics.observe()
    assert not state.force.any()
    assert state.position == pytest.approx(simulation.physics.scene.start[0])
    simulation.to(simulation.open_hand)
    simulation.run(0.3)
    assert not simulation.physics.observe().placed
    runner.go()
    simulation.run(0.1)
    assert runner.object_there
    assert simulation.physics.observe().placed


def test_the_operator_sees_task_number_clock_and_go_and_no_score(simulation):
    trials = TaskTrials((), ("right",), LoggingReporter())
    assert trials.shown() is None
    assert live_texts.trial(None) == ""
    trials.runner = TrialRunner(simulation, ("right",))

    def shown() -> str:
        return re.sub("<[^>]+>", " ", live_texts.trial(trials.shown()))

    trials.runner.change("cube", with_object=False)
    simulation.run(0.1)
    assert "Move freely" in shown()
    simulation.to(closed(simulation))
    trials.runner.go(when_clear=True, limit_s=75.0, trial=3, trials=10)
    simulation.run(0.1)
    assert "Vertical cube rotation · trial 3 of 10" in shown()
    assert "Move the hand away from the object" in shown()
    assert "Turn the cube by 90 degrees" in shown()
    simulation.to(simulation.open_hand)
    simulation.run(CLEAR_S + 0.1)
    assert " Go " in shown()
    simulation.run(2.0)
    assert " 0:02 of 1:15 " in shown()
    trials.runner.pause()
    assert "Paused: keep your hand still" in shown()
    simulation.run(60.0)
    trials.runner.pause(False)
    assert " 0:02 of 1:15 " in shown()
    trials.runner.finish()
    assert "Over: 0:02" in shown()
    assert "not-done" not in shown()


def test_what_ends_a_trial_ends_its_pause(simulation, tmp_path):
    runner = TrialRunner(simulation, ("right",), tmp_path)
    with pytest.raises(StudyError, match="before you pause it"):
        runner.pause()
    runner.pause(False)  # nothing to do
    for end in (runner.cancel, runner.finish):
        runner.go()
        simulation.run(0.1)
        runner.pause()
        runner.pause()
        report = runner.report()
        assert (report["phase"], report["paused"], report["pauses"]) == ("running", True, 1)
        end()
        assert not simulation.frozen
        assert not runner.report()["paused"]
    until((tmp_path / "cube-001.npz").exists)
    assert read_trial(tmp_path / "cube-001.npz").about == {"pauses": 1}


def test_the_record_of_an_undone_trial_is_marked(simulation, tmp_path):
    folder = tmp_path / "trials"
    runner = TrialRunner(simulation, ("right",), folder)
    for trial in (1, 2):
        runner.go(trial=trial)
        simulation.run(0.1)
        runner.finish()
    runner.cancel("undone", trial=1)  # it is the second that has just ended
    runner.cancel("undone", trial=2)
    names = {"cube-001.npz", "undone-cube-002.npz"}
    until(lambda: {path.name for path in folder.glob("*.npz")} == names)
    assert read_trial(folder / "undone-cube-002.npz").about == {"trial": 2, "marked": "undone"}
    runner.go(trial=3)
    simulation.run(0.1)
    runner.cancel("undone", trial=3)  # while it runs: nothing is kept
    runner.go(trial=3)
    runner.finish()
    until((folder / "cube-003.npz").exists)
    assert len(list(folder.glob("*.npz"))) == 3

"""Arms in the simulation: the hand on the flange, the tasks in front, the sink's read-back."""

from __future__ import annotations

import runpy
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mink", reason="the extra arm is not installed")
pytest.importorskip("daqp", reason="the extra arm is not installed")

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.arms.catalogue import ARMS
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.scenes.arm_physics import ArmPhysics
from smooth_operator.teleop import teleoperate
from smooth_operator.teleop.arm.settings import ArmSettings, place_arms, read_arm
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import ArmCommand, Mode, Tick
from smooth_operator.types import JointCommand


def _carried(arm: str) -> Any:
    return place_arms(ArmSettings(arm), {"right": load_hand("leap_hand")})["right"]  # type: ignore[arg-type]


@pytest.mark.parametrize("arm", ARMS)
def test_an_arm_holds_its_hand_and_goes_where_it_is_sent(arm: str) -> None:
    carried = _carried(arm)
    physics = ArmPhysics(carried.mount.hand, carried)
    assert physics.advance(0.3)
    np.testing.assert_allclose(physics.arm_positions, carried.home, atol=2e-3)
    target = carried.home + 0.1
    physics.command_arm(target)
    assert physics.advance(0.8)
    np.testing.assert_allclose(physics.arm_positions, target, atol=5e-3)
    physics.command_arm(np.full(len(target), np.nan))
    assert physics.advance(0.1)
    np.testing.assert_allclose(physics.arm_positions, target, atol=5e-3)


@pytest.mark.parametrize("task", ["card", "cube", "screwdriver"])
def test_a_task_stands_in_front_of_the_arm(task: str) -> None:
    carried = _carried("xarm7")
    hand = carried.mount.hand
    physics = ScenePhysics(hand, scene_for(task, hand), carried=carried)
    assert physics.advance(0.3)
    np.testing.assert_allclose(physics.arm_positions, carried.home, atol=5e-3)
    state = physics.observe()
    np.testing.assert_allclose(state.position, physics.scene.start[0], atol=0.01)
    assert physics.carried is not None
    away = state.position[:2] - physics.carried.base[:2, 3]
    assert 0.2 < np.linalg.norm(away) < ARMS["xarm7"].reach, "the object is within reach"


def test_the_sink_carries_the_hand_and_reads_the_arm_back() -> None:
    carried = _carried("panda")
    hand = carried.mount.hand
    sink = Simulation()
    assert sink.measured_wrist("right") is None
    sink.use_arms({"right": carried})
    sink.open({"right": hand}, {})
    try:
        before = sink.measured_wrist("right")
        assert before is not None
        q = hand.full_configuration(hand.neutral)
        wanted = carried.home + np.array([0.15, 0, 0, 0, 0, 0, 0])
        arm = ArmCommand("panda", carried.arm.joint_names, wanted, np.zeros(7), before)
        command = JointCommand(q, hand.joint_names, 0.0)
        sink.send(
            Tick("right", hand.name, command, np.zeros(len(q)), Mode.TRACKING, 0.0, 0, arm=arm)
        )
        end = time.monotonic() + 20.0
        while np.abs(sink.measured_arm("right") - wanted).max() > 5e-3:  # type: ignore[operator]
            assert time.monotonic() < end, "the arm does not go where it is sent"
            time.sleep(0.02)
        after = sink.measured_wrist("right")
        assert after is not None
        assert after[1] - before[1] > 0.05, "a positive first joint turns it to the left"
        assert sink.arm_base("right") is None, "there is no task"
    finally:
        sink.close()


@dataclass(frozen=True)
class _Kept(Sink):
    ticks: list[Tick] = field(default_factory=list)

    @property
    def label(self) -> str:
        return "kept"

    def open(self, hands: Any, config: Any) -> None:
        pass

    def send(self, tick: Tick) -> None:
        self.ticks.append(tick)

    def close(self) -> None:
        pass


def test_one_command_moves_two_arms_with_their_hands() -> None:
    kept = _Kept()
    teleoperate(
        "synthetic:wrist=0.1", ["mujoco", kept], hand="leap_hand", side="both",
        method="joint_angle", arm="ur5e:spacing=1.2", duration=2.0,
    )  # fmt: skip
    for side in ("right", "left"):
        arms = [tick.arm for tick in kept.ticks if tick.side == side]
        assert arms
        assert all(arm is not None for arm in arms)
        q = np.array([arm.positions for arm in arms if arm is not None])
        moved = np.abs(q - q[0]).max(axis=1) > 0.01
        assert moved.any(), f"the {side} arm moves"
        known = [k for k in np.flatnonzero(moved) if arms[k].measured is not None]
        apart = [np.abs(arms[k].measured - q[k]).max() for k in known]
        assert np.median(apart) < 0.3  # not the last: the machine may have stalled before it


def test_settings_of_an_arm_are_read_and_checked() -> None:
    assert read_arm("panda") == ArmSettings("panda")
    assert read_arm("ur5e:roll=90,adapter=0.03") == ArmSettings("ur5e", 0.03, 90.0)
    with pytest.raises(ConfigError, match="panda or ur5e"):
        read_arm("pandora")
    with pytest.raises(UnknownNameError, match="setting"):
        read_arm("panda:rol=90")
    with pytest.raises(ConfigError, match="spacing"):
        read_arm("panda:spacing=0.1")


@pytest.mark.parametrize(("arm", "task"), [("xarm7", "cube"), ("ur5e", "screwdriver")])
def test_a_task_of_the_study_is_done_with_an_arm(arm: str, task: str) -> None:
    path = Path(__file__).parents[1] / "research" / "benchmarks" / "arm_tasks.py"
    trial = runpy.run_path(str(path))["trial"](task, "mimic_p050", arm, 0, 1)
    assert trial["score"] == 1.0
    assert trial["off_mm"] < 3.0, "the arm holds against what the fingers press on"

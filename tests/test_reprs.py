"""What public values print as: one short line with what a person asks first."""

import numpy as np

from smooth_operator import HandFrame, HandRecording, Result, Status, load_hand
from smooth_operator.types import CommandTrajectory, JointCommand

LANDMARKS = np.zeros((21, 3))
COMMAND = JointCommand(np.array([0.5, -0.25, 0.0, 1.0]), ("a", "b", "c", "d"), 2.5)


def test_a_frame():
    lost = LANDMARKS.copy()
    lost[20] = np.nan
    assert repr(HandFrame(lost, 1.5)) == "<HandFrame: right, stamp 1.5 s, 20 of 21 landmarks valid>"
    assert "no stamp" in repr(HandFrame(LANDMARKS, side="left"))


def test_a_recording():
    recording = HandRecording(np.zeros((11, 21, 3)), np.arange(11) / 10, name="glove")
    assert repr(recording) == (
        "<HandRecording 'glove': right, 11 frames, 1 s, 10 Hz, 231 of 231 landmarks valid>"
    )
    assert "0 frames, 0 s, nan Hz" in repr(recording[:0])


def test_a_command():
    assert repr(COMMAND) == (
        "<JointCommand: stamp 2.5 s, 4 joints [rad]: a +0.500, b -0.250, c +0.000, ...>"
    )
    assert repr(JointCommand(np.zeros(1), ("a",))).endswith("1 joints [rad]: a +0.000>")


def test_a_result():
    text = repr(Result(COMMAND, Status.DEGENERATE_PALM, 0.4567, 0.123456, 0.83))
    assert text.startswith("<Result: DEGENERATE_PALM, latency 0.457 ms, tracking loss 0.123, scale")
    assert text.endswith(f"{COMMAND!r}>")


def test_a_trajectory():
    commands = CommandTrajectory(
        np.zeros((3, 4)),
        COMMAND.joint_names,
        np.array([0.0, 0.1, 0.2]),
        np.ones(3),
        np.array([0, 1, 0]),
    )
    assert repr(commands) == "<CommandTrajectory: 3 commands, 4 joints, 0.2 s, 2 with status OK>"


def test_a_hand():
    text = "<Hand 'mimic_p050': left, 5 fingers, 20 joints, 16 actuated>"
    assert repr(load_hand("mimic_p050", "left")) == text


def test_a_status_prints_its_name_and_is_a_number():
    assert str(Status.OK) == f"{Status.OK}" == "OK"
    assert int(Status.SOLVER_FAILED) == 3
    assert f"{Status.SOLVER_FAILED:d}" == "3"

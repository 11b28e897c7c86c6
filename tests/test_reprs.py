"""What public values print as: one short line with what a person asks first."""

import numpy as np
import pytest

from smooth_operator import HandFrame, HandRecording, Result, Status, load_hand
from smooth_operator.types import CommandTrajectory, JointCommand

LANDMARKS = np.zeros((21, 3))
LOST = np.where(np.arange(21)[:, None] == 20, np.nan, LANDMARKS)
RECORDING = HandRecording(np.zeros((11, 21, 3)), np.arange(11) / 10, name="glove")
NAMES = ("a", "b", "c", "d")
COMMAND = JointCommand(np.array([0.5, -0.25, 0.0, 1.0]), NAMES, 2.5)
COMMANDS = CommandTrajectory(
    np.zeros((3, 4)), NAMES, np.array([0.0, 0.1, 0.2]), np.ones(3), np.array([0, 1, 0])
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (HandFrame(LOST, 1.5), "<HandFrame: right, stamp 1.5 s, 20 of 21 landmarks valid>"),
        (HandFrame(LANDMARKS, side="left"), "<HandFrame: left, no stamp"),
        (
            RECORDING,
            "<HandRecording 'glove': right, 11 frames, 1 s, 10 Hz, 231 of 231 landmarks valid>",
        ),
        (RECORDING[:0], "<HandRecording 'glove': right, 0 frames, 0 s, nan Hz"),
        (COMMAND, "<JointCommand: stamp 2.5 s, 4 joints [rad]: a +0.500, b -0.250, c +0.000, ...>"),
        (
            Result(COMMAND, Status.DEGENERATE_PALM, 0.4567, 0.123456, 0.83),
            "<Result: DEGENERATE_PALM, latency 0.457 ms, tracking loss 0.123, scale",
        ),
        (COMMANDS, "<CommandTrajectory: 3 commands, 4 joints, 0.2 s, 2 with status OK>"),
        (
            load_hand("mimic_p050", "left"),
            "<Hand 'mimic_p050': left, 5 fingers, 20 joints, 16 actuated>",
        ),
    ],
)
def test_a_value_prints_as_one_line(value, text):
    assert repr(value).startswith(text)


def test_a_status_prints_its_name_and_is_a_number():
    assert str(Status.OK) == f"{Status.OK}" == "OK"
    assert int(Status.SOLVER_FAILED) == 3
    assert f"{Status.SOLVER_FAILED:d}" == "3"

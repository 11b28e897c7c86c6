"""LeRobot's SO-101 by hand tracking: its real classes, and simulated servos on a serial line.

Needs LeRobot with its extras ``feetech`` and ``kinematics``, and the teleoperator, installed; CI
has a job with them (``lerobot``).
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from arm_files import so101_urdf
from lerobot_stand_in import PACKAGES, TELEOPERATOR, needs_lerobot, offline
from simulators.common import SerialLine
from simulators.feetech_bus import SYNC_WRITE, FeetechBus

from smooth_operator.simulation.arms.catalogue import ARMS

pytestmark = needs_lerobot("feetech-servo-sdk", "placo", "mink", "daqp", TELEOPERATOR)

MOTORS = (*ARMS["so101"].joint_names, "gripper")
LOW, HIGH = 500, 3500  # range of each motor, as calibrated [steps]
GOAL = 42  # address of the goal position
DEGREE = 4095 / 360  # [steps]


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[SerialLine]:
    """The six servos of an SO-101, which LeRobot has calibrated under the name ``arm``."""
    bus = FeetechBus(dict.fromkeys(range(1, 7), "sts3215"))
    calibration = {}
    for number, name in enumerate(MOTORS, start=1):
        servo = bus.servos[number]
        servo.set_word(9, LOW)
        servo.set_word(11, HIGH)
        values = {"id": number, "drive_mode": 0, "homing_offset": 0}
        calibration[name] = {**values, "range_min": LOW, "range_max": HIGH}
    folder = tmp_path / "robots" / "so_follower"
    folder.mkdir(parents=True)
    (folder / "arm.json").write_text(json.dumps(calibration))
    with SerialLine(bus) as line:
        yield line


PATIENT = """
import runpy, sys, time
import scservo_sdk
scservo_sdk.PortHandler.getCurrentTime = lambda port: 20.0 * time.time()
sys.argv = sys.argv[1:]
run = runpy.run_path if sys.argv[0].endswith(".py") else runpy.run_module
run(sys.argv[0], run_name="__main__")
"""
"""Runs a program with a fiftieth of the time on the clock [ms] of the maker's library, which waits
50 ms for a servo: a busy machine delays the simulated ones."""


def ran(words: list[str], folder: Path) -> None:
    """Runs a program with LeRobot's calibration in a folder."""
    environment = {**offline(folder), "HF_LEROBOT_CALIBRATION": str(folder)}
    command = [sys.executable, "-c", PATIENT, *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]


def goals(line: SerialLine) -> np.ndarray:
    """(t, 6) goals that the servos got, in steps."""
    sent = [body[5:-1] for body in line.device.received if body[4] == SYNC_WRITE]
    rows = []
    for parameters in sent:
        if parameters[0] == GOAL:
            items = np.frombuffer(parameters[2:], np.uint8).reshape(-1, 3).astype(int)
            assert items[:, 0].tolist() == [1, 2, 3, 4, 5, 6]
            rows.append(items[:, 1] + 256 * items[:, 2])
    return np.array(rows)


def test_one_command_teleoperates_an_so101(arm, tmp_path):
    ran(
        [
            *("lerobot.scripts.lerobot_teleoperate", "--teleop_time_s=4"),
            *("--robot.type=so101_follower", f"--robot.port={arm.port}", "--robot.id=arm"),
            *("--robot.max_relative_target=10", "--teleop.type=smooth_operator"),
            *("--teleop.arm=so101", "--teleop.source=synthetic:wrist=0.05"),
        ],
        tmp_path,
    )
    sent = goals(arm)
    assert len(sent) > 40
    middle = (LOW + HIGH) / 2
    # The arm stood in the middle of its ranges, and starts in small steps.
    assert np.abs(sent[0, :5] - 2048).max() <= 10 * DEGREE + 1
    # Body joints in degrees from the middle, within the limits of the model.
    angles = np.radians((sent[:, :5] - middle) / DEGREE)
    limits = ARMS["so101"].limits
    assert (angles > limits[:, 0] - 0.01).all()
    assert (angles < limits[:, 1] + 0.01).all()
    assert np.ptp(angles[len(angles) // 2 :], axis=0).min() > 0.02, "each joint moves"
    # The gripper in percent of its range: the operator pinches, and opens again.
    assert np.ptp(sent[:, 5]) > 0.5 * (HIGH - LOW)


def test_lerobots_own_inverse_kinematics_moves_an_so101(arm, tmp_path):
    """The example script."""
    urdf = tmp_path / "so101.urdf"
    urdf.write_text(so101_urdf())
    example = PACKAGES / TELEOPERATOR / "examples" / "so101_end_effector.py"
    words = [str(example), "--port", arm.port, "--urdf", str(urdf), "--id", "arm"]
    ran([*words, "--source", "synthetic:wrist=0.05", "--seconds", "4"], tmp_path)
    sent = goals(arm)
    assert len(sent) > 40
    # It starts where the arm stands, and moves on without jumps.
    assert np.abs(sent[0, :5] - 2048).max() < 3 * DEGREE
    assert np.ptp(sent[:, :5], axis=0).max() > 5 * DEGREE
    assert np.ptp(sent[:, 5]) > 0.5 * (HIGH - LOW)

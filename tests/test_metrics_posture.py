"""Metrics of posture on made-up hands whose figures are known on paper."""

from dataclasses import replace

import numpy as np
import pytest
from metrics_cases import human_motion, make_trace

from smooth_operator.landmarks import BASES, TIPS
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.trace import Trace

BONE = 0.03
STRAIGHT = 3 * BONE
POSTURE = (
    *("finger_extension_error", "curl_error_deg", "finger_direction_error_deg"),
    *("thumb_direction_error_deg", "spread_error_deg"),
)


def hand_with(*bends: float, count: int = 4, size: float = 1.0) -> np.ndarray:
    """(count, 21, 3) a hand that rests; its long fingers point along x, bent at base, middle and
    last joint [degrees]; the thumb points along y."""
    points = np.zeros((21, 3))
    points[1:5, 1] = 0.03 + BONE * np.arange(4)
    angles = np.radians(np.cumsum(bends))
    bones = BONE * np.stack([np.cos(angles), 0 * angles, -np.sin(angles)], axis=-1)
    chain = np.concatenate([np.zeros((1, 3)), np.cumsum(bones, axis=0)])
    for i, base in enumerate(BASES[1:]):
        points[base : base + 4] = np.array([0.09, 0.03 - 0.02 * i, 0.0]) + chain
    return np.tile(size * points, (count, 1, 1))


def trace_of(human: np.ndarray, robot: np.ndarray, size: float = 1.0) -> Trace:
    trace = make_trace(human, robot[:, list(TIPS)])
    straight = np.full(5, size * STRAIGHT)
    return replace(trace, robot_landmarks=robot, straight_lengths=straight, robot_wrist=robot[0, 0])


def test_a_copy_of_another_size_has_no_error():
    human = hand_with(20, 30, 40)
    result = evaluate(trace_of(human, hand_with(20, 30, 40, size=1.5), size=1.5))
    for name in POSTURE:
        assert result[name] == pytest.approx(0, abs=1e-5), name


def test_a_bent_finger_and_a_fist_that_does_not_close():
    result = evaluate(trace_of(hand_with(0, 0, 0), hand_with(0, 60, 0)))
    bent = np.sqrt(1 + 4 + 2 * 2 * np.cos(np.radians(60))) / 3  # two bones at 60 degrees to one
    assert result["curl_error_deg"] == pytest.approx(60)
    assert result["finger_extension_error"] == pytest.approx(1 - bent)
    assert result["flat_extension_lack"] == pytest.approx(1 - bent)
    assert result["fist_extension_excess"] is None
    assert result["thumb_direction_error_deg"] == pytest.approx(0, abs=1e-5)
    result = evaluate(trace_of(hand_with(90, 100, 60), hand_with(90, 40, 20)))
    assert result["flat_extension_lack"] is None
    assert result["fist_extension_excess"] == result["finger_extension_error"]
    assert result["fist_extension_excess"] > 0.3
    assert result["curl_error_deg"] == pytest.approx(100)


def test_directions_of_fingers_and_thumb_and_their_spread():
    human, robot = hand_with(0, 0, 0), hand_with(25, 0, 0)
    robot[:, 1:5] = robot[:, 1:2] + BONE * np.arange(4)[:, None] * np.array([0.6, 0.8, 0])
    result = evaluate(trace_of(human, robot))
    assert result["finger_direction_error_deg"] == pytest.approx(25)
    assert result["thumb_direction_error_deg"] == pytest.approx(np.degrees(np.arccos(0.8)))
    robot, turn = hand_with(0, 0, 0), np.radians(12)
    across = np.array([np.cos(turn), np.sin(turn), 0])
    robot[:, 5:9] = robot[:, 5:6] + BONE * np.arange(4)[:, None] * across  # the index finger alone
    assert evaluate(trace_of(human, robot))["spread_error_deg"] == pytest.approx(12 / 3)


def test_steps_jumps_and_stalls():
    human, robot = hand_with(0, 0, 0, count=11), hand_with(0, 0, 0, count=11)
    human[5:, 8, 0] += 0.010  # a large step of the index finger
    robot[5:, 8, 0] += 0.003
    human[8:, 12, 0] += 0.010  # and of the middle finger
    robot[8:, 12, 0] += 0.023
    result = evaluate(trace_of(human, robot))
    assert result["stalled_share"] == pytest.approx(1 / 2)
    assert result["step_gain"] == pytest.approx((0.3 + 2.3) / 2)
    assert result["jumps_per_1000"] == pytest.approx(1000 / 10)


def test_a_larger_copy_does_not_jump():
    human = hand_with(0, 0, 0, count=11)
    human[5:, 8, 0] += 0.015  # a step of the index finger
    assert evaluate(trace_of(human, 2 * human, size=2))["jumps_per_1000"] == 0  # 15 mm further
    human[0], further = np.nan, 2 * human
    further[5:, 8, 0] += 0.013
    assert evaluate(trace_of(human, further, size=2))["jumps_per_1000"] == pytest.approx(1000 / 9)
    shorter = human.copy()  # of a robot half as large, as far as the human's, as in a pinch
    assert evaluate(trace_of(human, shorter, size=0.5))["jumps_per_1000"] == 0


def opening(*parts: tuple[int, float]) -> np.ndarray:
    """(T, 21, 3) a hand whose long fingers have an extension for so many frames each."""
    bends = [np.degrees(np.arccos((9 * extension**2 - 5) / 4)) for _, extension in parts]
    return np.concatenate(
        [hand_with(0, bend, 0, count=n) for (n, _), bend in zip(parts, bends, strict=True)]
    )


def test_settling_is_the_time_to_the_humans_extension():
    human = opening((20, 0.6), (10, 0.75), (170, 1.0))  # opens within 0.1 s, at 0.3 s
    for robot, seconds in (
        (opening((30, 0.6), (170, 1.0)), 0.0),
        (opening((30, 0.6), (7, 0.8), (163, 0.97)), 0.07),
        (opening((30, 0.6), (7, 1.0), (3, 0.9), (160, 1.0)), 0.1),  # it stays only then
        (opening((30, 0.6), (170, 0.9)), 0.8),  # never
    ):
        found = evaluate(trace_of(human, robot))["settling_s"]
        assert found == pytest.approx(seconds, abs=1e-6)
    slow = opening((20, 0.6), (30, 0.75), (150, 1.0))
    assert evaluate(trace_of(slow, slow))["settling_s"] is None
    late = opening((30, 0.6), (70, 1.0))  # the run ends before the robot is open
    assert evaluate(trace_of(late, opening((100, 0.6))))["settling_s"] is None


def test_a_shift_of_all_fingers():
    human = hand_with(0, 0, 0)
    robot = human + np.where(np.arange(21)[:, None] > 0, [0.003, 0.004, 0], 0)
    assert evaluate(trace_of(human, robot))["common_shift_mm"] == pytest.approx(5)


def test_without_the_robots_points_posture_is_unknown():
    result = evaluate(make_trace(human_motion(20)))
    for name in (*POSTURE, "jumps_per_1000", "settling_s"):
        assert result[name] is None, name

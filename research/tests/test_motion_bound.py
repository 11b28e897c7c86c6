"""The bound on motion preservation of fingers with one motor."""

import itertools

import numpy as np
import pytest

from smooth_operator import HandRecording, load_hand
from smooth_operator.metrics.consistency import motion_preservation
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator_research.judging.motion_bound import (
    curve_bound,
    motion_bounds,
    single_motors,
    tip_curve,
)

pytestmark = pytest.mark.weekly

ARC = np.stack([np.cos(np.linspace(0, 1.5, 7)), np.sin(np.linspace(0, 1.5, 7)), np.zeros(7)], -1)


def test_it_is_the_best_of_all_motions():
    steps = np.random.default_rng(3).normal(0.0, 0.01, (5, 3))
    steps[2] = 0.0  # the human rests
    steps[3, 0] = np.nan
    human = np.concatenate([np.zeros((1, 3)), np.cumsum(np.nan_to_num(steps), axis=0)])[:, None]
    best = -1.0
    for ways in itertools.product(range(7), repeat=6):
        if np.abs(np.diff(ways)).max() > 2 or 0 in np.diff(ways)[[0, 1, 4]]:
            continue  # the metric leaves out rest
        found = motion_preservation(human, ARC[list(ways)][:, None])
        best = max(best, found or -1.0)
    assert curve_bound(steps, ARC, 2) == pytest.approx(best, abs=1e-12)


def test_a_human_on_the_curve_can_be_followed_and_one_across_it_cannot():
    there_and_back = ARC[[0, 1, 2, 4, 3, 1]]
    assert curve_bound(np.diff(there_and_back, axis=0), ARC, 2) == pytest.approx(1.0)
    across = np.tile([0.0, 0.0, 0.01], (4, 1))
    assert curve_bound(across, ARC, 2) == pytest.approx(0.0)
    assert curve_bound(np.zeros((4, 3)), ARC, 2) is None


def test_fingers_with_one_motor_are_found_and_their_own_motion_reaches_the_bound():
    hand = load_hand("inspire_hand")
    motors = single_motors(hand)
    assert motors[hand.fingers.index("thumb")] is None
    assert sorted(m for m in motors if m is not None) == [2, 3, 4, 5]
    assert set(single_motors(load_hand("mimic_p050"))) == {None}
    for f, motor in enumerate(motors):
        if motor is not None:
            curve = tip_curve(hand, f, motor, 5)
            assert np.linalg.norm(np.diff(curve, axis=0), axis=-1).min() > 0.005
    low, high = hand.limits.T
    share = 0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, 60))[:, None]
    landmarks = human_landmarks(hand, low + share * (high - low))
    recording = HandRecording(landmarks, np.arange(60) / 30.0, hand.spec.side)
    for finger, bound in motion_bounds(hand, recording, 121).items():
        assert bound == pytest.approx(1.0, abs=0.01), finger


def test_a_human_finger_moves_more_ways_than_one_motor():
    operator = SyntheticOperator(seed=3, rate_hz=30.0).record(4.0)
    hand = load_hand("inspire_hand")
    found = motion_bounds(hand, operator, 61)
    assert found["thumb"] == 1.0
    assert all(
        value is not None and 0.5 < value < 0.995 for f, value in found.items() if f != "thumb"
    )

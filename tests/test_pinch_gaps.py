"""Gaps that a tracker leaves in pinches: estimated at any rate, closed without a jump."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.execution import execute
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import TIPS
from smooth_operator.planning import make_request, plan
from smooth_operator.retargeting.alignment import palm_alignment
from smooth_operator.retargeting.flat_hand import FLAT_HAND
from smooth_operator.retargeting.known_gaps import MEDIAPIPE, NO_GAPS
from smooth_operator.retargeting.pinch_gaps import PinchGapEstimate, PinchGapState
from smooth_operator.retargeting.program import FrameClock
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.synthetic.tracker import tracker_model

THUMB, INDEX = TIPS[0], TIPS[1]
STEEPEST = 1 + 0.9 * 5  # slope of the closed distance, just beyond a contact
OPEN = 0.8  # distance of thumb and index finger of an open hand [palm lengths]


@pytest.fixture(scope="module")
def estimate():
    return PinchGapEstimate(load_hand("mimic_p050"))


def pinches(estimate, gaps, rate, held=0.5):
    """Landmarks of a hand that pinches with its index finger, at one distance after the other
    [palm lengths], and these distances frame by frame."""
    times = np.arange(0, len(gaps) * (1.0 + held), 1 / rate)
    phase = times % (1.0 + held)
    goal = np.asarray(gaps)[(times // (1.0 + held)).astype(int)]
    closing = np.clip(np.minimum(phase, 1.0 + held - phase) / 0.5, 0, 1)  # 0.5 s there and back
    distance = OPEN + closing * (goal - OPEN)
    points = np.repeat(
        palm_alignment(FLAT_HAND, estimate.hand).apply(FLAT_HAND)[None], len(times), 0
    )
    away = np.array([0.6, 0.0, 0.8])
    points[:, INDEX] = points[:, THUMB] + estimate.palm * distance[:, None] * away
    return points.astype(np.float32), distance


def follow(estimate, points, known, rate):
    """States and distances of thumb and index finger after the correction [palm lengths]."""

    def one(state, frame):
        after, out = estimate.step(state, frame, clock)
        return after, (after, out)

    clock = FrameClock(jnp.float32(1 / rate), jnp.bool_(False))
    start = PinchGapState.of(estimate.hand.fingers, known)
    _, (states, out) = jax.lax.scan(one, start, jnp.asarray(points))
    apart = np.asarray(out[:, INDEX] - out[:, THUMB])
    return jax.device_get(states), np.linalg.norm(apart, axis=1) / estimate.palm, np.asarray(out)


@pytest.mark.parametrize("rate", [10, 120])
def test_two_contacts_that_agree_are_a_gap(estimate, rate):
    points, distance = pinches(estimate, [0.09, 0.10, 0.09], rate)
    states, closed, _ = follow(estimate, points, NO_GAPS, rate)
    gap = states.gap[:, 0]
    third = len(points) // 3
    assert gap[third - 1] == 0  # one contact may be anything
    assert gap[2 * third] == pytest.approx(0.09, abs=0.01)
    contact = distance[2 * third :] < 0.092
    assert closed[2 * third :][contact].max() < 0.04
    assert (states.gap[:, 1:] == 0).all()  # of the other fingers nothing is known
    # led in: no frame changes the distance by more than the hand's own motion asks
    steps, own = np.abs(np.diff(closed)), np.abs(np.diff(distance))
    assert (steps <= STEEPEST * own + 0.1 / (0.3 * rate)).all()


def test_contacts_that_do_not_agree_or_lie_far_apart_are_no_gap(estimate):
    for gaps in ([0.04, 0.1, 0.04], [0.2, 0.2, 0.2]):
        points, distance = pinches(estimate, gaps, 30)
        states, closed, _ = follow(estimate, points, NO_GAPS, 30)
        assert (states.gap == 0).all()
        np.testing.assert_allclose(closed, distance, atol=1e-5)
    points, distance = pinches(estimate, [0.3], 30)
    _, _, out = follow(estimate, points, None, 30)
    np.testing.assert_array_equal(out, points)  # switched off
    points[:, INDEX - 1] = np.nan  # the bones of the finger are not known
    _, closed, _ = follow(estimate, points, MEDIAPIPE, 30)
    np.testing.assert_allclose(closed, distance, atol=1e-5)


def test_a_trackers_gap_is_closed_from_the_first_contact(estimate):
    points, distance = pinches(estimate, [0.3], 30)
    _, closed, out = follow(estimate, points, MEDIAPIPE, 30)
    assert closed[distance < 0.31].max() < 0.04
    far = distance > 0.7
    np.testing.assert_allclose(out[far], points[far], atol=1e-3)
    assert (np.diff(closed[: len(closed) // 3]) <= 0).all()  # closer stays closer
    moved = np.nonzero((np.abs(out - points) > 1e-3).any(axis=(0, 2)))[0]
    assert moved.tolist() == [THUMB, INDEX]


def test_a_thing_between_thumb_and_finger_keeps_them_apart(estimate):
    """A tracker with a gap of 0.33 shows 0.35 as 0.43, and 0.5 as 0.54."""
    held = np.array([0.35, 0.5])
    points, distance = pinches(estimate, np.cbrt(held**3 + MEDIAPIPE["index"] ** 3), 30)
    _, closed, _ = follow(estimate, points, MEDIAPIPE, 30)
    nearest = [part.min() for part in np.split(closed, 2)]
    np.testing.assert_allclose(nearest, held, atol=0.12)
    closing = slice(0, 15)
    assert (np.diff(closed[closing]) / np.diff(distance[closing])).max() <= STEEPEST


def test_a_wrong_gap_does_not_last(estimate):
    points, distance = pinches(estimate, [0.05] * 5, 30)
    states, closed, _ = follow(estimate, points, {"index": 0.33}, 30)
    assert states.gap[-1, 0] < 0.07
    opening = (distance > 0.2) & (np.arange(len(distance)) > len(distance) * 0.8)
    np.testing.assert_allclose(closed[opening], distance[opening], atol=1e-3)


def test_retargeter_starts_with_known_gaps():
    hand = load_hand("leap_hand")  # without a little finger
    retargeter = Retargeter(hand, pinch_gaps=MEDIAPIPE)
    assert retargeter.pinch_gaps() == pytest.approx({k: MEDIAPIPE[k] for k in hand.fingers[1:]})
    assert Retargeter(hand).pinch_gaps() == {}
    assert Retargeter(hand, method="sbr", pinch_gaps=MEDIAPIPE).pinch_gaps() == {}


@pytest.mark.weekly
@pytest.mark.parametrize("preset", ["teleop", "offline"])
def test_a_cameras_pinches_close_on_the_robot(preset):
    camera = tracker_model("camera")
    human = SyntheticOperator(seed=2, gestures=("pinch_index",), tracker=camera).record(6.0)
    hand, nearest = load_hand("mimic_p050"), []
    for known in ("off", "mediapipe"):
        asked = plan(human, make_request(method="smooth", preset=preset, pinch_gaps=known))
        tips = hand.tips(execute(asked).commands.joint_positions)
        nearest.append(np.linalg.norm(tips[:, 1] - tips[:, 0], axis=-1).min())
    assert nearest[0] > 0.015
    assert nearest[1] < 0.01


@pytest.mark.parametrize(
    ("known", "error"), [({"thumb": 0.1}, UnknownNameError), ({"ring": 2}, ConfigError)]
)
def test_gaps_that_no_hand_has_are_refused(estimate, known, error):
    with pytest.raises(error, match="pinch"):
        PinchGapState.of(estimate.hand.fingers, known)

"""Places of the robot's fingertips by the human's fingers."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from smooth_operator import Retargeter, load_hand
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.surfaces import tip_surface_distances
from smooth_operator.landmarks import BASES, TIPS
from smooth_operator.metrics.pinches import DEEP, TOUCH_DISTANCE
from smooth_operator.retargeting.alignment import reference_landmarks
from smooth_operator.retargeting.correspondence import Correspondence, CorrespondenceConfig
from smooth_operator.retargeting.program import FrameClock
from smooth_operator.synthetic.robot_landmarks import human_landmarks

DT = jnp.float32(1 / 60)


def operator_of(hand: Hand, size: float = 0.6) -> np.ndarray:
    """(21, 3) an operator with the robot's palm, fingers of another size, moved by 20 mm."""
    points = reference_landmarks(hand)
    for base in BASES:
        points[base : base + 4] = points[base] + size * (points[base : base + 4] - points[base])
        points[base : base + 4] += [0.0, 0.02, 0.0]
    return points.astype(np.float32)


@cache
def program(correspondence: Correspondence) -> Callable[..., Any]:
    return jax.jit(correspondence.step)


def follow(
    correspondence: Correspondence, frames: np.ndarray, restarts: tuple[int, ...] = (0,)
) -> tuple[list[np.ndarray], np.ndarray]:
    """Lengths after each frame, and (T, F, 3) places."""
    state, lengths, places = correspondence.init(), [], []
    step = program(correspondence)
    last = frames[0]
    for i, points in enumerate(frames):
        tips = jnp.asarray(points[list(TIPS)])
        steps = jnp.asarray(np.nan_to_num(points - last)[list(TIPS)])
        clock = FrameClock(jnp.float32(DT), jnp.bool_(i in restarts))
        arguments = (jnp.asarray(points), tips, steps, steps, clock)
        state, *_ = step(state, *arguments)
        lengths.append(np.asarray(state.lengths))
        places.append(np.asarray(state.places))
        last = points
    return lengths, np.stack(places)


def test_the_robots_own_hand_of_another_size_stays_where_it_is(hand):
    frames = np.tile(operator_of(hand), (5, 1, 1))
    far_apart = CorrespondenceConfig(near=0.0, far=1e-4, thumb_follows=0.0)
    correspondence = Correspondence(hand, far_apart)
    _, places = follow(correspondence, frames)
    expected = reference_landmarks(hand)
    bones = np.linalg.norm(np.diff([expected[b : b + 4] for b in BASES], axis=1), axis=-1).sum(-1)
    rays = expected[list(TIPS)] - expected[list(BASES)]
    gains = correspondence.robot[1] / bones  # a finger's bones are hardly longer than its reach
    np.testing.assert_allclose(places[-1], expected[list(BASES)] + gains[:, None] * rays, atol=2e-4)


def test_the_robots_own_landmarks_stay_where_they_are(hand):
    """An operator with the robot's own bones is followed: the thumb's length is that of its bones,
    not that of the straight thumb, which is 7 % more."""
    rng = np.random.default_rng(0)
    low, high = hand.limits.T
    poses = hand.neutral + 0.3 * (rng.uniform(low, high, (8, len(low))) - hand.neutral)
    correspondence = Correspondence(hand, CorrespondenceConfig())
    for landmarks in human_landmarks(hand, poses).astype(np.float32):
        frames = np.tile(landmarks, (3, 1, 1))
        _, places = follow(correspondence, frames)
        off = np.linalg.norm(places[-1] - landmarks[list(TIPS)], axis=-1)
        assert off.max() < 6e-3
        assert off.mean() < 2.5e-3


def test_a_finger_is_as_straight_as_its_frame_shows_it(hand):
    """Headsets stretch a finger's bones by up to a fifth from frame to frame."""
    points = operator_of(hand)
    points[8] = points[5] + 0.8 * (points[8] - points[5])  # the index finger is bent
    frames = np.tile(points, (8, 1, 1))
    for t in range(4, 8):
        frames[t, 5:9] = points[5] + 1.15 * (points[5:9] - points[5])
    calm = CorrespondenceConfig(near=0.0, far=1e-4, catch_up=100.0)
    _, places = follow(Correspondence(hand, calm), frames)
    np.testing.assert_allclose(places[-1, 1], places[0, 1], atol=1e-5)


def pinch_of(hand: Hand, apart: float) -> np.ndarray:
    """(21, 3) the hand at its neutral pose, but thumb and index fingertip so far apart [m]."""
    pinch = human_landmarks(hand, hand.neutral[None])[0]
    index, thumb = TIPS[1], TIPS[0]
    middle, across = (pinch[index] + pinch[thumb]) / 2, pinch[index] - pinch[thumb]
    across = across * apart / np.linalg.norm(across)
    pinch[index], pinch[thumb] = middle + across / 2, middle - across / 2
    return pinch


def test_pads_of_a_pinch_meet_and_stay_whole():
    """A tracker shows fingertips in contact 1 to 11 mm apart; fingers round a handle stay."""
    hand = load_hand("mimic_p050")
    retargeter = Retargeter(hand, method="smooth", rate=100.0)
    for apart in (0.001, 0.006, 0.011):
        state = retargeter.init()
        for _ in range(150):
            state, result = retargeter.step(state, pinch_of(hand, apart))
        q = result.command.joint_positions
        surfaces = tip_surface_distances(hand, q[None], np.ones((1, 4), bool))[0, 0]
        assert -DEEP < surfaces < TOUCH_DISTANCE
    handle, usual = np.tile(pinch_of(hand, 0.04), (50, 1, 1)), CorrespondenceConfig()
    places = [
        follow(Correspondence(hand, config), handle)[1]
        for config in (usual, replace(usual, press=0.0))
    ]
    np.testing.assert_allclose(places[0], places[1], atol=5e-4)


def test_unknown_landmarks_leave_the_lengths(hand):
    frames = np.tile(operator_of(hand), (20, 1, 1))
    frames[10:, 6] = np.nan  # a joint of the index finger, not its tip
    lengths, places = follow(Correspondence(hand, CorrespondenceConfig()), frames)
    np.testing.assert_array_equal(lengths[-1], lengths[9])
    assert np.isfinite(places).all()


def pinch(hand: Hand, count: int = 400) -> np.ndarray:
    """The index finger turns until its tip meets the thumb's, and back, evenly; the last half of
    the frames settled."""
    points = operator_of(hand)
    frames = np.tile(points, (count, 1, 1))
    way = 0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, count // 2))
    to = points[TIPS[0]] - points[TIPS[1]]
    for joint in range(1, 4):
        moved = joint / 3 * way[:, None] * to
        frames[count // 2 :, BASES[1] + joint] += moved.astype(np.float32)
    return frames


def test_a_pinch_closes_and_has_no_jump(hand):
    calm = CorrespondenceConfig(catch_up=100.0)
    _, places = follow(Correspondence(hand, calm), pinch(hand))
    moving = places[210:]
    steps = np.diff(moving, axis=0)
    human = np.linalg.norm(np.diff(pinch(hand)[210:, TIPS[1]], axis=0), axis=-1).max()
    assert np.linalg.norm(steps, axis=-1).max() < 4 * human
    assert np.linalg.norm(np.diff(steps, axis=0), axis=-1).max() < 0.25 * human  # of velocity
    closed = np.linalg.norm(places[300, 1] - places[300, 0])
    assert closed < 5e-4


def test_a_finger_that_opens_within_three_frames_is_in_its_place_at_once(hand):
    """Its place goes as far beyond the human's step as the robot's finger is longer."""
    points = operator_of(hand)
    frames = np.tile(points, (12, 1, 1))
    folded = np.linspace(0.3, 1.0, 4)[:, None]
    for t in range(12):
        share = folded[min(max(t - 5, 0), 3)]
        frames[t, 8] = points[5] + share * (points[8] - points[5])
    _, places = follow(Correspondence(hand, CorrespondenceConfig(catch_up=0.01)), frames)
    np.testing.assert_allclose(places[8, 1], places[-1, 1], atol=2e-3)

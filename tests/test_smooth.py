"""The method ``smooth`` as a whole: what it promises, whatever its settings are tuned to."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest
from trees import limited_poses

from smooth_operator import Hand, HandFrame, HandRecording, Retargeter, SyntheticOperator
from smooth_operator.errors import ConfigError
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.landmarks import LANDMARKS, TIPS
from smooth_operator.retargeting import smooth as smooth_module
from smooth_operator.retargeting.fingertip_filter import FingertipFilterConfig
from smooth_operator.retargeting.levenberg import damped_newton
from smooth_operator.retargeting.smooth import SMOOTH_TELEOP
from smooth_operator.retargeting.smooth_terms import SelfCollisionConfig

RATE = 115.0


def landmarks_of(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(T, 21, 3) a human hand that is the robot's, at poses of the actuated joints."""
    out = np.zeros((len(q), 21, 3))
    out[:, [LANDMARKS.index(name) for name in hand.tree.names]] = hand.landmark_positions(q)
    return out


def recording(landmarks: np.ndarray, rate: float = RATE) -> HandRecording:
    return HandRecording(landmarks, np.arange(len(landmarks)) / rate, "right")


def commands(retargeter: Retargeter, of: HandRecording) -> np.ndarray:
    """(T, n) joint positions of a run."""
    state, out = retargeter.init(), []
    for frame in (of[i] for i in range(len(of))):
        state, result = retargeter.step(state, frame)
        out.append(result.command.joint_positions)
    return np.stack(out)


@pytest.fixture(scope="module")
def smooth() -> Retargeter:
    return Retargeter(method="smooth")


@pytest.fixture(scope="module")
def bare() -> Retargeter:
    """Without the damping of a pinch, the self-collision cost and the filter of fingertips."""
    config = replace(
        SMOOTH_TELEOP,
        pinch_damping=0.0,
        self_collision=SelfCollisionConfig(weight=0.0),
        fingertips=FingertipFilterConfig(share=1.0),
    )
    return Retargeter(config=config)


@pytest.fixture(scope="module")
def motion(hand) -> HandRecording:
    """Within the robot's reach, and back: 150 frames."""
    low, high = hand.limits.T
    ends = 0.7 * hand.neutral + 0.3 * limited_poses(np.random.default_rng(0), hand.limits, 6)
    ends = np.clip(ends, low, high)
    at = np.linspace(0, 5, 150)
    blend = 0.5 - 0.5 * np.cos(np.pi * (at % 1.0))
    first = np.minimum(at.astype(int), 4)
    q = ends[first] + blend[:, None] * (ends[first + 1] - ends[first])
    return recording(landmarks_of(hand, q))


@pytest.fixture(scope="module")
def answer(smooth, motion) -> np.ndarray:
    return commands(smooth, motion)


def test_a_pinch_moves_less_and_opens_on_time(smooth, bare, hand):
    still = landmarks_of(hand, np.tile(hand.neutral, (140, 1)))
    t = np.arange(140) / RATE
    closed = np.clip(t / 0.3, 0, 1) * np.clip((1.0 - t) / 0.1, 0, 1)
    thumb, index, ring = TIPS[0], TIPS[1], TIPS[3]
    meet = still[:, thumb] + 0.5 * (still[:, index] - still[:, thumb])
    moving = 0.012 * np.sin(2 * np.pi * 2 * np.clip(t - 0.35, 0, None))[:, None] * [0, 0, 1.0]
    for tip in (thumb, index):
        still[:, tip] += 0.95 * closed[:, None] * (meet - still[:, tip]) + moving
    still[:, ring] += moving

    held = (t > 0.5) & (t < 0.88)

    def span(points: np.ndarray) -> float:
        return float(np.linalg.norm(np.ptp(points[held], axis=0)))

    follows = hand.tips(commands(bare, recording(still)))
    holds = hand.tips(commands(smooth, recording(still)))
    assert span(holds[:, :2].mean(axis=1)) < 0.85 * span(follows[:, :2].mean(axis=1))
    assert span(holds[:, 3]) > 0.8 * span(follows[:, 3])  # the ring finger is free
    gap = np.linalg.norm(holds[:, 1] - holds[:, 0], axis=-1)
    assert gap[held].max() < 0.012 < 0.02 < gap[t > 1.15].min()


@pytest.mark.parametrize("rate", [30.0, 100.0])
def test_a_rate_stands_in_for_stamps(motion, rate):
    """Video frames one by one are what the stamped recording of them is, bit for bit."""
    landmarks = motion.landmarks[:30]
    stamped, _ = Retargeter(method="smooth").run(recording(landmarks, rate=rate))
    counting = Retargeter(method="smooth", rate=rate)
    state, stepped = counting.init(), []
    for points in landmarks:
        state, result = counting.step(state, points)
        stepped.append(result.command)
    called = [counting(points).command for points in landmarks]
    for commands in (stepped, called):
        positions = [command.joint_positions for command in commands]
        np.testing.assert_array_equal(positions, stamped.joint_positions)
        np.testing.assert_allclose([c.stamp for c in commands], stamped.stamps, atol=1e-9)


def test_a_call_without_a_stamp_is_of_its_moment(motion):
    """Frames of a 30 Hz camera, given when they come, are those that bear these times."""
    landmarks = motion.landmarks[:30]
    times = 5.0 + np.arange(30) / 30.0
    clock = iter(times)
    live = Retargeter(method="smooth", clock=lambda: next(clock))
    called = [live(points).command for points in landmarks]
    stamped, _ = Retargeter(method="smooth").run(HandRecording(landmarks, times, "right"))
    np.testing.assert_array_equal([c.joint_positions for c in called], stamped.joint_positions)
    assert [c.stamp for c in called] == times.tolist()
    # and it matters: as frames of 100 Hz they are another motion
    hurried, _ = Retargeter(method="smooth").run(recording(landmarks, rate=100.0))
    assert np.abs(hurried.joint_positions - stamped.joint_positions).max() > 0.01


def test_a_step_without_time_is_refused(motion):
    retargeter = Retargeter(method="smooth")
    for frame in (motion.landmarks[0], HandFrame(motion.landmarks[0])):
        with pytest.raises(ConfigError, match=r"no timestamp, and step\(\) has no clock.*rate=30"):
            retargeter.step(retargeter.init(), frame)
    retargeter(motion.landmarks[0])
    with pytest.raises(ConfigError, match=r"with and without timestamps are mixed.*reset\(\)"):
        retargeter(motion[1])
    retargeter.reset()
    assert retargeter(motion[1]).command.stamp == motion[1].stamp
    for rate in (0.0, -30.0, 5000.0, np.nan):
        with pytest.raises(ConfigError, match="rate must be 1 to 2000"):
            Retargeter(method="smooth", rate=rate)


def test_a_time_of_day_is_as_good_as_a_small_one(smooth, motion, answer):
    late = HandRecording(motion.landmarks[:30], motion.stamps[:30] + 1.7e9, "right")
    np.testing.assert_allclose(commands(smooth, late), answer[:30], atol=2e-3)


@pytest.fixture(scope="module")
def leap() -> Retargeter:
    return Retargeter("leap_hand")


POSES = SyntheticOperator(seed=3, rate_hz=10).record(30.0).landmarks
"""Poses of a human hand in all gestures."""


@pytest.mark.parametrize(
    "pair",
    [
        *[(201, 241), (39, 13), (198, 18)],
        *(
            pytest.param(pair, marks=pytest.mark.weekly)
            for pair in [(287, 166), (56, 19), (91, 5), (233, 212), (230, 4)]
        ),
    ],
)
def test_one_slip_of_the_tracker_does_not_last(leap, pair):
    """It jumps to another pose and stays there: 1.5 s later the hand is where it would have begun.
    Fingers used to stay where a descent from the old pose ended, up to 1.7 rad off."""
    before, after = POSES[list(pair)]
    slipped = commands(leap, recording(np.stack([before] * 20 + [after] * 150), 100.0))[-1]
    fresh = commands(leap, recording(np.stack([after] * 40), 100.0))[-1]
    assert np.abs(slipped - fresh).max() < 0.3
    assert np.linalg.norm(leap.hand.tips(slipped) - leap.hand.tips(fresh), axis=-1).max() < 0.008


def test_labels_of_fingers_that_swap_for_a_moment_leave_nothing(leap):
    """A tracker that takes each finger for another for 50 ms, and then goes on as before: a second
    later the fingertips are nearly where they would be. They used to be up to 39 mm off."""
    swapped = np.r_[0:5, 17:21, 13:17, 9:13, 5:9]
    moving = SyntheticOperator(seed=3).record(6.0).landmarks
    for at in (250, 400):
        right, wrong = moving[at - 60 : at + 101], moving[at - 60 : at + 101].copy()
        wrong[60:65] = wrong[60:65][:, swapped]
        ends = [leap.hand.tips(commands(leap, recording(p, 100.0))[-1]) for p in (right, wrong)]
        assert np.linalg.norm(ends[0] - ends[1], axis=-1).max() < 0.011


@pytest.fixture(scope="module")
def descents() -> Iterator[tuple[Retargeter, list[int]]]:
    """A retargeter that counts: Newton steps of each descent in a frame."""
    steps: list[int] = []

    def counted(*arguments: Any) -> Any:
        result = damped_newton(*arguments)
        jax.debug.callback(lambda count: steps.append(int(count)), result[2])
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(smooth_module, "damped_newton", counted)
        config = replace(SMOOTH_TELEOP, motion_speed=0.051)  # a program of its own
        retargeter = Retargeter("leap_hand", config=config)
        retargeter.warm_up()
        yield retargeter, steps


def steps_of(descents: tuple[Retargeter, list[int]], of: HandRecording) -> list[list[int]]:
    """Newton steps of each descent, frame by frame."""
    retargeter, steps = descents
    state, out = retargeter.init(), []
    for frame in (of[i] for i in range(len(of))):
        steps.clear()
        state, _ = retargeter.step(state, frame)
        jax.effects_barrier()
        out.append(steps.copy())
    return out


def test_a_refused_frame_is_not_solved(descents):
    """Landmarks that are no hand would take a solver longest."""
    wrong = [POSES[0], *(np.random.default_rng(0).normal(0, 0.5, (10, 21, 3))), POSES[0]]
    steps = steps_of(descents, recording(np.stack(wrong)))
    assert steps[1:-1] == [[]] * 10
    assert steps[0]
    assert steps[-1]


def test_the_steps_of_a_frame_are_bounded_whatever_comes(descents):
    rng = np.random.default_rng(0)
    poses = POSES[rng.integers(len(POSES), size=60)] + rng.normal(0, 0.004, (60, 21, 3))
    after_gaps = HandRecording(poses, np.arange(60) * 0.3, "right")
    for frames in (after_gaps, recording(poses)):
        steps = steps_of(descents, frames)
        assert max(map(sum, steps)) <= 4 * SMOOTH_TELEOP.iterations
    # a hand that moves on pays for one descent, and hardly any step
    steadily = SyntheticOperator(seed=1).record(0.8)
    usual = steps_of(descents, steadily)[1:]
    assert max(map(len, usual)) == 1
    assert np.median([sum(each) for each in usual]) <= 6


def test_after_a_gap_nothing_of_the_past_counts(leap):
    """Once an operator's lengths are known, a frame after a gap has one answer."""
    known, ends = leap.init(), []
    for i, pose in enumerate(np.random.default_rng(2).integers(len(POSES), size=200)):
        known, _ = leap.step(known, HandFrame(POSES[pose], i / 100))
    for last in (POSES[10], POSES[150], POSES[260]):
        state = known
        for i, points in enumerate([*[last] * 10, POSES[80]]):
            state, _ = leap.step(state, HandFrame(points, 2.0 + i / 100 + (i == 10)))
        ends.append(np.asarray(state.method.q))
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, atol=0.02)


def crossing(hand: Hand) -> HandRecording:
    """The index and middle tips change places, sideways: 60 frames."""
    q = np.tile(hand.neutral, (60, 1))
    landmarks = landmarks_of(hand, q)
    index, middle = landmarks[0, TIPS[1]], landmarks[0, TIPS[2]]
    share = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0, 1, 60))[:, None]
    landmarks[:, TIPS[1]] = index + 0.8 * share * (middle - index)
    landmarks[:, TIPS[2]] = middle + 0.8 * share * (index - middle)
    return recording(landmarks)


def test_the_self_collision_cost_keeps_fingers_out_of_each_other(smooth, bare, hand):
    frames = crossing(hand)
    deep, clear = (penetration_depths(hand, commands(r, frames)) for r in (bare, smooth))
    assert deep.max() > 0.004
    assert clear.max() < 0.0025

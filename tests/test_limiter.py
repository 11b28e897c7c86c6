"""The limits hold between any two stamps: uneven steps, coupled joints, stops, new limits."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smooth_operator import Hand, Retargeter, load_hand
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.runtime.limiter import (
    EXTRA,
    LONGEST,
    MAX_STEP_S,
    SHORTEST,
    JointLimiter,
    Limiter,
    PoseLimiter,
    RateLimiter,
)
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LimitsConfig, LoopConfig, WristConfig
from smooth_operator.teleop.sinks.tick import Mode
from smooth_operator.teleop.sources.live import Arrival, Mailbox

GEARED = {"schunk_svh": 1.44889, "inspire_hand": 1.334, "ability_hand": 1.05851}
"""Hands of which a coupled joint moves faster than the one that it follows, and by how much."""


@functools.cache
def loaded(name: str = "mimic_p050") -> Hand:
    return load_hand(name)


def excess(
    hand: Hand, limits: LimitsConfig, times: Sequence[float], q: Sequence[np.ndarray]
) -> dict[str, float]:
    """Relative excess of the worst pair of commands over each limit, of all joints.

    Velocity changes are held against the shorter of the step and the time between the middles of
    the step and the one before it.
    """
    every, dt = hand.full_configuration(np.array(q)), np.diff(times)[:, None]
    low, high = hand.joint_limits.T
    velocity = np.diff(every, axis=0) / dt
    apart = np.minimum(dt[1:], (dt[1:] + dt[:-1]) / 2)
    return {
        "range": float(np.maximum(low - every, every - high).max()),
        "velocity": float(np.abs(velocity).max() / limits.velocity - 1),
        "acceleration": float(
            (np.abs(np.diff(velocity, axis=0)) / apart).max() / limits.acceleration - 1
        ),
    }


class Path:
    """Commands of a limiter at uneven times."""

    def __init__(self, hand: Hand, limits: LimitsConfig) -> None:
        self.hand, self.limits, self.limiter = hand, limits, Limiter(hand, limits)
        self.times, self.q = [0.0], [self.limiter.q]

    def step(self, target: np.ndarray | None, dt: float, velocity: float | None = None) -> None:
        """One command towards a target, or to rest where it is None."""
        self.times.append(self.times[-1] + dt)
        dt = self.times[-1] - self.times[-2]  # as rounded
        rest = target is None
        q = self.limiter.rest(dt) if rest else self.limiter.step(target, dt, velocity)
        self.q.append(q)

    def excess(self) -> dict[str, float]:
        """Excess over the limits, which is none."""
        over = excess(self.hand, self.limits, self.times, self.q)
        assert max(over.values()) < 1e-6, over
        return over


STEPS = st.one_of(
    st.floats(1e-4, 0.02),  # what a loop does
    st.sampled_from([0.0125, 0.0014, 0.0025]),  # a 72 Hz headset between commands of the pace
    st.floats(0.02, 3.0),  # it was stopped and goes on
)
TARGETS = st.one_of(
    st.floats(-0.5, 1.5),  # share of the range, and beyond
    st.sampled_from([0.0, 1.0, float("nan"), float("inf")]),
)


@settings(max_examples=150, deadline=None)
@given(
    name=st.sampled_from(["mimic_p050", *GEARED]),
    limits=st.builds(
        LimitsConfig, st.floats(1.0, 20.0), st.floats(20.0, 3000.0), st.sampled_from([0.0, 0.02])
    ),
    moves=st.lists(
        st.tuples(
            STEPS,
            TARGETS,
            st.sampled_from(["step", "step", "step", "ease", "rest"]),
            st.integers(1, 6),
        ),
        min_size=2,
        max_size=25,
    ),
)
def test_limits_hold_at_every_pair_of_stamps(name, limits, moves):
    path = Path(loaded(name), limits)
    low, high = path.hand.limits.T
    for dt, share, kind, count in moves:
        target = None if kind == "rest" else low + share * (high - low)
        for _ in range(count):
            path.step(target, dt, 1.0 if kind == "ease" else None)
    path.excess()


@pytest.mark.parametrize("steps", [(0.0125, 0.0014), (0.0025, 0.01, 0.0175), (1e-3,), (0.5, 2e-3)])
def test_limits_hold_with_targets_at_the_ends_of_the_range(steps):
    """Full speed into the end, then a short step: what an audit found at 5 times the limit."""
    hand, rng = loaded(), np.random.default_rng(1)
    for limits in (LimitsConfig(), LimitsConfig(velocity=5.0, acceleration=100.0)):
        path, (low, high) = Path(hand, limits), hand.limits.T
        for k in range(600):
            if k % 40 == 0:
                target = np.where(rng.random(len(low)) < 0.5, low - 1, high + 1)
            path.step(target, rng.choice(steps) if len(steps) == 3 else steps[k % len(steps)])
        path.excess()
        travelled = np.ptp(np.array(path.q), axis=0) / (high - low)
        assert np.median(travelled) > 0.5  # and it moves


@pytest.mark.parametrize("name", GEARED)
def test_a_geared_joint_keeps_the_limits_and_uses_them(name):
    hand, limits = loaded(name), LimitsConfig(velocity=3.0, acceleration=100.0)
    assert np.abs(hand.transmission.matrix).max() == pytest.approx(GEARED[name], abs=1e-4)
    path = Path(hand, limits)
    for k in range(400):
        path.step(hand.limits[:, (k // 100) % 2], 0.01)
    over = path.excess()
    # the fastest follower is what the limit is for: it reaches it
    assert over["velocity"] > -1e-6
    assert over["acceleration"] > -1e-6


def test_a_target_that_moves_is_followed_exactly_with_uneven_steps():
    hand, rng = loaded(), np.random.default_rng(3)
    middle, half = hand.limits.mean(axis=1), np.diff(hand.limits, axis=1)[:, 0] / 2
    limiter, t = Limiter(hand, LimitsConfig()), 0.0
    for _ in range(200):
        limiter.step(middle, 0.01)
    fastest = 0.0
    for _ in range(400):
        dt = rng.uniform(0.004, 0.0125)
        t += dt
        target = middle + 0.9 * half * np.sin(2 * np.pi * 0.9 * t)
        np.testing.assert_allclose(limiter.step(target, dt), target, atol=1e-9)
        fastest = max(fastest, np.abs(limiter.velocity).max())
    assert fastest > 4.0  # rad/s: a fist in a fifth of a second


@pytest.mark.parametrize(("steps", "overshoot"), [((0.01,), 1e-9), ((0.0025, 0.01, 0.0175), 0.015)])
def test_a_jump_is_reached_in_time_with_little_overshoot(steps, overshoot):
    hand, rng = loaded(), np.random.default_rng(5)
    low, high = hand.limits.T
    for _ in range(20):
        path, target = Path(hand, LimitsConfig()), rng.uniform(low + 0.2, high - 0.2)
        for _ in range(60):
            path.step(target, rng.choice(steps))
        start, off = path.q[0], np.array(path.q) - target
        assert (np.sign(target - start) * off).max() < overshoot
        np.testing.assert_allclose(path.q[-1], target, atol=1e-9)
        # no slower than the physics of it: accelerate, cruise, brake
        limits = path.limits
        needed = np.abs(target - start).max() / limits.velocity
        needed += limits.velocity / limits.acceleration
        arrived = path.times[int(np.argmax(np.abs(off).max(axis=1) < 1e-3))]
        assert arrived < needed + 0.05


def test_a_pause_is_not_caught_up_with_and_its_velocity_is_what_was_seen():
    path = Path(loaded(), LimitsConfig(velocity=5.0, acceleration=200.0))
    for dt in [0.01] * 8 + [2.0] + [0.0025] * 40:
        path.step(path.hand.limits[:, 1], dt)
    path.excess()
    assert np.abs(path.q[9] - path.q[8]).max() <= path.limits.velocity * MAX_STEP_S + 1e-9


def test_an_emergency_stop_brakes_within_the_limits_and_then_stands():
    """In every mode: the stop itself, at any moment and pace, and the release."""
    hand = loaded()
    limits = LimitsConfig(velocity=10.0, acceleration=200.0)
    retargeter = Retargeter(hand, method="joint_angle")
    frames = list(SyntheticOperator(seed=4, rate_hz=100).record(6.0))
    now = 50.0
    pipeline = HandPipeline(
        retargeter, replace(LoopConfig(rate=100.0), limits=limits), clock=lambda: now
    )
    rng, ticks = np.random.default_rng(0), []
    for k, frame in enumerate(frames):
        now += rng.choice([0.002, 0.01, 0.016])
        if k % 50 == 30:
            pipeline.supervisor.stop()
        elif k % 50 == 45:
            pipeline.supervisor.release()
        # leaps: another pose every few frames
        shown = replace(frames[(k * 37) % len(frames) if k % 9 < 5 else k], stamp=frame.stamp)
        ticks.append(pipeline.step(now, Arrival(shown, now)))
    q = [tick.command.joint_positions[list(hand.actuated)] for tick in ticks]
    over = excess(hand, limits, [tick.time for tick in ticks], q)
    assert max(over.values()) < 1e-6, over
    stops = [ticks[k : k + 15] for k in range(30, len(ticks) - 15, 50)]
    assert all(t.mode is Mode.STOPPED for stop in stops for t in stop)
    assert max(np.abs(stop[0].velocity).max() for stop in stops) > 0  # some were fast, and braked
    assert all((t.velocity == 0).all() for stop in stops for t in stop[-3:])
    way = [t.command.joint_positions - s[0].command.joint_positions for s in stops for t in s]
    assert np.abs(way).max() < 10.0**2 / 200.0 + 10.0 * 0.016


PERIOD = 0.01
SLACK = 1e-9
SPAN = 8.0


@dataclass
class Played:
    """Times of commands; time of a command that answers a frame -> arrival of the frame [s]."""

    commands: list[float] = field(default_factory=list)
    answered: dict[float, float] = field(default_factory=dict)

    def ages(self) -> np.ndarray:
        """Ages of the frames at their answers [s]."""
        return np.array([at - came for at, came in self.answered.items()])


FRAME = next(iter(SyntheticOperator(seed=1).record(0.05)))


def played(arrivals: np.ndarray, end: float, period: float = PERIOD) -> Played:
    """The loop's own rules over a simulated time, with the loop's own mailbox."""
    now = 0.0
    mailbox = Mailbox(lambda: now)
    pace, result, coming = RateLimiter(period), Played(), iter([*arrivals.tolist(), np.inf])
    pace.begin(now)
    comes = next(coming)
    while True:
        newest, following = mailbox.newest("right"), mailbox.following("right")
        due = pace.keeps(following)
        if newest is not None:
            due = max(pace.answers(newest.received, following), pace.opens)
        if comes <= due:  # it came first
            now = comes
            mailbox.post(FRAME)
            comes = next(coming)
            continue
        now = max(now, due)
        if now >= end:
            return result
        taken = mailbox.take("right")
        result.commands.append(now)
        if taken is not None:
            result.answered[now] = taken.received
        pace.take(now)


def most(times: list[float], within: float) -> int:
    """Most commands in any window of this length [s]."""
    at = np.array(times)
    return int((np.searchsorted(at, at + within, "right") - np.arange(len(at))).max(initial=0))


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(0.0, 0.06), max_size=250),
    st.sampled_from([0.002, 0.01, 0.05]),
    st.floats(0.001, 1.0),
)
def test_the_rate_is_a_bound_whatever_comes(gaps, period, window):
    result = played(np.cumsum(gaps), min(sum(gaps) + 0.2, 3.0), period)
    between = np.diff(result.commands)
    assert most(result.commands, window) <= window / period + EXTRA + SLACK
    assert np.all(between >= SHORTEST * period - SLACK)
    assert np.all(between <= LONGEST * period + SLACK)


@pytest.mark.parametrize("rate", [20.0, 100.0])
@pytest.mark.parametrize("tracker", [30.0, 60.0, 72.0, 100.0, 240.0, 1000.0])
@pytest.mark.parametrize("jitter", [0.0, 0.15])
def test_the_rate_holds_and_frames_stay_fresh(rate, tracker, jitter):
    rng = np.random.default_rng(0)
    even = np.arange(0.003, SPAN, 1 / tracker)
    arrivals = np.sort(even + jitter / tracker * rng.uniform(size=len(even)))
    result = played(arrivals, SPAN, 1 / rate)
    # the rate, be the tracker faster or slower
    assert len(result.commands) / SPAN == pytest.approx(rate, rel=0.02)
    assert most(result.commands, 1.0) <= rate + EXTRA
    # as many frames as there are turns for
    assert len(result.answered) / SPAN >= 0.98 * min(rate, tracker)
    # An even pace would let frames wait for half of the tracker's period, on the average.
    assert result.ages().mean() < 0.22 / tracker
    if tracker <= rate:
        assert np.percentile(result.ages(), 95) < 0.1 / tracker


def test_in_silence_commands_keep_the_rate():
    commands = played(np.array([]), 5.0).commands
    assert len(commands) == pytest.approx(5.0 / PERIOD, abs=1)
    np.testing.assert_allclose(np.diff(commands), PERIOD, rtol=1e-9)


def test_a_tracker_at_the_pace_is_answered_as_it_comes():
    even, rng = np.arange(500) * PERIOD, np.random.default_rng(0)
    result = played(even + rng.uniform(0, 0.15 * PERIOD, 500), 5.0)
    assert result.ages().max() < SLACK
    assert len(result.commands) == len(even)
    even[100] += 0.7 * PERIOD  # its successor comes 0.3 periods behind it, and does not wait
    assert played(even, 5.0).ages().max() < SLACK


def test_of_a_stall_half_a_turn_is_made_up_for():
    pace, left = RateLimiter(1.0), []
    pace.begin(0.0)
    for now in (0.0, 10.0):  # a stall of ten turns, and then as many commands as may leave
        pace.take(now)
    for _ in range(5):
        left.append(pace.opens - 10.0)
        pace.take(pace.opens)
    assert left == [0.25, 0.75, 1.75, 2.75, 3.75]


@pytest.mark.parametrize("excess", [0.0, 0.0005, 0.005])
@pytest.mark.parametrize("stall", [0.7, 1.2, 3.0])
def test_a_wait_that_a_stall_left_behind_does_not_stay(stall, excess):
    arrivals = np.arange(3000) * PERIOD / (1 + excess)
    for at in (200, 700, 701, 1100):  # nothing comes for a while, then all of it comes late
        arrivals[at : at + 5] += stall * PERIOD
        arrivals[at : at + 5] = np.maximum(
            arrivals[at : at + 5], arrivals[at] + 1e-4 * np.arange(5)
        )
    arrivals = np.sort(arrivals)
    result = played(arrivals, arrivals[-1])
    ages = result.ages() / PERIOD
    assert np.percentile(ages, 99) < 0.1 + SLACK
    assert np.percentile(ages[1200:], 99.9) < 0.1 + SLACK  # half a period when none was replaced
    assert len(ages) > 0.985 * len(arrivals)


def test_half_the_frames_of_a_tracker_twice_as_fast_are_answered_as_they_come():
    result = played(np.arange(0.0, 5.0, PERIOD / 2), 5.0)
    assert np.all(result.ages()[5:] < SLACK)
    assert np.isclose(np.diff(result.commands), PERIOD).mean() > 0.98


def test_a_command_that_keeps_the_pace_waits_for_a_frame_that_is_due():
    # of a headset at 72 Hz and commands at 100: none leaves just before a frame, whose turn it took
    result = played(np.arange(0.0, 5.0, 1 / 72), 5.0)
    frames, others = [], []
    for before, at in zip(result.commands, result.commands[1:], strict=False):
        (frames if at in result.answered else others).append(at - before)
    assert min(frames[5:]) > 0.5 * PERIOD
    assert result.ages()[5:].max() < SLACK


def test_a_state_that_was_set_from_outside_does_not_leave_the_range():
    """The limiter itself never comes to such a speed so near to an end."""
    ends = np.array([[-1.0, 1.0]] * 2)
    limiter = JointLimiter(ends, np.full(2, 10.0), np.full(2, 50.0), np.zeros(2))
    limiter.q, limiter.velocity = np.array([0.99, -0.99]), np.array([10.0, -10.0])
    for _ in range(20):
        assert np.abs(limiter.step(np.array([1.0, -1.0]), PERIOD)).max() <= 1.0
    wrist = PoseLimiter(WristConfig())
    wrist.pose = np.array([0.99, -0.99, 1.49, 1.0, 0.0, 0.0, 0.0])
    wrist.velocity = np.array([1.0, -1.0, 1.0])
    for _ in range(20):
        place = wrist.step(np.array([1.0, -1.0, 1.5, 1.0, 0.0, 0.0, 0.0]), 0.1)[:3]
        assert (place <= WristConfig().high).all()
        assert (place >= WristConfig().low).all()


def test_an_emergency_stop_waits_for_nothing_and_delays_what_follows_only_so_far():
    pace = RateLimiter(PERIOD)
    pace.begin(0.0)
    for _ in range(200):  # stopped and released again and again within a moment
        pace.take(0.5)
    assert pace.opens <= 0.5 + LONGEST * PERIOD
    assert pace.keeps(None) <= 0.5 + LONGEST * PERIOD + SLACK


def test_the_mailbox_knows_when_the_next_frame_is_expected():
    now = 0.0
    mailbox = Mailbox(lambda: now)
    assert mailbox.following("right") is None
    for now in (1.0, 1.01, 1.02, 1.03, 1.5, 1.51):  # a gap once is no new pace
        mailbox.post(replace(FRAME, stamp=now))
    assert mailbox.following("right") == pytest.approx(1.52)
    assert mailbox.following("left") is None

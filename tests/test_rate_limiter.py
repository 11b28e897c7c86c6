"""When commands leave: never more than the rate, frames as they come, the pace where none come."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.runtime.limiter import EXTRA, LONGEST, SHORTEST, RateLimiter
from smooth_operator.teleop.sources.live import Mailbox
from smooth_operator.types import HandFrame

PERIOD = 0.01
SLACK = 1e-9
SPAN = 8.0


@dataclass
class Played:
    """What left: commands, and of those that answer a frame when it had come [s]."""

    commands: list[float] = field(default_factory=list)
    answered: dict[float, float] = field(default_factory=dict)

    def ages(self) -> np.ndarray:
        """Of the frames when they were answered [s]."""
        return np.array([at - came for at, came in self.answered.items()])


def frame() -> HandFrame:
    return next(iter(SyntheticOperator(seed=1).record(0.05)))


FRAME = frame()


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
def test_the_rate_is_a_bound_whatever_comes(
    gaps: list[float], period: float, window: float
) -> None:
    result = played(np.cumsum(gaps), min(sum(gaps) + 0.2, 3.0), period)
    between = np.diff(result.commands)
    assert most(result.commands, window) <= window / period + EXTRA + SLACK
    assert np.all(between >= SHORTEST * period - SLACK)
    assert np.all(between <= LONGEST * period + SLACK)


@pytest.mark.parametrize("rate", [10.0, 20.0, 50.0, 100.0])
@pytest.mark.parametrize("tracker", [30.0, 60.0, 72.0, 100.0, 120.0, 240.0, 1000.0])
@pytest.mark.parametrize("jitter", [0.0, 0.15])
def test_the_rate_holds_and_frames_stay_fresh(rate: float, tracker: float, jitter: float) -> None:
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


def test_in_silence_commands_keep_the_rate() -> None:
    commands = played(np.array([]), 5.0).commands
    assert len(commands) == pytest.approx(5.0 / PERIOD, abs=1)
    np.testing.assert_allclose(np.diff(commands), PERIOD, rtol=1e-9)


def test_a_tracker_at_the_pace_is_answered_as_it_comes() -> None:
    rng = np.random.default_rng(0)
    arrivals = np.arange(500) * PERIOD + rng.uniform(0, 0.15 * PERIOD, 500)
    result = played(arrivals, 5.0)
    assert result.ages().max() < SLACK
    assert len(result.commands) == len(arrivals)


def test_frames_that_were_held_up_do_not_hold_up_the_next() -> None:
    arrivals = np.arange(200) * PERIOD
    arrivals[100] += 0.7 * PERIOD  # its successor comes 0.3 periods behind it
    assert played(arrivals, 2.0).ages().max() < SLACK


def test_of_a_stall_half_a_turn_is_made_up_for() -> None:
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
def test_a_wait_that_a_stall_left_behind_does_not_stay(stall: float, excess: float) -> None:
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


def test_half_the_frames_of_a_tracker_twice_as_fast_are_answered_as_they_come() -> None:
    result = played(np.arange(0.0, 5.0, PERIOD / 2), 5.0)
    assert np.all(result.ages()[5:] < SLACK)
    assert np.isclose(np.diff(result.commands), PERIOD).mean() > 0.98


def test_a_command_that_keeps_the_pace_waits_for_a_frame_that_is_due() -> None:
    # of a headset at 72 Hz and commands at 100: none leaves just before a frame, whose turn it took
    result = played(np.arange(0.0, 5.0, 1 / 72), 5.0)
    frames, others = [], []
    for before, at in zip(result.commands, result.commands[1:], strict=False):
        (frames if at in result.answered else others).append(at - before)
    assert min(frames[5:]) > 0.5 * PERIOD
    assert result.ages()[5:].max() < SLACK


def test_an_emergency_stop_waits_for_nothing_and_delays_what_follows_only_so_far() -> None:
    pace = RateLimiter(PERIOD)
    pace.begin(0.0)
    for _ in range(200):  # stopped and released again and again within a moment
        pace.take(0.5)
    assert pace.opens <= 0.5 + LONGEST * PERIOD
    assert pace.keeps(None) <= 0.5 + LONGEST * PERIOD + SLACK


def test_the_mailbox_knows_when_the_next_frame_is_expected() -> None:
    now = 0.0
    mailbox = Mailbox(lambda: now)
    assert mailbox.following("right") is None
    for now in (1.0, 1.01, 1.02, 1.03, 1.5, 1.51):  # a gap once is no new pace
        mailbox.post(replace(FRAME, stamp=now))
    assert mailbox.following("right") == pytest.approx(1.52)
    assert mailbox.following("left") is None

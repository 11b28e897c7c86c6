"""When frames are answered: at the pace, as they come, and late ones don't hold up others."""

from __future__ import annotations

import numpy as np
import pytest

from smooth_operator.runtime.turns import CATCH_UP, PLAY, Turns

PERIOD = 0.01


def answered(arrivals: np.ndarray) -> np.ndarray:
    """When frames are answered that arrive then; the newest wins, as in the loop."""
    turns, times = Turns(), []
    for i, arrival in enumerate(arrivals):
        at = max(arrival, turns.opens(PERIOD))
        newer = arrivals[i + 1] if i + 1 < len(arrivals) else np.inf
        if at < newer:
            turns.take(at, PERIOD)
            times.append(at)
    return np.array(times)


def test_a_tracker_at_the_pace_is_answered_at_once() -> None:
    rng = np.random.default_rng(0)
    arrivals = np.arange(500) * PERIOD + rng.uniform(0, 0.15 * PERIOD, 500)
    np.testing.assert_array_equal(answered(arrivals), arrivals)


def test_frames_that_were_held_up_do_not_hold_up_the_next() -> None:
    arrivals = np.arange(200) * PERIOD
    arrivals[100] += 0.7 * PERIOD  # its successor comes 0.3 periods behind it
    np.testing.assert_array_equal(answered(arrivals), arrivals)


@pytest.mark.parametrize("rate", [130.0, 200.0, 240.0, 1000.0])
def test_faster_trackers_are_thinned_out(rate: float) -> None:
    times = answered(np.arange(0, 5, 1 / rate))
    gaps = np.diff(times)
    assert gaps.min() >= PLAY * PERIOD - 1e-9
    assert len(times) <= 5 / (PLAY * PERIOD) + 1


def test_a_burst_is_thinned_out() -> None:
    rng = np.random.default_rng(0)
    times = answered(np.sort(rng.uniform(0, 5, 2500)))
    gaps = np.diff(times)
    assert gaps.min() >= CATCH_UP * PERIOD - 1e-9
    assert len(times) <= 5 / (PLAY * PERIOD) + 1
    # as many as there is time for
    assert len(times) >= 0.95 * 5 / PERIOD


def test_the_first_is_answered_at_once() -> None:
    assert Turns().opens(PERIOD) == -np.inf

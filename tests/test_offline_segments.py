"""Stretches of a recording, its stamps on a grid, its noise and its leaps."""

import numpy as np
import pytest

from smooth_operator.retargeting.trajectory_retargeter import (
    segments,
    tracker_noise,
    without_jumps,
)


def test_segments_end_at_long_gaps():
    stamps = np.arange(30) * 0.1
    seen = np.ones(30, bool)
    seen[[0, 1, 10, 11, 20, 21, 22, 23, 29]] = False
    assert segments(seen, stamps, 0.3) == [slice(2, 20), slice(24, 29)]
    assert segments(seen, stamps, 0.0) == [slice(2, 10), slice(12, 20), slice(24, 29)]
    assert segments(np.zeros(30, bool), stamps, 0.3) == []
    stamps = stamps + np.where(np.arange(30) >= 15, 5.0, 0.0)  # frames that never came
    assert segments(seen, stamps, 0.3) == [slice(2, 15), slice(15, 20), slice(24, 29)]


def test_noise_of_a_tracker_is_what_its_points_do_beyond_steady_motion():
    rng = np.random.default_rng(6)
    points = 0.002 * np.arange(600.0)[:, None, None] + rng.normal(0, 1e-3, (600, 6, 3))
    seen = np.ones(600, bool)
    whole = tracker_noise(points, seen)
    # a second difference of white noise of 1 mm an axis has sqrt(6) mm an axis
    assert whole == pytest.approx(1e-3 * np.sqrt(6 * 2.37), rel=0.1)
    points[100:103] += 0.3  # what wasn't seen tells nothing
    seen[100:103] = False
    assert tracker_noise(points, seen) == pytest.approx(whole, rel=0.02)
    assert tracker_noise(points, seen & (np.arange(600) % 3 > 0)) == 0.0


def test_leaps_are_spread_and_nothing_is_late():
    t = np.arange(40.0)[:, None, None]
    seen = np.ones(40, bool)
    steady = np.concatenate([0.001 * t, 0.0 * t, 0.002 * t], axis=-1)
    found = without_jumps(steady, seen, 0.03)
    np.testing.assert_allclose(found[10:30], steady[10:30], atol=1e-6)  # late by as much as early
    jump = np.where(t < 20, 0.0, 0.05) * np.ones(3)
    spread = without_jumps(jump, seen, 0.03)
    assert np.abs(np.diff(spread[:, 0, 0])).max() < 0.5 * 0.05
    np.testing.assert_allclose(spread + spread[::-1], 0.05, atol=1e-12)  # alike before and after
    assert np.array_equal(without_jumps(jump, seen, 0.0), jump)
    seen[18:22] = False
    jump[18:22] = 7.0
    assert (without_jumps(jump, seen, 0.03)[18:22] == 7.0).all()
    assert np.abs(without_jumps(jump, seen, 0.03)[seen]).max() < 0.051

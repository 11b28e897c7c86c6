"""The One Euro filter: still at rest, quick in motion, nothing poisoned."""

from __future__ import annotations

import numpy as np
import pytest

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.sources.webcam.picture_tracker import (
    OneEuroConfig,
    OneEuroState,
    one_euro,
)

RATE = 30.0


def run(points: np.ndarray, gain: float = 20.0) -> np.ndarray:
    state: OneEuroState | None = None
    out = []
    for i, frame in enumerate(points):
        state = one_euro(state, frame, i / RATE, OneEuroConfig(gain=gain))
        out.append(state.points)
    return np.array(out)


def test_noise_at_rest_is_more_than_halved() -> None:
    noise = np.random.default_rng(0).normal(scale=1e-3, size=(400, 21, 3))
    filtered = run(noise)
    assert np.std(filtered[50:]) < 0.65 * np.std(noise)
    jitter = [np.mean(np.sum(np.diff(x, 2, axis=0) ** 2, axis=-1)) for x in (filtered, noise)]
    assert jitter[0] < 0.2 * jitter[1]


def test_a_moving_hand_is_followed_within_a_frame() -> None:
    t = np.arange(90) / RATE
    truth = np.zeros((90, 21, 3))
    truth[..., 0] = 0.08 * np.sin(2 * np.pi * 0.7 * t)[:, None]  # up to 0.35 m/s
    filtered = run(truth)
    speed = np.abs(np.diff(truth[:, 0, 0])).max() * RATE
    behind = np.abs(filtered - truth)[30:, 0, 0].max() / speed
    assert behind < 1.0 / RATE
    constant = np.abs(run(truth, gain=0.0) - truth)[30:, 0, 0].max() / speed
    assert behind < 0.75 * constant  # it is the speed that makes it quick


def test_no_direction_is_preferred() -> None:
    """Motion that is turned in space is answered by the answer, turned alike."""
    rng = np.random.default_rng(1)
    points = np.cumsum(rng.normal(scale=0.01, size=(60, 21, 3)), axis=0)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    np.testing.assert_allclose(run(points @ turn), run(points) @ turn, atol=1e-12)


def test_a_lost_landmark_stays_lost_and_comes_back_clean() -> None:
    points = np.full((6, 2, 3), 0.1)
    points[2:4, 1] = np.nan
    points[4:, 1] = 0.3
    filtered = run(points)
    assert np.isnan(filtered[2:4, 1]).all()
    np.testing.assert_allclose(filtered[4:, 1], 0.3)
    np.testing.assert_allclose(filtered[:, 0], 0.1)


@pytest.mark.parametrize("stamp", [0.5, 0.0, -1.0])
def test_it_begins_anew_after_a_gap_and_when_stamps_go_back(stamp: float) -> None:
    first = one_euro(None, np.zeros((1, 3)), 0.0)
    again = one_euro(first, np.ones((1, 3)), stamp)
    np.testing.assert_array_equal(again.points, 1.0)
    np.testing.assert_array_equal(again.velocity, 0.0)


@pytest.mark.parametrize("settings", [{"cutoff": 0.0}, {"gain": -1.0}, {"gap": float("nan")}])
def test_settings_are_checked(settings: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        OneEuroConfig(**settings)

"""Filter of fingertips: stillness, motion without delay, jumps, and the tracker's shake."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator.retargeting.fingertip_filter import (
    FilterState,
    FingertipFilterConfig,
    filter_fingertips,
)
from smooth_operator.retargeting.program import FrameClock

CONFIG = FingertipFilterConfig()
RATES = [10.0, 30.0, 100.0, 500.0]


def play(
    path: np.ndarray, rate: float, config: FingertipFilterConfig = CONFIG
) -> tuple[FilterState, np.ndarray]:
    """States after each frame of a (T, n, 3) path, and the (T, n, 3) steps of the points."""

    def frame(state: FilterState, given: Any) -> Any:
        clock = FrameClock(jnp.float32(1 / rate), given[1])
        after, moved, _ = filter_fingertips(state, given[0], config, clock)
        return after, (after, moved)

    first = jnp.arange(len(path)) == 0
    start = FilterState.unseen(path.shape[1])
    _, (states, steps) = jax.lax.scan(frame, start, (jnp.asarray(path, jnp.float32), first))
    return states, np.asarray(steps)


def shaken(seconds: float, rate: float, size: float = 5e-4, lasts: float = 0.08) -> np.ndarray:
    """(T, 6, 3) shake of a tracker with a correlation time [m]."""
    rng = np.random.default_rng(2)
    noise = rng.normal(0, size, (int(seconds * rate), 6, 3))
    keep = np.exp(-1 / (rate * lasts))
    for t in range(1, len(noise)):
        noise[t] = keep * noise[t - 1] + np.sqrt(1 - keep**2) * noise[t]
    return noise


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize("rate", RATES)
def test_a_hand_at_rest_shakes_less_at_any_rate(rate):
    path = shaken(20.0, rate)
    points = np.asarray(play(path, rate)[0].points)
    half = slice(len(path) // 2, None)
    before, after = (np.diff(one[half], axis=0) for one in (path, points))
    assert rms(after) < 0.5 * rms(before)
    assert (before * after).sum() > 0.8 * np.sqrt((before**2).sum() * (after**2).sum())


@pytest.mark.parametrize("rate", RATES)
def test_motion_is_followed_without_delay_or_stopping(rate):
    """A shaking hand rests, and then moves steadily."""
    t = np.arange(int(20 * rate)) / rate
    for speed in (0.01, 0.03, 0.3):
        path = shaken(20.0, rate)
        path[..., 0] += speed * np.clip(t - 10, 0, None)[:, None]
        states, steps = play(path, rate)
        resting = (t > 5) & (t < 10)
        assert rms(steps[resting]) < 0.6 * rms(np.diff(path, axis=0)[resting[1:]])
        assert steps[t > 12, :, 0].mean() == pytest.approx(speed / rate, rel=0.1)
        points = np.asarray(states.points)[..., 0].mean(axis=1)[t > 12]
        paces = np.diff(points[:: max(1, round(0.3 * rate))])
        assert paces.min() > 0.5 * paces.mean()  # no stick and slip


@pytest.mark.parametrize("rate", RATES)
def test_shake_is_measured_and_motion_is_not(rate):
    level = {
        size: float(play(shaken(20.0, rate, size), rate)[0].shake[-1]) for size in (2e-4, 1e-3)
    }
    assert level[1e-3] == pytest.approx(5 * level[2e-4], rel=0.25)
    t = np.arange(int(20 * rate))[:, None, None] / rate
    steady = np.ones((6, 3)) * 0.1 * t
    assert float(play(steady, rate)[0].shake[-1]) < 2e-5
    flicking = shaken(20.0, rate, 2e-4)
    flicking[::3, :2] += 0.02  # two fingers of six
    assert float(play(flicking, rate)[0].shake[-1]) < 2 * level[2e-4]


@pytest.mark.parametrize("rate", [30.0, 100.0])
def test_a_jump_of_one_frame_is_not_followed(rate):
    path = np.zeros((150, 6, 3))
    path[20:] += 1e-4  # so that something moves
    path[30, 1] += [0.3, 0.0, 0.0]
    states, _ = play(path, rate)
    for points in (states.points, states.followed):
        assert np.abs(np.asarray(points)).max() < 0.1
    path[30:, 1] = [0.3, 0.0, 0.0]  # it stays there
    followed = np.asarray(play(path, rate)[0].followed)[:, 1, 0]
    assert (np.diff(followed) >= -1e-6).all()
    assert followed[-1] == pytest.approx(0.3, abs=2e-3)


def test_a_share_of_one_filters_nothing():
    path = shaken(2.0, 100.0)
    config = FingertipFilterConfig(share=1.0, jump=10.0)
    states, _ = play(path, 100.0, config)
    np.testing.assert_allclose(states.points, path, atol=1e-7)


def test_after_a_gap_points_are_taken_as_they_are_and_the_shake_stays():
    states, _ = play(shaken(2.0, 100.0), 100.0)
    last = jax.tree.map(lambda one: one[-1], states)
    elsewhere = jnp.full((6, 3), 0.3)
    dt = jnp.float32(0.01)
    restart, clock = FrameClock(dt, jnp.bool_(True)), FrameClock(dt, jnp.bool_(False))
    after, *steps = filter_fingertips(last, elsewhere, CONFIG, restart)
    np.testing.assert_array_equal(steps, 0)
    np.testing.assert_array_equal(after.points, elsewhere)
    np.testing.assert_array_equal(after.followed, elsewhere)
    assert float(after.shake) == float(last.shake)
    still, *_ = filter_fingertips(after, elsewhere, CONFIG, clock)
    np.testing.assert_array_equal(still.points, elsewhere)

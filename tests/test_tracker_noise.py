"""Removal of tracker noise: the palm tells how much there is, and what is rigid stays as it is."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from smooth_operator import Status, load_hand, method_config
from smooth_operator.errors import ConfigError
from smooth_operator.geometry import umeyama
from smooth_operator.human.alignment import reference_landmarks
from smooth_operator.human.landmark_filter import PALM, NoiseConfig, NoiseState, remove_noise
from smooth_operator.landmarks import TIPS, WRIST
from smooth_operator.methods.program import align_frame

NEEDS = (WRIST, *TIPS)
DT = 0.01
FRAMES = 300
CONFIG = method_config("smooth").tracker_noise


@lru_cache(maxsize=1)
def still_hand() -> np.ndarray:
    """(FRAMES, 21, 3) a hand that rests [m]."""
    points = reference_landmarks(load_hand("mimic_p050"))
    return np.repeat(points[None], FRAMES, axis=0)


def white(sigma: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, sigma, (FRAMES, 21, 3))


def lasting(sigma: float, keep: float) -> np.ndarray:
    """Noise with the correlation ``keep`` between frames."""
    noise = white(sigma)
    for t in range(1, FRAMES):
        noise[t] = keep * noise[t - 1] + np.sqrt(1 - keep**2) * noise[t]
    return noise


@lru_cache
def program(config: NoiseConfig) -> Callable[[Any], Any]:
    """The filter of a whole path."""

    def frame(state: NoiseState, given: Any) -> Any:
        landmarks, restart = given
        state, points = remove_noise(state, landmarks, NEEDS, DT, config, restart)
        return state, (state, points)

    start = NoiseState.unseen(len(NEEDS))
    return jax.jit(lambda x: lax.scan(frame, start, x)[1])


def play(path: np.ndarray, config: NoiseConfig = CONFIG) -> tuple[NoiseState, np.ndarray]:
    """States after each frame, and (T, 6, 3) the points."""
    first = jnp.arange(len(path)) == 0
    states, points = program(config)((jnp.asarray(path, jnp.float32), first))
    return states, np.asarray(points)


def off_mm(points: np.ndarray, path: np.ndarray) -> float:
    """Mean distance of wrist and fingertips from where they are, of the second half [mm]."""
    late = slice(len(path) // 2, None)
    return 1e3 * float(np.linalg.norm(points[late] - path[late][:, NEEDS], axis=-1).mean())


def test_a_hand_at_rest_loses_most_of_the_noise():
    noisy = still_hand() + white(5e-4)
    assert off_mm(noisy[:, NEEDS], still_hand()) == pytest.approx(0.8, abs=0.05)
    fitted = play(noisy, NoiseConfig(acceleration=1e9))[1]  # no filter over time
    assert off_mm(play(noisy)[1], still_hand()) < 0.7 * off_mm(fitted, still_hand())


def test_noise_that_turns_and_scales_the_hand_is_taken_off_without_delay():
    """The palm alone is noisy, so the whole hand is moved by what the alignment makes of it."""
    path = still_hand()
    noise = white(5e-4)
    noise[:, [i for i in range(21) if i not in PALM]] = 0
    three = [1, 5, 17]
    turned = umeyama((path + noise)[:, three], path[:, three]).apply(path + noise)
    before = off_mm(turned[:, NEEDS], path)
    fitted = play(turned, NoiseConfig(acceleration=1e9))[1]  # no filter over time
    assert off_mm(fitted, path) < 0.6 * before


def test_fingers_of_a_rigid_palm_move_as_they_were_tracked():
    path = still_hand() + 0.0
    path[:, TIPS] += white(2e-3)[:, TIPS]
    np.testing.assert_allclose(play(path)[1], path[:, NEEDS], atol=1e-6)


def test_steady_motion_is_not_late():
    path = still_hand() + 0.0
    t = np.arange(FRAMES)[:, None, None] * DT
    path[:, TIPS] += t * np.array([0.0, 0.05, 0.0])  # 50 mm/s
    late = path + white(5e-4)
    found = play(late)[1][FRAMES // 2 :, 1:] - path[FRAMES // 2 :][:, TIPS]
    assert abs(found[..., 1].mean()) < 1e-4  # 2 ms


def test_the_palm_tells_how_much_noise_there_is_and_how_long_it_lasts():
    states, _ = play(still_hand() + white(5e-4))
    power = np.asarray(states.power)[-150:]
    assert np.sqrt(power.mean()) == pytest.approx(5e-4, rel=0.1)
    own = np.asarray(states.deviation)[-1]
    lasts = np.asarray(play(still_hand() + lasting(5e-4, 0.6))[0].deviation)[-1]
    assert lasts > 1.5 * own


def test_a_palm_that_is_lost_for_a_moment_counts_little():
    path = still_hand() + white(3e-4)
    lost = path.copy()
    lost[200:202] += white(2e-2, seed=1)[200:202]
    usual, states = play(path)[0], play(lost)[0]
    power = [float(np.asarray(s.power)[210]) for s in (usual, states)]
    assert power[1] < 2 * power[0]


def test_palm_landmarks_that_are_missing_are_left_out():
    path = still_hand() + white(5e-4)
    path[:, 9] = np.nan
    path[100:150, 13] = np.nan
    states, points = play(path)
    assert np.isfinite(points).all()
    assert off_mm(points, still_hand()) < off_mm(path[:, NEEDS], still_hand())
    assert np.isnan(np.asarray(states.shape)[-1, PALM.index(9)]).all()


def test_without_a_scale_of_motion_nothing_is_removed():
    path = still_hand() + white(5e-4)
    np.testing.assert_array_equal(play(path, NoiseConfig())[1], path[:, NEEDS].astype(np.float32))


@pytest.mark.parametrize("name", ["level_time", "shape_time", "outlier"])
def test_settings_are_checked(name):
    with pytest.raises(ConfigError, match=f"tracker_noise.{name}"):
        NoiseConfig(**{name: 0.0})


def test_landmarks_that_are_marked_invalid_are_not_known():
    hand = load_hand("mimic_p050")
    config = method_config("smooth")
    method = config.build(hand)
    landmarks = jnp.asarray(reference_landmarks(hand), jnp.float32).at[9].add(0.5)
    valid = jnp.ones(21, bool).at[9].set(False)
    align = jax.jit(lambda *seen: align_frame(method, config.alignment, *seen))
    frame = align(landmarks, valid)
    assert int(frame.status) == Status.OK
    unknown = np.isnan(np.asarray(frame.aligned)).any(axis=-1)
    assert np.flatnonzero(unknown).tolist() == [9]

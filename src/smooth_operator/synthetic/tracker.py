"""Tracker of the synthetic operator (noise, jitter, losses), and motion of the hand's wrist."""

from __future__ import annotations

import operator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.poses import from_rotation_vectors
from smooth_operator.settings import LARGEST, check_range

_POINTS = NUM_LANDMARKS + 4  # the metacarpal bases are measured too


@dataclass(frozen=True)
class TrackerModel:
    """Imperfections of a tracker; all are off by default.

    Loss comes in bursts: a two-state Markov chain (E. N. Gilbert, "Capacity of a Burst-Noise
    Channel", Bell System Technical Journal 39, 1960) with the given share of losses and mean
    length of a burst. The motion underneath is the same whatever is set here.

    Attributes:
        noise: standard deviation of each coordinate of each landmark and metacarpal base [m].
        noise_time: correlation time of that noise [s]; 0 is white noise.
        rate_jitter: standard deviation of a frame's time about its even place, over the period. It
            is cut off at 0.45 so that stamps stay strictly increasing. A frame shows the hand at
            the time of its stamp.
        frame_loss: share of frames that never arrive.
        frame_loss_burst: mean length of such a gap [s].
        landmark_loss: share of (frame, landmark) pairs that are NaN and flagged invalid.
        landmark_loss_burst: mean length of a landmark's absence [s].
        seed: seed of all these.

    Raises:
        ConfigError: a value is outside its range.
    """

    noise: float = 0.0
    noise_time: float = 0.0
    rate_jitter: float = 0.0
    frame_loss: float = 0.0
    frame_loss_burst: float = 0.03
    landmark_loss: float = 0.0
    landmark_loss_burst: float = 0.15
    seed: int = 0

    def __post_init__(self) -> None:
        check_range("tracker noise", self.noise, 0.0, 0.05, "m")
        check_range("tracker noise_time", self.noise_time, 0.0, LARGEST, "s")
        check_range("tracker rate_jitter", self.rate_jitter, 0.0, 0.45)
        check_range("tracker frame_loss", self.frame_loss, 0.0, 0.9)
        check_range("tracker frame_loss_burst", self.frame_loss_burst, 0.0, LARGEST, "s")
        check_range("tracker landmark_loss", self.landmark_loss, 0.0, 0.9)
        check_range("tracker landmark_loss_burst", self.landmark_loss_burst, 0.0, LARGEST, "s")
        check_seed("tracker seed", self.seed)


@dataclass(frozen=True, eq=False)
class Ticks:
    """Imperfections at n successive ticks of the tracker's clock.

    Attributes:
        stamps: (n,) strictly increasing times [s].
        arrives: (n,) False for a lost frame.
        noise: (n, 25, 3) noise of the 21 landmarks and the 4 metacarpal bases [m], or None.
        lost: (n, 21) True for a lost landmark.
    """

    stamps: Float[np.ndarray, " n"]
    arrives: Bool[np.ndarray, " n"]
    noise: Float[np.ndarray, "n 25 3"] | None
    lost: Bool[np.ndarray, "n 21"]


class TrackerStream:
    """The endless sequence of ticks of a tracker.

    Args:
        model: imperfections of the tracker.
        rate_hz: frame rate [Hz].
    """

    def __init__(self, model: TrackerModel, rate_hz: float) -> None:
        self._model = model
        self._period = 1.0 / rate_hz
        self._tick = 0
        # a generator for each imperfection, so that one does not change the draws of another
        self._clock, self._noise, frame, landmark = (
            np.random.default_rng([int(model.seed), 0x7C, k]) for k in range(4)
        )
        self._frames = _Bursts(frame, model.frame_loss, model.frame_loss_burst * rate_hz, 1)
        self._landmarks = _Bursts(
            landmark, model.landmark_loss, model.landmark_loss_burst * rate_hz, NUM_LANDMARKS
        )
        self._drift: Float[np.ndarray, "25 3"] | None = None

    def next(self, count: int) -> Ticks:
        """The next ``count`` ticks."""
        ticks = self._tick + np.arange(count, dtype=float)
        self._tick += count
        if self._model.rate_jitter:
            offset = self._clock.normal(0.0, self._model.rate_jitter, count)
            ticks = np.maximum(ticks + np.clip(offset, -0.45, 0.45), 0.0)
        arrives = ~self._frames.next(count)[:, 0]
        return Ticks(
            ticks * self._period, arrives, self._next_noise(count), self._landmarks.next(count)
        )

    def _next_noise(self, count: int) -> Float[np.ndarray, "n 25 3"] | None:
        if not self._model.noise:
            return None
        noise = self._noise.normal(0.0, self._model.noise, (count, _POINTS, 3))
        if self._model.noise_time:
            # First-order autoregression with the variance of the white noise that drives it.
            keep = float(np.exp(-self._period / self._model.noise_time))
            drift = noise[0] if self._drift is None else self._drift
            for k in range(count):
                if k or self._drift is not None:
                    drift = keep * drift + np.sqrt(1.0 - keep**2) * noise[k]
                noise[k] = drift
            self._drift = drift.copy()
        return noise


class _Bursts:
    """Independent two-state Markov chains, present or lost; all start present."""

    def __init__(
        self, rng: np.random.Generator, share: float, mean_ticks: float, width: int
    ) -> None:
        self._rng = rng
        # bursts, and the gaps between them, last at least one tick
        length = max(mean_ticks, 1.0, share / (1.0 - share))
        self._recover = 1.0 / length
        self._lose = share / (1.0 - share) / length
        self._lost = np.zeros(width, bool)
        self._share = share

    def next(self, count: int) -> Bool[np.ndarray, "n width"]:
        lost = np.zeros((count, len(self._lost)), bool)
        if self._share:
            draws = self._rng.random(lost.shape)
            for k in range(count):
                lost[k] = self._lost
                self._lost = np.where(self._lost, draws[k] >= self._recover, draws[k] < self._lose)
        return lost


def check_seed(name: str, value: int) -> None:
    """Refuse a seed that isn't a whole number from 0 on.

    Raises:
        ConfigError: the seed is refused; names the setting and the value.
    """
    try:
        good = operator.index(value) >= 0
    except TypeError:
        good = False
    if not good:
        raise ConfigError(f"{name} must be a whole number from 0 on, not {value!r}")


_TERMS = 4


@dataclass(frozen=True)
class WristMotion:
    """Slow random motion of the wrist; off by default, as a glove reports the hand alone.

    Attributes:
        translation: standard deviation of each coordinate of the wrist [m].
        rotation: standard deviation of each coordinate of the rotation vector [rad].
        seed: seed of the motion.

    Raises:
        ConfigError: a value is outside its range.
    """

    translation: float = 0.0
    rotation: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_range("wrist translation", self.translation, 0.0, 1.0, "m")
        check_range("wrist rotation", self.rotation, 0.0, 1.5, "rad")
        check_seed("wrist seed", self.seed)

    def __bool__(self) -> bool:
        return bool(self.translation or self.rotation)

    def at(
        self, times: Float[np.ndarray, " T"]
    ) -> tuple[Float[np.ndarray, "T 3"], Float[np.ndarray, "T 3"]]:
        """Translation [m] and rotation vector [rad] of the wrist at each time [s]."""
        rng = np.random.default_rng([int(self.seed), 0x3A])
        frequency = rng.uniform(0.05, 0.4, (6, _TERMS))
        phase = rng.uniform(0.0, 2.0 * np.pi, (6, _TERMS))
        # Each sine has a mean square of 1/2.
        sines = np.sin(2.0 * np.pi * frequency * times[:, None, None] + phase).sum(-1)
        sines *= np.sqrt(2.0 / _TERMS)
        return self.translation * sines[:, :3], self.rotation * sines[:, 3:]

    def pose_at(self, time: float) -> Float[np.ndarray, "7"]:
        """Pose of the wrist at one time [s]: x y z [m], quaternion w x y z."""
        place, turn = self.at(np.array([time]))
        return np.concatenate([place[0], from_rotation_vectors(turn[0])])

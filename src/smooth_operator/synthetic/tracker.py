"""Model of a tracker: noise, uneven clock, lost frames and landmarks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.synthetic.settings import check_range, check_seed

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
        rate_jitter: standard deviation of a frame's time about its even place, over the period,
            before it is cut off at 0.45 so that stamps stay strictly increasing. The hand is seen
            at the time of the stamp.
        frame_loss: share of frames that never arrive.
        frame_loss_burst: mean length of such a gap [s].
        landmark_loss: share of (frame, landmark) pairs that are NaN and flagged invalid.
        landmark_loss_burst: mean length of a landmark's absence [s].
        seed: of all of the above.

    Raises:
        ConfigError: if a figure is outside its range.
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
        check_range("tracker noise_time", self.noise_time, 0.0, math.inf, "s")
        check_range("tracker rate_jitter", self.rate_jitter, 0.0, 0.45)
        check_range("tracker frame_loss", self.frame_loss, 0.0, 0.9)
        check_range("tracker frame_loss_burst", self.frame_loss_burst, 0.0, math.inf, "s")
        check_range("tracker landmark_loss", self.landmark_loss, 0.0, 0.9)
        check_range("tracker landmark_loss_burst", self.landmark_loss_burst, 0.0, math.inf, "s")
        check_seed("tracker seed", self.seed)


@dataclass(frozen=True, eq=False)
class Ticks:
    """A stretch of n even ticks of the tracker's clock, and what happens at each.

    Attributes:
        stamps: (n,) strictly increasing times [s].
        arrives: (n,) False where the frame is lost.
        noise: (n, 25, 3) to add to the 21 landmarks and the 4 metacarpal bases [m], or None.
        lost: (n, 21) True where the landmark is lost.
    """

    stamps: Float[np.ndarray, " n"]
    arrives: Bool[np.ndarray, " n"]
    noise: Float[np.ndarray, "n 25 3"] | None
    lost: Bool[np.ndarray, "n 21"]


class TrackerStream:
    """The endless sequence of ticks of one tracker.

    Args:
        model: its imperfections.
        rate_hz: its frame rate [Hz].
    """

    def __init__(self, model: TrackerModel, rate_hz: float) -> None:
        self._model = model
        self._period = 1.0 / rate_hz
        self._tick = 0
        # One source each, so that switching one imperfection on doesn't change another.
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
    """Independent two-state chains: present or lost. All start present."""

    def __init__(
        self, rng: np.random.Generator, share: float, mean_ticks: float, width: int
    ) -> None:
        self._rng = rng
        # A burst lasts a tick at least, and long enough that the gaps between bursts do too.
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

"""Model of the synthetic operator's tracker (shake, delay, lost data), and of wrist motion."""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.landmarks import BASES, NUM_LANDMARKS, TIPS, WRIST
from smooth_operator.poses import from_rotation_vectors
from smooth_operator.settings import LARGEST, check_range


def check_seed(name: str, value: int) -> None:
    """Raises ConfigError for a seed that is not a whole number of at least 0."""
    try:
        good = operator.index(value) >= 0
    except TypeError:
        good = False
    if not good:
        raise ConfigError(f"{name} must be a whole number of at least 0, not {value!r}")


@dataclass(frozen=True)
class TrackerModel:
    """Imperfections of a tracker; all are off by default.

    The palm is rigid, as in the hand models of real trackers: wrist and finger bases never move
    against each other. Each fingertip shakes by a first-order autoregression, the joints
    below it by a third and two thirds of that. Loss comes in bursts: a two-state Markov chain
    (E. N. Gilbert, "Capacity of a Burst-Noise Channel", Bell System Technical Journal 39, 1960)
    with the given share of losses and mean length of a burst. The hand's true motion does not
    depend on these settings.

    Attributes:
        rate_hz: frame rate [Hz].
        shake: standard deviation of each coordinate of each fingertip in the palm's frame [m].
        shake_time: correlation time of that shake [s]; 0 is white.
        delay: age of the hand pose that a frame shows [s].
        pinch_gaps: smallest distance that the tracker shows between the thumb and the tips of
            index, middle, ring and little finger [palm lengths, wrist to middle MCP]. A distance d
            is shown as (d^3 + gap^3)^(1/3).
        rate_jitter: standard deviation of a frame's time from its regular time, divided by the
            period. The deviation is limited to 0.45 so that stamps stay strictly increasing. A
            frame shows the hand at the time of its stamp, less the delay.
        frame_loss: share of frames that never arrive.
        frame_loss_burst: mean length of such a gap [s].
        landmark_loss: share of (frame, landmark) pairs that are NaN and flagged invalid.
        landmark_loss_burst: mean length of a landmark's absence [s].
        seed: seed of all these random values.

    Raises:
        ConfigError: a value is outside its range.
    """

    rate_hz: float = 100.0
    shake: float = 0.0
    shake_time: float = 0.0
    delay: float = 0.0
    pinch_gaps: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    rate_jitter: float = 0.0
    frame_loss: float = 0.0
    frame_loss_burst: float = 0.03
    landmark_loss: float = 0.0
    landmark_loss_burst: float = 0.15
    seed: int = 0

    def __post_init__(self) -> None:
        check_range("tracker rate_hz", self.rate_hz, 1.0, 10_000.0, "Hz")
        check_range("tracker shake", self.shake, 0.0, 0.05, "m")
        check_range("tracker shake_time", self.shake_time, 0.0, LARGEST, "s")
        check_range("tracker delay", self.delay, 0.0, 1.0, "s")
        for gap in self.pinch_gaps:
            check_range("tracker pinch_gaps", gap, 0.0, 1.0, "palm lengths")
        check_range("tracker rate_jitter", self.rate_jitter, 0.0, 0.45)
        check_range("tracker frame_loss", self.frame_loss, 0.0, 0.9)
        check_range("tracker frame_loss_burst", self.frame_loss_burst, 0.0, LARGEST, "s")
        check_range("tracker landmark_loss", self.landmark_loss, 0.0, 0.9)
        check_range("tracker landmark_loss_burst", self.landmark_loss_burst, 0.0, LARGEST, "s")
        check_seed("tracker seed", self.seed)


TRACKERS: Final = {
    "glove": TrackerModel(
        rate_hz=100.0,
        shake=0.0002,
        shake_time=0.04,
        delay=0.01,
        frame_loss=0.04,
        frame_loss_burst=0.01,
    ),
    "headset": TrackerModel(
        rate_hz=30.0,
        shake=0.0006,
        shake_time=0.05,
        delay=0.045,
        rate_jitter=0.07,
        frame_loss=0.005,
        frame_loss_burst=0.09,
    ),
    "camera": TrackerModel(
        rate_hz=30.0,
        shake=0.0008,
        shake_time=0.02,
        delay=0.1,
        pinch_gaps=(0.295, 0.369, 0.251, 0.075),
    ),
}
"""Trackers by kind; ``research/docs/trackers.md`` says how they were measured from recordings."""


def tracker_model(
    name: str | None,
    seed: int = 0,
    *,
    frame_loss: float | None = None,
    landmark_loss: float = 0.0,
    rate_jitter: float | None = None,
) -> TrackerModel:
    """Returns the model of one kind of tracker: ``glove``, ``headset`` or ``camera``.

    Args:
        name: the kind; None for a perfect tracker at 100 Hz.
        seed: seed of its shake and losses.
        frame_loss: see ``TrackerModel``; None for the value of its kind.
        landmark_loss: see ``TrackerModel``.
        rate_jitter: see ``TrackerModel``; None for the value of its kind.

    Raises:
        UnknownNameError: there is no such kind.
        ConfigError: a value is outside its range.
    """
    if name is not None and name not in TRACKERS:
        raise UnknownNameError("tracker", name, TRACKERS)
    model = TrackerModel() if name is None else TRACKERS[name]
    return replace(
        model,
        seed=seed,
        frame_loss=model.frame_loss if frame_loss is None else frame_loss,
        landmark_loss=landmark_loss,
        rate_jitter=model.rate_jitter if rate_jitter is None else rate_jitter,
    )


@dataclass(frozen=True, eq=False)
class Ticks:
    """Imperfections at n successive ticks of a tracker's clock.

    Attributes:
        model: the tracker.
        stamps: (n,) strictly increasing times [s].
        arrives: (n,) False for a lost frame.
        shake: (n, 5, 3) displacement of the fingertips, thumb first [m], or None.
        lost: (n, 21) True for a lost landmark.
    """

    model: TrackerModel
    stamps: Float[np.ndarray, " n"]
    arrives: Bool[np.ndarray, " n"]
    shake: Float[np.ndarray, "n 5 3"] | None
    lost: Bool[np.ndarray, "n 21"]

    def shown(self, landmarks: Float[np.ndarray, "n 21 3"]) -> Float[np.ndarray, "n 21 3"]:
        """Positions of the landmarks as the tracker shows them [m], including lost ones."""
        shown = np.array(landmarks)
        if any(self.model.pinch_gaps):
            palm = np.linalg.norm(shown[:, BASES[2]] - shown[:, WRIST], axis=-1)
            gaps = (palm[:, None] * self.model.pinch_gaps)[..., None]
            apart = shown[:, TIPS[1:]] - shown[:, TIPS[:1]]
            distance = np.linalg.norm(apart, axis=-1, keepdims=True)
            farther = np.cbrt(distance**3 + gaps**3) - distance
            push = np.zeros((len(shown), len(TIPS), 3))
            push[:, 1:] = farther * apart / np.maximum(distance, 1e-9)
            _move_fingertips(shown, push)
        if self.shake is not None:
            _move_fingertips(shown, self.shake)
        return shown


def _move_fingertips(
    landmarks: Float[np.ndarray, "n 21 3"], by: Float[np.ndarray, "n 5 3"]
) -> None:
    """Moves fingertips in place, and the joints below them by a third and two thirds of that
    motion.
    """
    for finger, base in enumerate(BASES):
        for joint in (1, 2, 3):
            landmarks[:, base + joint] += joint / 3.0 * by[:, finger]


class TrackerStream:
    """The endless sequence of a tracker's ticks.

    Args:
        model: imperfections of the tracker.
        rate_hz: frame rate [Hz]; None for the model's.
    """

    def __init__(self, model: TrackerModel, rate_hz: float | None = None) -> None:
        self._model = model
        rate_hz = model.rate_hz if rate_hz is None else rate_hz
        self._period = 1.0 / rate_hz
        self._tick = 0
        # a generator for each imperfection, so that one does not change the draws of another
        self._clock, shake, frame, landmark = (
            np.random.default_rng([int(model.seed), 0x7C, k]) for k in range(4)
        )
        self._frames = _Bursts(frame, model.frame_loss, model.frame_loss_burst * rate_hz, 1)
        self._landmarks = _Bursts(
            landmark, model.landmark_loss, model.landmark_loss_burst * rate_hz, NUM_LANDMARKS
        )
        self._shake = _Autoregression(shake, model.shake, model.shake_time / self._period)

    def next(self, count: int) -> Ticks:
        """Returns the next ``count`` ticks."""
        ticks = self._tick + np.arange(count, dtype=float)
        self._tick += count
        if self._model.rate_jitter:
            offset = self._clock.normal(0.0, self._model.rate_jitter, count)
            ticks = np.maximum(ticks + np.clip(offset, -0.45, 0.45), 0.0)
        arrives = ~self._frames.next(count)[:, 0]
        return Ticks(
            self._model,
            ticks * self._period,
            arrives,
            self._shake.next(count),
            self._landmarks.next(count),
        )


class _Autoregression:
    """First-order autoregression of the fingertips; ``time`` is its correlation time in ticks."""

    def __init__(self, rng: np.random.Generator, deviation: float, time: float) -> None:
        self._rng, self._deviation = rng, deviation
        self._keep = float(np.exp(-1.0 / time)) if time else 0.0
        self._last: Float[np.ndarray, "5 3"] | None = None

    def next(self, count: int) -> Float[np.ndarray, "n 5 3"] | None:
        if not self._deviation:
            return None
        shake = self._rng.normal(0.0, self._deviation, (count, len(TIPS), 3))
        fresh = np.sqrt(1.0 - self._keep**2)  # keeps the variance
        for k in range(count):
            if self._last is not None:
                shake[k] = self._keep * self._last + fresh * shake[k]
            self._last = shake[k]
        return shake


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


_TERMS = 4


@dataclass(frozen=True)
class WristMotion:
    """Slow random motion of the wrist; off by default, because a glove reports only the hand.

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

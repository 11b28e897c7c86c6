"""Pictures in, hand frames out: what camera and video have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float, UInt8

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.opencv import opencv
from smooth_operator.teleop.sources.webcam.hand_labels import SeenHand, Tracks, assign_sides
from smooth_operator.teleop.sources.webcam.mediapipe_hands import HandLandmarker, hand_model
from smooth_operator.types import HandFrame, Side

Points: TypeAlias = Literal["world", "picture"]


@dataclass(frozen=True)
class PictureConfig:
    """How hands are found in pictures.

    Attributes:
        mirrored: the pictures are mirrored, as selfie views are; they are turned back first.
        max_hands: how many hands are looked for, 1 or 2.
        confidence: how sure the tracker must be that there is a hand, 0 to 1.
        points: ``world``, the tracker's own positions in metres; ``picture``, what it sees in the
            picture, brought to the size of those.
        smoothing: cutoff of a filter for a hand at rest [Hz]; 0 filters nothing. It follows a hand
            that moves, see ``smooth_operator.teleop.sources.webcam.picture_tracker``.
        model: the hand-landmarker file; None for the published one, fetched once.
    """

    mirrored: bool = False
    max_hands: int = 2
    confidence: float = 0.5
    points: Points = "world"
    smoothing: float = 0.0
    model: Path | None = None

    def __post_init__(self) -> None:
        if self.max_hands not in (1, 2):
            raise ConfigError(f"max_hands must be 1 or 2, not {self.max_hands}")
        if not 0.0 < self.confidence < 1.0:
            raise ConfigError(f"confidence must be between 0 and 1, not {self.confidence}")
        if self.points not in ("world", "picture"):
            raise ConfigError(f"points must be world or picture, not {self.points!r}")
        if self.smoothing != 0.0 and not 0.1 <= self.smoothing <= 100.0:  # NaN too
            raise ConfigError(
                f"smoothing must be 0 for none, or 0.1 to 100 Hz, not {self.smoothing}"
            )


class PictureTracker:
    """Finds the hands in one picture after the other.

    Args:
        config: how.

    Raises:
        MissingExtraError: MediaPipe is not installed.
        SourceError: the model can't be had or loaded.
    """

    def __init__(self, config: PictureConfig) -> None:
        self._config = config
        self._cv2 = opencv()
        self._landmarker = HandLandmarker(
            hand_model(config.model), max_hands=config.max_hands, confidence=config.confidence
        )
        self._tracks = Tracks()
        self._filter = OneEuroConfig(config.smoothing) if config.smoothing else None
        self._filtered: dict[Side, OneEuroState] = {}

    def frames(self, pixels: UInt8[np.ndarray, "h w 3"], time: float) -> list[HandFrame]:
        """The hands of a picture, at most one of each side.

        Args:
            pixels: blue, green, red.
            time: time of the picture [s]; becomes the stamp.

        Raises:
            SourceError: MediaPipe failed.
        """
        colours = self._cv2.cvtColor(pixels, self._cv2.COLOR_BGR2RGB)
        turned = self._cv2.flip(colours, 1) if self._config.mirrored else colours
        hands_seen = self._landmarker.find(turned, time)
        hands, self._tracks = assign_sides(hands_seen, self._tracks, time)
        return [
            HandFrame(self._landmarks(side, hand, time), time, side, valid=hand.inside)
            for side, hand in hands.items()
        ]

    def _landmarks(self, side: Side, hand: SeenHand, time: float) -> Float[np.ndarray, "21 3"]:
        landmarks = landmarks_of(hand, self._config.points)
        if self._filter is None:
            return landmarks
        state = one_euro(self._filtered.get(side), landmarks, time, self._filter)
        self._filtered[side] = state
        return state.points

    def close(self) -> None:
        """Give everything back; a second call does nothing."""
        self._landmarker.close()


def landmarks_of(hand: SeenHand, points: Points) -> Float[np.ndarray, "21 3"]:
    """A hand's landmarks [m], about its centre, in a right-handed frame.

    x points to the right in the picture, y down and z away from the camera.

    Args:
        hand: as the tracker has it.
        points: see ``PictureConfig``. In the picture fingertips are placed more finely, so
            touching ones come closer; but depth is flattened, so bones change their length more.
    """
    if points == "world":
        return hand.world
    centred = hand.picture - hand.picture.mean(axis=0)
    size = np.linalg.norm(hand.world - hand.world.mean(axis=0))
    scaled: np.ndarray = centred * (size / max(float(np.linalg.norm(centred)), 1e-9))
    return scaled


@dataclass(frozen=True)
class OneEuroConfig:
    """How strongly is filtered.

    Attributes:
        cutoff: cutoff of a point at rest [Hz]; lower is smoother, and later.
        gain: by how much the cutoff rises with speed [Hz per m/s].
        speed_cutoff: cutoff of the low-pass on the speed [Hz].
        gap: after a longer gap in the stamps the filter restarts [s].
    """

    cutoff: float = 4.0
    gain: float = 20.0
    speed_cutoff: float = 1.0
    gap: float = 0.25

    def __post_init__(self) -> None:
        for name in ("cutoff", "speed_cutoff", "gap"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(f"One Euro: {name} must be positive, not {getattr(self, name)}")
        if not 0.0 <= self.gain < math.inf:
            raise ConfigError(f"One Euro: gain must not be negative, not {self.gain}")


@dataclass(frozen=True, eq=False)
class OneEuroState:
    """What the filter remembers.

    Attributes:
        points: (N, 3) filtered points [m].
        velocity: (N, 3) their filtered velocity [m/s].
        stamp: time of the last frame [s].
    """

    points: Float[np.ndarray, "N 3"]
    velocity: Float[np.ndarray, "N 3"]
    stamp: float


def one_euro(
    state: OneEuroState | None,
    points: Float[np.ndarray, "N 3"],
    stamp: float,
    config: OneEuroConfig = OneEuroConfig(),
) -> OneEuroState:
    """Filter one frame.

    Args:
        state: state of the last frame; None at the start.
        points: (N, 3) [m]; one that is not finite stays so, and restarts when it is back.
        stamp: time of the frame [s]; if it stands or goes back, the filter restarts.
        config: how strongly.

    Returns:
        the new state; its ``points`` are the answer.
    """
    step = math.inf if state is None else stamp - state.stamp
    if state is None or not 0.0 < step <= config.gap:
        return OneEuroState(points, np.zeros_like(points), stamp)
    complete = np.isfinite(state.points).all(axis=1, keepdims=True)
    before = np.where(complete, state.points, points)
    velocity = np.where(np.isfinite(state.velocity), state.velocity, 0.0)
    velocity = velocity + _share(config.speed_cutoff, step) * ((points - before) / step - velocity)
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    moved = before + _share(config.cutoff + config.gain * speed, step) * (points - before)
    return OneEuroState(moved, np.where(complete, velocity, 0.0), stamp)


def _share(cutoff: float | np.ndarray, step: float) -> np.ndarray:
    """Weight of the new value in a first-order low-pass."""
    return np.asarray(1.0 / (1.0 + 1.0 / (2.0 * math.pi * cutoff * step)))

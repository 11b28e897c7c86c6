"""Pictures in, hand frames out: what camera and video have in common."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, UInt8

from smooth_operator.errors import ConfigError
from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.teleop.opencv import opencv
from smooth_operator.teleop.sources.webcam.mediapipe_hands import HandLandmarker, hand_model
from smooth_operator.types import HandFrame, Side

Points: TypeAlias = Literal["world", "picture"]


@dataclass(frozen=True, kw_only=True)
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


MEMORY_S: Final = 0.3
"""How long it is remembered where a hand was [s]."""
REACH: Final = 1.5
"""How far a hand may have moved since, in lengths of its palm."""
PATIENCE: Final = 8
"""So many pictures on end a label must contradict the continuity before it is believed."""
SAME: Final = 0.5
"""Hands that are closer than this are one hand, found twice; in lengths of the palm."""

_PALM: Final = (WRIST, *BASES[1:])


@dataclass(frozen=True, eq=False)
class SeenHand:
    """One hand in one picture, as the tracker has it.

    Attributes:
        label: the side that the tracker takes it for.
        score: how sure it is of that, 0 to 1.
        world: (21, 3) positions about the hand's centre [m]; x to the right in the picture, y
            down, z away from the camera, which is a right-handed frame.
        picture: (21, 3) positions in the picture, as shares of its width, width and width; y is
            down, z away from the camera and about the wrist.
        inside: (21,) whether a landmark lies within the picture.
    """

    label: Side
    score: float
    world: Float[np.ndarray, "21 3"]
    picture: Float[np.ndarray, "21 3"]
    inside: Bool[np.ndarray, "21"]

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """Middle of the palm in the picture."""
        middle: np.ndarray = self.picture[list(_PALM), :2].mean(axis=0)
        return middle

    @property
    def size(self) -> float:
        """Length of the palm in the picture; of a palm seen edge-on, its depth counts."""
        return float(np.linalg.norm(self.picture[BASES[2]] - self.picture[WRIST]))


@dataclass(frozen=True, eq=False)
class Track:
    """Where a hand was.

    Attributes:
        centre: (2,) middle of the palm in the picture.
        time: when [s].
        doubts: pictures on end whose label contradicted.
    """

    centre: Float[np.ndarray, "2"]
    time: float
    doubts: int = 0


@dataclass(frozen=True)
class Tracks:
    """Where the hands were: the state of ``assign_sides``."""

    of: Mapping[Side, Track] = field(default_factory=dict)


def assign_sides(
    detections: Iterable[SeenHand], tracks: Tracks, time: float
) -> tuple[dict[Side, SeenHand], Tracks]:
    """Say which hand is which.

    Args:
        detections: the hands of one picture.
        tracks: where they were before; ``Tracks()`` at the start.
        time: time of the picture [s]; if it goes back, what was before is forgotten.

    Returns:
        side -> hand, at most one of each; and the new tracks.
    """
    recent = {s: t for s, t in tracks.of.items() if 0.0 <= time - t.time <= MEMORY_S}
    chosen: dict[Side, tuple[SeenHand, Track]] = {}
    for hand in _without_duplicates(detections):
        side, doubts = _side_of(hand, recent)
        track = Track(hand.centre, time, doubts)
        rival = chosen.get(side)
        if rival is None or _rank(hand, side, recent) > _rank(rival[0], side, recent):
            chosen[side] = hand, track
    hands = {side: hand for side, (hand, _) in chosen.items()}
    moved = recent | {side: track for side, (_, track) in chosen.items()}
    return hands, Tracks(moved)


def _without_duplicates(detections: Iterable[SeenHand]) -> list[SeenHand]:
    distinct: list[SeenHand] = []
    for hand in sorted(detections, key=lambda h: -h.score):
        if all(_distance(hand, other.centre) > SAME for other in distinct):
            distinct.append(hand)
    return distinct


def _side_of(hand: SeenHand, recent: Mapping[Side, Track]) -> tuple[Side, int]:
    """The side of a hand, and for how many pictures its label has said otherwise."""
    other: Side = "left" if hand.label == "right" else "right"
    was = recent.get(other)
    own = recent.get(hand.label)
    if was is None or _distance(hand, was.centre) > REACH:
        return hand.label, 0
    if own is not None and _distance(hand, own.centre) <= REACH:  # both were near: hands cross
        return hand.label, 0
    # It stands where the other hand was: the label flipped, unless it insists.
    if was.doubts + 1 >= PATIENCE:
        return hand.label, 0
    return other, was.doubts + 1


def _rank(hand: SeenHand, side: Side, recent: Mapping[Side, Track]) -> tuple[bool, float]:
    """Of two hands of one side the one that was there before, then the surer one."""
    was = recent.get(side)
    return was is not None and _distance(hand, was.centre) <= REACH, hand.score


def _distance(hand: SeenHand, centre: Float[np.ndarray, "2"]) -> float:
    """In lengths of the hand's palm."""
    return float(np.linalg.norm(hand.centre - centre)) / max(hand.size, 1e-6)

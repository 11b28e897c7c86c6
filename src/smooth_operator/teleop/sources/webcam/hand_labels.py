"""Which of the seen hands is the right one: labels, duplicates and continuity.

A camera's tracker estimates the side of each hand in every picture. It errs occasionally: for a
picture or two a label flips, both hands get the same one, or one hand is found twice. Where hands
were a moment ago settles most of that; what can't be settled is left out, and never guessed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.types import Side

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
    seen: Iterable[SeenHand], tracks: Tracks, time: float
) -> tuple[dict[Side, SeenHand], Tracks]:
    """Say which hand is which.

    Args:
        seen: the hands of one picture.
        tracks: where they were before; ``Tracks()`` at the start.
        time: time of the picture [s]; if it goes back, what was before is forgotten.

    Returns:
        side -> hand, at most one of each; and the new tracks.
    """
    recent = {s: t for s, t in tracks.of.items() if 0.0 <= time - t.time <= MEMORY_S}
    chosen: dict[Side, tuple[SeenHand, Track]] = {}
    for hand in _without_duplicates(seen):
        side, doubts = _side_of(hand, recent)
        track = Track(hand.centre, time, doubts)
        rival = chosen.get(side)
        if rival is None or _rank(hand, side, recent) > _rank(rival[0], side, recent):
            chosen[side] = hand, track
    hands = {side: hand for side, (hand, _) in chosen.items()}
    moved = recent | {side: track for side, (_, track) in chosen.items()}
    return hands, Tracks(moved)


def _without_duplicates(seen: Iterable[SeenHand]) -> list[SeenHand]:
    distinct: list[SeenHand] = []
    for hand in sorted(seen, key=lambda h: -h.score):
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

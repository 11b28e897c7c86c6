"""Checks side and order of landmarks by their shape.

Order: the lengths between neighbouring landmarks hardly depend on the pose. Those of a human hand,
as ratios, are compared under every order of the fingers and under the layouts of other trackers
and datasets (``LAYOUTS``). Side: fingers bend to the palm, the
thumb's base is in front of it, and the knuckles arch away from it; a mirror image is the
opposite. ``python -m smooth_operator.lab.judging.input_check`` measures both on real recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError, UnknownNameError
from smooth_operator.landmarks import BASES, FINGERS, LAYOUTS, NUM_LANDMARKS
from smooth_operator.types import Side

FEWEST_FRAMES: Final = 5
"""Frames with all landmarks without which nothing is judged."""

MISFIT: Final = 0.25
"""A layout is refused if another fits better by this much, in mean deviations of a length.

Recordings in the right order come to 0.05 at most over five frames, with noise of 4 mm too; the
named layouts to 0.35 at least.
"""

MIRRORED: Final = -0.25
"""A side is refused if the mean chirality for it is less.

Right ones come to -0.15 at the least over five frames with 6 mm of noise, mirrored ones to -0.35 at
the most, but for flat hands of trackers whose palm is a plane.
"""

_FITS: Final = 0.9  # what deviates more is no human hand, and is not judged
_SPREAD: Final = 0.3  # of the logarithm of a length, between people and between trackers
_MOST: Final = 3.0  # spreads that one length may count
_JUDGED: Final = 300  # frames of a recording that are looked at

_PAIRS: Final = np.array(
    [pair for b in BASES for pair in ((0, b), (b, b + 1), (b + 1, b + 2), (b + 2, b + 3))]
    + [(1, 5), (5, 9), (9, 13), (13, 17), (5, 17), (1, 17)]
)
# Lengths of these in palm lengths (wrist to middle MCP): what a MANUS glove, two camera trackers
# and the built-in operator have in common.
_LENGTHS: Final = np.array(
    [
        *(0.34, 0.44, 0.34, 0.30),
        *(0.98, 0.38, 0.25, 0.23),
        *(1.00, 0.39, 0.28, 0.25),
        *(0.93, 0.35, 0.27, 0.24),
        *(0.90, 0.28, 0.20, 0.21),
        *(0.78, 0.25, 0.24, 0.22, 0.66, 0.90),
    ]
)
_LOGS: Final = np.log(_LENGTHS)


@dataclass(frozen=True)
class Doubt:
    """Why landmarks can't be what they are said to be.

    Attributes:
        what: what they look like, as a clause.
        layout: the layout that they are in, if it has a name.
        order: the index of each landmark in the points as they came; None where the side is wrong.
        side: the side that they are of; None where the order is wrong.
    """

    what: str
    layout: str | None = None
    order: tuple[int, ...] | None = None
    side: Side | None = None

    @property
    def remedy(self) -> str:
        """What to say or write, for a file on the command line or in Python."""
        if self.side is not None:
            return (
                f"say --side {self.side} (in Python: side={self.side!r}); if it was mirrored, "
                "mirror it back: points * (-1, 1, 1)"
            )
        if self.layout is not None:
            return f"say --layout {self.layout} (in Python: layout={self.layout!r})"
        return f"put them in order: points[:, {list(self.order or ())}]"

    @property
    def in_python(self) -> str:
        """What to do with the points of a frame in a program."""
        if self.side is not None:
            return (
                f"load the {self.side} robot hand and say HandFrame(..., side={self.side!r}), or "
                "mirror the points: points * (-1, 1, 1)"
            )
        if self.layout is not None:
            return f"points[list(smooth_operator.landmarks.LAYOUTS[{self.layout!r}])]"
        return f"points[{list(self.order or ())}]"

    @property
    def live(self) -> str:
        """What is wrong with frames that come one by one, and what to do, in a few words."""
        if self.side is not None:
            return (
                f"by its shape it is a {self.side} hand; say side={self.side}, or do not mirror it"
            )
        if self.layout is not None:
            return f"landmarks in the order {self.layout!r}; give the source layout={self.layout}"
        return f"landmarks in another order; put them in order: points[{list(self.order or ())}]"


def layout_order(name: str | None) -> tuple[int, ...]:
    """The index of each landmark in points of a layout; None is the project's own.

    Raises:
        UnknownNameError: there is no such layout.
    """
    if name is None:
        return LAYOUTS["mediapipe"]
    if name not in LAYOUTS:
        raise UnknownNameError("layout", name, LAYOUTS)
    return LAYOUTS[name]


def check_hand(
    points: Float[np.ndarray, "T 21 3"],
    side: Side,
    valid: Bool[np.ndarray, "T 21"] | None = None,
    *,
    layout: str | None = None,
    where: str = "the landmarks",
) -> None:
    """Refuse points that are, by their shape, of the other hand or in another order.

    Args:
        points: (T, 21, 3) positions [m] as they came, in any right-handed frame.
        side: which hand they are said to be of.
        valid: (T, 21) which of them count; the finite ones if left out.
        layout: the order they are said to be in; None for the project's own, which is judged.
            ``mediapipe`` (or ``openpose``) is the same, and its order is not checked.
        where: what they are, for the message.

    Raises:
        RecordingError: they are not, with what was recognised and what to do. Fewer than
            ``FEWEST_FRAMES`` whole frames, or a shape that is no human hand's, raise nothing.
        UnknownNameError: there is no such layout.
    """
    found = doubt(points, side, valid, layout=layout)
    if found is not None:
        raise RecordingError(f"{where}: {found.what}; {found.remedy}")


def doubt(
    points: Float[np.ndarray, "T 21 3"],
    side: Side,
    valid: Bool[np.ndarray, "T 21"] | None = None,
    *,
    layout: str | None = None,
) -> Doubt | None:
    """What is wrong with the side or order of points; None if nothing is.

    Args:
        points: (T, 21, 3) positions [m] as they came.
        side: which hand they are said to be of.
        valid: (T, 21) which of them count; the finite ones if left out.
        layout: the order they are said to be in; None for the project's own, which is judged.
            ``mediapipe`` (or ``openpose``) is the same, and its order is not checked.

    Raises:
        UnknownNameError: there is no such layout.
    """
    order = layout_order(layout)
    believed = layout is not None and order == LAYOUTS["mediapipe"]
    whole = np.isfinite(points).all(axis=(1, 2))
    if valid is not None:
        whole &= valid.all(axis=1)
    if whole.sum() < FEWEST_FRAMES:
        return None
    rows = np.flatnonzero(whole)
    rows = rows[np.linspace(0, len(rows) - 1, min(_JUDGED, len(rows))).astype(int)]
    seen = points[rows]
    with np.errstate(over="ignore", invalid="ignore"):  # a landmark far beyond any hand
        misplaced = None if believed else _other_order(seen, order)
        return misplaced or _other_side(seen[:, order], side)


def _other_side(landmarks: Float[np.ndarray, "T 21 3"], side: Side) -> Doubt | None:
    sign = 1.0 if side == "right" else -1.0
    if sign * float(chirality(landmarks).mean()) >= MIRRORED:
        return None
    bones = np.diff(landmarks[:, _PAIRS], axis=2)[:, :, 0]
    if _misfits(np.median(np.linalg.norm(bones, axis=-1), axis=0)[None])[0] > _FITS:
        return None
    other: Side = "left" if side == "right" else "right"
    return Doubt(
        f"by its shape this is a {other} hand: fingers and thumb bend to the back of a {side} one",
        side=other,
    )


def chirality(landmarks: Float[np.ndarray, "T 21 3"]) -> Float[np.ndarray, " T"]:
    """Which hand each frame shows, by its shape: positive for a right, negative for a left one.

    The sum of how far thumb CMC and MCP are in front of the plane of the palm and the middle and
    ring MCP behind it, in palm lengths, and of the mean sine of the fingers' bends; 2 at most. A
    mirror image has the negative.

    Args:
        landmarks: (T, 21, 3) positions in the project's order, in any right-handed frame.
    """
    wrist = landmarks[:, 0]
    palmar = _unit(np.cross(landmarks[:, 5] - wrist, landmarks[:, 17] - wrist))
    before = ((landmarks[:, [1, 2, 9, 13]] - wrist[:, None]) * palmar[:, None]).sum(axis=-1)
    palm = np.maximum(np.linalg.norm(landmarks[:, 9] - wrist, axis=-1), 1e-9)
    across = _unit(landmarks[:, 5] - landmarks[:, 17])
    bones = _unit(np.diff(landmarks[:, 5:].reshape(-1, 4, 4, 3), axis=2))
    bends = (np.cross(bones[:, :, :-1], bones[:, :, 1:]) * across[:, None, None]).sum(axis=-1)
    stands = before @ np.array([1.0, 1.0, -1.0, -1.0]) / palm
    hand: np.ndarray = np.clip(stands + bends.mean(axis=(1, 2)), -2.0, 2.0)
    return hand


class HandCheck:
    """The same for frames that come one by one.

    The first frames are judged by order and side, the later ones, which may show another hand but
    no other order, by their side.

    Args:
        side: which hand they are said to be of.

    Attributes:
        judged: how many whole frames have been seen.
    """

    WINDOW: Final = 30
    """Frames that are judged together, and after which they are judged again."""

    def __init__(self, side: Side) -> None:
        self.side = side
        self.judged = 0
        self._window = np.empty((self.WINDOW, NUM_LANDMARKS, 3))
        self._found: Doubt | None = None

    def see(
        self, landmarks: Float[np.ndarray, "21 3"], valid: Bool[np.ndarray, "21"]
    ) -> Doubt | None:
        """What is wrong with the last frames; None if nothing is, or too few have come.

        Args:
            landmarks: (21, 3) of the next frame [m], in the project's order.
            valid: (21,) which of them count; a frame that is not whole is left out.
        """
        if not valid.all():
            return self._found
        self._window[self.judged % self.WINDOW] = landmarks
        self.judged += 1
        first = self.judged in (FEWEST_FRAMES, 2 * FEWEST_FRAMES, self.WINDOW)
        if first or (self.judged % self.WINDOW == 0 and self._found is not None):
            self._found = doubt(self._window[: self.judged], self.side)
        elif self.judged % self.WINDOW == 0:
            self._found = _other_side(self._window, self.side)
        return self._found


def _other_order(points: Float[np.ndarray, "T 21 3"], said: tuple[int, ...]) -> Doubt | None:
    """Which other order fits far better than the one that was said, if any."""
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    lengths = np.median(apart, axis=0)
    orders = np.vstack([said, _ORDERS])
    misfits = _misfits(lengths[orders[:, _PAIRS[:, 0]], orders[:, _PAIRS[:, 1]]])
    best = int(np.argmin(misfits))
    if misfits[best] > _FITS or misfits[0] - misfits[best] <= MISFIT:
        return None
    order = tuple(orders[best].tolist())
    name = next((name for name, named in LAYOUTS.items() if named == order), None)
    if name is None:
        looks = f"the points come in the order {_described(order)}"
    else:
        looks = f"the points are in the order {name!r} ({_described(order)})"
    was = next((name for name, named in LAYOUTS.items() if named == said), "said")
    return Doubt(
        f"by the lengths between them {looks}, not in {was!r} ({_described(said)})", name, order
    )


def _misfits(lengths: Float[np.ndarray, "n pairs"]) -> Float[np.ndarray, " n"]:
    """How far lengths are from those of a human hand of any size, in spreads, on average."""
    off = np.log(np.maximum(lengths, 1e-9)) - _LOGS
    off -= np.median(off, axis=1, keepdims=True)
    misfits: np.ndarray = np.minimum(np.abs(off) / _SPREAD, _MOST).mean(axis=1)
    return misfits


def _described(order: Sequence[int]) -> str:
    """The points in the order in which they come, finger by finger."""
    names = [""] * NUM_LANDMARKS
    for k, at in enumerate(order):
        names[at] = "wrist" if k == 0 else FINGERS[(k - 1) // 4]
    runs = [name for i, name in enumerate(names) if i == 0 or names[i - 1] != name]
    return ", ".join(runs) + (", each from tip to base" if order[4] < order[1] else "")


def _unit(vectors: np.ndarray) -> np.ndarray:
    unit: np.ndarray = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return unit


_ORDERS: Final = np.array(
    list(LAYOUTS.values())
    + [
        (0, *(BASES[f] + k for f in fingers for k in way))
        for way in ((0, 1, 2, 3), (3, 2, 1, 0))
        for fingers in permutations(range(5))
    ]
)

"""Checks size, order and side of landmarks by their shape.

Order: the lengths between neighbouring landmarks hardly depend on the pose. Those of a human hand,
as ratios, are compared under every order of the fingers and under the layouts of other trackers
and datasets (``LAYOUTS``); points that fit none are no hand. Side: fingers bend to the palm, the
thumb's base is in front of it, and the knuckles arch away from it; a mirror image is the
opposite. ``smooth_operator_research.judging.input_check`` measures both on real recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError, UnknownNameError
from smooth_operator.geometry import AnyArray, array_namespace
from smooth_operator.landmarks import BASES, FINGERS, LAYOUTS, NUM_LANDMARKS, WRIST
from smooth_operator.types import Side

PALM_RANGE_M: Final = (0.05, 0.14)
"""Bounds [m] on the distance from the wrist to the middle finger's MCP.

An adult's is near 0.095 m. The bounds leave room for children and for trackers that put the wrist
a little off, and no hand in millimetres, centimetres, decimetres, inches or feet fits between them.
"""

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

NO_HAND: Final = 1.0
"""Points whose lengths deviate more than this on average, in the order that is said, are no hand.

Over five frames recordings come to 0.6 at most, with 4 mm of noise too, the built-in robot hands to
0.8; random orders of 21 points to 1.1 at least.
"""

NO_HAND_FRAME: Final = 1.5
"""The same for a single frame, which one with 8 mm of noise stays under."""

_LONGEST: Final = 2.0  # palm lengths of any length; 1.1 in hands and robot hands
_UNSTEADY: Final = 0.3  # of the logarithms of bones; recordings 0.1, with 15 mm of noise 0.23
_STRETCHES: Final = 6  # of frames, over which medians of bones are compared
_FITS: Final = 0.9  # an order that deviates more is not named
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
_PALM: Final = 8  # of these pairs: wrist to middle MCP

_NEAR_CMC: Final = [WRIST, 2, 5, 17]  # its neighbours, without which side it need not be known
_CMC: Final = np.array([0.63, 0.408, 0.103, -0.141])  # their shares: least squares, 7 recordings


@dataclass(frozen=True)
class Doubt:
    """Reason why landmarks can't be those of the declared side and order.

    Attributes:
        what: appearance of the landmarks, as a clause.
        layout: the layout that they are in, if it has a name.
        order: the index of each landmark in the points as they came; None where the side is wrong.
        side: the side that they are of; None where the order is wrong.
        mend: advice where neither would help.
    """

    what: str
    layout: str | None = None
    order: tuple[int, ...] | None = None
    side: Side | None = None
    mend: str = ""

    @property
    def remedy(self) -> str:
        """Remedy for a file: the option on the command line, or the Python code."""
        if self.side is not None:
            return (
                f"say --side {self.side} (in Python: side={self.side!r}); if it was mirrored, "
                "mirror it back: points * (-1, 1, 1)"
            )
        if self.layout is not None:
            return f"say --layout {self.layout} (in Python: layout={self.layout!r})"
        return self.mend or f"put them in order: points[:, {list(self.order or ())}]"

    @property
    def in_python(self) -> str:
        """Remedy for the points of a frame in a program."""
        if self.side is not None:
            return (
                f"load the {self.side} robot hand and say HandFrame(..., side={self.side!r}), or "
                "mirror the points: points * (-1, 1, 1)"
            )
        if self.layout is not None:
            return f"smooth_operator.io.anatomy.in_our_order(points, layout={self.layout!r})"
        return self.mend or f"points[{list(self.order or ())}]"

    @property
    def live(self) -> str:
        """Problem and remedy in a few words, for frames that come one by one."""
        if self.side is not None:
            return (
                f"by its shape it is a {self.side} hand; say side={self.side}, or do not mirror it"
            )
        if self.layout is not None:
            return f"landmarks in the order {self.layout!r}; give the source layout={self.layout}"
        if self.mend:
            return f"{self.what}; {self.mend}"
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


def in_our_order(
    points: Float[np.ndarray, "*n 21 3"], layout: str | None = None
) -> Float[np.ndarray, "*n 21 3"]:
    """Points of a layout as the project's 21 landmarks.

    ``aria`` has the centre of the palm in place of the thumb's CMC, which is estimated from wrist,
    thumb, index and pinky MCP: 6 to 11 mm off on average in recordings of gloves and cameras.

    Raises:
        UnknownNameError: there is no such layout.
    """
    landmarks: np.ndarray = points[..., list(layout_order(layout)), :]
    if layout == "aria":
        landmarks[..., 1, :] = np.einsum("...kj,k->...j", landmarks[..., _NEAR_CMC, :], _CMC)
    return landmarks


def implausible(
    landmarks: AnyArray, valid: AnyArray, palms: tuple[float, float] = PALM_RANGE_M
) -> AnyArray:
    """True for a frame that can't be a hand, by its size [m] or by the lengths of its bones.

    Args:
        landmarks: (..., 21, 3) positions [m], in the project's order; NumPy or JAX.
        valid: (..., 21) which of them count. Only whole frames are judged by lengths.
        palms: least and greatest distance from the wrist to the middle finger's MCP [m].
    """
    xp = array_namespace(landmarks)
    bones = landmarks[..., _PAIRS[:, 1], :] - landmarks[..., _PAIRS[:, 0], :]
    lengths = xp.sqrt((bones * bones).sum(axis=-1))
    palm = lengths[..., _PALM]
    sized = (palm >= palms[0]) & (palm <= palms[1])
    shaped = (_misfits(lengths) <= NO_HAND_FRAME) & (lengths.max(axis=-1) <= _LONGEST * palm)
    odd: AnyArray = (valid[..., _PAIRS[_PALM]].all(axis=-1) & ~sized) | (
        valid.all(axis=-1) & ~shaped
    )
    return odd


def of_a_picture(landmarks: Float[np.ndarray, "T 21 3"]) -> bool:
    """True for image landmarks of a camera tracker: x and y, normalised or in
    pixels, count from a corner of the picture, and z counts from the wrist."""
    wrist, depth = landmarks[:, WRIST], np.abs(landmarks[..., 2]).max(axis=1, initial=0.0)
    flat = (np.abs(wrist[:, 2]) <= 1e-4 * depth) & (wrist[:, :2] > 0.0).all(axis=1)
    return len(landmarks) > 0 and bool(flat.all())


OF_A_PICTURE: Final = Doubt(
    "these are image landmarks: x and y are places in a picture and the wrist's z is 0, so no "
    "factor makes metres of them",
    mend="save the tracker's world landmarks, which are in metres",
)


def keeps_lengths(landmarks: Float[np.ndarray, "T 21 3"]) -> bool:
    """True if bones keep their lengths, in proportion, from one stretch of frames to the next.

    Fewer than five whole frames in a stretch are not judged, since noise would decide.
    """
    if len(landmarks) < FEWEST_FRAMES * _STRETCHES:
        return True
    bones = np.linalg.norm(np.diff(landmarks[:, _PAIRS[:20]], axis=2)[:, :, 0], axis=-1)
    parts = [np.median(part, axis=0) for part in np.array_split(bones, _STRETCHES)]
    logs = np.log(np.maximum(parts, 1e-9))
    logs -= np.median(logs, axis=1, keepdims=True)
    return bool(np.median(logs.std(axis=0)) <= _UNSTEADY)


def check_hand(
    points: Float[np.ndarray, "T 21 3"],
    side: Side,
    valid: Bool[np.ndarray, "T 21"] | None = None,
    *,
    layout: str | None = None,
    where: str = "the landmarks",
) -> None:
    """Refuse points that are, by their shape, no hand, of the other hand, or in another order.

    Args:
        points: (T, 21, 3) positions [m] as they came, in any right-handed frame.
        side: declared side of the hand.
        valid: (T, 21) which of them count; the finite ones if left out.
        layout: the order they are said to be in; None for the project's own, which is judged.
            ``mediapipe`` (or ``openpose``) is the same, and its order is not checked.
        where: origin of the landmarks, for the message.

    Raises:
        RecordingError: they are not, with what was recognised and what to do. Fewer than
            ``FEWEST_FRAMES`` whole frames raise nothing.
        UnknownNameError: there is no such layout.
    """
    reason = doubt(points, side, valid, layout=layout)
    if reason is not None:
        raise RecordingError(f"{where}: {reason.what}; {reason.remedy}")


def doubt(
    points: Float[np.ndarray, "T 21 3"],
    side: Side,
    valid: Bool[np.ndarray, "T 21"] | None = None,
    *,
    layout: str | None = None,
) -> Doubt | None:
    """Problem with the shape, order or side of points; None if there is none. Arguments are those
    of ``check_hand``.

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
    visible = points[rows]
    with np.errstate(over="ignore", invalid="ignore"):  # a landmark far beyond any hand
        if of_a_picture(visible[:, order]):
            return OF_A_PICTURE
        misplaced = None if believed else _other_order(visible, layout)
        return misplaced or _other_side(visible[:, order], side)


def _other_side(landmarks: Float[np.ndarray, "T 21 3"], side: Side) -> Doubt | None:
    sign = 1.0 if side == "right" else -1.0
    if sign * float(chirality(landmarks).mean()) >= MIRRORED:
        return None
    bones = np.diff(landmarks[:, _PAIRS], axis=2)[:, :, 0]
    if _misfits(np.median(np.linalg.norm(bones, axis=-1), axis=0)) > NO_HAND:
        return None
    other: Side = "left" if side == "right" else "right"
    return Doubt(
        f"by its shape this is a {other} hand: fingers and thumb bend to the back of a {side} one",
        side=other,
    )


def chirality(landmarks: Float[np.ndarray, "T 21 3"]) -> Float[np.ndarray, " T"]:
    """Chirality of each frame by its shape: positive for a right, negative for a left one.

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
        side: declared side of the hand.

    Attributes:
        judged: number of whole frames so far.
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
        """Problem with the last frames, after another [m]; None if there is none, or too few have
        come. Frames that are not whole are left out."""
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


def _other_order(points: Float[np.ndarray, "T 21 3"], layout: str | None) -> Doubt | None:
    """Finds an order that fits far better than the declared one, or that none fits."""
    stated = layout_order(layout)
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    lengths = np.median(apart, axis=0)
    if lengths.max() < 1e-9:  # no hand was in view, which the status says
        return None
    orders = np.vstack([stated, _ORDERS])
    misfits = _misfits(lengths[orders[:, _PAIRS[:, 0]], orders[:, _PAIRS[:, 1]]])
    best = int(np.argmin(misfits))
    if misfits[best] > _FITS or misfits[0] - misfits[best] <= MISFIT:
        if misfits[0] <= NO_HAND and keeps_lengths(points[:, stated]):
            return None
        return Doubt(
            "by the lengths between them the points are no hand, in this order or in any other "
            "that is known",
            mend=f"say their order (layout {', '.join(LAYOUTS)}), or put them in that of "
            "smooth_operator.landmarks.LANDMARKS, in metres along three axes",
        )
    order = tuple(orders[best].tolist())
    name = next((name for name, named in LAYOUTS.items() if named == order), None)
    if name is None:
        looks = f"the points come in the order {_described(order)}"
    else:
        looks = f"the points are in the order {name!r} ({_described(order)})"
    was = next((name for name, named in LAYOUTS.items() if named == stated), "given")
    return Doubt(
        f"by the lengths between them {looks}, not in {was!r} ({_described(stated)})", name, order
    )


def _misfits(lengths: AnyArray) -> AnyArray:
    """Mean deviation of (..., pairs) lengths from a human hand of any size, in spreads."""
    xp = array_namespace(lengths)
    off = xp.log(xp.maximum(lengths, 1e-9)) - _LOGS.astype(lengths.dtype)
    off = off - off.mean(axis=-1, keepdims=True)
    misfits: AnyArray = xp.minimum(abs(off) / _SPREAD, _MOST).mean(axis=-1)
    return misfits


def _described(order: Sequence[int]) -> str:
    """The points in the order in which they come, finger by finger."""
    names = [""] * NUM_LANDMARKS
    for k, at in enumerate(order):
        names[at] = "wrist" if k == 0 else FINGERS[(k - 1) // 4]
    runs = [name for i, name in enumerate(names) if i == 0 or names[i - 1] != name]
    return ", ".join(runs) + (", each from tip to base" if order[4] + 1 == order[3] else "")


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

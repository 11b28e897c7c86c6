"""Checks the size, order and side of landmarks, judging by their shape.

Order: ratios of the distances between neighbouring landmarks are compared with those of a human
hand for every order of the fingers and for the layouts of other trackers (``LAYOUTS``). Side:
fingers bend to the palm, the thumb's base is in front of it, and the knuckles arch away from it.
``smooth_operator_research.judging.input_check`` measures both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.geometry import AnyArray, array_namespace
from smooth_operator.landmarks import BASES, FINGERS, LAYOUTS, NUM_LANDMARKS, WRIST
from smooth_operator.types import Side

PALM_RANGE_M: Final = (0.05, 0.14)
"""Bounds [m] on the distance from the wrist to the middle finger's MCP; adults have 0.095. They
include children, and exclude hands in millimetres, centimetres, decimetres, inches or feet."""

FEWEST_FRAMES: Final = 5
"""Smallest number of complete frames for a judgement."""

MISFIT: Final = 0.25
"""A layout is refused if another layout fits better by this much, in mean deviations of a length.
Over five frames with 4 mm of noise, the right order reaches at most 0.05, others at least 0.35."""

MIRRORED: Final = -0.25
"""A side is refused if its mean chirality is below this value. Over five frames with 6 mm of noise,
correct sides reach at least -0.15, mirrored ones at most -0.35, unless the palm is a plane."""

BENT: Final = 0.2
"""Mean sine of the fingers' bends above which they determine the side."""

CLEAR: Final = 0.6
"""Chirality above which straight fingers also determine the side. Depth cameras measure the thumb
of a flat hand behind the palm, which gives -0.55 at worst."""

_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
_IN_FRONT: Final = np.array([1.0, 1.0, -1.0, -1.0])
"""Landmarks in front of the palm's plane (thumb CMC, MCP) and behind it (middle and ring MCP)."""

NO_HAND: Final = 1.0
"""Largest mean deviation of the lengths of a hand in the declared order. Over five frames,
recordings have at most 0.6, robot hands 0.8; random orders have at least 1.1."""

NO_HAND_FRAME: Final = 1.5
"""Largest mean deviation of the lengths in one frame. Frames with 8 mm of noise are below it."""

_LONGEST: Final = 2.0  # palm lengths of any length; 1.1 in hands and robot hands
_UNSTEADY: Final = 0.3  # of the logarithms of bones; recordings 0.1, with 15 mm of noise 0.23
_STRETCHES: Final = 6  # of frames, over which medians of bones are compared
_FITS: Final = 0.9  # an order that deviates more is not named
_SPREAD: Final = 0.3  # of the logarithm of a length, between people and between trackers
_MOST: Final = 3.0  # spreads that one length may count

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


@dataclass(frozen=True)
class Doubt:
    """Reason to believe that landmarks are not those of the declared side and order.

    Attributes:
        what: description of the landmarks, as a clause.
        layout: the layout of the landmarks, if it has a name.
        order: the index of each landmark among the given points; None if the side is wrong.
        side: the actual side; None if the order is wrong.
        mend: advice if neither the side nor the order explains the problem.
    """

    what: str
    layout: str | None = None
    order: tuple[int, ...] | None = None
    side: Side | None = None
    mend: str = ""

    @property
    def in_python(self) -> str:
        """Advice on how to correct the points of a frame in a Python program."""
        if self.side is not None:
            return (
                f"load the {self.side} robot hand and use HandFrame(..., "
                f"side={self.side!r}), or mirror the points: points * (-1, 1, 1)"
            )
        if self.layout is not None:
            return f"smooth_operator.io.landmark_order.in_our_order(points, layout={self.layout!r})"
        return self.mend or f"points[{list(self.order or ())}]"


def implausible(
    landmarks: AnyArray, valid: AnyArray, palms: tuple[float, float] = PALM_RANGE_M
) -> AnyArray:
    """True for frames that can't show a hand, by its size [m] or the lengths of its bones.

    Args:
        landmarks: (..., 21, 3) positions [m], in the project's order; NumPy or JAX.
        valid: (..., 21) True for landmarks that count. Only complete frames are judged by lengths.
        palms: smallest and largest distance from the wrist to the middle finger's MCP [m].
    """
    lengths = bone_lengths(landmarks)
    palm = lengths[..., _PALM]
    sized = (palm >= palms[0]) & (palm <= palms[1])
    shaped = (misfits_of(lengths) <= NO_HAND_FRAME) & (lengths.max(axis=-1) <= _LONGEST * palm)
    odd: AnyArray = (valid[..., _PAIRS[_PALM]].all(axis=-1) & ~sized) | (
        valid.all(axis=-1) & ~shaped
    )
    return odd


def of_a_picture(landmarks: Float[np.ndarray, "T 21 3"]) -> bool:
    """True for image landmarks of a camera tracker: x and y are measured from a corner of the
    picture (normalised or in pixels), and z from the wrist."""
    wrist, depth = landmarks[:, WRIST], np.abs(landmarks[..., 2]).max(axis=1, initial=0.0)
    flat = (np.abs(wrist[:, 2]) <= 1e-4 * depth) & (wrist[:, :2] > 0.0).all(axis=1)
    return len(landmarks) > 0 and bool(flat.all())


OF_A_PICTURE: Final = Doubt(
    "these are image landmarks: x and y are positions in an image and the wrist's z is 0, so "
    "they can't be converted to metres",
    mend="save the tracker's world landmarks, which are in metres",
)


def keeps_lengths(landmarks: Float[np.ndarray, "T 21 3"]) -> bool:
    """True if the ratios of bone lengths stay constant over the recording, or if there are too few
    frames to tell."""
    if len(landmarks) < FEWEST_FRAMES * _STRETCHES:
        return True
    bones = np.linalg.norm(np.diff(landmarks[:, _PAIRS[:20]], axis=2)[:, :, 0], axis=-1)
    parts = [np.median(part, axis=0) for part in np.array_split(bones, _STRETCHES)]
    logs = np.log(np.maximum(parts, 1e-9))
    logs -= np.median(logs, axis=1, keepdims=True)
    return bool(np.median(logs.std(axis=0)) <= _UNSTEADY)


def of_the_other(side: Side) -> Doubt:
    """Returns the problem to report for a hand whose side is not the declared ``side``."""
    other: Side = "left" if side == "right" else "right"
    return Doubt(
        f"judging by its shape, this is a {other} hand: on a {side} hand, fingers and thumb would "
        "bend backwards",
        side=other,
    )


def sides(landmarks: Float[np.ndarray, "T 21 3"]) -> Int[np.ndarray, " T"]:
    """Side of each frame, computed from its shape: 1 right, -1 left, 0 unknown. Straight fingers
    determine it only if thumb and knuckles stand out clearly. NaN has no effect.

    Args:
        landmarks: (T, 21, 3) positions in the project's order, in any right-handed frame.
    """
    stands, bends = stands_and_bends(landmarks)
    hand = stands + bends
    bent = (np.abs(bends) >= BENT) & (bends * hand > 0.0) & (np.abs(hand) >= -MIRRORED)
    told: np.ndarray = np.where(bent | (np.abs(hand) >= CLEAR), np.sign(hand), 0.0).astype(int)
    return told


def stands_and_bends(landmarks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Computes the two parts of the chirality of (T, 21, 3) landmarks; a part without data is 0."""
    points = landmarks - landmarks[:, :1]
    palmar = _unit(_cross(points[:, 5], points[:, 17]))
    palm = np.maximum(np.sqrt((points[:, 9] ** 2).sum(axis=-1)), 1e-9)
    stands = (points[:, [1, 2, 9, 13]] @ palmar[:, :, None])[..., 0] * _IN_FRONT / palm[:, None]
    fingers = points[:, 5:].reshape(-1, 4, 4, 3)
    bones = _unit(fingers[:, :, 1:] - fingers[:, :, :-1])
    across = _unit(points[:, 5] - points[:, 17])[:, None, :, None]
    bends = (_cross(bones[:, :, :-1], bones[:, :, 1:]) @ across)[..., 0]
    known = np.isfinite(bends)
    return (
        np.where(np.isfinite(stands), stands, 0.0).sum(axis=1),
        np.where(known, bends, 0.0).sum(axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1),
    )


class HandCheck:
    """Check of side and order for frames that arrive one at a time.

    The order is judged over the first frames together, and again later if it was wrong. The side is
    judged in every frame: a frame that is clearly of the other hand is refused at once. After two
    such frames, frames with an unknown side are also refused for ``MEMORY_S``, until a frame is
    clearly of the right side.

    Args:
        side: declared side of the hand.

    Attributes:
        judged: number of complete frames so far.
    """

    WINDOW: Final = 30
    """Number of frames that are judged together, and after which the order is judged again."""

    MEMORY_S: Final = 0.25
    """Time after a frame of the other hand for which flat hands count as that hand [s]."""

    def __init__(self, side: Side) -> None:
        self.side = side
        self.judged = 0
        self._window = np.empty((self.WINDOW, NUM_LANDMARKS, 3))
        self._order: Doubt | None = None
        self._other = 0  # frames of the other hand, none of the right one between them
        self._other_at = 0.0

    def see(
        self, landmarks: Float[np.ndarray, "21 3"], valid: Bool[np.ndarray, "21"], at: float
    ) -> Doubt | None:
        """Adds a frame and returns the problem with the last frames; None if nothing is wrong.

        Args:
            landmarks: positions [m].
            valid: True for landmarks that count; the order is judged only in complete frames.
            at: time of the frame [s].
        """
        if valid.all():
            self._window[self.judged % self.WINDOW] = landmarks
            self.judged += 1
            first = self.judged in (FEWEST_FRAMES, 2 * FEWEST_FRAMES, self.WINDOW)
            if first or (self.judged % self.WINDOW == 0 and self._order is not None):
                self._order = wrong_order(self._window[: self.judged], LAYOUTS["mediapipe"])
        return self._order or self._other_hand(np.where(valid[:, None], landmarks, np.nan), at)

    @property
    def surely_other(self) -> bool:
        """True if too many frames are of the other hand to be tracking errors."""
        return self._other >= FEWEST_FRAMES

    def _other_hand(self, landmarks: Float[np.ndarray, "21 3"], at: float) -> Doubt | None:
        with np.errstate(over="ignore", invalid="ignore"):  # a landmark far beyond any hand
            side = int(sides(landmarks[None])[0]) * (1 if self.side == "right" else -1)
            if side < 0 and misfits_of(bone_lengths(landmarks)) > NO_HAND:
                side = 0  # no hand of any side
        remembered = 0.0 <= at - self._other_at <= self.MEMORY_S
        if side > 0 or (side == 0 and not remembered):
            self._other = 0
        elif side < 0:
            self._other, self._other_at = self._other + 1, at
        if side < 0 or self._other > 1:
            return of_the_other(self.side)
        return None


def wrong_order(
    points: Float[np.ndarray, "T 21 3"], stated: tuple[int, ...], believed: bool = False
) -> Doubt | None:
    """Returns what is wrong with the order; if ``believed``, checks only for image landmarks."""
    with np.errstate(over="ignore", invalid="ignore"):  # a landmark far beyond any hand
        if of_a_picture(points[:, list(stated)]):
            return OF_A_PICTURE
        return None if believed else _other_order(points, stated)


def _other_order(points: Float[np.ndarray, "T 21 3"], stated: tuple[int, ...]) -> Doubt | None:
    """Finds an order that fits far better than the declared one, or finds that no order fits."""
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    lengths = np.median(apart, axis=0)
    if lengths.max() < 1e-9:  # no hand was in view, which the status says
        return None
    orders = np.vstack([stated, _ORDERS])
    misfits = misfits_of(lengths[orders[:, _PAIRS[:, 0]], orders[:, _PAIRS[:, 1]]])
    best = int(np.argmin(misfits))
    if misfits[best] > _FITS or misfits[0] - misfits[best] <= MISFIT:
        if misfits[0] <= NO_HAND and keeps_lengths(points[:, list(stated)]):
            return None
        return Doubt(
            "judging by the distances between them, the points do not form a hand in this or "
            "any other known order",
            mend=f"name their order (layout {', '.join(LAYOUTS)}), or reorder them as in "
            "smooth_operator.landmarks.LANDMARKS, in metres along three axes",
        )
    order = tuple(orders[best].tolist())
    name = next((name for name, named in LAYOUTS.items() if named == order), None)
    if name is None:
        looks = f"the points are in the order {_described(order)}"
    else:
        looks = f"the points are in the order {name!r} ({_described(order)})"
    was = next((name for name, named in LAYOUTS.items() if named == stated), "given")
    return Doubt(
        f"judging by the distances between them, {looks}, not in {was!r} ({_described(stated)})",
        name,
        order,
    )


def bone_lengths(landmarks: AnyArray) -> AnyArray:
    """(..., 26) lengths of bones and of lines across the palm [m] from (..., 21, 3) landmarks."""
    bones = landmarks[..., _PAIRS[:, 1], :] - landmarks[..., _PAIRS[:, 0], :]
    lengths: AnyArray = array_namespace(landmarks).sqrt((bones * bones).sum(axis=-1))
    return lengths


def misfits_of(lengths: AnyArray) -> AnyArray:
    """Mean deviation of (..., pairs) lengths from a human hand's, in standard deviations."""
    xp = array_namespace(lengths)
    off = xp.log(xp.maximum(lengths, 1e-9)) - _LOGS.astype(lengths.dtype)
    off = off - off.mean(axis=-1, keepdims=True)
    misfits: AnyArray = xp.minimum(abs(off) / _SPREAD, _MOST).mean(axis=-1)
    return misfits


def _described(order: Sequence[int]) -> str:
    """Description of the order of the points, finger by finger."""
    names = [""] * NUM_LANDMARKS
    for k, at in enumerate(order):
        names[at] = "wrist" if k == 0 else FINGERS[(k - 1) // 4]
    runs = [name for i, name in enumerate(names) if i == 0 or names[i - 1] != name]
    return ", ".join(runs) + (", each from tip to base" if order[4] + 1 == order[3] else "")


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of (..., 3) vectors; it takes a third of the time of NumPy's."""
    product: np.ndarray = a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]
    return product


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    unit: np.ndarray = vectors / np.maximum(lengths, 1e-12)
    return unit


_ORDERS: Final = np.array(
    list(LAYOUTS.values())
    + [
        (0, *(BASES[f] + k for f in fingers for k in way))
        for way in ((0, 1, 2, 3), (3, 2, 1, 0))
        for fingers in permutations(range(5))
    ]
)

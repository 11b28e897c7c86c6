"""Converts the points of a file or tracker to landmarks, and checks their shape, side and order."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError, UnknownNameError
from smooth_operator.io.anatomy import (
    FEWEST_FRAMES,
    MIRRORED,
    NO_HAND,
    Doubt,
    bone_lengths,
    misfits_of,
    of_the_other,
    sides,
    stands_and_bends,
    wrong_order,
)
from smooth_operator.landmarks import LAYOUTS, WRIST
from smooth_operator.types import Side

_JUDGED_SHARE: Final = 0.05  # of the frames that must tell the side
_JUDGED: Final = 300  # frames of a recording that are looked at

_NEAR_CMC: Final = [WRIST, 2, 5, 17]  # its neighbours, without which side it need not be known
_CMC: Final = np.array([0.63, 0.408, 0.103, -0.141])  # their shares: least squares, 7 recordings


def layout_order(name: str | None) -> tuple[int, ...]:
    """Index of each landmark among the points of a layout; None means the project's own layout.
    Raises UnknownNameError if there is no such layout."""
    if name is None:
        return LAYOUTS["mediapipe"]
    if name not in LAYOUTS:
        raise UnknownNameError("layout", name, LAYOUTS)
    return LAYOUTS[name]


def in_our_order(
    points: Float[np.ndarray, "*n 21 3"], layout: str | None = None
) -> Float[np.ndarray, "*n 21 3"]:
    """Converts points of a layout to the project's 21 landmarks.

    ``aria`` has the centre of the palm instead of the thumb's CMC. The CMC is estimated from the
    wrist and the MCPs of thumb, index and pinky, with a mean error of 6 to 11 mm.

    Raises:
        UnknownNameError: there is no such layout.
    """
    landmarks: np.ndarray = points[..., list(layout_order(layout)), :]
    if layout == "aria":
        landmarks[..., 1, :] = np.einsum("...kj,k->...j", landmarks[..., _NEAR_CMC, :], _CMC)
    return landmarks


def check_hand(
    points: Float[np.ndarray, "T 21 3"],
    side: Side,
    valid: Bool[np.ndarray, "T 21"] | None = None,
    *,
    layout: str | None = None,
    where: str = "the landmarks",
) -> None:
    """Refuses points whose shape is not that of a hand, is that of the other hand, or has another
    order.

    Args:
        points: (T, 21, 3) original positions [m], in any right-handed frame.
        side: declared side of the hand.
        valid: (T, 21) mask of the landmarks to use. Default: finite landmarks.
        layout: declared order; None for the project's own order, which is checked. ``mediapipe``
            (or ``openpose``) is the same, and its order is not checked.
        where: origin of the landmarks, for the message.

    Raises:
        RecordingError: the check failed; the message states the recognised hand and a remedy. Fewer
            than ``FEWEST_FRAMES`` complete frames are accepted.
        UnknownNameError: there is no such layout.
    """
    reason = doubt(points, side, valid, layout=layout)
    if reason is not None:
        raise RecordingError(f"{where}: {reason.what}; {remedy(reason)}")


def remedy(doubt: Doubt) -> str:
    """Advice on how to correct a file: the option on the command line, or the Python code."""
    if doubt.side is not None:
        return (
            f"use --side {doubt.side} (in Python: side={doubt.side!r}); if the recording "
            "was mirrored, mirror it back: points * (-1, 1, 1)"
        )
    if doubt.layout is not None:
        return f"use --layout {doubt.layout} (in Python: layout={doubt.layout!r})"
    return doubt.mend or f"reorder them: points[:, {list(doubt.order or ())}]"


def doubt(
    points: Float[np.ndarray, "T 21 3"],
    side: Side,
    valid: Bool[np.ndarray, "T 21"] | None = None,
    *,
    layout: str | None = None,
) -> Doubt | None:
    """Problem with the shape, order or side of points; None if nothing is wrong. Takes the same
    arguments as ``check_hand``. Raises UnknownNameError if there is no such layout."""
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
        misplaced = wrong_order(visible, order, believed)
        return misplaced or _other_side(visible[:, order], side)


def _other_side(landmarks: Float[np.ndarray, "T 21 3"], side: Side) -> Doubt | None:
    told = sides(landmarks)
    judged = told != 0
    if judged.sum() < max(FEWEST_FRAMES, _JUDGED_SHARE * len(landmarks)):
        return None
    sign = 1.0 if side == "right" else -1.0
    if sign * float(chirality(landmarks[judged]).mean()) >= MIRRORED:
        return None
    if misfits_of(np.median(bone_lengths(landmarks), axis=0)) > NO_HAND:
        return None
    return of_the_other(side)


def chirality(landmarks: Float[np.ndarray, "T 21 3"]) -> Float[np.ndarray, " T"]:
    """Chirality of each frame, judged by its shape: positive for a right hand, negative for a left
    hand.

    It is the sum of three terms: the distance of thumb CMC and MCP in front of the plane of the
    palm, the distance of middle and ring MCP behind it, both in palm lengths, and the mean sine of
    the fingers' bends. It is at most 2. A mirror image has the negative. NaN has no effect.

    Args:
        landmarks: (T, 21, 3) positions in the project's order, in any right-handed frame.
    """
    stands, bends = stands_and_bends(landmarks)
    hand: np.ndarray = np.clip(stands + bends, -2.0, 2.0)
    return hand

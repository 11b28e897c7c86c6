"""Axes of a palm, and axes of a human palm that was aligned to a robot's palm."""

from __future__ import annotations

from types import ModuleType
from typing import Generic, Literal, NamedTuple, TypeVar

import numpy as np

from smooth_operator.geometry import AnyArray, AnyKind, array_namespace
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.alignment import palm_alignment
from smooth_operator.retargeting.flat_hand import flat_hand

_Held = TypeVar("_Held", bound=AnyArray)  # a named tuple can't be generic over alternatives


class PalmAxes(NamedTuple, Generic[_Held]):
    """Orthonormal directions of a palm.

    Attributes:
        distal: (..., 3) direction towards the fingers.
        radial: (..., 3) direction towards the thumb's side.
        palmar: (..., 3) direction out of the palm.
    """

    distal: _Held
    radial: _Held
    palmar: _Held


def palm_axes(landmarks: AnyKind, side: Literal["right", "left"]) -> PalmAxes[AnyKind]:
    """Computes the directions of a palm. Distal points from wrist to middle MCP; palmar is
    perpendicular to it and to the line between the index and pinky MCPs.

    Args:
        landmarks: (..., 21, 3) [m].
        side: side of the hand; the mirror image of a hand has the mirror image of its axes.
    """
    xp = array_namespace(landmarks)
    distal = unit_vectors(landmarks[..., 9, :] - landmarks[..., 0, :], xp)
    across = landmarks[..., 5, :] - landmarks[..., 17, :]
    handed = 1.0 if side == "right" else -1.0
    palmar = handed * unit_vectors(xp.cross(across, distal), xp)
    return PalmAxes(distal, handed * xp.cross(distal, palmar), palmar)


def unit_vectors(vector: AnyKind, xp: ModuleType) -> AnyKind:
    """Normalises vectors; a zero vector stays zero."""
    length = xp.sqrt((vector * vector).sum(axis=-1, keepdims=True))
    out: AnyKind = vector / xp.maximum(length, 1e-9)
    return out


def human_palm_axes(hand: Hand) -> PalmAxes[np.ndarray]:
    """Axes of a human palm in the robot's palm frame, after the alignment.

    A robot's own wrist and knuckles seldom span a palm like a human's, so the directions are those
    of the built-in operator's hand, aligned like every frame.
    """
    landmarks = flat_hand(hand.spec.side)
    return palm_axes(palm_alignment(landmarks, hand).apply(landmarks), hand.spec.side)

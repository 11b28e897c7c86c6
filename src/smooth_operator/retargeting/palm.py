"""Directions of a palm."""

from __future__ import annotations

from types import ModuleType
from typing import Generic, Literal, NamedTuple, TypeVar

from smooth_operator.geometry import AnyArray, AnyKind, array_namespace

_Held = TypeVar("_Held", bound=AnyArray)  # a named tuple can't be generic over alternatives


class PalmAxes(NamedTuple, Generic[_Held]):
    """Orthonormal directions of a palm.

    Attributes:
        distal: (..., 3) to the fingers.
        radial: (..., 3) to the side of the thumb.
        palmar: (..., 3) out of the palm.
    """

    distal: _Held
    radial: _Held
    palmar: _Held


def palm_axes(landmarks: AnyKind, side: Literal["right", "left"]) -> PalmAxes[AnyKind]:
    """The directions of a palm: distal from wrist to middle MCP, palmar square to that and to the
    line of the index and pinky MCPs.

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
    """Unit vectors; zero of a zero vector."""
    length = xp.sqrt((vector * vector).sum(axis=-1, keepdims=True))
    out: AnyKind = vector / xp.maximum(length, 1e-9)
    return out

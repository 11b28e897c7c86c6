"""The far end of a link's shapes, seen from its joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

_NAIL: Final = 0.06  # shift of the very end of a shape, of its thickness, that makes a nail
_PAD: Final = 0.8  # how far behind a nail's end the pad is, in half thicknesses
_ELSEWHERE: Final = 0.5  # of the finger's length: a shape farther from the joint is not the link's
_ROUNDS: Final = 4


@dataclass(frozen=True)
class End:
    """End of a link, in the world frame.

    Attributes:
        tip: (3,) where its pad ends [m]: the far end, or a little behind a nail.
        far: (3,) the far end on the middle line [m].
        nail: True if the back extends beyond the pad.
    """

    tip: Float[np.ndarray, "3"]
    far: Float[np.ndarray, "3"]
    nail: bool


def far_end(
    clouds: Sequence[Float[np.ndarray, "p 3"]],
    anchor: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    scale: float,
) -> End | None:
    """The far end of a link on the middle line of its shapes.

    The middle line runs through the centres of two sections, one near the joint and one near the
    end, and is found together with the end by repetition.

    Args:
        clouds: points on each shape, world [m].
        anchor: a point of the joint's axis [m].
        axis: unit vector of the joint.
        scale: length of the rest of the finger [m], to tell what is small and what is far.

    Returns:
        the end; None if there are no shapes, or they lie about the joint and show no direction.
    """
    parts = [part for part in clouds if len(part)]
    if not parts:
        return None
    gaps = [float(np.linalg.norm(part - anchor, axis=1).min()) for part in parts]
    near = [part for part, gap in zip(parts, gaps, strict=True) if gap < _ELSEWHERE * scale]
    points = np.concatenate(near or parts) - anchor
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    middle = middle - (middle @ axis) * axis  # where along its hinge a link is drawn says nothing
    if np.linalg.norm(middle) < 1e-4:
        return None
    along = middle / np.linalg.norm(middle)
    tip = far = np.zeros(3)
    nail = False
    for _ in range(_ROUNDS):
        lateral = axis - (axis @ along) * along
        if np.linalg.norm(lateral) < 1e-6:
            return None  # a link along its own axis: it twists, and has no bending plane
        lateral = lateral / np.linalg.norm(lateral)
        across = np.cross(along, lateral)
        run = points @ along
        top = _top(run)
        if top < min(0.15 * scale, 0.008):
            return None
        share = run / top
        flat = points @ np.stack([across, lateral], axis=1)
        upper = (
            _section(flat, share, 0.6, 0.92)
            or _section(flat, share, 0.5, 1.0)
            or _section(flat, share, -np.inf, 1.0)
        )
        if upper is None:
            return None
        centre, half = upper
        far = top * along + centre[0] * across + centre[1] * lateral
        nail = _has_nail(flat[(share > 0.975) & (share <= 1.0)][:, 0], float(centre[0]), half)
        tip = far - (_PAD * half * along if nail else 0.0)
        lower = _section(flat, share, 0.1, 0.4)
        if lower is None:
            break
        start = 0.25 * top * along + lower[0][0] * across + lower[0][1] * lateral
        end = 0.76 * top * along + centre[0] * across + centre[1] * lateral
        along = (end - start) / np.linalg.norm(end - start)
    return End(anchor + tip, anchor + far, nail)


def _section(
    flat: np.ndarray, share: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, float] | None:
    """Centre of a stretch of the link, (2,), and half its thickness; None with too few points."""
    inside = flat[(share >= low) & (share <= high)]
    if len(inside) < 6:
        return None
    least, most = inside.min(axis=0), inside.max(axis=0)
    return (least + most) / 2, float(most[0] - least[0]) / 2


def _has_nail(cap: np.ndarray, centre: float, half: float) -> bool:
    """True if a link is rounded and ends at one side; a straight cut has no nail."""
    if len(cap) < 5:
        return False
    shift = abs(float(cap.min() + cap.max()) / 2 - centre)
    return 2 * _NAIL * half < shift and float(np.ptp(cap)) < 1.7 * half


def _top(run: np.ndarray) -> float:
    """Finds the end of a shape: its last point, without few stray points beyond a gap."""
    order = np.sort(run)
    few = max(len(order) // 50, 1)
    if len(order) > 100:
        gaps = np.diff(order[-few - 1 :])
        jumps = np.flatnonzero(gaps > 0.08 * max(order[-few - 1], 1e-6))
        if len(jumps):
            return float(order[-few - 1 + jumps[0]])
    return float(order[-1])

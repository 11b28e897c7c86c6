"""Segments of a recording: which frames are connected, and which gaps are too long."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float


def even_stamps(stamps: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Stamps on an even grid of the median period, lost frames counted whole.

    A tracker's clock jitters where its frames are evenly taken, and a derivative by jittering
    stamps jitters itself.

    Args:
        stamps: (T,) strictly increasing times [s].

    Returns:
        (T,) times from 0 on [s].
    """
    if len(stamps) < 2:
        return np.zeros(len(stamps))
    steps = np.diff(stamps)
    period = float(np.median(steps))
    return np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / period), 1.0))]) * period


def segments(
    valid: Bool[np.ndarray, " T"], stamps: Float[np.ndarray, " T"], bridge: float
) -> list[slice]:
    """Stretches that begin and end with a frame that was seen, without long gaps inside.

    Args:
        valid: (T,) frames with a usable hand.
        stamps: (T,) times [s].
        bridge: longest time from one seen frame to the next within a stretch, plus a period [s].
    """
    at = np.flatnonzero(valid)
    if not len(at):
        return []
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    # half a period more, so that rounding decides nothing
    cuts = np.flatnonzero(np.diff(stamps[at]) > bridge + 1.5 * period)
    starts, ends = [0, *(cuts + 1)], [*cuts, len(at) - 1]
    return [slice(int(at[i]), int(at[j]) + 1) for i, j in zip(starts, ends, strict=True)]


def tracker_noise(points: Float[np.ndarray, "T N 3"], valid: Bool[np.ndarray, " T"]) -> float:
    """Usual noise of a tracker in a point's second difference [m].

    Of each frame the median of the points, over time the mean of roots: as
    the landmark filter has it, but of all frames together.

    Args:
        points: (T, N, 3) [m].
        valid: (T,) frames that count; the noise needs three of those in a row.
    """
    usable = valid[2:] & valid[1:-1] & valid[:-2]
    if not usable.any():
        return 0.0
    bend = np.linalg.norm(points[2:] - 2 * points[1:-1] + points[:-2], axis=-1)[usable]
    return float(np.sqrt(np.median(bend, axis=1)).mean() ** 2)


def without_jumps(
    points: Float[np.ndarray, "T N 3"], valid: Bool[np.ndarray, " T"], jump: float
) -> Float[np.ndarray, "T N 3"]:
    """Points that are followed without jumps, and neither late nor early.

    They are filtered twice, forwards and backwards in time, each time by an ever smaller share of a
    step as it grows, and the mean is taken. Steady motion is late in one and as early in the other;
    a jump is spread over the frames before and after it.

    Args:
        points: (T, N, 3) [m].
        valid: (T,) frames that count; the others stay as they are.
        jump: the filter follows half of a step of this length in a frame [m]; 0 follows all.
    """
    at = np.flatnonzero(valid)
    if not jump or len(at) < 2:
        return points
    followed = np.zeros((2, *points.shape))
    for k, order in enumerate((at, at[::-1])):
        last = points[order[0]].astype(np.float64)
        for t in order:
            step = points[t] - last
            size = np.sqrt((step * step).sum(axis=-1, keepdims=True))
            last = last + step / (1.0 + size / jump)
            followed[k, t] = last
    out = points.copy()
    out[at] = followed.mean(axis=0)[at]
    return out


def windows(count: int, size: int, ahead: int) -> list[tuple[int, int, int]]:
    """Parts of a long stretch: (first, end of what is kept, end of what is looked at)."""
    parts = []
    for start in range(0, max(count, 1), size):
        keep = min(start + size, count)
        if count - keep <= ahead:  # a short rest is done with it
            keep = count
        parts.append((start, keep, min(keep + ahead, count)))
        if keep == count:
            break
    return parts


def hold(
    q: Float[np.ndarray, "T m"], stretches: list[slice], neutral: Float[np.ndarray, " m"]
) -> None:
    """The last pose between stretches and after them; the neutral one before the first."""
    last, done = neutral, 0
    for stretch in [*stretches, slice(len(q), len(q))]:
        q[done : stretch.start] = last
        if stretch.stop > stretch.start:
            last, done = q[stretch.stop - 1], stretch.stop

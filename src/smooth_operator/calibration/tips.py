"""Offsets from the tip landmarks to the finger pads, estimated from pinches."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.human.anatomical_axes import PalmAxes
from smooth_operator.human.operator import tip_frames
from smooth_operator.landmarks import FINGERS, TIPS

PRIOR: Final = 0.004
"""What is expected of an offset before anything is seen: zero, give or take [m]."""
DEVIATION: Final = 0.002
"""What a long finger's is expected to differ from those of the others [m]."""
NOISE: Final = 0.002
"""Of one pinch: how far off the pads are from meeting, by the tracker or in truth [m]."""
LIMIT: Final = 0.02
"""Offsets are held within this [m]."""

_PER_SEGMENT: Final = 2.0  # frames of one pinch are alike: a whole segment counts as so many
_HUBER: Final = 2.0  # [NOISE]
_ROUNDS: Final = 10


def fit_tip_offsets(
    pinches: Mapping[str, tuple[Float[np.ndarray, "N 21 3"], int]],
    axes: PalmAxes[np.ndarray],
) -> Float[np.ndarray, "5 2"]:
    """Offsets that bring thumb pad and finger pad together wherever they pinch.

    For each frame of a pinch, finger tip + offset = thumb tip + offset, each offset a constant in
    the frame of its tip. Long fingers share an offset and differ from it by little, so that one
    that was never seen pinching has theirs; the thumb has its own. A least-squares problem with
    these expectations as a prior, and Huber's weights against frames that are off.

    Args:
        pinches: finger -> landmarks of its frames in the palm frame, at human size [m], and how
            many pinches they are of.
        axes: of the palm, in that frame.

    Returns:
        (5, 2) along the last bone and to the pad, thumb first [m]; zeros without any pinch.
    """
    if not pinches:
        return np.zeros((5, 2))
    rows, targets, counts = [], [], []
    for finger, (points, times) in pinches.items():
        i = FINGERS.index(finger)
        along, pad = tip_frames(points, [0, i], axes)
        frames = np.stack([along, pad], axis=-1)  # (N, thumb and finger, 3, 2)
        row = np.zeros((len(points), 3, 12))
        row[..., 0:2] = -frames[:, 0]
        row[..., 2:4] = frames[:, 1]  # what the long fingers share
        row[..., 2 + 2 * i : 4 + 2 * i] = frames[:, 1]  # how this one differs
        rows.append(row)
        targets.append(points[:, TIPS[0]] - points[:, TIPS[i]])
        share = min(1.0, _PER_SEGMENT * times / len(points))
        counts.append(np.full(len(points), share))
    matrix, target = np.concatenate(rows), np.concatenate(targets)
    weight = np.concatenate(counts) / NOISE**2
    prior = np.diag(np.array([PRIOR] * 4 + [DEVIATION] * 8) ** -2.0)
    robust = np.ones(len(target))
    x = np.zeros(12)
    for _ in range(_ROUNDS):
        w = weight * robust
        normal = np.einsum("nki,n,nkj->ij", matrix, w, matrix) + prior
        x = np.linalg.solve(normal, np.einsum("nki,n,nk->i", matrix, w, target))
        off = np.linalg.norm(matrix @ x - target, axis=1)
        robust = np.minimum(1.0, _HUBER * NOISE / np.maximum(off, 1e-12))
    offsets = np.concatenate([x[None, 0:2], x[None, 2:4] + x[4:].reshape(4, 2)])
    return np.asarray(np.clip(offsets, -LIMIT, LIMIT))

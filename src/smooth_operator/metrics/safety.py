"""Self-collision, and the used fraction of the robot hand's workspace."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from smooth_operator.metrics import summary

COLLISION_DEPTH: Final = 0.002
"""Overlap of two links that counts as a collision [m]: soft tips may touch."""
WORKSPACE_RADIUS: Final = 0.005
"""Distance from a visited fingertip within which a reachable point counts as used [m]."""


def self_collision(penetration: Float[np.ndarray, " T"]) -> dict[str, float | None]:
    """Self-collision over a run; lower is better.

    Args:
        penetration: (T,) deepest overlap of two links per frame [m], positive inside; NaN where
            unknown. Zero or negative values (a clearance) are not an overlap.

    Returns:
        ``share`` of frames deeper than ``COLLISION_DEPTH``, ``mean_depth_mm`` (over all frames,
        0 where clear) and ``max_depth_mm``.
    """
    depth = np.maximum(penetration, 0.0)
    finite = depth[np.isfinite(depth)]
    return {
        "share": summary.mean(finite > COLLISION_DEPTH),
        "mean_depth_mm": summary.scaled(summary.mean(finite), 1e3),
        "max_depth_mm": summary.scaled(summary.maximum(finite), 1e3),
    }


def workspace_utilisation(
    tips: Float[np.ndarray, "T F 3"],
    reach: Float[np.ndarray, "S F 3"],
    radius: float = WORKSPACE_RADIUS,
) -> list[float | None]:
    """Fraction of each fingertip's reachable positions that are near a visited point; higher is
    better.

    Source: the paper's efficiency metrics (Monte-Carlo form of the volume ratio). It grows with the
    recording's length, so compare only results on the same recording.

    Args:
        tips: (T, F, 3) visited fingertips [m].
        reach: (S, F, 3) fingertips of random poses [m].
        radius: distance within which a reachable point counts as used [m].

    Returns:
        F shares in [0, 1]; None for a finger without data.
    """
    shares: list[float | None] = []
    for finger in range(tips.shape[1]):
        visited = tips[np.isfinite(tips[:, finger]).all(axis=-1), finger]
        samples = reach[np.isfinite(reach[:, finger]).all(axis=-1), finger]
        if not len(visited) or not len(samples):
            shares.append(None)
            continue
        # A bound just past the radius prunes the search; the comparison then is exact.
        bound = radius * (1.0 + 1e-6)
        distance, _ = cKDTree(visited).query(samples, k=1, distance_upper_bound=bound)
        shares.append(float(np.mean(distance <= radius)))
    return shares

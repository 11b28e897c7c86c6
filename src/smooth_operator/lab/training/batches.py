"""Batches of a training: drawn on the host, a function of seed and epoch alone."""

from __future__ import annotations

from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from smooth_operator.lab.training.data import PointSet
from smooth_operator.lab.training.losses import Batch
from smooth_operator.lab.training.settings import STEP_RANGE, GeortTraining

PINCHES: Final = 256
"""Frames with a pinch in a step."""


def draw_batches(
    points: PointSet,
    reach: Float[np.ndarray, "F 3 R"],
    settings: GeortTraining,
    steps: int,
    *words: int,
) -> Batch:
    """Batches for some steps, stacked along a new first axis.

    Each finger's points are drawn by themselves, with replacement; pinches are drawn whole.

    Args:
        points: where to draw from.
        reach: reach of the robot.
        settings: number and spread of the points.
        steps: number of batches.
        words: with the seed, what the draw is a function of.
    """
    rng = np.random.default_rng([settings.seed, *words])
    fingers = len(points.counts)

    def drawn(pool: np.ndarray, at: np.ndarray) -> np.ndarray:
        """(S, F, 3, B) of (F, 3, N) at (S, F, B)."""
        return np.take_along_axis(pool[None], at[:, :, None], axis=-1)

    at = rng.integers(0, points.counts[:, None], (steps, fingers, settings.batch))
    base = drawn(points.points, at)
    direction = rng.standard_normal(base.shape, np.float32)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True) + 1e-6
    length = rng.uniform(*STEP_RANGE, (steps, fingers, 1, settings.batch))
    around = settings.surround * rng.standard_normal(base.shape, np.float32)
    # the same random poses for all fingers, as they were drawn
    covered = rng.integers(0, reach.shape[-1], (steps, 1, settings.reach))
    pinches, pinched = points.pinches, points.pinched
    if not pinched.shape[-1]:  # a stand-in, in which no finger pinches
        pinches, pinched = points.points[:, :, :1], np.zeros((len(pinched), 1), bool)
    moments = rng.integers(0, pinched.shape[-1], (steps, PINCHES))
    arrays = (
        base,
        (base + around).astype(np.float32),
        (direction * length).astype(np.float32),
        drawn(reach, np.repeat(covered, fingers, axis=1)),
        np.moveaxis(pinches[:, :, moments], 2, 0),
        np.moveaxis(pinched[:, moments], 1, 0),
    )
    return Batch(*(jnp.asarray(array) for array in arrays))

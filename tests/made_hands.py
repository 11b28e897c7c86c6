"""Landmarks for tests that need a hand, whichever it is."""

import functools

import numpy as np

from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import Side


def hand_points(frames: int, seed: int = 0, side: Side = "right") -> np.ndarray:
    """(frames, 21, 3) of a built-in operator, the wrist at zero and the palm 0.095 m long."""
    return np.resize(_operator(seed, side), (frames, 21, 3))  # over again where they are few


@functools.cache
def _operator(seed: int, side: Side) -> np.ndarray:
    points = SyntheticOperator(seed=seed, side=side).record(1.0).landmarks
    points = points - points[:, :1]
    return points * 0.095 / np.linalg.norm(points[:, 9:10], axis=-1, keepdims=True)

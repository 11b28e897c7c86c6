"""Numbers as messages in JSON have them, in which what is not finite is null."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float


def numbers(array: Float[np.ndarray, " k"]) -> list[float | None]:
    """A row of numbers."""
    row: list[float | None] = array.tolist()
    if np.isfinite(array).all():
        return row
    return [None if x is None or not math.isfinite(x) else x for x in row]

"""Mean, median, maximum and percentile that skip values that are not finite and return None without
data."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Shaped


def mean(values: Shaped[np.ndarray, "..."]) -> float | None:
    """Mean of the finite values (for booleans, the fraction of true values); None if no value is
    finite."""
    finite = _finite(values)
    return float(finite.mean()) if finite.size else None


def median(values: Float[np.ndarray, "..."]) -> float | None:
    """Median of the finite values; None if no value is finite."""
    finite = _finite(values)
    return float(np.median(finite)) if finite.size else None


def maximum(values: Float[np.ndarray, "..."]) -> float | None:
    """Largest finite value; None if no value is finite."""
    finite = _finite(values)
    return float(finite.max()) if finite.size else None


def percentile(values: Float[np.ndarray, "..."], q: float) -> float | None:
    """q-th percentile of the finite values (linear interpolation); None if no value is finite."""
    finite = _finite(values)
    return float(np.percentile(finite, q)) if finite.size else None


def scaled(value: float | None, factor: float) -> float | None:
    """Converts a value to another unit; None stays None."""
    return None if value is None else value * factor


def _finite(values: Shaped[np.ndarray, "..."]) -> Float[np.ndarray, " N"]:
    array = np.asarray(values, np.float64)
    return np.asarray(array[np.isfinite(array)])

"""Latency and status of commands."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.metrics import summary
from smooth_operator.types import Status


def latency(latency_ms: Float[np.ndarray, " T"]) -> dict[str, float | None]:
    """Latency per command [ms]; lower is better.

    Args:
        latency_ms: (T,) from landmarks to command [ms]; NaN where it was not measured.

    Returns:
        ``mean``, ``p50``, ``p95``, ``p99`` (linear interpolation) over all commands, and ``first``.
    """
    first = latency_ms[0] if len(latency_ms) else np.nan
    return {
        "mean": summary.mean(latency_ms),
        "p50": summary.percentile(latency_ms, 50.0),
        "p95": summary.percentile(latency_ms, 95.0),
        "p99": summary.percentile(latency_ms, 99.0),
        "first": summary.mean(np.asarray(first)),
    }


def status_counts(status: Int[np.ndarray, " T"]) -> dict[str, int]:
    """Number of frames of each ``Status``, by its name in lower case.

    Args:
        status: (T,) values; a value that is not a known status is counted as ``unknown``.

    Returns:
        Every known name, zeros included; ``unknown`` only if such a value occurs.
    """
    counts = {s.name.lower(): int(np.sum(status == s)) for s in Status}
    unknown = len(status) - sum(counts.values())
    return counts | ({"unknown": unknown} if unknown else {})

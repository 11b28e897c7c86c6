"""Percentiles of times, and peak memory."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np


def percentiles(samples_ms: Sequence[float] | np.ndarray) -> dict[str, float]:
    """p50, p95, p99 and maximum of some times [ms]."""
    values = np.asarray(samples_ms, float)
    p50, p95, p99 = np.percentile(values, (50, 95, 99))
    return {
        "p50_ms": float(p50),
        "p95_ms": float(p95),
        "p99_ms": float(p99),
        "max_ms": float(values.max()),
    }


def peak_memory_mib() -> float | None:
    """Largest resident set of this process so far [MiB]; None where the system can't tell."""
    try:  # of this program alone; getrusage may still hold that of the parent it was forked from
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        pass
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)

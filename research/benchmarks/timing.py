"""Timing of pieces of work, and peak memory."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
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


def interleaved(
    work: Mapping[str, Callable[[], object]], seconds: float, least: int = 20, most: int = 500
) -> dict[str, np.ndarray]:
    """Time several pieces of work in turn, so that noise of the machine hits all of them alike.

    Args:
        work: name -> a call that returns when its result is there.
        seconds: about how long to go on.
        least: rounds at least, however slow.
        most: rounds at most.

    Returns:
        name -> times of its calls [ms].
    """
    names = list(work)
    for name in names:  # warm-up: compilation, caches, clocks
        work[name]()
        work[name]()
    times: dict[str, list[float]] = {name: [] for name in names}
    start = time.perf_counter()
    for turn in range(most):
        if turn >= least and time.perf_counter() - start > seconds:
            break
        for name in names if turn % 2 == 0 else reversed(names):
            before = time.perf_counter()
            work[name]()
            times[name].append((time.perf_counter() - before) * 1e3)
    return {name: np.array(values) for name, values in times.items()}


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

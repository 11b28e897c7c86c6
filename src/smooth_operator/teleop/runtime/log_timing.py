"""Timing of the loop, from its log."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.teleop.recording.log_reader import Log
from smooth_operator.teleop.runtime.statistics import percentiles

ADDED: Final = ("receive", "solve", "limit", "send")
"""Stages between the arrival of a frame and its command at the sinks; ``tracker`` lies before."""


def added_latency(log: Log) -> Float[np.ndarray, " F"]:
    """Frame received to command sent, of each command that answers a frame [ms]."""
    stages = [log.stages_ms[name] for name in ADDED if name in log.stages_ms]
    if not stages:
        return np.empty(0)
    total = np.nansum(stages, axis=0)
    answered = np.isfinite(log.stages_ms.get("solve", np.full(len(total), np.nan)))
    return np.asarray(total[answered])


def log_timing(log: Log) -> dict[str, Any]:
    """Every stage, pace, modes and events of a log, JSON-serialisable; times in ms.

    Raises:
        RecordingError: the log holds no commands.
    """
    if log.commands is None:
        raise RecordingError("the log holds no commands, so there is nothing that took time")
    figures: dict[str, Any] = {
        "commands": len(log.commands),
        "truncated": log.truncated,
        "method_ms": percentiles(log.commands.latency_ms),
        "stages_ms": {name: percentiles(values) for name, values in log.stages_ms.items()},
    }
    if log.loop is None:  # of `demo` or `convert`: no loop, no pace
        return figures
    gaps = np.diff(log.loop.times)
    length = float(log.loop.times[-1] - log.loop.times[0])
    events = Counter(event for events in log.loop.events.values() for event in events)
    return {
        **figures,
        "frames_answered": int(log.loop.answers.sum()),
        "duration_s": length,
        "rate_hz": len(gaps) / length if length > 0 else None,
        "added_latency_ms": percentiles(added_latency(log)),
        "interval_ms": percentiles(gaps * 1e3),
        "mode_share": {
            mode: count / len(log.commands) for mode, count in Counter(log.loop.modes).items()
        },
        "events": dict(events.most_common()),
    }

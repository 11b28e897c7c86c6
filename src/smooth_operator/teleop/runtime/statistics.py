"""Statistics of a run of the loop: percentiles of every stage, counts, shares of modes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Float, Float32

from smooth_operator.errors import RecordingError
from smooth_operator.teleop.runtime.motion_delay import MotionDelay
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.types import Side, Status

if TYPE_CHECKING:
    from smooth_operator.teleop.recording.log_reader import Log

_PERCENTILES: Final = (50.0, 95.0, 99.0)
_CAPACITY: Final = 200_000
"""Number of frames whose times are stored: over 30 minutes at 100 Hz."""


class _Times:
    """Ring buffer of the newest times of a stage [ms]."""

    def __init__(self) -> None:
        self._ring = np.full(_CAPACITY, np.nan, np.float32)
        self._count = 0

    def append(self, ms: float) -> None:
        self._ring[self._count % _CAPACITY] = ms
        self._count += 1

    def newest(self, count: int = _CAPACITY) -> Float32[np.ndarray, " n"]:
        """Copy of the newest times, unordered."""
        there = min(self._count, count, _CAPACITY)
        return self._ring[np.arange(self._count - there, self._count) % _CAPACITY]


class LoopStatistics:
    """Counts and times of a loop; written by the loop, read by anyone.

    Args:
        period: period of the loop [s].

    Attributes:
        motion: side -> delay from command to motion, for hands with measurements.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self._added = _Times()
        self._stages: dict[str, _Times] = defaultdict(_Times)
        self._commands: dict[Side, int] = defaultdict(int)
        self._answered = 0
        self._unusable: dict[str, int] = defaultdict(int)
        self._missed = 0
        self._due = 0
        self._modes: dict[Mode, int] = defaultdict(int)
        self._first: float | None = None
        self._latest = 0.0
        self.motion: dict[Side, MotionDelay] = {}

    def add(self, tick: Tick, due: float, sent: float) -> None:
        """Add a command.

        Args:
            tick: the command, with the stage ``send``.
            due: time at which it was due: the arrival of its frame, or by the pace of the loop [s].
            sent: time at which all sinks had it [s].
        """
        self._first = sent if self._first is None else self._first
        self._latest = sent
        self._commands[tick.side] += 1
        if tick.state is not None:
            if tick.side not in self.motion:
                self.motion[tick.side] = MotionDelay()
            self.motion[tick.side].add(tick)
        self._modes[tick.mode] += 1
        self._due += 1
        self._missed += sent - due > self.period
        if tick.status is not None:
            self._answered += tick.status == Status.OK
            if tick.status != Status.OK:
                self._unusable[tick.status.reason] += 1
            self._added.append((sent - tick.arrival.received) * 1e3 if tick.arrival else np.nan)
            for name, ms in tick.stages.items():
                self._stages[name].append(ms)

    def recent(self, count: int = 500) -> dict[str, dict[str, float]]:
        """Percentiles of the last frames [ms]: ``total`` (received to sent) and the stages."""
        return {
            name: percentiles(times.newest(count))
            for name, times in {"total": self._added, **self._stages}.items()
        }

    @property
    def missed_share(self) -> float:
        """Share of commands that left more than a period after they were due."""
        return self._missed / max(self._due, 1)

    @property
    def unusable(self) -> int:
        """Number of frames that the method could not use."""
        return sum(self._unusable.copy().values())

    @property
    def rate_hz(self) -> float:
        """Commands per second and hand, over the whole run."""
        hands, length = len(self._commands), self._latest - (self._first or 0.0)
        count = sum(self._commands.values()) - hands
        return count / hands / length if hands and length > 0 else 0.0

    def summary(self) -> dict[str, Any]:
        """Statistics of the whole run, JSON-serialisable; times in ms."""
        total = sum(self._modes.values())
        return {
            "commands": dict(self._commands),
            "rate_hz": self.rate_hz,
            "frames_answered": self._answered,
            "frames_unusable": self.unusable,
            "frames_unusable_by_reason": dict(self._unusable),
            "deadlines_missed": self._missed,
            "deadlines_missed_share": self.missed_share,
            "added_latency_ms": percentiles(self._added.newest()),
            "stages_ms": {name: percentiles(t.newest()) for name, t in self._stages.items()},
            "motion_delay_ms": {
                side: None if (estimate := delay.now()) is None else 1e3 * estimate.seconds
                for side, delay in self.motion.items()
            },
            "mode_share": {mode.value: self._modes[mode] / max(total, 1) for mode in self._modes},
        }


def percentiles(values: Any) -> dict[str, float]:
    """p50, p95, p99 and the largest value; empty without values."""
    array = np.asarray(values, float)
    array = array[np.isfinite(array)]
    if not len(array):
        return {}
    quantiles = np.percentile(array, _PERCENTILES)
    named: Mapping[str, float] = {
        f"p{p:g}": float(v) for p, v in zip(_PERCENTILES, quantiles, strict=True)
    }
    return {**named, "max": float(array.max())}


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
    """Statistics of stages, pace, modes and events of a log, JSON-serialisable; times in ms.

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

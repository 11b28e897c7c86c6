"""Statistics of a run: percentiles of every stage, counts, time in each mode, motion delay."""

from __future__ import annotations

import time
from collections import Counter, defaultdict, deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Float, Float32

from smooth_operator.errors import RecordingError
from smooth_operator.teleop.sinks.tick import HandState, Mode, Tick
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import Side, Status

if TYPE_CHECKING:
    from smooth_operator.formats.episode import StateTrajectory
    from smooth_operator.teleop.recording.log_reader import Log


_WINDOW_S: Final = 10.0
_LEAST_S: Final = 2.0
"""Shortest motion from which a delay is computed [s]."""

_SPACING_S: Final = 0.008
"""Shortest time between two stored commands or states [s]; there may be 1000 commands a second."""

_KEPT: Final = int(_WINDOW_S / _SPACING_S)
_GRID_S: Final = 0.01
_LONGEST_S: Final = 0.5
"""Longest delay that is considered [s]."""

_MOVES: Final = 0.05
"""Standard deviation of the velocity from which a joint counts as moving [rad/s]."""

_TRUSTED: Final = 0.7
"""Smallest correlation at which a delay is valid."""

_REFRESH_S: Final = 1.0


class _Track:
    """Ring buffer of the newest joint positions with their times."""

    def __init__(self, joints: int) -> None:
        self._times = np.full(_KEPT, np.nan)
        self._positions = np.full((_KEPT, joints), np.nan, np.float32)
        self._count = 0
        self._last = -np.inf

    def add(self, at: float, positions: Float[np.ndarray, " n"]) -> None:
        if at - self._last < _SPACING_S * 0.9:
            return
        row = self._count % _KEPT
        self._positions[row], self._times[row] = positions, at
        self._last = at
        self._count += 1

    def newest(self) -> tuple[np.ndarray, np.ndarray]:
        """Times and positions in order."""
        times = self._times.copy()  # the loop may write on, so only finite times count
        order = np.argsort(times)[: np.count_nonzero(np.isfinite(times))]
        return times[order], self._positions[order]


class MotionDelay:
    """Measures the delay between the commanded and the measured motion of one hand.

    The commanded and measured velocities of all joints that move are correlated at delays from 0 to
    half a second; the delay is where the correlation is largest, refined by a parabola. The loop
    writes; any thread may read.
    """

    def __init__(self) -> None:
        self._commands: _Track | None = None
        self._states: _Track | None = None
        self._state: HandState | None = None
        self._newest: tuple[float, float | None] = (-np.inf, None)

    def add(self, tick: Tick) -> None:
        """Stores a command and a measured state; takes microseconds."""
        if tick.state is None:
            return
        if self._commands is None or self._states is None:
            self._commands = _Track(len(tick.command.joint_positions))
            self._states = _Track(len(tick.state.positions))
        self._commands.add(tick.time, tick.command.joint_positions)
        if tick.state is not self._state:
            self._state = tick.state
            self._states.add(tick.state.stamp, tick.state.positions)

    def now(self) -> float | None:
        """Delay over the last ten seconds [s], computed at most once a second.

        Returns:
            None without a measured state, without motion, or if the measured motion does not
            correlate with the command.
        """
        at, delay = self._newest
        if time.monotonic() - at > _REFRESH_S:
            delay = self._compute()
            self._newest = (time.monotonic(), delay)
        return delay

    def _compute(self) -> float | None:
        commands, states = self._commands, self._states
        if commands is None or states is None:
            return None
        sent_at, commanded = commands.newest()
        measured_at, measured = states.newest()
        if len(sent_at) < 3 or len(measured_at) < 3 or commanded.shape[1] != measured.shape[1]:
            return None
        begin, end = max(sent_at[0] + _LONGEST_S, measured_at[0]), min(sent_at[-1], measured_at[-1])
        if end - begin < _LEAST_S:
            return None
        lags = round(_LONGEST_S / _GRID_S)
        grid = np.arange(begin, end, _GRID_S)
        before = np.arange(-lags, len(grid)) * _GRID_S + begin
        complete = np.isfinite(measured).all(axis=0)
        moved = _velocities(grid, measured_at, measured[:, complete])
        sent = _velocities(before, sent_at, commanded[:, complete])
        moving = (moved.std(axis=0) > _MOVES) & (sent.std(axis=0) > _MOVES)
        if not moving.any():
            return None
        moved, sent = moved[:, moving], sent[:, moving]
        moved, sent = moved - moved.mean(axis=0), sent - sent.mean(axis=0)
        count = len(moved)
        scores = np.empty(lags + 1)
        for lag in range(lags + 1):
            part = sent[lags - lag : lags - lag + count]
            scores[lag] = (part * moved).sum() / np.sqrt((part**2).sum() * (moved**2).sum())
        best = int(scores.argmax())
        if scores[best] < _TRUSTED:
            return None
        shift = 0.0
        if 0 < best < lags:
            left, top, right = scores[best - 1 : best + 2]
            curve = left - 2 * top + right
            shift = 0.5 * (left - right) / curve if curve < 0 else 0.0
        return float((best + shift) * _GRID_S)


def _velocities(
    grid: Float[np.ndarray, " g"], times: Float[np.ndarray, " t"], positions: np.ndarray
) -> np.ndarray:
    columns = [np.interp(grid, times, column) for column in positions.T]
    return np.diff(np.array(columns).T, axis=0) / _GRID_S


_STATE_WINDOW_S = 10.0


class TrackerDelay:
    """Measures the delay of each frame relative to the fastest frame of the last seconds.

    Two clocks that are not synchronised show only the variation of the delay: the difference of
    arrival and stamp is the delay plus a constant, and its smallest recent value stands for the
    fastest transmission. The window is short enough to follow the drift of the clocks. Stamps of a
    recording that is played at another speed are scaled to ours.
    """

    def __init__(self) -> None:
        self._session: int | None = None
        self._lowest: deque[tuple[float, float]] = deque()  # (received, difference), both rising

    def see(self, arrival: Arrival) -> None:
        """Adds a frame."""
        if arrival.session != self._session:
            self._session = arrival.session
            self._lowest.clear()
        difference = _difference(arrival)
        while self._lowest and self._lowest[-1][1] >= difference:
            self._lowest.pop()
        self._lowest.append((arrival.received, difference))
        while self._lowest[0][0] < arrival.received - _STATE_WINDOW_S:
            self._lowest.popleft()

    def above_fastest(self, arrival: Arrival) -> float:
        """Delay of an added frame relative to the fastest one [s]."""
        return _difference(arrival) - self._lowest[0][1]


def _difference(arrival: Arrival) -> float:
    """Delay of an arrival plus the difference of the two clocks [s]."""
    return arrival.received - arrival.stamp / arrival.speed


_PERCENTILES: Final = (50.0, 95.0, 99.0)
_CAPACITY: Final = 200_000
"""Number of frames whose times are stored: over 30 minutes at 100 Hz."""


class RecentTimes:
    """Ring buffer of the newest durations [ms]."""

    def __init__(self) -> None:
        self._ring = np.full(_CAPACITY, np.nan, np.float32)
        self._count = 0

    def append(self, ms: float) -> None:
        """Adds a duration [ms]."""
        self._ring[self._count % _CAPACITY] = ms
        self._count += 1

    def newest(self, count: int = _CAPACITY) -> Float32[np.ndarray, " n"]:
        """Returns a copy of the newest durations, in no particular order."""
        there = min(self._count, count, _CAPACITY)
        return self._ring[np.arange(self._count - there, self._count) % _CAPACITY]


class LoopStatistics:
    """Counts and durations of a loop. The loop writes them; any thread may read them.

    Args:
        period: period of the loop [s].

    Attributes:
        motion: side -> delay from command to motion, for hands with measurements.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self._added = RecentTimes()
        self._stages: dict[str, RecentTimes] = defaultdict(RecentTimes)
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
        """Adds a command.

        Args:
            tick: the command, with the stage ``send``.
            due: time at which it was due: its frame's arrival, or its turn at the loop's rate [s].
            sent: time at which all sinks had received it [s].
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
        """Percentiles over the last frames [ms]: each stage, and ``total`` (from receiving to
        sending)."""
        return {
            name: percentiles(times.newest(count))
            for name, times in {"total": self._added, **self._stages}.items()
        }

    @property
    def missed_share(self) -> float:
        """Share of commands that were sent more than one period late."""
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
        """Statistics of the whole run, ready for JSON; times are in ms."""
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
                side: None if (seconds := delay.now()) is None else 1e3 * seconds
                for side, delay in self.motion.items()
            },
            "mode_share": {mode.value: self._modes[mode] / max(total, 1) for mode in self._modes},
        }


def percentiles(values: Any) -> dict[str, float]:
    """Percentiles p50, p95 and p99, and the largest value; empty without values."""
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
"""Stages between the arrival of a frame and the sending of its command; excludes ``tracker``."""


def added_latency(log: Log) -> Float[np.ndarray, " F"]:
    """Time from frame to command [ms], for each command that was computed from a frame."""
    if "solve" not in log.stages_ms:
        return np.empty(0)
    total = np.nansum([log.stages_ms[name] for name in ADDED if name in log.stages_ms], axis=0)
    return np.asarray(total[np.isfinite(log.stages_ms["solve"])])


def log_timing(log: Log) -> dict[str, Any]:
    """Statistics of a log's stages, rate, modes and events, ready for JSON; times are in ms.
    RecordingError if the log contains no commands."""
    if log.commands is None:
        raise RecordingError("the log contains no commands, so there are no times to measure")
    figures: dict[str, Any] = {
        "commands": len(log.commands),
        "truncated": log.truncated,
        "method_ms": percentiles(log.commands.latency_ms),
        "stages_ms": {name: percentiles(values) for name, values in log.stages_ms.items()},
    }
    if log.loop is None:  # a log of `demo` or `convert`
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
        **({} if (rate := _contact_rate(log.states)) is None else {"contact_rate_hz": rate}),
    }


def _contact_rate(states: StateTrajectory | None) -> float | None:
    """Measurements of contact per second; None without any."""
    if states is None or states.contact is None or len(states) < 2:
        return None
    length = float(states.stamps[-1] - states.stamps[0])
    return (len(states) - 1) / length if length > 0 else None

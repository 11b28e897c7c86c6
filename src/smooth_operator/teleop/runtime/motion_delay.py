"""Delay from a command to the motion of the hand, by cross-correlation."""

from __future__ import annotations

import time
from collections import deque
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from smooth_operator.teleop.sinks.tick import HandState, Tick
from smooth_operator.teleop.sources.live import Arrival

_WINDOW_S: Final = 10.0
_LEAST_S: Final = 2.0
"""Shortest motion that gives a delay [s]."""

_SPACING_S: Final = 0.008
"""Time between two stored commands, or states; there are up to a thousand commands a second [s]."""

_KEPT: Final = int(_WINDOW_S / _SPACING_S)
_GRID_S: Final = 0.01
_LONGEST_S: Final = 0.5
"""Longest delay in the search [s]."""

_MOVES: Final = 0.05
"""Standard deviation of the velocity from which a joint counts as moving [rad/s]."""

_TRUSTED: Final = 0.7
"""Smallest correlation of a valid delay."""

_AGAIN_S: Final = 1.0


class Delay(NamedTuple):
    """Delay between a command and the measured motion of a hand.

    Attributes:
        seconds: time from the command to the measured motion [s].
        correlation: correlation of the velocities at that delay, 0 to 1.
    """

    seconds: float
    correlation: float


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
        times = self._times.copy()  # the loop may write on: what is in the copy counts, no count
        order = np.argsort(times)[: np.count_nonzero(np.isfinite(times))]
        return times[order], self._positions[order]


class MotionDelay:
    """Delay of one hand over the last seconds; written by the loop, read by anyone.

    The velocities of all joints that move, commanded and measured, are correlated at delays from 0
    to half a second; the largest value, refined by a parabola, is the delay.
    """

    def __init__(self) -> None:
        self._commands: _Track | None = None
        self._states: _Track | None = None
        self._state: HandState | None = None
        self._newest: tuple[float, Delay | None] = (-np.inf, None)

    def add(self, tick: Tick) -> None:
        """Store a command and a measured state; takes microseconds."""
        if tick.state is None:
            return
        if self._commands is None or self._states is None:
            self._commands = _Track(len(tick.command.positions))
            self._states = _Track(len(tick.state.positions))
        self._commands.add(tick.time, tick.command.positions)
        if tick.state is not self._state:
            self._state = tick.state
            self._states.add(tick.state.stamp, tick.state.positions)

    def now(self) -> Delay | None:
        """The delay over the last ten seconds, computed at most once a second.

        Returns:
            None without a measured state, without motion, or if the measured motion does not
            correlate with the command.
        """
        at, delay = self._newest
        if time.monotonic() - at > _AGAIN_S:
            delay = self._compute()
            self._newest = (time.monotonic(), delay)
        return delay

    def _compute(self) -> Delay | None:
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
        asked_for = _velocities(before, sent_at, commanded[:, complete])
        moving = (moved.std(axis=0) > _MOVES) & (asked_for.std(axis=0) > _MOVES)
        if not moving.any():
            return None
        moved, asked_for = moved[:, moving], asked_for[:, moving]
        moved, asked_for = moved - moved.mean(axis=0), asked_for - asked_for.mean(axis=0)
        count = len(moved)
        scores = np.empty(lags + 1)
        for lag in range(lags + 1):
            part = asked_for[lags - lag : lags - lag + count]
            scores[lag] = (part * moved).sum() / np.sqrt((part**2).sum() * (moved**2).sum())
        best = int(scores.argmax())
        if scores[best] < _TRUSTED:
            return None
        shift = 0.0
        if 0 < best < lags:
            left, top, right = scores[best - 1 : best + 2]
            curve = left - 2 * top + right
            shift = 0.5 * (left - right) / curve if curve < 0 else 0.0
        return Delay((best + shift) * _GRID_S, float(scores[best]))


def _velocities(
    grid: Float[np.ndarray, " g"], times: Float[np.ndarray, " t"], positions: np.ndarray
) -> np.ndarray:
    columns = [np.interp(grid, times, column) for column in positions.T]
    return np.diff(np.array(columns).T, axis=0) / _GRID_S


_STATE_WINDOW_S = 10.0


class TrackerDelay:
    """Delay of each frame above the fastest of the last seconds.

    Two clocks that are not synchronised show only the variation of the delay: the difference of
    arrival and stamp is the delay plus a constant, and its smallest recent value stands for the
    fastest transmission. The window is short enough to follow the drift of the clocks. Stamps of a
    recording that is played at another speed are scaled to ours.
    """

    def __init__(self) -> None:
        self._session: int | None = None
        self._lowest: deque[tuple[float, float]] = deque()  # (received, difference), both rising

    def see(self, arrival: Arrival) -> None:
        """Add a frame."""
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
        """Delay of an added frame above the fastest one [s]."""
        return _difference(arrival) - self._lowest[0][1]


def _difference(arrival: Arrival) -> float:
    """Delay of an arrival plus the difference of the two clocks [s]."""
    return arrival.received - arrival.stamp / arrival.speed

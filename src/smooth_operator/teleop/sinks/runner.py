"""Runs the sinks of a loop: each gets every tick, and a fault of one does not affect the others.

A sink that raises is closed, its error stored for the report at the end, and opened again later.
Closing and opening may take long (compiling a model, finishing a file), so both happen on a
separate thread, and the loop does not wait for them.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError, SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.arm import CarriedHand
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import HandState, Tick
from smooth_operator.teleop.sources.live import Clock
from smooth_operator.types import Side

SinkState: TypeAlias = Literal["closed", "open", "failed"]
"""State of a sink; ``failed``: it raised, and will be opened again."""

_PATIENCE: Final = 1.0
"""Time that closing waits for a call that is still inside the sink [s]."""


@dataclass(frozen=True)
class SinkHealth:
    """Health of a sink, now or at its end.

    Attributes:
        label: name of the sink.
        state: see ``SinkState``.
        detail: the last error, or a note for a person; empty if there is none.
        sent: number of ticks that it got.
        failed: number of errors, including those of opening again.
        missed: number of ticks while it was not open.
        figures: further counts and times (``Sink.figures``).
    """

    label: str
    state: SinkState
    detail: str = ""
    sent: int = 0
    failed: int = 0
    missed: int = 0
    figures: Mapping[str, Any] = field(default_factory=dict)


class SinkRunner:
    """Several sinks as one.

    ``send`` is for one thread, the loop's; all else may be called from any.

    Args:
        sinks: the sinks; ``open`` opens them.
        retry_s: time between a failure and the next opening of a sink [s].
        clock: clock of the times [s].

    Raises:
        ConfigError: ``retry_s`` is not positive.
    """

    def __init__(
        self,
        sinks: Iterable[Sink] = (),
        retry_s: float = 1.0,
        clock: Clock = time.perf_counter,
    ) -> None:
        if not retry_s > 0.0:
            raise ConfigError(f"retry_s must be positive, not {retry_s}")
        self.retry_s = retry_s
        self._clock = clock
        self._entries = tuple(self._entry(sink) for sink in sinks)
        self._gone: list[_Entry] = []
        self._opened: tuple[Mapping[Side, Hand], Mapping[str, Any]] | None = None
        self._changed = threading.Condition()
        self._mender: threading.Thread | None = None

    def use_arms(self, arms: Mapping[Side, CarriedHand]) -> None:
        """Tell every sink which arms carry the hands."""
        for entry in self._entries:
            entry.sink.use_arms(arms)

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Check that every sink can be opened (``Sink.check``), before anything slow is done.

        Raises:
            SmoothOperatorError: as ``open``.
        """
        for entry in self._entries:
            entry.sink.check(hands)

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Open all sinks, or none.

        Raises:
            SmoothOperatorError: as ``Sink.open``; those that were open already are closed.
        """
        if self._opened is not None:
            raise ConfigError("the sinks are open already; close them first")
        done: list[_Entry] = []
        try:
            for entry in self._entries:
                entry.open(hands, config)
                done.append(entry)
        except BaseException:
            for entry in done:
                entry.end()
            raise
        self._opened = (hands, config)
        self._mender = threading.Thread(target=self._mend, name="sinks", daemon=True)
        self._mender.start()

    def send(self, tick: Tick) -> None:
        """Hand a tick to every open sink that acts; never raises what a sink raises."""
        self._hand_over(tick, observing=False)

    def observe(self, tick: Tick) -> None:
        """Hand a tick to the observing sinks (``Sink.observes``), after the others.

        They get the tick with the time of sending among its stages.
        """
        self._hand_over(tick, observing=True)

    def _hand_over(self, tick: Tick, observing: bool) -> None:
        for entry in self._entries:
            if entry.sink.observes != observing:
                continue
            if entry.call(lambda sink: sink.send(tick)):
                entry.sent += 1
            else:
                entry.missed += 1

    def state(self, side: Side) -> HandState | None:
        """The last measured state of a hand: of a real one, else of a simulated one."""
        first: HandState | None = None
        for entry in self._entries:
            if entry.state == "open" and (measured := entry.sink.state(side)) is not None:
                if entry.sink.simulation is None:
                    return measured
                first = first or measured
        return first

    def stalled(self, seconds: float) -> None:
        """Notify every open sink of a time without commands [s], also while a ``send`` hangs."""
        for entry in self._entries:
            entry.call(lambda sink: sink.stalled(seconds))

    def measured_wrist(self, side: Side) -> Float[np.ndarray, "7"] | None:
        """Pose of the wrist of a hand, from the first open sink that measures it."""
        poses: list[Float[np.ndarray, "7"] | None] = [None]
        for entry in self._entries:
            entry.call(lambda sink: poses.append(sink.measured_wrist(side)))
            if poses[-1] is not None:
                break
        return poses[-1]

    def measured_arm(self, side: Side) -> Float[np.ndarray, " n"] | None:
        """Joint positions of an arm [rad], from the first open sink that measures them."""
        for entry in self._entries:
            if entry.state == "open" and (positions := entry.sink.measured_arm(side)) is not None:
                return positions
        return None

    def add(self, sink: Sink) -> None:
        """Add a sink; it is opened if the others are open.

        Raises:
            SmoothOperatorError: as ``Sink.open``; the sink is not added.
        """
        entry = self._entry(sink)
        if self._opened is not None:
            entry.open(*self._opened)
        with self._changed:
            self._entries = (*self._entries, entry)

    def remove(self, sink: Sink) -> None:
        """Close and remove a sink, if it is one of these; its errors stay in ``report``."""
        with self._changed:
            entries = [entry for entry in self._entries if entry.sink is sink]
            self._entries = tuple(entry for entry in self._entries if entry.sink is not sink)
            self._gone += entries
        for entry in entries:
            entry.end()

    def close(self) -> None:
        """Close all of them, even when one fails in closing; a second call does nothing."""
        with self._changed:
            self._opened = None
            self._changed.notify_all()
        mender, self._mender = self._mender, None
        if mender is not None:
            mender.join(_PATIENCE + self.retry_s)
        for entry in self._entries:
            entry.end()

    def health(self) -> list[SinkHealth]:
        """Health of each sink now, in their order."""
        return [entry.health() for entry in self._entries]

    def report(self) -> list[SinkHealth]:
        """Health of the removed sinks and of the others, for the end of a run."""
        return [entry.health() for entry in (*self._gone, *self._entries)]

    def _entry(self, sink: Sink) -> _Entry:
        return _Entry(sink, self.retry_s, self._clock)

    def _mend(self) -> None:
        """Close what failed, and open it again when its time has come."""
        step = min(0.05, self.retry_s / 4)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._opened is None, step)
                opened, entries = self._opened, self._entries
            if opened is None:
                return
            for entry in entries:
                entry.mend(*opened)


class _Entry:
    """A sink and its state."""

    def __init__(self, sink: Sink, retry_s: float, clock: Clock) -> None:
        self.sink = sink
        self.state: SinkState = "closed"
        self.sent = self.failed = self.missed = 0
        self._retry_s, self._clock = retry_s, clock
        self._error = ""
        self._closed = True
        self._retry_at = 0.0
        self._inside = 0
        self._change = threading.Condition()  # of the fields; never held while in the sink
        self._moving = threading.Lock()  # one closing or opening at a time

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Open it; errors reach the caller."""
        try:
            self.sink.open(hands, config)
        except SmoothOperatorError:
            raise
        except OSError as error:  # of a sink that does not word its errors itself
            raise SinkError(f"{self.sink.label} can't be opened: {error}") from error
        with self._change:
            self.state, self._closed = "open", False

    def call(self, action: Callable[[Sink], None]) -> bool:
        """Call an action with the sink if it is open.

        Returns:
            True if the action was called and did not raise.
        """
        with self._change:
            if self.state != "open":
                return False
            self._inside += 1
        try:
            action(self.sink)
        except Exception as error:  # anything: the loop and the other sinks go on
            self._fail(error)
            return False
        finally:
            with self._change:
                self._inside -= 1
                self._change.notify_all()
        return True

    def end(self) -> None:
        """Close it for good; an error in closing is kept."""
        with self._change:
            self.state = "closed"
        self._shut()

    def mend(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Close what has failed, and open it again if it is time."""
        if not self._has_failed():
            return
        self._shut()
        if self._clock() < self._retry_at:
            return
        with self._moving:
            if not self._has_failed():  # it was released meanwhile
                return
            try:
                self.sink.open(hands, config)
            except Exception as error:
                self._fail(error)
                return
            with self._change:
                self._closed = False
                if self._has_failed():  # else it was released meanwhile, and is closed next
                    self.state = "open"

    def health(self) -> SinkHealth:
        """Health of the sink; its own note comes first."""
        detail = "; ".join(part for part in (self.sink.note, self._error) if part)
        return SinkHealth(
            self.sink.label,
            self.state,
            detail,
            self.sent,
            self.failed,
            self.missed,
            dict(self.sink.figures),
        )

    def _has_failed(self) -> bool:
        return self.state == "failed"

    def _shut(self) -> None:
        """Close it, once nobody is inside."""
        with self._moving:
            with self._change:
                self._change.wait_for(lambda: self._inside == 0, _PATIENCE)
                if self._closed:
                    return
                self._closed = True
            try:
                self.sink.close()
            except Exception as error:
                self._fail(error)

    def _fail(self, error: Exception) -> None:
        expected = isinstance(error, SmoothOperatorError)
        with self._change:
            self._error = str(error) if expected else f"{type(error).__name__}: {error}"
            self._retry_at = self._clock() + self._retry_s
            self.failed += 1
            if self.state == "open":
                self.state = "failed"

"""Sinks, which receive the joint commands of a running loop, and a runner for several sinks.

A fault of one sink does not affect the others: a sink that raises is closed and opened again later,
and its error is stored for the report at the end. Closing and opening may take long (compiling a
model, finishing a file), so both happen on a separate thread, and the loop does not wait for them.
"""

from __future__ import annotations

import functools
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, Protocol, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError, SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.control.bindings import ACTIONS
from smooth_operator.teleop.sinks.tick import HandState, Tick
from smooth_operator.teleop.sources.live import Clock
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.simulation.arms.arm import CarriedHand
    from smooth_operator.simulation.live import LiveSimulation


class Sink(ABC):
    """Destination of commands: a robot, a simulation, a file or a message bus.

    Subclasses are dataclasses of settings. The loop calls ``send`` from one thread and must not
    wait, so a sink that may wait leaves the newest command to its own thread. A sink that raises is
    closed and opened again later, and does not stop the others.
    """

    observes: ClassVar[bool] = False
    """True for a sink that moves nothing, such as a log or a table. It gets its ticks after the
    other sinks, with the time of sending among the stages."""

    moves_real_hand: ClassVar[bool] = False
    """True for a sink that moves one real hand, so that the run can't go on with another one."""

    @property
    @abstractmethod
    def label(self) -> str:
        """Short human-readable name of the sink."""

    @property
    def note(self) -> str:
        """Note for the user, such as a warning; empty if there is nothing to say."""
        return ""

    @property
    def actions(self) -> Mapping[str, Callable[[], None]]:
        """Maps the name of each operator action to a function, which another thread calls. Actions
        that have no input by default get one with ``--bind``."""
        return {}

    @property
    def simulation(self) -> LiveSimulation | None:
        """The simulated hands that the commands move; None if the sink simulates nothing."""
        return None

    @property
    def figures(self) -> Mapping[str, Any]:
        """Counts and times for the summary of a run, as plain values; by default empty."""
        return {}

    @property
    def measures(self) -> bool:
        """True if ``state`` returns measurements while the sink is open, as in a simulation."""
        return self.simulation is not None

    def state(self, side: Side) -> HandState | None:
        """The last measured state of a hand; safe from any thread.

        None (the default) if the sink measures nothing, is not open, or has no such hand.
        """
        del side
        return None

    def measured_wrist(self, side: Side) -> Float[np.ndarray, "7"] | None:
        """The last pose of a hand's wrist, measured by its arm.

        In the frame of the robot's base: x y z [m], unit quaternion w x y z. Called on the loop's
        thread, so it must be quick. None (the default) if the sink moves no arm or is not open.
        """
        del side
        return None

    def measured_arm(self, side: Side) -> Float[np.ndarray, " n"] | None:
        """The last measured joint positions of a hand's arm [rad].

        In the order of ``ArmCommand.joint_names``; safe from any thread. None (the default) if the
        sink moves no arm or is not open.
        """
        del side
        return None

    def use_arms(self, arms: Mapping[Side, CarriedHand]) -> None:
        """Sets the arms that carry the hands, before ``check`` and ``open``.

        By default does nothing: ticks have the arms' commands.
        """
        del arms

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Checks that the sink can be opened, and leaves nothing open. By default checks nothing.

        Raises:
            SmoothOperatorError: as ``open``.
        """
        del hands

    @abstractmethod
    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Opens the sink for the commands of some hands; may be called again after ``close``.

        Args:
            hands: side -> robot hand.
            config: the resolved configuration of the run, JSON-serialisable, for sinks that store
                it.

        Raises:
            SinkError: it can't be opened.
            OutputError: its file can't be written.
            MissingExtraError: a library that it needs is not installed.
        """

    @abstractmethod
    def send(self, tick: Tick) -> None:
        """Sends a command; must take well under a millisecond.

        Raises:
            SinkError: the receiver is gone.
            OutputError: the disk is full.
        """

    def stalled(self, seconds: float) -> None:
        """Reacts to a time without commands [s]; called from the watchdog's thread.

        Called repeatedly while the silence lasts. By default does nothing.
        """
        del seconds

    @abstractmethod
    def close(self) -> None:
        """Writes pending data and closes everything; a second call does nothing."""

    def _set(self, **values: object) -> None:
        """Set attributes of an open sink, although its dataclass is frozen."""
        for name, value in values.items():
            object.__setattr__(self, name, value)


def simulated_hands(sinks: Iterable[Sink]) -> LiveSimulation | None:
    """The first simulation among some sinks; None if there is none."""
    return next((sink.simulation for sink in sinks if sink.simulation is not None), None)


_PATIENCE: Final = 3.0
"""Time that closing waits for the thread [s]."""


class Link(Protocol):
    """An open connection to a receiver; all methods are called on the sink's own thread."""

    def deliver(self, tick: Tick) -> None:
        """Sends a command."""

    def stalled(self, seconds: float) -> None:
        """Reports a time without commands [s]."""

    def close(self) -> None:
        """Closes the connection."""


def sink_actions(
    sinks: Sequence[Sink], say: Callable[[str], None]
) -> dict[str, Callable[[], None]]:
    """Actions of several sinks by name; each action runs in all sinks that have it."""

    def act(name: str) -> None:
        for action in [sink.actions[name] for sink in sinks if name in sink.actions]:
            action()
            say(ACTIONS[name][0] if name in ACTIONS else name)

    return {name: functools.partial(act, name) for sink in sinks for name in sink.actions}


class ThreadedSink(Sink):
    """A sink that passes the newest command of each hand to a link, on its own thread.

    There is no queue: a new command replaces one that the link has not yet taken. Subclasses are
    frozen dataclasses of settings.
    """

    @abstractmethod
    def connect(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> Link:
        """Opens the connection. The caller of ``open`` receives its errors."""

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Opens the connection and closes it again; see ``Sink``."""
        self.connect(hands, {}).close()

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Opens the sink; see ``Sink``."""
        if self._sender() is not None:
            raise SinkError(f"{self.label}: the sink is already open")
        self._set(_now=_Sender(self.connect(hands, config), self.label))

    def send(self, tick: Tick) -> None:
        """Leaves a command for the thread; SinkError, with the reason, if the thread has failed."""
        sender = self._sender()
        if sender is None:
            raise SinkError(f"{self.label}: the sink is not open")
        sender.post(tick)

    def stalled(self, seconds: float) -> None:
        """Passes a time without commands [s] to the thread."""
        sender = self._sender()
        if sender is not None:
            sender.silence(seconds)

    def close(self) -> None:
        """Sends a pending command, and closes the link; a second call does nothing."""
        sender = self._sender()
        self._set(_now=None)
        if sender is not None:
            sender.end()

    def _sender(self) -> _Sender | None:
        sender: _Sender | None = getattr(self, "_now", None)
        return sender


class _Sender:
    """The thread of a sink, and its pending commands."""

    def __init__(self, link: Link, label: str) -> None:
        self._link, self._label = link, label
        self._newest: dict[Side, Tick] = {}
        self._stalled: float | None = None
        self._error: Exception | None = None
        self._ending = False
        self._change = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"sink {label}", daemon=True)
        self._thread.start()

    def post(self, tick: Tick) -> None:
        with self._change:
            if self._error is not None:
                raise SinkError(f"{self._label}: {self._error}") from self._error
            self._newest[tick.side] = tick
            self._stalled = None
            self._change.notify_all()

    def silence(self, seconds: float) -> None:
        with self._change:
            self._stalled = seconds
            self._change.notify_all()

    def end(self) -> None:
        with self._change:
            self._ending = True
            self._change.notify_all()
        self._thread.join(_PATIENCE)
        if self._thread.is_alive():
            raise SinkError(
                f"{self._label}: the device or program at the other end does not respond; it stays "
                "in its last state"
            )

    def _run(self) -> None:
        try:
            while self._pass_on():
                pass
        except Exception as error:  # raised with the next command
            with self._change:
                self._error = error
        finally:
            try:
                self._link.close()
            except Exception as error:
                with self._change:
                    self._error = self._error or error

    def _pass_on(self) -> bool:
        with self._change:
            self._change.wait_for(lambda: self._newest or self._stalled is not None or self._ending)
            ticks, self._newest = list(self._newest.values()), {}
            seconds, self._stalled = self._stalled, None
            ending = self._ending
        for tick in ticks:
            self._link.deliver(tick)
        if seconds is not None and not ticks:
            self._link.stalled(seconds)
        return not (ending and not ticks)


SinkState: TypeAlias = Literal["closed", "open", "failed"]
"""State of a sink; ``failed`` means that it raised an error and will be opened again."""

_LEAVE_S: Final = 1.0
"""Time that closing waits for a call that is still inside the sink [s]."""


@dataclass(frozen=True)
class SinkHealth:
    """Health of a sink, now or when it was closed.

    Attributes:
        label: name of the sink.
        state: see ``SinkState``.
        detail: the last error, or a note for the user; empty without either.
        sent: number of ticks that it received.
        failed: number of errors, including those of reopening.
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
    """Runs several sinks as if they were one.

    Only the loop's thread calls ``send``; everything else is safe from any thread.

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
        self._entries = tuple(_Entry(sink, retry_s, clock) for sink in sinks)
        self._gone: list[_Entry] = []
        self._opened: tuple[Mapping[Side, Hand], Mapping[str, Any]] | None = None
        self._changed = threading.Condition()
        self._mender: threading.Thread | None = None

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Checks that every sink can be opened (``Sink.check``), before any slow preparation.

        Raises:
            SmoothOperatorError: as ``open``.
        """
        for entry in self._entries:
            entry.sink.check(hands)

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Opens all sinks; if one can't be opened, leaves none open.

        Raises:
            SmoothOperatorError: as ``Sink.open``; those that were open already are closed.
        """
        if self._opened is not None:
            raise ConfigError("the sinks are already open; close them first")
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
        """Sends a tick to every open sink that moves something. Errors of sinks are only stored."""
        self._hand_over(tick, observing=False)

    def observe(self, tick: Tick) -> None:
        """Sends a tick, with the time of sending, to the observing sinks (``Sink.observes``)."""
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
        """The last measured state of a hand, preferably from a real hand."""
        first: HandState | None = None
        for entry in self._entries:
            if entry.state == "open" and (measured := entry.sink.state(side)) is not None:
                if entry.sink.simulation is None:
                    return measured
                first = first or measured
        return first

    def stalled(self, seconds: float) -> None:
        """Tells every open sink about a time without commands [s], even while a ``send`` hangs."""
        for entry in self._entries:
            entry.call(lambda sink: sink.stalled(seconds))

    def measured_wrist(self, side: Side) -> Float[np.ndarray, "7"] | None:
        """Pose of a hand's wrist, from the first open sink that measures it."""
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
        """Adds a sink; if the others are open, opens it.

        Raises:
            SmoothOperatorError: as ``Sink.open``; the sink is not added.
        """
        entry = _Entry(sink, self.retry_s, self._clock)
        if self._opened is not None:
            entry.open(*self._opened)
        with self._changed:
            self._entries = (*self._entries, entry)

    def remove(self, sink: Sink) -> None:
        """Closes and removes a sink, if it is one of these; its errors stay in ``report``."""
        with self._changed:
            entries = [entry for entry in self._entries if entry.sink is sink]
            self._entries = tuple(entry for entry in self._entries if entry.sink is not sink)
            self._gone += entries
        for entry in entries:
            entry.end()

    def close(self) -> None:
        """Closes all sinks, even if one raises; a second call does nothing."""
        with self._changed:
            self._opened = None
            self._changed.notify_all()
        mender, self._mender = self._mender, None
        if mender is not None:
            mender.join(_LEAVE_S + self.retry_s)
        for entry in self._entries:
            entry.end()

    def health(self) -> list[SinkHealth]:
        """Current health of each sink, in the order of the sinks."""
        return [entry.health() for entry in self._entries]

    def report(self) -> list[SinkHealth]:
        """Health of all sinks, including removed ones, for the end of a run."""
        return [entry.health() for entry in (*self._gone, *self._entries)]

    def _mend(self) -> None:
        """Close sinks that failed, and reopen them after ``retry_s``."""
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
        """Open the sink; errors reach the caller."""
        try:
            self.sink.open(hands, config)
        except SmoothOperatorError:
            raise
        except OSError as error:
            raise SinkError(f"{self.sink.label} can't be opened: {error}") from error
        with self._change:
            self.state, self._closed = "open", False

    def call(self, action: Callable[[Sink], None]) -> bool:
        """Call an action with the sink if it is open; True if it was called and did not raise."""
        with self._change:
            if self.state != "open":
                return False
            self._inside += 1
        try:
            action(self.sink)
        except Exception as error:  # the loop and the other sinks go on
            self._fail(error)
            return False
        finally:
            with self._change:
                self._inside -= 1
                self._change.notify_all()
        return True

    def end(self) -> None:
        """Close the sink for good; an error in closing is stored."""
        with self._change:
            self.state = "closed"
        self._shut()

    def mend(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Close a sink that failed, and open it again if it is time."""
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
        """Close the sink once no call is running in it."""
        with self._moving:
            with self._change:
                self._change.wait_for(lambda: self._inside == 0, _LEAVE_S)
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

"""Base class of sinks, which take the joint commands of a running loop."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.sinks.tick import HandState, Tick
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.hands.hand import Hand
    from smooth_operator.simulation.arms.arm import CarriedHand
    from smooth_operator.simulation.live import LiveSimulation


class Sink(ABC):
    """Destination of commands: a robot, a simulation, a file, a bus.

    Subclasses are dataclasses of settings. The loop calls ``send`` from one thread and must not
    wait: a sink that may have to wait leaves the newest command to its own thread. A sink that
    raises is closed and opened again later, and does not stop the others.
    """

    observes: ClassVar[bool] = False
    """True for a sink that moves nothing, such as a log or a table. It gets its ticks after the
    others, with their time among the stages."""

    @property
    @abstractmethod
    def label(self) -> str:
        """Name for a person, in a few words."""

    @property
    def note(self) -> str:
        """A note for a person, such as a warning; empty for none."""
        return ""

    @property
    def simulation(self) -> LiveSimulation | None:
        """The simulated hands that the commands move; None if the sink simulates nothing."""
        return None

    @property
    def figures(self) -> Mapping[str, Any]:
        """Counts and times for the summary of a run, as plain values; empty for none."""
        return {}

    @property
    def measures(self) -> bool:
        """True if ``state`` returns measurements while the sink is open; so for a simulation."""
        return self.simulation is not None

    def state(self, side: Side) -> HandState | None:
        """The last measured state of a hand; safe from any thread.

        None, as by default, if it measures nothing, is not open, or has no such hand.
        """
        del side
        return None

    def measured_wrist(self, side: Side) -> Float[np.ndarray, "7"] | None:
        """The last measured pose of the wrist of a hand, by the arm that it moves.

        In the frame of the robot's base: x y z [m], unit quaternion w x y z. Called on the loop's
        thread, so it must be quick. None, as by default, if it moves no arm or is not open.
        """
        del side
        return None

    def measured_arm(self, side: Side) -> Float[np.ndarray, " n"] | None:
        """The last measured joint positions of the arm of a hand [rad].

        In the order of ``ArmCommand.joint_names``; safe from any thread. None, as by default, if it
        moves no arm or is not open.
        """
        del side
        return None

    def use_arms(self, arms: Mapping[Side, CarriedHand]) -> None:
        """Set the arms that carry the hands, before ``check`` and ``open``.

        By default does nothing: ticks have the arms' commands.
        """
        del arms

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Check that the sink can be opened, before anything slow is done.

        It leaves nothing open. By default checks nothing.

        Raises:
            SmoothOperatorError: as ``open``.
        """
        del hands

    @abstractmethod
    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Open the sink for the commands of some hands; may be called again after ``close``.

        Args:
            hands: side -> robot hand.
            config: the resolved configuration of the run, JSON-serialisable, for sinks that keep
                it.

        Raises:
            SinkError: it can't be opened.
            OutputError: its file can't be written.
            MissingExtraError: a library that it needs is not installed.
        """

    @abstractmethod
    def send(self, tick: Tick) -> None:
        """Hand over a command, in well under a millisecond.

        Raises:
            SinkError: the far side is gone.
            OutputError: the disk is full.
        """

    def stalled(self, seconds: float) -> None:
        """React to a time without commands [s]; called from the watchdog's thread.

        Called repeatedly while the silence lasts. By default does nothing.
        """
        del seconds

    @abstractmethod
    def close(self) -> None:
        """Write pending data and close everything; a second call does nothing."""


def simulated_hands(sinks: Iterable[Sink]) -> LiveSimulation | None:
    """The first simulation among sinks; None without any."""
    return next((sink.simulation for sink in sinks if sink.simulation is not None), None)


_PATIENCE: Final = 3.0
"""Time that closing waits for the thread [s]."""


class Link(Protocol):
    """An open connection to the far side; all methods are called on the sink's own thread."""

    def deliver(self, tick: Tick) -> None:
        """Send a command."""

    def stalled(self, seconds: float) -> None:
        """Report a time without commands [s]."""

    def close(self) -> None:
        """Close the connection."""


class ThreadedSink(Sink):
    """A sink that hands the newest command of each hand to a link, on its own thread.

    A command that the link has not yet taken is overwritten by the next one: there is no queue.
    Subclasses are frozen dataclasses of settings.
    """

    @property
    @abstractmethod
    def label(self) -> str:
        """Name for a person, in a few words."""

    @abstractmethod
    def connect(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> Link:
        """Open the connection; its errors reach the caller of ``open``."""

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Open the way to the far side and close it again; see
        ``SinkRunner.check``."""
        self.connect(hands, {}).close()

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Open the sink; see ``Sink``."""
        if self._sender() is not None:
            raise SinkError(f"{self.label}: it is open already")
        # The settings are frozen, the state of an open sink is not.
        object.__setattr__(self, "_now", _Sender(self.connect(hands, config), self.label))

    def send(self, tick: Tick) -> None:
        """Leave a command for the thread.

        Raises:
            SinkError: the thread gave up, with its reason.
        """
        sender = self._sender()
        if sender is None:
            raise SinkError(f"{self.label}: it is not open")
        sender.post(tick)

    def stalled(self, seconds: float) -> None:
        """Pass a time without commands [s] to the thread."""
        sender = self._sender()
        if sender is not None:
            sender.silence(seconds)

    def close(self) -> None:
        """Send a pending command, and close the link; a second call does nothing."""
        sender = self._sender()
        object.__setattr__(self, "_now", None)
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
            raise SinkError(f"{self._label}: the far side does not answer; it was left as it is")

    def _run(self) -> None:
        try:
            while self._pass_on():
                pass
        except Exception as error:  # reaches the loop with its next command
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

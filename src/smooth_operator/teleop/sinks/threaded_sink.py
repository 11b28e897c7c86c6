"""Thread-backed sinks: a thread passes on the newest command of each hand."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Final, Protocol

from smooth_operator.errors import SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import Side

_PATIENCE: Final = 3.0
"""How long closing waits for the thread [s]."""


class Link(Protocol):
    """An open way to the far side; everything here is called on the sink's own thread."""

    def deliver(self, tick: Tick) -> None:
        """Pass a command on."""

    def stalled(self, seconds: float) -> None:
        """Say that no command has come for so long [s]."""

    def close(self) -> None:
        """Give everything back."""


class ThreadedSink(Sink):
    """A sink that hands the newest command of each hand to a link, on its own thread.

    A command that the link has not yet taken when the next one comes is overwritten: a robot gets
    the newest or nothing, never a queue. Subclasses are frozen dataclasses of settings.
    """

    @property
    @abstractmethod
    def label(self) -> str:
        """What it is, in a few words."""

    @abstractmethod
    def connect(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> Link:
        """Open the way to the far side; errors reach the caller that opens the sink."""

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Open the way to the far side and close it again; see
        ``SinkRunner.check``."""
        self.connect(hands, {}).close()

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Get ready; see ``Sink``."""
        if self._sender() is not None:
            raise SinkError(f"{self.label}: it is open already")
        # The settings are frozen, but a sink that is open is not its settings alone.
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
        """Leave word for the thread that no command has come for so long [s]."""
        sender = self._sender()
        if sender is not None:
            sender.silence(seconds)

    def close(self) -> None:
        """Pass on what is left, and close the link; a second call does nothing."""
        sender = self._sender()
        object.__setattr__(self, "_now", None)
        if sender is not None:
            sender.end()

    def _sender(self) -> _Sender | None:
        sender: _Sender | None = getattr(self, "_now", None)
        return sender


class _Sender:
    """The thread, and what lies ready for it."""

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

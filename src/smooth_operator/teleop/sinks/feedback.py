"""Haptic feedback of contacts to the operator: messages for gloves, pulses of controllers.

An output of feedback is a sink that observes: each tick has the newest measured contact of the
robot hand, and the message leaves on the output's own thread, so that no command waits for it.
"""

from __future__ import annotations

import socket
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.io.jsonable import numbers
from smooth_operator.settings import check_range
from smooth_operator.teleop.runtime.limiter import RateLimiter
from smooth_operator.teleop.runtime.statistics import RecentTimes, percentiles
from smooth_operator.teleop.sinks.sink import Link, ThreadedSink
from smooth_operator.teleop.sinks.tick import Contact, HandState, Tick
from smooth_operator.teleop.sinks.zmq_sink import check_address, encode, open_publisher
from smooth_operator.teleop.sources.combined import part_of
from smooth_operator.teleop.sources.live import LiveSource
from smooth_operator.teleop.sources.webxr import WebXr
from smooth_operator.types import Side

FORMAT: Final = 1
"""Version of the messages."""

VALID_S: Final = 0.2
"""Age of a contact from which it is not sent, and time for which a message is valid [s]."""

PULSE_S: Final = 0.1
"""Length of a controller's pulse, which the next one replaces [s]."""

Output: TypeAlias = tuple[Callable[[dict[str, Any]], object], Callable[[], None]]
"""Function that sends a message, and function that closes the connection."""


class FeedbackCounts:
    """Counts and delays of feedback messages. The sender's thread writes them; any thread may read.

    Attributes:
        not_finite: number of levels that were not finite, and sent as 0.
        unmeasured: True if the newest state of a hand had no contact.
    """

    def __init__(self) -> None:
        self.not_finite = 0
        self.unmeasured = False
        self._messages: dict[Side, int] = {}
        self._first = self._last = 0.0
        self._delays = RecentTimes()

    def sent(self, side: Side, now: float) -> None:
        """Counts a message."""
        self._first, self._last = self._first or now, now
        self._messages[side] = self._messages.get(side, 0) + 1

    def delayed(self, seconds: float) -> None:
        """Adds the time from the measurement of a contact to its message [s]."""
        self._delays.append(1e3 * seconds)

    def summary(self) -> dict[str, Any]:
        """Numbers for ``Sink.figures``; ``rate_hz`` is the rate of each hand."""
        count, length = sum(self._messages.values()), self._last - self._first
        return {
            "messages": count,
            "rate_hz": count / len(self._messages) / length if length > 0 else 0.0,
            "contacts_not_finite": self.not_finite,
            "feedback_delay_ms": percentiles(self._delays.newest()),
        }


@dataclass(frozen=True)
class Feedback(ThreadedSink):
    """Base class of feedback outputs, which send the contact of each finger, within limits.

    Nothing is felt (levels of 0) unless the operator moves the robot: in an emergency stop, a
    pause, a loss of the tracker or of the robot hand, and after the run.

    Attributes:
        strength: level that is sent for full contact, 0 to 1; no level is larger.
        rate: maximum mean rate of the messages of each hand [Hz].

    Raises:
        ConfigError: a setting is outside its range.
    """

    observes: ClassVar[bool] = True

    strength: float = field(default=0.5, kw_only=True)
    rate: float = field(default=100.0, kw_only=True)
    _counts: FeedbackCounts = field(
        default_factory=FeedbackCounts, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        check_range("feedback: strength", self.strength, 0.0, 1.0)
        check_range("feedback: rate", self.rate, 1.0, 1000.0, "Hz")

    def use_source(self, source: LiveSource) -> None:
        """Receives the source of the run before it starts; by default does nothing."""
        del source

    @abstractmethod
    def output(self) -> Output:
        """Opens the connection; raises the same errors as ``ThreadedSink.connect``."""

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Opens the connection and closes it again; see ``Sink``."""
        _, close = self.output()
        close()

    def connect(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> Link:
        """Opens the connection; see ``ThreadedSink``."""
        return _FeedbackLink(self, hands, self.output())

    @property
    def note(self) -> str:
        """Note for the user; empty if all is well."""
        return "the robot hand does not measure contact" if self._counts.unmeasured else ""

    @property
    def figures(self) -> dict[str, Any]:
        """Number and rate of the messages, and their delay after the measurement."""
        return self._counts.summary()


class _FeedbackLink:
    """An open connection; only the output's own thread uses it."""

    def __init__(self, feedback: Feedback, hands: Mapping[Side, Hand], output: Output) -> None:
        self._strength, self._counts = feedback.strength, feedback._counts
        self._hands = hands
        self._send, self._shut = output
        self._paces = {side: RateLimiter(1.0 / feedback.rate) for side in hands}
        self._felt: set[Side] = set()  # hands whose last message was not silent
        self._states: dict[Side, HandState] = {}  # the last that were sent
        self._number = 0

    def deliver(self, tick: Tick) -> None:
        """Send the contact of a hand in its turn; the first silence is sent at once."""
        side, now = tick.side, time.perf_counter()
        newest = self._newest(tick, now)
        if now < self._paces[side].opens and (newest is not None or side not in self._felt):
            return
        self._paces[side].take(now)
        if newest is None:
            self._silence(side)
            return
        state, contact = newest
        finite = np.isfinite(contact.levels)
        self._counts.not_finite += int((~finite).sum())
        levels = np.where(finite, np.clip(contact.levels, 0.0, 1.0), 0.0)
        self._felt.add(side)
        self._tell(side, self._strength * levels, contact.newtons, now - state.stamp)
        if state is not self._states.get(side):
            self._states[side] = state
            self._counts.delayed(time.perf_counter() - state.stamp)

    def _newest(self, tick: Tick, now: float) -> tuple[HandState, Contact] | None:
        """Measured contact of a hand with its state; None if nothing may be felt."""
        state = tick.state
        if state is None or not tick.mode.moves or now - state.stamp > VALID_S:
            return None
        self._counts.unmeasured = state.contact is None
        return None if state.contact is None else (state, state.contact)

    def stalled(self, seconds: float) -> None:
        """Send silence for all hands."""
        for side in self._hands:
            self._silence(side)

    def close(self) -> None:
        """Send silence for all hands, and close the connection."""
        try:
            self.stalled(0.0)
        finally:
            self._shut()

    def _silence(self, side: Side) -> None:
        self._felt.discard(side)
        nothing = np.zeros(len(self._hands[side].fingers))
        self._tell(side, nothing, nothing, None)

    def _tell(
        self,
        side: Side,
        levels: Float[np.ndarray, " f"],
        newtons: Float[np.ndarray, " f"],
        age: float | None,
    ) -> None:
        hand = self._hands[side]
        self._send(
            {
                "side": side,
                "type": "feedback",
                "format": FORMAT,
                "hand": hand.name,
                "number": self._number,
                "fingers": list(hand.fingers),
                "levels": levels.round(4).tolist(),
                "newtons": numbers(newtons),
                "age_s": age,
                "unix_time": time.time(),
                "valid_for_s": VALID_S,
            }
        )
        self._number += 1
        self._counts.sent(side, time.perf_counter())


@dataclass(frozen=True)
class ZmqFeedback(Feedback):
    """Publishes the contact of the fingers as JSON on a ZeroMQ socket (PUB).

    Attributes:
        address: address for subscribers; the default can be reached from this machine only.
    """

    address: str = "tcp://127.0.0.1:5559"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_address(self.address)

    @property
    def label(self) -> str:
        """The words ``feedback zmq`` and the address."""
        return f"feedback zmq {self.address}"

    def output(self) -> Output:
        """Opens the socket."""
        context, publisher = open_publisher(self.address, "feedback")

        def close() -> None:
            publisher.close()
            context.term()

        return lambda message: publisher.send(encode(message)), close


@dataclass(frozen=True)
class UdpFeedback(Feedback):
    """Sends the contact of the fingers as JSON in UDP datagrams.

    Attributes:
        receiver: host and port of the receiver, ``HOST:PORT``.
    """

    receiver: str

    def __post_init__(self) -> None:
        super().__post_init__()
        host, _, port = self.receiver.rpartition(":")
        if not (host and port.isascii() and port.isdigit() and 0 < int(port) < 65536):
            raise ConfigError(
                f"feedback udp: expected HOST:PORT, such as 127.0.0.1:9000, not {self.receiver!r}"
            )

    @property
    def label(self) -> str:
        """The words ``feedback udp`` and the receiver's address."""
        return f"feedback udp {self.receiver}"

    def output(self) -> Output:
        """Looks up the receiver's address, and opens a socket."""
        host, _, port = self.receiver.rpartition(":")
        try:
            family, kind, _, _, address = socket.getaddrinfo(
                host.strip("[]"), int(port), type=socket.SOCK_DGRAM
            )[0]
        except OSError as error:
            raise SinkError(f"{self.label}: the host can't be found: {error}") from error
        sender = socket.socket(family, kind)  # not connected: a missing receiver is no error
        return lambda message: sender.sendto(encode(message), address), sender.close


@dataclass(frozen=True)
class WebXrFeedback(Feedback):
    """Makes the controllers of a headset vibrate, as strongly as the finger with the strongest
    contact.

    The run's source, or its source of the wrist, must be ``webxr``.
    """

    rate: float = field(default=50.0, kw_only=True)
    _headset: WebXr | None = field(default=None, init=False, repr=False, compare=False)

    @property
    def label(self) -> str:
        """The words ``feedback webxr``."""
        return "feedback webxr"

    def use_source(self, source: LiveSource) -> None:
        """Finds the headset among the sources; see ``Feedback``."""
        headset = part_of(source, WebXr)
        if headset is None:
            raise ConfigError(
                "--feedback webxr needs a headset: use --source webxr or --wrist-source webxr"
            )
        headset.expect_pulses()
        self._set(_headset=headset)

    def output(self) -> Output:
        """Prepares to send pulses through the source, which has its own connection."""
        felt: set[Side] = set()
        headset = self._headset
        assert headset is not None  # set before the run

        def send(message: dict[str, Any]) -> None:
            side, strength = message["side"], max(message["levels"])
            if strength > 0.0 or side in felt:
                headset.pulse(side, strength, PULSE_S)
            (felt.add if strength > 0.0 else felt.discard)(side)

        return send, lambda: None

"""The Quest app Hand Tracking Streamer as a source: ``hts``."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from smooth_operator.headsets.hts_lines import HtsHands, begins_line, parse_line
from smooth_operator.teleop.sources.message_receiver import Message, OneSender
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.teleop.sources.stream import Hands, Inbox, StreamSource, check_port, sides_of
from smooth_operator.teleop.sources.tcp_inbox import Sockets, TcpInbox, Together, split_lines
from smooth_operator.teleop.sources.udp import UdpInbox

Transport: TypeAlias = Literal["both", "udp", "tcp"]
"""What the app sends over; ``both`` listens to both."""

UDP_PORT: Final = 9000
TCP_PORT: Final = 8000
"""The app's own ports."""


@dataclass(frozen=True)
class HtsSource(StreamSource):
    """Both hands from the Quest app Hand Tracking Streamer, over Wi-Fi or a cable.

    Whoever can send to the ports moves the hand; the app knows no passwords. So it listens on this
    machine alone by default, which is enough for a cable (``adb reverse tcp:8000 tcp:8000``).

    Attributes:
        host: address to listen on; ``0.0.0.0`` for the whole network, which Wi-Fi needs.
        port: to listen on; the app's own if None: 9000 for UDP, 8000 for TCP. 0 for any free one.
        transport: ``udp``, ``tcp``, or ``both``.
        side: the hands that are taken.

    Raises:
        ConfigError: a setting is outside its range.
    """

    host: str = "127.0.0.1"
    port: int | None = None
    transport: Transport = "both"
    side: Hands = "both"

    def __post_init__(self) -> None:
        check_port(self.port)
        sides_of(self.side)

    @property
    def label(self) -> str:
        """What it is, in a few words."""
        return "Hand Tracking Streamer"

    @property
    def hint(self) -> str:
        """What to look at while nothing has come."""
        if self.host in ("127.0.0.1", "localhost", "::1"):
            return ", this computer alone (a cable); for Wi-Fi say hts:0.0.0.0"
        return "; in the app, set this computer's address, the port and the protocol"

    def connect(self) -> Inbox:
        """Take the ports."""
        object.__setattr__(self, "_hands", HtsHands())
        object.__setattr__(self, "_sender", OneSender())
        inboxes: list[Sockets] = []
        if self.transport != "tcp":
            port = UDP_PORT if self.port is None else self.port
            inboxes.append(_UdpLines(self.host, port, "hts:port=PORT"))
        if self.transport != "udp":
            port = TCP_PORT if self.port is None else self.port
            try:
                inboxes.append(TcpInbox(self.host, port, split_lines, begins_line, "hts"))
            except Exception:
                for inbox in inboxes:
                    inbox.close()
                raise
        return inboxes[0] if len(inboxes) == 1 else Together(inboxes)

    def read(self, message: Message, received: float) -> Sequence[Reading]:
        """The hand that a line completes."""
        data, host, *connection = message
        sender: OneSender = getattr(self, "_sender")  # noqa: B009  (set in connect())
        hands: HtsHands = getattr(self, "_hands")  # noqa: B009
        line = parse_line(data)  # what is no line does not choose the sender
        sender.check(host, received)
        frame = hands.add(line, received)
        if frame is None:
            return ()
        stamped = frame.stamp is not None
        if not stamped:
            frame = dataclasses.replace(frame, stamp=received)
        # Another connection is another start of the app.
        return (Reading(frame, stamped, b" ".join((host, *connection)).decode()),)


class _UdpLines(UdpInbox):
    """Lines in datagrams."""

    def receive(self, timeout: float) -> list[Message]:
        """See ``Inbox``."""
        return [
            (line, host)
            for data, host in super().receive(timeout)
            for line in data.split(b"\n")
            if line.strip()
        ]

"""Headset apps as sources: ``hts`` (Quest), ``pico``, ``avp`` (Vision Pro; extra ``avp``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

from smooth_operator.errors import ConfigError
from smooth_operator.headsets import avp, hts_lines, pico_packets
from smooth_operator.headsets.repeats import Repeats
from smooth_operator.teleop.sources.inboxes import (
    GrpcInbox,
    Inbox,
    Message,
    TcpInbox,
    Together,
    UdpInbox,
    split_lines,
)
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.teleop.sources.stream import (
    Hands,
    OneSender,
    Reader,
    StreamSource,
    check_port,
    sides_of,
)

Transport: TypeAlias = Literal["both", "udp", "tcp"]
"""Transport of the app; ``both`` listens to both."""

UDP_PORT: Final = 9000
TCP_PORT: Final = 8000
"""The app's own ports."""


@dataclass(frozen=True)
class HtsSource(StreamSource):
    """Both hands from the Quest app Hand Tracking Streamer, over Wi-Fi or a cable.

    Everybody who can send to the ports moves the hand, since the app has no passwords. By default
    the source therefore listens on this machine only, which is enough for a cable (``adb reverse
    tcp:8000 tcp:8000``).

    Attributes:
        host: address to listen on; ``0.0.0.0`` for the whole network, which Wi-Fi needs.
        port: port to listen on; None for those of the app: 9000 for UDP, 8000 for TCP. 0 for any
            free one.
        transport: ``udp``, ``tcp``, or ``both``.
        side: hands to use.

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
        """The source in a few words."""
        return "Hand Tracking Streamer"

    @property
    def hint(self) -> str:
        """Advice while nothing has come."""
        if self.host in ("127.0.0.1", "localhost", "::1"):
            return ", this computer alone (a cable); for Wi-Fi say hts:0.0.0.0"
        return "; in the app, set this computer's address, the port and the protocol"

    def connect(self) -> Inbox:
        """Takes the ports."""
        inboxes: list[Inbox] = []
        if self.transport != "tcp":
            port = UDP_PORT if self.port is None else self.port
            inboxes.append(_UdpLines(self.host, port, "hts:port=PORT"))
        if self.transport != "udp":
            port = TCP_PORT if self.port is None else self.port
            try:
                inboxes.append(TcpInbox(self.host, port, split_lines, hts_lines.begins_line, "hts"))
            except Exception:
                for inbox in inboxes:
                    inbox.close()
                raise
        return inboxes[0] if len(inboxes) == 1 else Together(inboxes)

    def reader(self) -> Reader:
        """Reads the lines, each of which may complete a hand."""
        sender, hands = OneSender(), hts_lines.HtsHands()

        def read(message: Message, received: float) -> Sequence[Reading]:
            data, host, *connection = message
            line = hts_lines.parse_line(data)  # only a valid line chooses the sender
            sender.check(host, received)
            frame = hands.add(line, received)
            if frame is None:
                return ()
            stamped = frame.stamp is not None
            frame = frame if stamped else replace(frame, stamp=received)
            # Another connection is another start of the app.
            return (Reading(frame, stamped, b" ".join((host, *connection)).decode()),)

        return read


class _UdpLines(UdpInbox):
    """Lines in datagrams."""

    def receive(self, timeout: float) -> list[Message]:
        """The lines of the newest datagrams."""
        return [
            (line, host)
            for data, host in super().receive(timeout)
            for line in data.split(b"\n")
            if line.strip()
        ]


@dataclass(frozen=True)
class PicoSource(StreamSource):
    """Both hands from the PICO app XRoboToolkit, which connects to this program as to its service.

    The app's PC service must not run on this computer at the same time, since both use one port.
    Everybody who can connect moves the hand, since the app has no passwords. By default the source
    therefore listens on this machine only.

    Attributes:
        host: address to listen on; ``0.0.0.0`` for the whole network, which a headset needs.
        port: TCP port; the app connects only to 63901.
        side: hands to use.
        axes: axes of the joints: ``openxr``, right-handed, or ``unity``, left-handed, for an app
            that sends them so.

    Raises:
        ConfigError: a setting is outside its range.
    """

    host: str = "127.0.0.1"
    port: int = pico_packets.PORT
    side: Hands = "both"
    axes: pico_packets.Axes = "openxr"

    def __post_init__(self) -> None:
        check_port(self.port)
        sides_of(self.side)

    @property
    def label(self) -> str:
        """The source in a few words."""
        return "XRoboToolkit (PICO)"

    @property
    def hint(self) -> str:
        """Advice while nothing has come."""
        if self.host in ("127.0.0.1", "localhost", "::1"):
            return ", this computer alone; for a headset on the network say pico:0.0.0.0"
        return "; in the app, enter this computer's address, then switch on Hand and Send"

    def connect(self) -> Inbox:
        """Takes the port."""
        split, begins = pico_packets.split_packets, pico_packets.begins_packet
        return TcpInbox(self.host, self.port, split, begins, "pico")

    def reader(self) -> Reader:
        """Reads the packets."""
        sender, repeats = OneSender(), Repeats()

        def read(message: Message, received: float) -> Sequence[Reading]:
            data, host, connection = message
            packet = pico_packets.read_packet(data, self.axes)  # what is none chooses no sender
            sender.check(host, received)
            stamped, session = packet.stamp is not None, f"{host.decode()} {connection.decode()}"
            return [
                Reading(frame if stamped else replace(frame, stamp=received), stamped, session)
                for frame in map(repeats.new, packet.frames)
                if frame is not None
            ]

        return read


@dataclass(frozen=True)
class AvpSource(StreamSource):
    """Both hands from a Vision Pro with the app Tracking Streamer, over Wi-Fi.

    This program connects to the headset, and reconnects after the headset was asleep. The app sends
    neither the time of a measurement nor the visibility of a hand: a stamp is the time of receipt,
    and an unchanged hand is no new frame, so that a lost hand falls silent. An unchanged wrist
    is not valid while the fingers move.

    Attributes:
        address: address of the headset, as the app shows it.
        port: port of the app.
        side: hands to use.

    Raises:
        ConfigError: a setting is outside its range.
    """

    address: str
    port: int = avp.PORT
    side: Hands = "both"

    def __post_init__(self) -> None:
        if not self.address.strip():
            raise ConfigError("avp needs the headset's address, which the app shows: avp:ADDRESS")
        if not 1 <= self.port <= 65_535:
            raise ConfigError(f"port must be 1 to 65535, not {self.port}")
        sides_of(self.side)

    @property
    def label(self) -> str:
        """The source in a few words."""
        return f"Tracking Streamer (Vision Pro) at {self.address}"

    def connect(self) -> Inbox:
        """Begins to connect; the headset need not be there yet."""
        host = f"[{self.address}]" if ":" in self.address else self.address
        method, longest = avp.METHOD, avp.MOST_BYTES
        return GrpcInbox("the source 'avp'", "avp", f"{host}:{self.port}", method, longest)

    def reader(self) -> Reader:
        """Reads the messages."""
        repeats = Repeats(wrist=True)

        def read(message: Message, received: float) -> Sequence[Reading]:
            data, connection = message
            return [
                Reading(replace(frame, stamp=received), session=connection.decode())
                for frame in map(repeats.new, avp.read_hands(data))
                if frame is not None
            ]

        return read

"""The PICO app XRoboToolkit as a source: ``pico``."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from smooth_operator.headsets.pico_packets import (
    PORT,
    Axes,
    begins_packet,
    read_packet,
    split_packets,
)
from smooth_operator.headsets.repeats import Repeats
from smooth_operator.teleop.sources.message_receiver import Message, OneSender
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.teleop.sources.stream import Hands, Inbox, StreamSource, check_port, sides_of
from smooth_operator.teleop.sources.tcp_inbox import TcpInbox


@dataclass(frozen=True)
class PicoSource(StreamSource):
    """Both hands from the PICO app XRoboToolkit, which connects to this program as to its service.

    The app's PC service must not run on this computer at the same time: both take one port.
    Whoever can connect moves the hand; the app knows no passwords. So it listens on this machine
    alone by default.

    Attributes:
        host: address to listen on; ``0.0.0.0`` for the whole network, which a headset needs.
        port: TCP port; the app connects to 63901 and to no other.
        side: the hands that are taken.
        axes: axes of the joints: ``openxr``, right-handed, or ``unity``, left-handed, for an app
            that sends them so.

    Raises:
        ConfigError: a setting is outside its range.
    """

    host: str = "127.0.0.1"
    port: int = PORT
    side: Hands = "both"
    axes: Axes = "openxr"

    def __post_init__(self) -> None:
        check_port(self.port)
        sides_of(self.side)

    @property
    def label(self) -> str:
        """What it is, in a few words."""
        return "XRoboToolkit (PICO)"

    @property
    def hint(self) -> str:
        """What to look at while nothing has come."""
        if self.host in ("127.0.0.1", "localhost", "::1"):
            return ", this computer alone; for a headset on the network say pico:0.0.0.0"
        return "; in the app, enter this computer's address, then switch on Hand and Send"

    def connect(self) -> Inbox:
        """Take the port."""
        object.__setattr__(self, "_sender", OneSender())
        object.__setattr__(self, "_repeats", Repeats())
        return TcpInbox(self.host, self.port, split_packets, begins_packet, "pico")

    def read(self, message: Message, received: float) -> Sequence[Reading]:
        """The hands of a packet."""
        data, host, connection = message
        sender: OneSender = getattr(self, "_sender")  # noqa: B009  (set in connect())
        repeats: Repeats = getattr(self, "_repeats")  # noqa: B009
        packet = read_packet(data, self.axes)  # what is no packet does not choose the sender
        sender.check(host, received)
        frames = tuple(frame for frame in map(repeats.new, packet.frames) if frame is not None)
        if packet.stamp is None:
            frames = tuple(dataclasses.replace(frame, stamp=received) for frame in frames)
        session = f"{host.decode()} {connection.decode()}"
        return [Reading(frame, packet.stamp is not None, session) for frame in frames]

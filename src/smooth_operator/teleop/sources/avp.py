"""The Vision Pro app Tracking Streamer as a source: ``avp:ADDRESS`` (extra ``avp``)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from smooth_operator.errors import ConfigError
from smooth_operator.headsets.avp_messages import METHOD, MOST_BYTES, PORT, read_hands
from smooth_operator.headsets.repeats import Repeats
from smooth_operator.teleop.sources.grpc_inbox import GrpcInbox
from smooth_operator.teleop.sources.message_receiver import Message
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.teleop.sources.stream import Hands, Inbox, StreamSource, sides_of


@dataclass(frozen=True)
class AvpSource(StreamSource):
    """Both hands from a Vision Pro with the app Tracking Streamer, over Wi-Fi.

    This program connects to the headset, and again when the headset was asleep. The app says
    neither when a hand was measured nor whether it is seen: a stamp is the time of receipt, and a
    hand that is sent again unchanged is no new frame, so that a lost hand falls silent. A wrist
    that is sent again unchanged while the fingers move is not valid.

    Attributes:
        address: address of the headset, as the app shows it.
        port: port of the app.
        side: the hands that are taken.

    Raises:
        ConfigError: a setting is outside its range.
    """

    address: str
    port: int = PORT
    side: Hands = "both"

    def __post_init__(self) -> None:
        if not self.address.strip():
            raise ConfigError("avp needs the headset's address, which the app shows: avp:ADDRESS")
        if not 1 <= self.port <= 65_535:
            raise ConfigError(f"port must be 1 to 65535, not {self.port}")
        sides_of(self.side)

    @property
    def label(self) -> str:
        """What it is, in a few words."""
        return f"Tracking Streamer (Vision Pro) at {self.address}"

    def connect(self) -> Inbox:
        """Begin to connect; the headset need not be there yet."""
        object.__setattr__(self, "_repeats", Repeats(wrist=True))
        host = f"[{self.address}]" if ":" in self.address else self.address
        return GrpcInbox("the source 'avp'", "avp", f"{host}:{self.port}", METHOD, MOST_BYTES)

    def problem(self, inbox: Inbox) -> str:
        """Why there is no connection."""
        return inbox.problem if isinstance(inbox, GrpcInbox) else ""

    def read(self, message: Message, received: float) -> Sequence[Reading]:
        """The hands of a message."""
        data, connection = message
        repeats: Repeats = getattr(self, "_repeats")  # noqa: B009  (set in connect())
        return [
            Reading(dataclasses.replace(frame, stamp=received), session=connection.decode())
            for frame in map(repeats.new, read_hands(data))
            if frame is not None
        ]

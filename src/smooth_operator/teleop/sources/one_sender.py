"""One sender at a time, so that two trackers on a network do not move one hand in turn."""

from __future__ import annotations

from smooth_operator.errors import RecordingError
from smooth_operator.teleop.sources.message_receiver import SILENCE_S


class OneSender:
    """The first address that sends is listened to, until it has been silent for a second.

    Programs at one address count as one sender: an app may open a socket for each hand.
    """

    def __init__(self) -> None:
        self._host: bytes | None = None
        self._last = 0.0

    def check(self, host: bytes, received: float) -> None:
        """Take note of a message.

        Args:
            host: the address that it came from.
            received: when it came [s].

        Raises:
            RecordingError: it is from another address than the one that is listened to.
        """
        if self._host not in (None, host) and received - self._last <= SILENCE_S:
            heard = (self._host or b"").decode()
            raise RecordingError(
                f"{host.decode()} sends too, and is not used while {heard} does; stop one of "
                "them, or give each a port of its own"
            )
        self._host, self._last = host, received

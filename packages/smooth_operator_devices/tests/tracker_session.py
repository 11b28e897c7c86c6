"""A running source of a tracker, and a sender of its datagrams."""

import contextlib
import socket
from collections.abc import Iterator
from typing import Any

from live_time import Kept

from smooth_operator.teleop.components import build_source


@contextlib.contextmanager
def started(text: str) -> Iterator[tuple[Any, Kept]]:
    """A source by its text, and its mailbox, which keeps all frames."""
    source, mailbox = build_source(text), Kept()
    source.start(mailbox)
    try:
        yield source, mailbox
    finally:
        source.stop()


@contextlib.contextmanager
def sender(source: Any) -> Iterator[Any]:
    """A function that sends datagrams to the port of a source."""
    host, _, port = source.endpoint.removeprefix("udp://").rpartition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        yield lambda data: one.sendto(data, (host, int(port)))

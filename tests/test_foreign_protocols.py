"""Sources that listen on TCP, and what reaches them that is not of their protocol."""

import contextlib
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import headset_apps as app
import pytest
from live_time import Kept, until

from smooth_operator.teleop.components import build_source

POSE = (0.4, -0.3, 1.1, 0.6, -0.48, 0.384, 0.512)
JOINTS = app.hand("right")


def hts(number: int) -> bytes:
    pose = (POSE[0] + 0.001 * number, *POSE[1:])
    return app.hts_packet("right", pose, app.landmarks(JOINTS)) + b"\n"


def pico(number: int) -> bytes:
    pose = (POSE[0] + 0.001 * number, *POSE[1:])
    return app.pico_tracking({"rightHand": app.pico_hand(pose, JOINTS)}, number * 20_000_000)


SOURCES: dict[str, Callable[[int], bytes]] = {"hts:port=0,transport=tcp": hts, "pico:port=0": pico}

HEADERS = [
    b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 5000\r\n\r\n",
    b"GET /?Right%20wrist HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"HEAD / HTTP/1.1\r\n\r\n",
    b"OPTIONS / HTTP/1.1\r\n\r\n",
    b"PUT / HTTP/1.1\r\n\r\n",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    b"\x00\x01\x00\x08",
    b"\xff\x00\x00\x00\x00\x00\x00\x00\x01\x7f",
]


@contextlib.contextmanager
def listening(text: str) -> Iterator[tuple[Any, Kept, tuple[str, int]]]:
    source: Any = build_source(text)
    mailbox = Kept()
    source.start(mailbox)
    try:
        host, _, port = source.endpoint.removeprefix("tcp://").rpartition(":")
        yield source, mailbox, (host, int(port))
    finally:
        source.stop()


def is_closed(one: socket.socket) -> bool:
    """Whether the other end is."""
    try:
        return one.recv(1) == b""
    except ConnectionError:
        return True


def works(mailbox: Kept, where: tuple[str, int], data: bytes) -> None:
    """A headset, whose bytes arrive one by one."""
    before = mailbox.received
    with socket.create_connection(where, timeout=60) as headset:
        headset.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for byte in data[:40]:
            headset.sendall(bytes([byte]))
        headset.sendall(data[40:])
        until(lambda: mailbox.received == before + 1)


@pytest.mark.parametrize("text", SOURCES)
@pytest.mark.parametrize("pieces", ["together", "apart", "byte by byte"])
def test_another_protocol_is_closed_for_good(text, pieces):
    frame = SOURCES[text]
    with listening(text) as (source, mailbox, where):
        for header in HEADERS:
            with socket.create_connection(where, timeout=60) as one:
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                if pieces == "byte by byte":
                    with pytest.raises(ConnectionError):  # noqa: PT012  (whichever is noticed)
                        for byte in header[:9] * 20:
                            one.sendall(bytes([byte]))
                            time.sleep(0.005)
                    continue
                if pieces == "apart":
                    one.sendall(header)
                    assert is_closed(one)
                with contextlib.suppress(ConnectionError):  # as it should be
                    one.sendall(frame(1) if pieces == "apart" else header + frame(1))
                    one.sendall(frame(2))
                assert is_closed(one)
        count = f"connections closed: {len(HEADERS)}; a web page or another program at"
        until(lambda: count in source.health().detail)  # counted just after the socket is closed
        assert (
            r"127.0.0.1 connected to this port, and its connection was closed: b'\xff"
            in source.health().detail
        )
        assert source.health().state == "waiting"
        works(mailbox, where, frame(3))
        assert mailbox.received == 1
        until(lambda: source.health().state == "running")
        assert "connections closed" in source.health().detail

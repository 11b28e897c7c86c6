"""What comes to a page's port that is no request, or a wrong one, is refused in silence."""

import contextlib
import os
import socket
import ssl
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
import viser
from live_time import PATIENCE_S

PAGE = """
import sys
import rich
from smooth_operator.teleop.pages.viser_server import open_server, page_url
rich.get_console().quiet = True  # viser says on it that it stops
server = open_server(sys.argv[1], 0)
token = page_url(sys.argv[1], server).partition("?token=")[2]
print(server.get_port(), token, flush=True)
sys.stdin.read()
server.stop()
"""
WEBXR = """
import sys
from smooth_operator.teleop.sources.live import Mailbox
from smooth_operator.teleop.sources.webxr.source import WebXr
source = WebXr(port=0, code="246810")
source.start(Mailbox())
print(source.addresses[0].rpartition(":")[2], flush=True)
sys.stdin.read()
source.stop()
"""


@dataclass
class Server:
    """A server in a process, all that it prints is kept."""

    port: int
    token: str
    tls: bool
    path: str

    @contextlib.contextmanager
    def connected(self) -> Iterator[socket.socket]:
        with socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S) as plain:
            if not self.tls:
                yield plain
                return
            context = ssl.create_default_context()
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
            with context.wrap_socket(plain) as wrapped:
                yield wrapped

    def status(self, request: bytes) -> int:
        """Of the answer; 0 if there is none."""
        with self.connected() as one:
            one.sendall(request)
            with contextlib.suppress(ConnectionError, ssl.SSLError, TimeoutError):
                words = one.recv(4096).split()
                return int(words[1]) if len(words) > 1 else 0
        return 0

    def upgrade(self, *headers: bytes) -> bytes:
        """A request that opens the WebSocket."""
        return request(
            f"{self.path}?token={self.token}".encode(),
            b"Upgrade: websocket",
            b"Connection: Upgrade",
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            b"Sec-WebSocket-Version: 13",
            b"Sec-WebSocket-Protocol: viser-v" + viser.__version__.encode(),
            *headers,
        )


def request(path: bytes, *headers: bytes, host: bytes = b"localhost") -> bytes:
    return b"\r\n".join((b"GET " + path + b" HTTP/1.1", b"Host: " + host, *headers, b"", b""))


@contextlib.contextmanager
def started(
    words: Sequence[str], folder: Path, *, path: str, tls: bool = False
) -> Iterator[Server]:
    """A program that serves, in a process; in the end it must have printed nothing.

    Args:
        words: text of the program, which prints its port and perhaps a token, and its arguments.
        folder: folder of its cache and of what it prints.
        path: path of its WebSocket.
        tls: true if it speaks TLS.
    """
    with (folder / "errors").open("w+b") as errors:
        process = subprocess.Popen(
            [sys.executable, "-c", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env={**os.environ, "SMOOTH_OPERATOR_CACHE": str(folder / "cache")},
        )
        try:
            line = process.stdout.readline().decode().split()
            assert line, (folder / "errors").read_text()
            yield Server(int(line[0]), "".join(line[1:]), tls, path)
            printed = process.communicate(timeout=PATIENCE_S)[0]
            assert printed + (folder / "errors").read_bytes() == b""
        finally:
            process.kill()
            process.wait()


@pytest.fixture(
    scope="module",
    params=[(PAGE, "127.0.0.1"), (PAGE, "0.0.0.0"), (WEBXR,)],
    ids=["page", "page elsewhere", "webxr"],
)
def server(request, tmp_path_factory) -> Iterator[Server]:
    tls = request.param[0] == WEBXR
    path = "/link" if tls else "/"
    with started(request.param, tmp_path_factory.mktemp("server"), path=path, tls=tls) as server:
        yield server


WRONG = {
    "two hosts": request(b"/", b"Host: localhost"),
    "two other hosts": request(b"/", b"Host: elsewhere.example"),
    "host with a bracket": request(b"/", host=b"["),
    "two origins": request(b"/", b"Origin: http://localhost", b"Origin: http://localhost"),
    "origin with a bracket": request(b"/", b"Origin: http://["),
    "two cookies": request(b"/", b"Cookie: a=b", b"Cookie: a=c"),
    "cookie of bytes": request(b"/", b"Cookie: a=\xff"),
    "two upgrades": request(b"/", b"Upgrade: websocket", b"Upgrade: h2c"),
    "token of bytes": request(b"/?token=\xff\xfe"),
    "path with a bracket": request(b"//["),
    "post": b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\n\r\nabc",
    "no http": b"\x00\x01\x02\xff\r\n\r\n",
    "long header": request(b"/", b"X: " + b"x" * 20_000),
}
UNFINISHED = [b"", b"G", b"GET / HTTP/1.1\r\nHost: local", b"\x16\x03\x01\xff\xff", b"\x80" * 3]


def test_a_wrong_request_is_refused_and_prints_nothing(server):
    statuses = {name: server.status(data) for name, data in WRONG.items()}
    # The files of a headset's page are for everyone; its link, below, looks at the origin.
    files = {"host with a bracket", "origin with a bracket"} if server.tls else set()
    assert {name for name, status in statuses.items() if status == 200} == files
    assert 500 not in statuses.values()
    assert {statuses[name] for name in WRONG if name.startswith("two")} == {400}
    for data in UNFINISHED:
        for reset in (False, True):
            with socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE_S) as one:
                if reset:
                    linger = struct.pack("ii", 1, 0)
                    one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
                one.sendall(data)
    for header in (b"Origin: http://[", b"Origin: null", b"Origin: http://elsewhere.example"):
        assert server.status(server.upgrade(header)) == 403
    assert server.status(server.upgrade(b"Origin: http://localhost")) == 101


def test_messages_that_are_none_print_nothing(server):
    ping = b"\x89\x80\0\0\0\0"
    messages = [
        b"\x82\x85\0\0\0\0hello",
        b"\x81\x85\0\0\0\0hello",
        b"\x82\x83\0\0\0\0\xff\xff\xff",
        b"\xf2\x80\0\0\0\0",
        b"\x8f\x80\0\0\0\0",
        b"\x82\x05hello",
        b"\x88\x82\0\0\0\0\x00\x01",
        b"\x82\xff\x7f\xff\xff\xff\xff\xff\xff\xff",
    ]
    for message in (*messages, ping * 20_000, ping * 20_000):
        with server.connected() as one:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            one.sendall(server.upgrade())
            assert b"101" in one.recv(4096).split()
            with contextlib.suppress(ConnectionError, ssl.SSLError, TimeoutError):
                one.sendall(message)
            if len(message) < 100:
                time.sleep(0.1)
    time.sleep(1.0)
    assert server.status(server.upgrade()) == 101

"""A headset's browser as source: messages, pairing, certificate, server, and the page itself."""

import datetime
import json
import os
import re
import socket
import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_page import picture
from emulated_headset import NoEmulator, fetch_emulator, new_headset
from live_time import PATIENCE_S
from live_time import until as eventually

from smooth_operator.errors import ConfigError, RecordingError, SourceError
from smooth_operator.formats.checks import check_units
from smooth_operator.landmarks import BONES, FINGER_COLORS, FROM_WEBXR_25, METACARPALS_WEBXR_25
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.sources.live import Arrival, Mailbox
from smooth_operator.teleop.sources.webxr import WebXr
from smooth_operator.teleop.sources.webxr import source as xr_source
from smooth_operator.teleop.sources.webxr.link import (
    HEADER,
    IN_ALL,
    MAX_BYTES,
    PER_ADDRESS,
    WINDOW,
    LinkState,
    Pairing,
    read_packet,
)
from smooth_operator.teleop.sources.webxr.source import SWITCH, VALID, describe, get_certificate
from smooth_operator.types import Side
from smooth_operator.web import addresses
from smooth_operator.web.listening import LimitedListener, listen

pytest.importorskip("cryptography", reason="the extra webxr is not installed")
client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
closed = pytest.importorskip("websockets.exceptions").ConnectionClosed

CODE = "246810"


def joints(sign: float = 1.0) -> np.ndarray:
    """(25, 8) of which each joint says its number: x = index [cm], quaternion, radius 1 cm."""
    hand = np.zeros((25, 8), "<f4")
    hand[:, 0] = sign * 0.01 * np.arange(25)
    hand[:, 3:7] = 0.5, -0.5, 0.5, 0.5
    hand[:, 7] = 0.01
    return hand


def message(
    left: np.ndarray | None = None,
    right: np.ndarray | None = None,
    *,
    number: int = 0,
    stamp: float = 1.0,
) -> bytes:
    mask = (left is not None) + 2 * (right is not None)
    body = b"".join(hand.tobytes() for hand in (left, right) if hand is not None)
    return HEADER.pack(b"XRH1", number, stamp, mask, 0) + body


def test_joints_become_landmarks_in_our_order_and_quaternions_ours():
    packet = read_packet(message(joints(-1), joints(), number=7, stamp=2.5))
    assert (packet.number, packet.stamp) == (7, 2.5)
    assert [frame.side for frame in packet.frames] == ["left", "right"]
    for frame, sign in zip(packet.frames, (-1, 1), strict=True):
        assert frame.stamp == 2.5
        np.testing.assert_allclose(frame.landmarks[:, 0], sign * 0.01 * np.array(FROM_WEBXR_25))
        np.testing.assert_allclose(
            frame.metacarpals[:, 0], sign * 0.01 * np.array(METACARPALS_WEBXR_25)
        )
        np.testing.assert_allclose(frame.orientations, np.tile([0.5, 0.5, -0.5, 0.5], (21, 1)))
        assert frame.valid.all()


def test_what_the_headset_does_not_see_is_nan_and_never_a_guess():
    hand = joints()
    hand[2] = np.nan  # thumb MCP
    hand[6, 1] = np.inf  # index MCP
    hand[9, 0] = 1e6  # index tip, a thousand kilometres off
    hand[11, 3:7] = 0.0  # middle MCP has no orientation
    (frame,) = read_packet(message(right=hand)).frames
    assert np.flatnonzero(~frame.valid).tolist() == [2, 5, 8]
    assert np.isnan(frame.landmarks[[2, 5, 8]]).all()
    assert np.flatnonzero(np.isnan(frame.orientations).any(-1)).tolist() == [2, 9]


def test_a_moment_without_hands_is_a_message():
    assert read_packet(message()).frames == ()
    assert len(message(joints(), joints())) == MAX_BYTES


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        b"XRH1",
        b"XRH2" + message(joints())[4:],
        message(joints())[:-1],
        message(joints()) + b"\0",
        HEADER.pack(b"XRH1", 0, 0.0, 3, 0) + joints().tobytes(),
        HEADER.pack(b"XRH1", 0, 0.0, 4, 0),
        message(joints(), stamp=float("nan")),
        message(joints(), stamp=1e300),
        message(joints(), stamp=-1e12),
    ],
)
def test_a_broken_message_is_refused(bad):
    with pytest.raises(RecordingError):
        read_packet(bad)


def test_codes_are_random_and_forgive_how_they_are_typed():
    codes = {Pairing(None).code for _ in range(20)}
    assert len(codes) > 15
    assert all(re.fullmatch(r"\d{6}", code) for code in codes)
    pairing = Pairing("abc-123")
    assert pairing.check(" ABC 123 ", "a") == "paired"
    assert pairing.check("abc124", "a") == "wrong"
    assert pairing.spoken == "abc 123"


def test_wrong_codes_are_looked_at_only_so_often():
    now = 0.0
    pairing = Pairing(CODE, lambda: now)
    assert [pairing.check("000000", "a") for _ in range(PER_ADDRESS)] == ["wrong"] * PER_ADDRESS
    assert pairing.check(CODE, "a") == "locked"  # or guessing would go on behind the lock
    assert pairing.check(CODE, "b") == "paired"  # the operator is not locked out by others
    for k in range(IN_ALL):
        pairing.check("000000", f"c{k}")
    assert pairing.check(CODE, "b") == "locked"
    now = WINDOW + 1
    assert pairing.check(CODE, "a") == "paired"
    assert pairing.refused > IN_ALL


@pytest.mark.parametrize("code", ["12345", "", "12 34-5", "ünïcöde", "x" * 65, "123456;"])
def test_a_code_that_is_no_use_is_refused(code):
    with pytest.raises(ConfigError, match="6 to 64 letters and digits"):
        WebXr(code=code)


def test_a_certificate_is_kept_in_private_and_used_again(tmp_path):
    folder = tmp_path / "kept"
    made = get_certificate(addresses.LOCAL, folder)
    again = get_certificate(addresses.LOCAL, folder)
    assert made == again
    assert b"PRIVATE" in made.file.read_bytes()
    assert b"PRIVATE" not in made.public
    other = get_certificate((*addresses.LOCAL, "192.168.1.20"), folder)
    assert other.fingerprint != made.fingerprint
    assert get_certificate(addresses.LOCAL, folder) == made  # back on the first network
    if os.name == "posix":
        assert made.file.stat().st_mode & 0o777 == 0o600
        assert folder.stat().st_mode & 0o777 == 0o700


def test_a_certificate_is_made_anew_when_it_runs_out(tmp_path):
    now = datetime.datetime.now(datetime.UTC)
    first = get_certificate(("localhost",), tmp_path, now)
    late = now + VALID - datetime.timedelta(days=2)
    assert get_certificate(("localhost",), tmp_path, late) == first
    after = get_certificate(("localhost",), tmp_path, late + datetime.timedelta(days=1.5))
    assert after.fingerprint != first.fingerprint
    assert after.expires > first.expires


@pytest.mark.parametrize("damage", ["cut", "garbage", "open"])
def test_a_damaged_or_open_certificate_is_replaced(tmp_path, damage):
    first = get_certificate(("localhost",), tmp_path)
    if damage == "open":
        if os.name != "posix":
            pytest.skip("no file modes here")
        first.file.chmod(0o644)
    else:
        text = first.file.read_bytes()
        first.file.write_bytes(text[:200] if damage == "cut" else b"\0" * 50)
    second = get_certificate(("localhost",), tmp_path)
    assert second.fingerprint != first.fingerprint
    assert os.name != "posix" or second.file.stat().st_mode & 0o077 == 0


def test_a_folder_that_can_not_be_written_is_said(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(SourceError, match=SWITCH):
        get_certificate(("localhost",), tmp_path / "file")


def test_the_names_are_those_that_a_headset_types():
    for host in ("127.0.0.1", "localhost", "::1"):
        assert addresses.names_of(host) == addresses.LOCAL
        assert addresses.page_addresses(host, 8443) == ("https://localhost:8443",)
    lan = addresses.lan_addresses()
    assert set(lan) <= set(addresses.names_of("0.0.0.0"))
    assert not any(":" in address for address in lan)  # what listens there has no IPv6
    assert set(lan) <= set(addresses.lan_addresses("::"))
    assert not {"127.0.0.1", "::1"} & set(lan)
    assert addresses.names_of("192.168.7.9")[-1] == "192.168.7.9"
    assert addresses.page_addresses("2001:db8::7", 1) == ("https://[2001:db8::7]:1",)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The user's cache folder, for this module."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SWITCH, str(folder))
        yield folder


class Host:
    """A started source and its mailbox."""

    def __init__(self) -> None:
        self.mailbox = Mailbox()
        self.source = WebXr(port=0, code=CODE)
        self.source.start(self.mailbox)
        (self.address,) = self.source.addresses

    def connect(self, **changes: Any) -> Any:
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        # This client reads in a thread of its own, and with older Pythons' ssl (gh-124984) loses
        # its first request if TLS 1.3's tickets come just then. Browsers use 1.3.
        context.maximum_version = ssl.TLSVersion.TLSv1_2
        address = self.address.replace("https", "wss") + "/link"
        return client.connect(address, ssl=context, proxy=None, **changes)

    def pair(self, code: str = CODE) -> Any:
        link = self.connect()
        link.send(json.dumps({"type": "hello", "protocol": 1, "code": code}))
        return link

    def welcome(self) -> tuple[Any, int]:
        link = self.pair()
        said = json.loads(link.recv(5))
        assert said["type"] == "welcome"
        return link, said["session"]

    def arrival(self, side: Side) -> Arrival:
        assert self.mailbox.wait([side], 5.0), "no frame arrived"
        return self.mailbox.take(side)

    def state(self) -> str:
        return self.source.health().state


@pytest.fixture
def host(cache: Path) -> Iterator[Host]:
    started = Host()
    try:
        yield started
    finally:
        started.source.stop()


def close_of(link: Any) -> tuple[int, str]:
    """Code and reason with which the server closes a link."""
    with pytest.raises(closed) as caught:
        list(iter(lambda: link.recv(5), None))  # until it ends
    return caught.value.rcvd.code, caught.value.rcvd.reason


def test_hands_arrive_with_stamp_side_and_session(host):
    assert eventually(host.source.health).state == "waiting"
    eventually(lambda: "pairing code 246 810" in host.source.health().detail)
    assert host.address in host.source.health().detail
    link, session = host.welcome()
    with link:
        before = time.perf_counter()
        link.send(message(joints(-1), joints(), stamp=12.5))
        left, right = host.arrival("left"), host.arrival("right")
        assert (left.frame.stamp, right.frame.stamp) == (12.5, 12.5)
        assert left.session == right.session == session == 1
        assert before < left.received < time.perf_counter()
        assert left.frame.landmarks[-1, 0] < 0 < right.frame.landmarks[-1, 0]
        eventually(lambda: host.state() == "running")
        link.send(message(joints(), number=4))
        host.arrival("left")
        assert host.source.link.skipped == 3  # 1, 2 and 3 were never sent
        assert host.source.link.frames == 3


def test_a_page_can_stop_the_loop_and_knows_its_mode(host):
    stops: list[bool] = []
    host.mailbox.stop = lambda: stops.append(True)
    link, _ = host.welcome()
    ping = json.dumps({"type": "ping", "at": 1.0})
    link.send(ping)
    assert json.loads(link.recv(5))["mode"] == ""  # there is no loop
    host.mailbox.mode = lambda: "stopped" if stops else "tracking"
    for expected in ("tracking", "stopped"):
        link.send(ping)
        assert json.loads(link.recv(5))["mode"] == expected
        link.send(json.dumps({"type": "stop"}))
        eventually(lambda: stops)
    link.close()


def test_a_lost_headset_is_waited_for_and_comes_back_as_a_new_session(host):
    for expected in (1, 2, 3):
        link, session = host.welcome()
        assert session == expected
        link.send(message(right=joints()))
        assert host.arrival("right").session == expected
        eventually(lambda: host.state() == "running")
        if expected == 2:
            link.socket.shutdown(socket.SHUT_RDWR)  # gone without a word
        link.close()
        eventually(lambda: host.state() == "waiting")
        assert "the headset is gone" in host.source.health().detail


def test_the_newest_headset_wins_and_the_old_one_is_told(host):
    old, _ = host.welcome()
    new, session = host.welcome()
    assert session == 2
    assert close_of(old) == (4409, "another headset took over")
    new.send(message(right=joints()))
    assert host.arrival("right").session == 2
    new.close()


@pytest.mark.parametrize(
    ("first", "code"),
    [
        ({"type": "hello", "protocol": 1, "code": "000000"}, 4401),
        ({"type": "hello", "protocol": 1}, 4400),
        ({"type": "hello", "protocol": 1, "code": 246810}, 4400),
        ({"type": "hello", "protocol": 2, "code": CODE}, 4400),
        ({"type": "ping", "at": 0.0}, 4400),
    ],
)
def test_without_the_code_nobody_gets_in(host, first, code):
    with host.connect() as link:
        link.send(json.dumps(first))
        assert close_of(link)[0] == code
    with host.connect() as link:
        link.send(message(joints(), joints()))
        assert close_of(link)[0] == 4400
    assert host.mailbox.received == 0
    assert host.source.link.session == 0


def test_guessing_is_locked_out(host):
    for _ in range(PER_ADDRESS):
        assert close_of(host.pair("999999"))[0] == 4401
    assert close_of(host.pair(CODE)) == (4429, "too many wrong pairing codes: wait a minute")
    eventually(lambda: "wrong pairing codes: 6" in host.source.health().detail)


def test_messages_that_can_not_be_read_are_counted_and_the_link_holds(host):
    link, _ = host.welcome()
    bad = (b"nonsense", "nonsense", "[" * 1500, "[1]", '{"type": "ping"}', b"XRH1" + b"\0" * 30)
    for item in bad:
        link.send(item)
    link.send(message(right=joints()))
    host.arrival("right")
    assert host.source.link.bad == len(bad)
    eventually(lambda: f"messages that can't be read: {len(bad)}" in host.source.health().detail)
    for _ in range(50):
        link.send(b"nonsense")
    assert close_of(link)[0] == 4400


def test_a_message_that_is_too_long_ends_the_link(host):
    link, _ = host.welcome()
    link.send(b"\0" * 4000)
    assert close_of(link)[0] == 1009
    eventually(lambda: host.source.link.bad == 1)
    eventually(lambda: host.state() == "waiting")


def test_pings_bring_the_clock_of_the_host_and_the_state_of_the_link(host):
    link, _ = host.welcome()
    before = time.perf_counter()
    ping = {"type": "ping", "at": 3.5, "round_trip": 0.004, "offset": 71.5, "tracking": True}
    link.send(json.dumps(ping))
    pong = json.loads(link.recv(5))
    assert (pong["type"], pong["at"]) == ("pong", 3.5)
    assert before < pong["host"] < time.perf_counter()
    state = host.source.link
    assert (state.round_trip_s, state.clock_offset_s, state.tracking) == (0.004, 71.5, True)
    eventually(lambda: "no hands are sent" in host.source.health().detail)
    link.send(message(right=np.full((25, 8), np.nan, "<f4")))  # a hand that is out of sight
    assert not np.isfinite(host.arrival("right").frame.landmarks).any()
    link.send(message(right=joints()))
    eventually(lambda: "round trip 4 ms" in host.source.health().detail)
    link.close()


def test_other_sites_can_not_reach_the_link(host):
    refused = pytest.importorskip("websockets.exceptions").InvalidStatus
    with pytest.raises(refused, match="403"):
        host.connect(origin="https://elsewhere.example")
    with host.connect(origin=host.address):
        pass


def fetch(address: str, context: ssl.SSLContext) -> tuple[bytes, Any]:
    opener = urllib.request.build_opener(
        urllib.request.ProxyHandler({}), urllib.request.HTTPSHandler(context=context)
    )
    with opener.open(address, timeout=60) as answer:
        return answer.read(), answer.headers


def test_the_page_is_whole_and_its_certificate_can_be_trusted(host, tmp_path):
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    page, headers = fetch(host.address, context)
    assert headers["Content-Type"].startswith("text/html")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    used = re.findall(rb'(?:src|href)="([^"]+)"', page)
    used += [b"link.js", b"hands.js", b"scene.js", b"tracking.js"]
    for name in used:
        body, headers = fetch(f"{host.address}/{name.decode()}", context)
        assert len(body) == int(headers["Content-Length"]) > 100
        assert b"http://" not in body.replace(b"http://www.w3.org/2000/svg", b"")  # no strangers
    (tmp_path / "root.pem").write_bytes(fetch(f"{host.address}/certificate.crt", context)[0])
    trusting = ssl.create_default_context(cafile=str(tmp_path / "root.pem"))
    for name in ("localhost", "127.0.0.1"):
        fetch(host.address.replace("localhost", name), trusting)
    with pytest.raises(urllib.error.HTTPError, match="404"):
        fetch(f"{host.address}/../pyproject.toml", context)


def test_the_joints_have_the_colours_of_the_other_pages(host):
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    module = fetch(f"{host.address}/colors.js", context)[0].decode()
    served = re.fullmatch(r"export const FINGER_COLORS = (.+);\n", module)
    colors = ["#{:02x}{:02x}{:02x}".format(*color) for color in json.loads(served[1])]
    assert colors == list(FINGER_COLORS)
    scene = fetch(f"{host.address}/scene.js", context)[0].decode()
    assert "import { FINGER_COLORS } from './colors.js';" in scene
    assert not re.findall(r"const FINGER\w* =", scene)  # and has none besides


def test_no_page_can_frame_it(host):
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    for path in ("/", "/no-such", "/certificate.crt"):
        try:
            _, headers = fetch(f"{host.address}{path}", context)
        except urllib.error.HTTPError as refused:
            headers = refused.headers
        assert headers["X-Frame-Options"] == "DENY", path
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"], path


def test_every_address_that_is_shown_leads_to_the_page(cache):
    source = WebXr("0.0.0.0", 0, CODE)
    source.start(Mailbox())
    try:
        eventually(lambda: all(address in source.health().detail for address in source.addresses))
        names = addresses.names_of("0.0.0.0")
        trusting = ssl.create_default_context(
            cadata=get_certificate(names, cache / "webxr").public.decode()
        )
        for address in source.addresses:
            assert b"Pairing code" in fetch(address, trusting)[0]
    finally:
        source.stop()


def test_the_certificate_serves_no_other_name(cache, tmp_path):
    from cryptography import x509

    made = get_certificate(("localhost", "192.168.1.20"), tmp_path)
    found = x509.load_pem_x509_certificate(made.public).extensions
    constraints = found.get_extension_for_class(x509.NameConstraints)
    assert constraints.critical
    permitted = constraints.value.permitted_subtrees
    assert {str(name.value) for name in permitted} == {"localhost", "192.168.1.20/32"}


def test_a_plain_http_browser_and_noise_do_not_disturb(host, capfd):
    port = int(host.address.rsplit(":", 1)[1])
    for noise in (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"\x16\x03\x01\xff\xff" + b"\0" * 50, b""):
        with socket.create_connection(("127.0.0.1", port), timeout=60) as raw:
            raw.sendall(noise)
    link, _ = host.welcome()
    link.close()
    assert capfd.readouterr() == ("", "")


def test_a_flood_of_half_open_connections_is_refused_and_the_link_lives(cache, monkeypatch):
    """Connections that never finish TLS cost memory each: beyond a few they are closed unread."""
    monkeypatch.setattr(xr_source, "_HANDSHAKE_S", 1.0)
    started = Host()
    port = int(started.address.rsplit(":", 1)[1])
    flood: list[socket.socket] = []
    try:
        link, session = started.welcome()
        flood += [socket.create_connection(("127.0.0.1", port), timeout=60) for _ in range(150)]
        # at most: on a busy machine the first of them may be over their second already
        eventually(lambda: sum(not is_closed(raw, 0.0) for raw in flood) <= xr_source.MOST_WAITING)
        waiting = [raw for raw in flood if not is_closed(raw, 0.0)]
        # the paired headset goes on meanwhile
        link.send(message(joints(-1), joints(), stamp=3.5))
        arrival = started.arrival("right")
        assert (arrival.frame.stamp, arrival.session) == (3.5, session)
        # none of them stays: each has a second for its TLS
        assert all(is_closed(raw, 5.0) for raw in waiting)
        newer, _ = started.welcome()
        newer.close()
        link.close()
    finally:
        for raw in flood:
            raw.close()
        started.source.stop()


def test_half_open_connections_lock_no_address_out(cache, monkeypatch):
    """The oldest of them make room for one that goes on, long before their time is over."""
    monkeypatch.setattr(xr_source, "_HANDSHAKE_S", 120.0)
    started = Host()
    port = int(started.address.rsplit(":", 1)[1])
    flood: list[socket.socket] = []
    try:
        for _ in range(6):
            flood += [socket.create_connection(("127.0.0.1", port), timeout=60) for _ in range(10)]
            time.sleep(0.05)
        links = [started.pair() for _ in range(3)]
        assert json.loads(links[-1].recv(5))["type"] == "welcome"
        assert sum(not is_closed(raw, 0.0) for raw in flood) <= xr_source.MOST_WAITING
        for link in links:
            link.close()
    finally:
        for raw in flood:
            raw.close()
        started.source.stop()


def is_closed(raw: socket.socket, seconds: float = 5.0) -> bool:
    """Whether the other end has closed a connection, or does within a time."""
    raw.settimeout(seconds)
    try:
        return raw.recv(1) == b""
    except (TimeoutError, BlockingIOError):
        return False
    except ConnectionResetError:
        return True


def test_a_listener_has_room_again_when_a_connection_ends():
    with LimitedListener(listen("127.0.0.1", 0), most=3, most_of_one=2, most_waiting=2) as door:
        door.settimeout(0.2)
        where = door.getsockname()
        clients = [socket.create_connection(where) for _ in range(3)]
        inside = [door.accept()[0] for _ in range(2)]
        with pytest.raises(TimeoutError):
            door.accept()
        assert is_closed(clients[2])
        assert not is_closed(clients[0], 0.05)
        inside[0].close()
        inside[0].close()  # counts once
        clients.append(socket.create_connection(where))
        inside.append(door.accept()[0])
        clients.append(socket.create_connection(where))
        with pytest.raises(TimeoutError):
            door.accept()
        for end in (*clients, *inside):
            end.close()


def test_of_connections_that_wait_the_oldest_makes_room():
    with LimitedListener(listen("127.0.0.1", 0), 9, 9, most_waiting=2) as door:
        where = door.getsockname()
        clients, inside = [], []
        for k in range(4):
            clients.append(socket.create_connection(where))
            connection, address = door.accept()
            inside.append(connection)
            if k == 0:
                door.served(address)  # and stays, however many come
        assert [is_closed(each, 0.1) for each in clients] == [False, True, False, False]
        inside[2].close()  # waits no longer
        clients.append(socket.create_connection(where))
        inside.append(door.accept()[0])
        assert [is_closed(each, 0.1) for each in clients] == [False, True, True, False, False]
        for end in (*clients, *inside):
            end.close()


def test_stopping_tells_the_headset_and_frees_the_port(cache):
    started = Host()
    port = int(started.address.rsplit(":", 1)[1])
    with pytest.raises(SourceError, match="name another port"):
        WebXr(port=port).start(Mailbox())
    link, _ = started.welcome()
    started.source.stop()
    started.source.stop()
    assert started.state() == "ended"
    assert close_of(link)[0] == 1001  # going away: the page tries again
    again = WebXr(port=port)
    again.start(Mailbox())
    again.stop()


def test_settings_come_from_a_text():
    assert build_source(f"webxr:0.0.0.0,port=9000,code={CODE}") == WebXr("0.0.0.0", 9000, CODE)
    assert build_source("webxr").label == "webxr 127.0.0.1:8443"  # nobody else gets in by default
    assert CODE not in repr(WebXr(code=CODE))
    with pytest.raises(ConfigError, match="port"):
        WebXr(port=70000)
    with pytest.raises(SourceError, match="can't listen"):
        WebXr(host="203.0.113.7", port=0).start(Mailbox())


@pytest.fixture(scope="module")
def emulator(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The script of the emulated headset, or a skip."""
    cache = getattr(request.config, "cache", None)  # may be switched off
    try:
        return fetch_emulator(
            tmp_path_factory.mktemp("iwer") if cache is None else Path(cache.mkdir("iwer"))
        )
    except NoEmulator as why:
        pytest.skip(str(why))


def text(page: Any, part: str) -> str:
    return str(page.inner_text(f"#{part}"))


def bones(landmarks: np.ndarray) -> np.ndarray:
    """(20,) lengths [m]."""
    parent, child = np.transpose(BONES)
    return np.asarray(np.linalg.norm(landmarks[child] - landmarks[parent], axis=-1))


def palm_side(landmarks: np.ndarray) -> float:
    """Positive where the fingers of a right hand, negative where those of a left one bend."""
    normal = np.cross(landmarks[5] - landmarks[0], landmarks[17] - landmarks[0])
    return float((landmarks[[8, 12, 16, 20]] - landmarks[[5, 9, 13, 17]]).sum(0) @ normal)


COUNT_PICTURES = """
window.pictures = 0;
window.began = performance.now() / 1000;
const count = () => { window.pictures += 1; window.requestAnimationFrame(count); };
count();
"""


@pytest.mark.browser
def test_a_headset_streams_both_hands(host, chromium, emulator):
    page = new_headset(chromium, emulator)
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    page.goto(host.address)
    assert page.locator("#start").is_disabled()

    page.fill("#code", "000000")
    page.click("#pair")
    page.get_by_text("not the one in the terminal").wait_for()
    assert text(page, "state") == "refused"
    page.fill("#code", "246 810")
    page.click("#pair")
    page.get_by_text("linked", exact=True).wait_for()
    assert page.locator("#pairing").is_hidden()
    page.click("#start")
    host.arrival("right")
    host.arrival("left")

    seen: dict[str, list[Arrival]] = {"left": [], "right": []}
    begin = time.perf_counter()
    sides: tuple[Side, ...] = ("left", "right")

    page.evaluate(COUNT_PICTURES)
    while time.perf_counter() < begin + 1.5 or min(map(len, seen.values())) < 20:
        assert time.perf_counter() < begin + PATIENCE_S, {side: len(seen[side]) for side in sides}
        host.mailbox.wait(sides, 0.1)
        for side in sides:
            if (arrival := host.mailbox.take(side)) is not None:
                seen[side].append(arrival)
    # Of the pictures that the browser had time for.
    pictures, lasted = page.evaluate("[window.pictures, performance.now() / 1000 - window.began]")
    assert min(map(len, seen.values())) >= 0.5 * pictures, pictures
    for side, sign in (("left", -1), ("right", 1)):
        arrivals = seen[side]
        stamps = np.array([a.frame.stamp for a in arrivals])
        assert (np.diff(stamps) > 0).all()
        hands = np.stack([a.frame.landmarks for a in arrivals])
        valid = np.stack([a.frame.valid for a in arrivals])
        check_units(hands, valid, side)
        assert all(a.frame.side == side and a.session == 1 for a in arrivals)
        assert valid.all()
        for hand in hands:
            assert bones(hand).min() > 0.01
            assert bones(hand).max() < 0.12
        assert (sign * hands[:, 0, 0] > 0.05).all()  # each on its own side of the headset
        gap = np.linalg.norm(hands[:, 4] - hands[:, 8], axis=-1)
        assert gap.min() < 0.02 < 0.035 < gap.max()  # it pinches and opens
        assert sign * palm_side(hands[gap.argmin()]) > 0
        turns = np.stack([a.frame.orientations for a in arrivals])
        np.testing.assert_allclose(np.linalg.norm(turns, axis=-1), 1.0, atol=1e-6)

    state = host.source.link
    assert 0 <= state.round_trip_s < 1.0
    late = [a.received - a.frame.stamp - state.clock_offset_s for a in seen["right"]]
    assert abs(np.median(late)) < state.round_trip_s + 0.2  # the offset is that of the clocks
    assert text(page, "left") == text(page, "right") == "seen"
    assert float(text(page, "trip")) > 0
    assert int(text(page, "rate")) > 0.1 * pictures / lasted

    page.evaluate("headset.hands.left.connected = false")
    page.locator("#left", has_text="not seen").wait_for()
    host.mailbox.take("left")
    host.arrival("right")
    assert host.mailbox.take("left") is None
    page.evaluate("document.querySelector('#start').click()")  # the headset's view lies above it
    page.locator("#start", has_text="Start").wait_for()
    eventually(lambda: "press Start" in host.source.health().detail)
    assert [p for p in problems if "WebSocket" not in p] == []
    page.context.close()
    eventually(lambda: "the headset is gone" in host.source.health().detail)


def red(page: Any, low: float = 0.0, high: float = 1.0) -> float:
    """Share of strongly red pixels between two heights of the picture, from above."""
    shot = picture(page, 480, 640)[int(640 * low) : int(640 * high)]
    return float(((shot[..., 0] > 120) & (shot[..., 1:].max(axis=-1) < 60)).mean())


@pytest.mark.browser
def test_a_stop_is_shown_inside_the_headset_and_can_be_pressed_there(host, chromium, emulator):
    mode, stops = ["tracking"], []
    host.mailbox.mode = lambda: mode[0]
    host.mailbox.stop = lambda: stops.append(mode[0])
    page = new_headset(chromium, emulator)
    page.goto(f"{host.address}/#{CODE}")
    page.get_by_text("linked", exact=True).wait_for()
    page.click("#stop")  # of the page itself
    eventually(lambda: len(stops) >= 3)  # and again, until it is confirmed
    page.locator("#state", has_text="Stopping").wait_for()
    mode[0] = "stopped"
    page.locator("#state", has_text="STOPPED").wait_for()
    assert "press U at the computer to release" in text(page, "hint")
    mode[0] = "tracking"
    page.get_by_text("linked", exact=True).wait_for()
    page.wait_for_timeout(500)
    stops.clear()

    page.select_option("#mode", "immersive-vr")
    page.click("#start")
    page.evaluate("window.moving = false")
    page.evaluate("headset.hands.right.position.set(0.2, 1.2, -0.35)")
    host.arrival("right")
    eventually(lambda: red(page, high=0.5) > 0.002)  # the disc, above
    assert red(page, low=0.5) < 0.001
    mode[0] = "stopped"
    eventually(lambda: red(page, low=0.5) > 0.01)  # the board, below, says STOPPED
    mode[0] = "tracking"
    eventually(lambda: red(page, low=0.5) < 0.001)
    assert not stops

    def put(x: float, y: float, z: float) -> None:
        """Move the tip of the right index finger to a place."""
        host.mailbox.take("right")
        tip = host.arrival("right").frame.landmarks[8]
        at = page.evaluate("['x', 'y', 'z'].map((k) => headset.hands.right.position[k])")
        x, y, z = np.array([x, y, z]) + at - tip
        page.evaluate(f"headset.hands.right.position.set({x}, {y}, {z})")

    head = page.evaluate("['x', 'y', 'z'].map((k) => headset.position[k])")
    put(head[0], head[1] + 0.12, head[2] - 0.2)  # not far enough
    page.wait_for_timeout(600)
    assert not stops
    put(head[0], head[1] + 0.12, head[2] - 0.4)
    eventually(lambda: stops)
    mode[0] = "stopped"
    page.wait_for_timeout(600)
    count, mode[0] = len(stops), "tracking"  # released, with the finger still there
    page.wait_for_timeout(600)
    assert len(stops) == count
    page.context.close()


@pytest.mark.browser
def test_the_page_comes_back_by_itself(cache, chromium, emulator):
    first = Host()
    port = int(first.address.rsplit(":", 1)[1])
    page = new_headset(chromium, emulator, 390, 844)
    page.goto(f"{first.address}/#{CODE}")
    page.get_by_text("linked", exact=True).wait_for()
    assert CODE not in page.url  # it is not left lying in the address
    page.click("#start")
    first.arrival("right")
    first.source.stop()
    page.get_by_text("link lost", exact=True).wait_for()

    mailbox = Mailbox()
    second = WebXr(port=port, code=CODE)
    second.start(mailbox)
    try:
        assert mailbox.wait(["right"], 15.0)  # paired again, and still tracking
        page.get_by_text("linked", exact=True).wait_for()
        other = new_headset(chromium, emulator)
        told = page.get_by_text("Another headset took over")
        paired = second.link.session  # more than 1 if a busy machine made the page try twice
        for _ in range(3):  # it may keep the other from connecting, too: people try again
            other.goto("about:blank")
            other.goto(f"{first.address}/#{CODE}")
            if shown(told, 15.0):
                break
        told.wait_for()
        taken = second.link.session
        assert taken > paired
        page.wait_for_timeout(700)
        assert second.link.session == taken  # it does not fight back
    finally:
        second.stop()
        for opened in (page, other):
            opened.context.close()


def shown(found: Any, seconds: float) -> bool:
    """Whether something comes to be visible in time."""
    try:
        found.wait_for(timeout=1e3 * seconds)
    except Exception as error:
        if type(error).__name__ != "TimeoutError":
            raise
        return False
    return True


@pytest.mark.browser
def test_a_browser_without_a_headset_is_told_and_a_phone_has_room(host, chromium):
    context = chromium.new_context(ignore_https_errors=True, viewport={"width": 360, "height": 740})
    page = context.new_page()
    page.add_init_script("Object.defineProperty(Navigator.prototype, 'xr', {value: undefined})")
    page.goto(host.address)
    page.get_by_text("This browser has no WebXR").wait_for()
    page.fill("#code", CODE)
    page.keyboard.press("Enter")
    page.get_by_text("linked", exact=True).wait_for()
    assert page.locator("#start").is_disabled()
    page.get_by_text("It does not work").click()
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    context.close()


@pytest.mark.browser
def test_a_headset_that_gives_no_hands_is_told_why(host, chromium, emulator):
    page = new_headset(chromium, emulator)
    page.goto(f"{host.address}/#{CODE}")
    page.get_by_text("linked", exact=True).wait_for()
    refuse = "async () => { throw new DOMException('no', 'NotAllowedError'); }"
    page.evaluate(f"() => {{ navigator.xr.requestSession = {refuse}; }}")
    page.click("#start")
    page.get_by_role("alert").get_by_text("Turn hand tracking on").wait_for()
    assert host.mailbox.received == 0
    page.context.close()


def test_an_address_that_no_headset_can_open_comes_with_what_to_give():
    here = describe(
        LinkState(), addresses.page_addresses("127.0.0.1", 8443), Pairing("AB12CD")
    ).detail
    assert "https://localhost:8443" in here
    assert "webxr:0.0.0.0" in here
    there = describe(LinkState(), ("https://192.168.1.20:8443",), Pairing("AB12CD")).detail
    assert "0.0.0.0" not in there

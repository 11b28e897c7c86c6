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
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_page import picture
from emulated_headset import new_headset, pair
from live_time import PATIENCE_S
from live_time import until as eventually

from smooth_operator.errors import ConfigError, RecordingError, SourceError
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
    Pairing,
    read_packet,
)
from smooth_operator.teleop.sources.webxr.source import SWITCH, VALID, get_certificate
from smooth_operator.types import Side
from smooth_operator.web import addresses
from smooth_operator.web.listening import LimitedListener, listen

pytest.importorskip("cryptography", reason="the extra webxr is not installed")
client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
websocket_errors = pytest.importorskip("websockets.exceptions")

CODE = "246810"
SIDES: tuple[Side, ...] = ("left", "right")


def joints(sign: float = 1.0) -> np.ndarray:
    """(25, 8) joints with their number as x [cm], one quaternion, and a radius of 1 cm."""
    hand = np.zeros((25, 8), "<f4")
    hand[:, 0] = sign * 0.01 * np.arange(25)
    hand[:, 3:7] = 0.5, -0.5, 0.5, 0.5
    hand[:, 7] = 0.01
    return hand


def message(
    left: np.ndarray | None = None, right: np.ndarray | None = None, *, stamp: float = 1.0
) -> bytes:
    mask = (left is not None) + 2 * (right is not None)
    body = b"".join(hand.tobytes() for hand in (left, right) if hand is not None)
    return HEADER.pack(b"XRH1", 0, stamp, mask, 0) + body


def test_joints_become_landmarks_in_our_order_and_quaternions_ours():
    packet = read_packet(message(joints(-1), joints(), stamp=2.5))
    assert [frame.side for frame in packet.frames] == ["left", "right"]
    for frame, sign in zip(packet.frames, (-1, 1), strict=True):
        assert frame.stamp == 2.5
        np.testing.assert_allclose(frame.landmarks[:, 0], sign * 0.01 * np.array(FROM_WEBXR_25))
        np.testing.assert_allclose(
            frame.metacarpals[:, 0], sign * 0.01 * np.array(METACARPALS_WEBXR_25)
        )
        np.testing.assert_allclose(frame.orientations, np.tile([0.5, 0.5, -0.5, 0.5], (21, 1)))
        assert frame.valid.all()
    assert read_packet(message()).frames == ()  # a moment without hands
    assert len(message(joints(), joints())) == MAX_BYTES


def test_what_the_headset_does_not_see_is_nan_and_never_a_guess():
    hand = joints()
    hand[2] = np.nan  # thumb MCP
    hand[6, 1] = np.inf  # index MCP
    hand[9, 0] = 1e6  # index tip, a thousand kilometres away
    hand[11, 3:7] = 0.0  # middle MCP without an orientation
    (frame,) = read_packet(message(right=hand)).frames
    assert np.flatnonzero(~frame.valid).tolist() == [2, 5, 8]
    assert np.isnan(frame.landmarks[[2, 5, 8]]).all()
    assert np.flatnonzero(np.isnan(frame.orientations).any(-1)).tolist() == [2, 9]


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
        HEADER.pack(b"XRH1", 0, 0.0, 6, 0) + joints().tobytes(),  # a left controller, a right hand
        HEADER.pack(b"XRH1", 0, 0.0, 17, 0) + joints().tobytes(),
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


def test_wrong_codes_lock_an_address_and_then_all():
    now = 0.0
    pairing = Pairing(CODE, lambda: now)
    assert [pairing.check("000000", "a") for _ in range(PER_ADDRESS)] == ["wrong"] * PER_ADDRESS
    assert pairing.check(CODE, "a") == "locked"  # or guessing would go on behind the lock
    assert pairing.check(CODE, "b") == "paired"  # the operator at another address
    for k in range(IN_ALL):
        pairing.check("000000", f"c{k}")
    assert pairing.check(CODE, "b") == "locked"
    now = WINDOW + 1
    assert pairing.check(CODE, "a") == "paired"
    assert pairing.refused > IN_ALL


def test_a_certificate_is_private_and_used_again_until_it_expires(tmp_path):
    from cryptography import x509

    folder, now = tmp_path / "cache", datetime.datetime.now(datetime.UTC)
    first = get_certificate(addresses.LOCAL, folder, now)
    assert b"PRIVATE" in first.file.read_bytes()
    assert b"PRIVATE" not in first.public
    if os.name == "posix":
        assert first.file.stat().st_mode & 0o777 == 0o600
        assert folder.stat().st_mode & 0o777 == 0o700
    other = get_certificate(("localhost", "192.168.1.20"), folder)
    assert other.fingerprint != first.fingerprint
    extensions = x509.load_pem_x509_certificate(other.public).extensions
    constraints = extensions.get_extension_for_class(x509.NameConstraints)
    assert constraints.critical  # it serves no other name
    permitted = {str(name.value) for name in constraints.value.permitted_subtrees}
    assert permitted == {"localhost", "192.168.1.20/32"}
    late = now + VALID - datetime.timedelta(days=2)
    assert get_certificate(addresses.LOCAL, folder, late) == first  # back on the first network
    after = get_certificate(addresses.LOCAL, folder, late + datetime.timedelta(days=1.5))
    assert after.fingerprint != first.fingerprint
    assert after.expires > first.expires
    (tmp_path / "file").touch()
    with pytest.raises(SourceError, match=SWITCH):  # a folder that can't be written is named
        get_certificate(addresses.LOCAL, tmp_path / "file")


@pytest.mark.parametrize("damage", ["cut", "open"])
def test_a_damaged_or_open_certificate_is_replaced(tmp_path, damage):
    first = get_certificate(("localhost",), tmp_path)
    if damage == "cut":
        first.file.write_bytes(first.file.read_bytes()[:200])
    elif os.name == "posix":
        first.file.chmod(0o644)
    else:
        pytest.skip("no file modes here")
    second = get_certificate(("localhost",), tmp_path)
    assert second.fingerprint != first.fingerprint
    assert os.name != "posix" or second.file.stat().st_mode & 0o077 == 0


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The user's cache folder, for this module."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SWITCH, str(folder))
        yield folder


def trusting_anyone() -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


class Host:
    """A started source and its mailbox."""

    def __init__(self, pulses: bool = False) -> None:
        self.mailbox = Mailbox()
        self.source = WebXr(port=0, code=CODE)
        if pulses:
            self.source.expect_pulses()
        self.source.start(self.mailbox)
        (self.address,) = self.source.addresses
        self.port = int(self.address.rsplit(":", 1)[1])

    def connect(self, **changes: Any) -> Any:
        context = trusting_anyone()
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
        answer = json.loads(link.recv(PATIENCE_S))
        assert answer["type"] == "welcome"
        return link, answer["session"]

    def raw(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S)

    def arrival(self, side: Side) -> Arrival:
        assert self.mailbox.wait([side], PATIENCE_S), "no frame arrived"
        return self.mailbox.take(side)

    def says(self, words: str) -> None:
        eventually(lambda: words in self.source.health().detail)


@contextmanager
def hosting(pulses: bool = False) -> Iterator[Host]:
    started = Host(pulses)
    try:
        yield started
    finally:
        started.source.stop()


@pytest.fixture
def host(cache: Path) -> Iterator[Host]:
    with hosting() as started:
        yield started


def close_of(link: Any) -> tuple[int, str]:
    """Code and reason with which the server closes a link."""
    with pytest.raises(websocket_errors.ConnectionClosed) as caught:
        list(iter(lambda: link.recv(PATIENCE_S), None))  # until it ends
    return caught.value.rcvd.code, caught.value.rcvd.reason


def test_hands_arrive_with_stamp_side_and_session(host):
    host.says("pairing code 246 810")
    assert host.source.health().state == "waiting"
    assert host.address in host.source.health().detail
    assert "webxr:0.0.0.0" in host.source.health().detail  # this address serves this machine alone
    link, session = host.welcome()
    before = time.perf_counter()
    link.send(message(joints(-1), joints(), stamp=12.5))
    left, right = host.arrival("left"), host.arrival("right")
    assert (left.frame.stamp, right.frame.stamp) == (12.5, 12.5)
    assert left.session == right.session == session == 1
    assert before < left.received < time.perf_counter()
    assert left.frame.landmarks[-1, 0] < 0 < right.frame.landmarks[-1, 0]
    eventually(lambda: host.source.health().state == "running")
    link.close()


def test_pings_bring_clock_mode_and_state_and_a_page_can_stop_the_loop(host):
    stops: list[bool] = []
    host.mailbox.stop = lambda: stops.append(True)
    link, _ = host.welcome()

    def pong(**changes: Any) -> Any:
        link.send(json.dumps({"type": "ping", "at": 3.5, **changes}))
        return json.loads(link.recv(PATIENCE_S))

    before = time.perf_counter()
    answer = pong(round_trip=0.004, offset=71.5, tracking=True)
    assert (answer["type"], answer["at"], answer["mode"]) == ("pong", 3.5, "")  # there is no loop
    assert before < answer["host"] < time.perf_counter()
    state = host.source.link
    assert (state.round_trip_s, state.clock_offset_s, state.tracking) == (0.004, 71.5, True)
    host.says("it sends no hands")
    link.send(message(right=np.full((25, 8), np.nan, "<f4")))  # a hand that is out of sight
    assert not np.isfinite(host.arrival("right").frame.landmarks).any()
    link.send(message(right=joints()))
    host.says("round trip 4 ms")
    host.mailbox.mode = lambda: "stopped" if stops else "tracking"
    assert pong()["mode"] == "tracking"
    link.send(json.dumps({"type": "stop"}))
    assert pong()["mode"] == "stopped"
    link.close()


def test_a_lost_headset_comes_back_as_a_new_session_and_the_newest_wins(host):
    for expected in (1, 2):
        link, session = host.welcome()
        assert session == expected
        link.send(message(right=joints()))
        assert host.arrival("right").session == expected
        eventually(lambda: host.source.health().state == "running")
        if expected == 2:
            link.socket.shutdown(socket.SHUT_RDWR)  # lost without a close
        link.close()
        host.says("the headset has disconnected")
        assert host.source.health().state == "waiting"
    old, _ = host.welcome()
    new, session = host.welcome()
    assert session == 4
    assert close_of(old) == (4409, "another headset took over")
    new.send(message(right=joints()))
    assert host.arrival("right").session == 4
    new.close()


@pytest.mark.parametrize(
    ("first", "code"),
    [
        ({"type": "hello", "protocol": 1, "code": "000000"}, 4401),
        ({"type": "hello", "protocol": 1}, 4400),
        ({"type": "hello", "protocol": 1, "code": 246810}, 4400),
        ({"type": "hello", "protocol": 2, "code": CODE}, 4400),
        ({"type": "ping", "at": 0.0}, 4400),
        (message(joints(), joints()), 4400),
    ],
)
def test_without_the_code_nobody_gets_in(host, first, code):
    with host.connect() as link:
        link.send(first if isinstance(first, bytes) else json.dumps(first))
        assert close_of(link)[0] == code
    assert host.mailbox.received == 0
    assert host.source.link.session == 0


def test_guessing_is_locked_out(host):
    for _ in range(PER_ADDRESS):
        assert close_of(host.pair("999999"))[0] == 4401
    assert close_of(host.pair(CODE))[0] == 4429
    host.says("wrong pairing codes: 6")


def test_unreadable_messages_are_counted_and_too_many_or_too_long_ones_end_the_link(host):
    link, _ = host.welcome()
    bad = (b"nonsense", "nonsense", "[" * 1500, "[1]", '{"type": "ping"}', b"XRH1" + b"\0" * 30)
    for item in bad:
        link.send(item)
    link.send(message(right=joints()))
    host.arrival("right")
    assert host.source.link.bad == len(bad)
    host.says(f"messages that can't be read: {len(bad)}")
    for _ in range(50):
        link.send(b"nonsense")
    assert close_of(link)[0] == 4400
    count = host.source.link.bad
    link, _ = host.welcome()
    link.send(b"\0" * 4000)
    assert close_of(link)[0] == 1009
    eventually(lambda: host.source.link.bad == count + 1)
    eventually(lambda: host.source.health().state == "waiting")


def fetch(address: str, context: ssl.SSLContext) -> tuple[bytes, Any]:
    """Body and headers of an answer, also of an error."""
    opener = urllib.request.build_opener(
        urllib.request.ProxyHandler({}), urllib.request.HTTPSHandler(context=context)
    )
    try:
        with opener.open(address, timeout=PATIENCE_S) as answer:
            return answer.read(), answer.headers
    except urllib.error.HTTPError as refused:
        return b"%d" % refused.code, refused.headers


def test_the_page_is_whole_and_its_certificate_can_be_trusted(host, tmp_path):
    context = trusting_anyone()
    page, headers = fetch(host.address, context)
    assert headers["Content-Type"].startswith("text/html")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    names = re.findall(rb'(?:src|href)="([^"]+)"', page)
    names += [b"link.js", b"hands.js", b"scene.js", b"tracking.js"]
    for name in names:
        body, headers = fetch(f"{host.address}/{name.decode()}", context)
        assert len(body) == int(headers["Content-Length"]) > 100
        assert b"http://" not in body.replace(b"http://www.w3.org/2000/svg", b"")  # no strangers
    (tmp_path / "root.pem").write_bytes(fetch(f"{host.address}/certificate.crt", context)[0])
    trusting = ssl.create_default_context(cafile=str(tmp_path / "root.pem"))
    for name in ("localhost", "127.0.0.1"):
        assert fetch(host.address.replace("localhost", name), trusting)[0] == page
    assert fetch(f"{host.address}/../pyproject.toml", context)[0] == b"404"
    for path in ("/", "/no-such", "/certificate.crt"):  # no page can frame it
        headers = fetch(f"{host.address}{path}", context)[1]
        assert headers["X-Frame-Options"] == "DENY", path
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"], path
    # the joints have the colours of the other pages
    module = fetch(f"{host.address}/colors.js", context)[0].decode()
    served = re.fullmatch(r"export const FINGER_COLORS = (.+);\n", module)
    colors = ["#{:02x}{:02x}{:02x}".format(*color) for color in json.loads(served[1])]
    assert colors == list(FINGER_COLORS)


@contextmanager
def closing(sockets: list[socket.socket]) -> Iterator[None]:
    try:
        yield
    finally:
        for each in sockets:
            each.close()


def is_closed(raw: socket.socket, seconds: float = 0.0) -> bool:
    """True if the other end has closed a connection, or does so within a time."""
    raw.settimeout(seconds)
    try:
        return raw.recv(1) == b""
    except (TimeoutError, BlockingIOError):
        return False
    except ConnectionResetError:
        return True


def test_a_flood_of_half_open_connections_is_refused_and_the_link_lives(cache, monkeypatch):
    """Connections that never finish TLS cost memory, so most of them are closed unread."""
    monkeypatch.setattr(xr_source, "_HANDSHAKE_S", 1.0)
    flood: list[socket.socket] = []
    with hosting() as started, closing(flood):
        link, session = started.welcome()
        flood += [started.raw() for _ in range(150)]
        # at most: on a busy machine the first of them may be over their second already
        eventually(lambda: sum(not is_closed(raw) for raw in flood) <= xr_source.MOST_WAITING)
        link.send(message(joints(-1), joints(), stamp=3.5))  # the paired headset goes on
        arrival = started.arrival("right")
        assert (arrival.frame.stamp, arrival.session) == (3.5, session)
        assert all(is_closed(raw, PATIENCE_S) for raw in flood)  # each has a second for its TLS
        started.welcome()[0].close()
        link.close()


def test_half_open_connections_lock_no_address_out(cache, monkeypatch):
    """The oldest of them make room for one that goes on, long before their time is over."""
    monkeypatch.setattr(xr_source, "_HANDSHAKE_S", 2 * PATIENCE_S)
    flood: list[socket.socket] = []
    with hosting() as started, closing(flood):
        flood += [started.raw() for _ in range(60)]

        def welcomed() -> bool:
            """Tried as by the page, which comes again if the server has not made room yet."""
            try:
                started.welcome()[0].close()
            except OSError:
                return False
            return True

        eventually(welcomed, 60)
        assert sum(not is_closed(raw) for raw in flood) <= xr_source.MOST_WAITING


def test_a_listener_has_room_again_when_a_connection_ends():
    sockets: list[socket.socket] = []
    with LimitedListener(listen("127.0.0.1", 0), 9, 2, most_waiting=9) as door, closing(sockets):
        door.settimeout(0.2)

        def knock() -> socket.socket:
            sockets.append(socket.create_connection(door.getsockname()))
            sockets.append(door.accept()[0])
            return sockets[-1]

        inside = [knock() for _ in range(2)]
        for _ in range(2):
            with pytest.raises(TimeoutError):
                knock()
            assert is_closed(sockets[-1], PATIENCE_S)
            inside[0].close()
            inside[0].close()  # counts once
            inside[0] = knock()


def test_of_connections_that_wait_the_oldest_makes_room():
    clients: list[socket.socket] = []
    inside: list[socket.socket] = []
    with (
        LimitedListener(listen("127.0.0.1", 0), 9, 9, most_waiting=2) as door,
        closing(clients),
        closing(inside),
    ):

        def knock() -> Any:
            clients.append(socket.create_connection(door.getsockname()))
            connection, address = door.accept()
            inside.append(connection)
            return address

        door.served(knock())  # this one stays
        for _ in range(3):
            knock()
        assert [is_closed(each, 0.1) for each in clients] == [False, True, False, False]
        inside[2].close()  # waits no longer
        knock()
        assert [is_closed(each, 0.1) for each in clients] == [False, True, True, False, False]


def test_stopping_tells_the_headset_and_frees_the_port(host):
    with pytest.raises(SourceError, match="name another port"):
        WebXr(port=host.port).start(Mailbox())
    link, _ = host.welcome()
    host.source.stop()
    host.source.stop()
    assert host.source.health().state == "ended"
    assert close_of(link)[0] == 1001  # going away: the page tries again
    again = WebXr(port=host.port)
    again.start(Mailbox())
    again.stop()


@pytest.mark.parametrize("code", ["12345", "12 34-5", "ünïcöde", "x" * 65])
def test_a_useless_code_is_refused(code):
    with pytest.raises(ConfigError, match="6 to 64 letters and digits"):
        WebXr(code=code)


def test_settings_come_from_a_text():
    assert build_source(f"webxr:0.0.0.0,port=9000,code={CODE}") == WebXr("0.0.0.0", 9000, CODE)
    assert build_source("webxr").label == "webxr 127.0.0.1:8443"  # nobody else gets in by default
    assert CODE not in repr(WebXr(code=CODE))
    with pytest.raises(ConfigError, match="port"):
        WebXr(port=70000)
    with pytest.raises(SourceError, match="can't listen"):
        WebXr(host="203.0.113.7", port=0).start(Mailbox())


def text(page: Any, part: str) -> str:
    return str(page.inner_text(f"#{part}"))


def shows(page: Any, state: str) -> None:
    page.locator("#state", has_text=state).wait_for()


def bones(landmarks: np.ndarray) -> np.ndarray:
    """(T, 20) lengths [m]."""
    parent, child = np.transpose(BONES)
    return np.asarray(np.linalg.norm(landmarks[:, child] - landmarks[:, parent], axis=-1))


def palm_side(landmarks: np.ndarray) -> float:
    """Positive where the fingers of a right hand, negative where those of a left one bend."""
    normal = np.cross(landmarks[5] - landmarks[0], landmarks[17] - landmarks[0])
    return float((landmarks[[8, 12, 16, 20]] - landmarks[[5, 9, 13, 17]]).sum(0) @ normal)


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
    shows(page, "linked")
    assert page.locator("#pairing").is_hidden()
    page.evaluate("""() => {
      window.ask = navigator.xr.requestSession;
      navigator.xr.requestSession = async () => { throw new DOMException('', 'NotAllowedError'); };
    }""")
    page.click("#start")
    page.get_by_role("alert").get_by_text("Allow immersive mode and hand tracking").wait_for()
    page.evaluate("() => { navigator.xr.requestSession = window.ask; }")
    page.click("#start")
    host.arrival("right")
    host.arrival("left")

    seen: dict[Side, list[Arrival]] = {"left": [], "right": []}
    begin = time.perf_counter()
    while time.perf_counter() < begin + 1.5 or min(map(len, seen.values())) < 20:
        assert time.perf_counter() < begin + PATIENCE_S, {side: len(seen[side]) for side in SIDES}
        host.mailbox.wait(SIDES, 0.1)
        for side in SIDES:
            if (arrival := host.mailbox.take(side)) is not None:
                seen[side].append(arrival)
    for side, sign in (("left", -1), ("right", 1)):
        arrivals = seen[side]
        assert (np.diff([a.frame.stamp for a in arrivals]) > 0).all()
        hands = np.stack([a.frame.landmarks for a in arrivals])
        assert all(a.frame.side == side and a.session == 1 for a in arrivals)
        assert all(a.frame.valid.all() for a in arrivals)
        assert 0.01 < bones(hands).min() < bones(hands).max() < 0.12
        assert (sign * hands[:, 0, 0] > 0.05).all()  # each on its own side of the headset
        gap = np.linalg.norm(hands[:, 4] - hands[:, 8], axis=-1)
        assert gap.min() < 0.02 < 0.035 < gap.max()  # it pinches and opens
        assert sign * palm_side(hands[gap.argmin()]) > 0
        turns = np.stack([a.frame.orientations for a in arrivals])
        np.testing.assert_allclose(np.linalg.norm(turns, axis=-1), 1.0, atol=1e-6)

    state = host.source.link
    assert 0 <= state.round_trip_s < PATIENCE_S
    late = [a.received - a.frame.stamp - state.clock_offset_s for a in seen["right"]]
    assert abs(np.median(late)) < state.round_trip_s + 0.2  # the offset is that of the clocks
    assert text(page, "left") == text(page, "right") == "seen"
    assert float(text(page, "trip")) > 0
    assert int(text(page, "rate")) > 0

    page.evaluate("headset.hands.left.connected = false")
    page.locator("#left", has_text="not seen").wait_for()
    host.mailbox.take("left")
    host.arrival("right")
    assert host.mailbox.take("left") is None
    page.evaluate("document.querySelector('#start').click()")  # the headset's view lies above it
    page.locator("#start", has_text="Start").wait_for()
    host.says("press Start")
    assert [p for p in problems if "WebSocket" not in p] == []
    page.context.close()
    host.says("the headset has disconnected")


def red(page: Any, low: float = 0.0, high: float = 1.0) -> float:
    """Share of strongly red pixels between two heights of the picture, from above.

    The orange joints of a thumb don't count, also where they are dark.
    """
    shot = picture(page, 480, 640)[int(640 * low) : int(640 * high)]
    return float(((shot[..., 0] > 120) & (shot[..., 1:].max(axis=-1) < 0.3 * shot[..., 0])).mean())


class RightHand:
    """The emulated right hand of a page, at rest."""

    def __init__(self, page: Any, host: Host) -> None:
        self._page, self._host = page, host
        page.evaluate("window.moving = false; headset.hands.left.connected = false")

    def after(self, stamp: float) -> Arrival:
        """The first frame of the page after a time by its clock [s]."""
        while (arrival := self._host.arrival("right")).stamp <= stamp:
            pass
        return arrival

    def put(self, place: np.ndarray) -> None:
        """Moves the tip of the index finger to a place [m], where it stays for 0.5 s."""
        now = self._page.evaluate("performance.now() / 1000")
        by = place - self.after(now).frame.landmarks[8]
        now = self._page.evaluate(
            """([x, y, z]) => {
              const at = headset.hands.right.position;
              at.set(at.x + x, at.y + y, at.z + z);
              return performance.now() / 1000;
            }""",
            by.tolist(),
        )
        np.testing.assert_allclose(self.after(now).frame.landmarks[8], place, atol=2e-3)
        self.rest()

    def rest(self) -> None:
        """Waits until the page has handled frames of 0.5 s, as many as it has time for."""
        now = self._page.evaluate("performance.now() / 1000")
        self.after(self.after(now + 0.5).stamp)


@pytest.mark.browser
def test_controllers_beside_tracked_hands_vibrate(cache, chromium, emulator):
    """The emulated headset has actuators, but not the list of sources beside the hands."""
    with hosting(pulses=True) as host:
        host.source.pulse("right", 0.4, 0.1)  # nobody is there
        page = new_headset(chromium, emulator)
        pair(page, host.address, CODE)
        page.evaluate("""() => {
          window.pulses = [];
          const ask = navigator.xr.requestSession.bind(navigator.xr);
          navigator.xr.requestSession = async (mode, options) => {
            window.asked = options.optionalFeatures;
            const session = await ask(mode, options);
            const beside = Object.values(headset.controllers).map((each) => each.inputSource);
            for (const { handedness, gamepad } of beside) {
              gamepad.hapticActuators[0].pulse = (...values) => {
                window.pulses.push([handedness, ...values]);
                return Promise.reject(new Error('the battery is low'));
              };
            }
            Object.defineProperty(session, 'trackedSources', { value: beside });
            return session;
          };
        }""")
        host.source.pulse("right", 0.4, 0.1)  # no session yet
        page.click("#start")
        host.arrival("right")
        assert "tracked-sources" in page.evaluate("asked")
        felt = [["right", 0.4, 100], ["left", 0.25, 100], ["right", 0, 100]]

        def felt_until(number: int) -> bool:
            side, strength, _ = felt[number]
            host.source.pulse(side, strength, 0.1)  # again: it is left out while one is sent
            return [pulse for pulse, _ in groupby(page.evaluate("pulses"))] == felt[: number + 1]

        for number in range(len(felt)):
            eventually(lambda number=number: felt_until(number))
        page.context.close()


def gaps(arrival: Arrival) -> np.ndarray:
    """(4,) distances of thumb tip and fingertips [m]."""
    hand = arrival.frame.landmarks
    return np.asarray(np.linalg.norm(hand[[8, 12, 16, 20]] - hand[4], axis=1))


@pytest.mark.browser
def test_controllers_stand_for_hands_until_a_hand_appears(host, chromium, emulator):
    """Axes of the grip space as WebXR defines them, buttons as its xr-standard mapping does."""
    pressed: list[str] = []
    stops: list[bool] = []
    host.mailbox.press = pressed.append
    host.mailbox.bindings = {"x": "stop", "button:y": "stop", "button:a": "record"}
    host.mailbox.stop = lambda: stops.append(True)
    host.mailbox.mode = lambda: "stopped" if stops else "tracking"
    page = new_headset(chromium, emulator)
    # The emulator says of every pose that it is estimated, and its grip differs from its ray.
    page.add_init_script("""
        headset.primaryInputMode = 'controller';
        window.lost = false;
        Object.defineProperty(XRPose.prototype, 'emulatedPosition', { get: () => window.lost });
        for (const { inputSource } of Object.values(headset.controllers)) {
          Object.defineProperty(inputSource, 'gripSpace', { value: inputSource.targetRaySpace });
        }
    """)
    pair(page, host.address, CODE, "immersive-vr")
    page.evaluate("""() => {
      const ask = navigator.xr.requestSession.bind(navigator.xr);
      navigator.xr.requestSession = (mode, options) => {
        window.asked = options.optionalFeatures;
        return ask(mode, options);
      };
    }""")
    page.click("#start")
    host.arrival("right")
    assert "tracked-sources" in page.evaluate("asked")  # for the buttons beside tracked hands

    def after(code: str, side: Side = "right") -> Arrival:
        """The first frame that the page sends after a script."""
        stamp = page.evaluate(f"() => {{ {code}; return performance.now() / 1000; }}")
        while (arrival := host.arrival(side)).stamp <= stamp:
            pass
        return arrival

    # a vertical rod in the fist, thumb up, the arm behind: -z up, x out of the right hand's back
    place = "for (const [side, x] of [['right', 0.2], ['left', -0.2]]) {" + (
        "headset.controllers[side].position.set(x, 1.4, -0.4);"
        "headset.controllers[side].quaternion.set(Math.SQRT1_2, 0, 0, Math.SQRT1_2); }"
    )
    for side, sign in (("right", 1), ("left", -1)):
        frame = after(place, side).frame
        assert frame.side == side
        thumb, middle = frame.landmarks[4] - frame.landmarks[0], frame.landmarks[12]
        assert thumb[1] > 0.06  # up
        ahead = middle - frame.landmarks[0]
        assert ahead[2] < -0.15
        np.testing.assert_allclose(frame.landmarks[0, 1:], [1.4, -0.32], atol=0.03)
        assert sign * (frame.landmarks[0, 0] - sign * 0.2) > 0.01  # the palm is inside of the rod
        assert sign * palm_side(frame.landmarks) > 0
        assert not np.isnan(frame.T_world_wrist).any()
        assert 0.01 < bones(frame.landmarks[None]).min() < bones(frame.landmarks[None]).max() < 0.12

    assert np.isnan(after("window.lost = true").frame.landmarks).all()  # not a guess
    after("window.lost = false")

    right = "headset.controllers.right"
    opened = gaps(after(""))
    assert opened.min() > 0.06
    fist = after(f"{right}.updateButtonValue('squeeze', 1)")
    reach = np.linalg.norm(fist.frame.landmarks[[8, 12]] - fist.frame.landmarks[0], axis=1)
    assert reach[0] > 0.15 > 0.1 > reach[1]  # the grip leaves the index finger to the trigger
    after(f"{right}.updateButtonValue('squeeze', 0); {right}.updateAxis('thumbstick', 'x-axis', 1)")
    page.locator("#right", has_text="pinch").wait_for()
    page.wait_for_timeout(500)  # the fingers move to another preset
    half = gaps(after(f"{right}.updateButtonValue('trigger', 0.5)"))
    pinch = gaps(after(f"{right}.updateButtonValue('trigger', 1)"))
    assert opened[0] > half[0] > pinch[0] + 0.01
    assert pinch[0] < 0.003 < 0.05 < pinch[1:].min()
    after(f"{right}.updateAxis('thumbstick', 'x-axis', 0)")
    after(f"{right}.updateAxis('thumbstick', 'x-axis', 1)")
    page.wait_for_timeout(500)
    tripod = gaps(after(""))
    assert tripod[:2].max() < 0.015 < 0.05 < tripod[2:].min()
    assert text(page, "right") == "tripod"

    for _ in range(2):
        after(f"{right}.updateButtonValue('a-button', 1)")
        last = after(f"{right}.updateButtonValue('a-button', 0)")
    eventually(lambda: pressed == ["button:a"] * 2)
    assert not stops
    session = last.session
    page.evaluate("headset.primaryInputMode = 'hand'")  # the controllers are put down
    while (arrival := host.arrival("right")).session == session:
        pass
    page.locator("#right", has_text="seen").wait_for()
    page.evaluate("headset.primaryInputMode = 'controller'")
    while host.arrival("right").session == arrival.session:
        pass
    left = "headset.controllers.left"
    after(f"{left}.updateButtonValue('y-button', 1)")
    eventually(lambda: stops)
    assert pressed == ["button:a"] * 2
    page.context.close()


@pytest.mark.browser
def test_a_stop_is_shown_inside_the_headset_and_can_be_pressed_there(host, chromium, emulator):
    mode, stops = ["tracking"], []
    host.mailbox.mode = lambda: mode[0]
    host.mailbox.stop = lambda: stops.append(mode[0])
    page = new_headset(chromium, emulator)
    pair(page, host.address, CODE)
    page.click("#stop")  # of the page itself
    eventually(lambda: len(stops) >= 3)  # sent again until the loop confirms it
    shows(page, "Stopping")
    mode[0] = "stopped"
    shows(page, "STOPPED")
    assert "release it at the computer" in text(page, "hint")
    mode[0] = "tracking"
    shows(page, "linked")
    stops.clear()

    page.select_option("#mode", "immersive-vr")
    page.click("#start")
    hand = RightHand(page, host)
    head = np.array(page.evaluate("['x', 'y', 'z'].map((k) => headset.position[k])"))
    hand.put(head + np.array([0.2, -0.4, -0.35]))
    eventually(lambda: red(page, high=0.5) > 0.002)  # the disc, above
    eventually(lambda: red(page, low=0.5) < 0.001)
    for state, board in (("stopped", "STOPPED"), ("tracking", "")):
        mode[0] = state  # the board, below
        eventually(lambda board=board: (red(page, low=0.5) > 0.01) == bool(board))
    assert not stops

    hand.put(head + np.array([0.0, 0.12, -0.2]))  # not far enough
    assert not stops
    hand.put(head + np.array([0.0, 0.12, -0.4]))
    eventually(lambda: stops)
    mode[0] = "stopped"
    shows(page, "STOPPED")
    mode[0] = "tracking"
    shows(page, "linked")
    count = len(stops)
    hand.rest()
    assert len(stops) == count  # released, with the finger still there
    page.context.close()


@pytest.mark.browser
def test_the_page_comes_back_by_itself(cache, chromium, emulator):
    first = Host()
    page, other = (new_headset(chromium, emulator, 390, 844) for _ in range(2))
    pair(page, first.address, CODE)
    assert CODE not in page.url  # the address does not keep it
    page.click("#start")
    first.arrival("right")
    first.source.stop()
    shows(page, "link lost")

    mailbox = Mailbox()
    second = WebXr(port=first.port, code=CODE)
    second.start(mailbox)
    try:
        assert mailbox.wait(["right"], PATIENCE_S)  # paired again, and still tracking
        shows(page, "linked")
        paired = second.link.session  # more than 1 if a busy machine made the page try twice
        pair(other, first.address, CODE)
        notices = [each.get_by_text("Another headset took over") for each in (page, other)]
        # A page that lost its link on a busy machine may come back after the other one.
        eventually(lambda: any(notice.is_visible() for notice in notices))
        taken = second.link.session
        assert taken > paired
        page.wait_for_timeout(700)
        assert second.link.session == taken  # it does not fight back
    finally:
        second.stop()
        for opened in (page, other):
            opened.context.close()


@pytest.mark.browser
def test_a_browser_without_a_headset_is_told_and_a_phone_has_room(host, chromium):
    context = chromium.new_context(ignore_https_errors=True, viewport={"width": 360, "height": 740})
    page = context.new_page()
    page.clock.install()
    page.add_init_script("Object.defineProperty(Navigator.prototype, 'xr', {value: undefined})")
    page.goto(host.address)
    page.get_by_text("This browser has no WebXR").wait_for()
    page.fill("#code", CODE)
    page.keyboard.press("Enter")
    shows(page, "linked")
    assert page.locator("#start").is_disabled()
    page.get_by_text("It does not work").click()
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    # A browser that was busy for a minute has answers that it has not read yet: the link holds.
    page.clock.fast_forward(60_000)
    assert text(page, "state") == "linked"
    page.wait_for_timeout(600)
    assert host.source.link.session == 1
    context.close()


class LargePictures:
    """A view whose pictures are more than a link takes at once."""

    def look(self, number: object) -> dict[str, Any]:
        return {"type": "view", "number": number}

    def picture(self, camera: object) -> bytes:
        return bytes(8_000_000)


def test_pictures_that_a_slow_link_has_not_taken_do_not_delay_a_stop(host):
    stops: list[bool] = []
    host.mailbox.stop = lambda: stops.append(True)
    link = host.connect(max_queue=1, max_size=None)  # reads one message ahead
    link.send(json.dumps({"type": "hello", "protocol": 1, "code": CODE}))
    assert json.loads(link.recv(PATIENCE_S))["type"] == "welcome"
    link.send(json.dumps({"type": "look", "number": 5}))
    assert json.loads(link.recv(PATIENCE_S)) == {"type": "view", "number": 0}  # there is no robot
    host.source.show(LargePictures())
    for _ in range(5):
        link.send(json.dumps({"type": "picture", "camera": 0}))
    link.send(json.dumps({"type": "stop"}))
    eventually(lambda: stops)
    assert len(link.recv(PATIENCE_S)) == 8_000_000
    link.socket.shutdown(socket.SHUT_RDWR)
    link.close()

"""The live page: what its controls do, who may open it; and the page itself in a Chromium."""

import contextlib
import dataclasses
import html
import http.client
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser
from browser_page import changed, nameless, new_page, picture, settled
from hostile_texts import ATTACK, guarded_page, hostile_hand
from live_loop import Stage, panel_of, running, serving, session_of
from live_time import PATIENCE_S
from live_time import until as eventually

from smooth_operator import Retargeter, load_hand
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.planning import make_request
from smooth_operator.teleop import PageSettings, TeleopRequest, teleoperate
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.control.method_switcher import MethodSwitcher
from smooth_operator.teleop.pages.live import drawing, live_texts
from smooth_operator.teleop.pages.live.drawing import LiveDrawing, Pace
from smooth_operator.teleop.pages.live.live_page import Link, LivePage, LoopLink, PageSetup
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.live.live_session import LiveSession, RateMeter
from smooth_operator.teleop.pages.live.stop_panel import StopPanel
from smooth_operator.teleop.pages.viser_server import page_url
from smooth_operator.teleop.recording import read_log
from smooth_operator.teleop.recording.take_quality import take_quality
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig, SafetyConfig
from smooth_operator.teleop.sinks.sink import Sink, SinkRunner
from smooth_operator.teleop.sinks.tick import Contact, HandState, Mode, Tick
from smooth_operator.types import Side

RATE = 50.0


class PageStage(Stage):
    """A running loop whose state a page asks for."""

    def see(self) -> dict[str, Any]:
        return self.session.look(text=True)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageStage]:
    asked = make_request(method="joint_angle")
    retargeter = Retargeter(load_hand("mimic_p050"), config=asked.config)
    retargeter.warm_up()
    # a busy machine is late, which is no loss of the tracker here
    config = LoopConfig(rate=RATE, safety=SafetyConfig(stale_s=PATIENCE_S, lost_s=PATIENCE_S))
    source = build_source(f"synthetic:seed=4,rate={RATE},wrist=0")
    loop = TeleopLoop({"right": HandPipeline(retargeter, config)}, source, SinkRunner(), config)
    session = session_of(loop, MethodSwitcher(loop, asked), tmp_path_factory.mktemp("live"))
    with running(loop, session.watch) as run:
        eventually(lambda: run.mode() is Mode.TRACKING)
        yield PageStage(run, session)
    session.close()


def test_what_is_shown_is_what_the_loop_does(stage):
    eventually(
        lambda: stage.see()["status"]["rates"]["right"] and stage.see()["hands"]["right"]["human"]
    )
    first = len(stage.ticks) - 1
    seen = json.loads(json.dumps(stage.see()))  # as it goes through the pipe
    hand = seen["hands"]["right"]

    def shown() -> list[Tick]:
        return [
            tick
            for tick in stage.ticks[first:]
            if np.allclose(hand["positions"], tick.command.joint_positions, rtol=0, atol=1e-5)
        ]

    eventually(shown)  # the tick that is shown is kept a moment later
    assert hand["mode"] in {tick.mode.value for tick in shown()}
    assert np.asarray(hand["human"]).shape == (63,)
    assert hand["age_s"] >= 0
    status = seen["status"]
    assert 0 < status["rates"]["right"] < 1.1 * RATE
    assert hand["latched"] is None  # joint_angle has no latches
    assert hand["targets"] is None  # nor places of fingertips
    assert {"tracker", "receive", "solve", "limit", "send", "total"} == set(status["stages"])
    assert status["source"]["state"] == "running"
    controls = seen["controls"]
    assert (controls["method"], controls["preset"]) == ("joint_angle", "default")
    assert controls["presets"]["sbr"] == ["realtime", "paper"]


def test_the_trackers_rate_is_not_the_command_rate(stage):
    """The loop commands twice as often as this tracker sends; both are shown, with their names."""
    meter = RateMeter(2.0)
    assert [meter.count(k, k / 25) or meter.rate for k in range(52)][-3:] == [None, 25.0, 25.0]
    eventually(lambda: stage.see()["status"]["frame_rates"]["right"])
    status = {
        **stage.see()["status"],
        "frame_rates": {"right": 25.0, "left": 1.4},
        "rates": {"right": 100.0, "left": None},
    }
    text = plain(live_texts.summary(status))
    assert text.startswith("tracker 25 / 1.4 frames/s · commands 100 / – Hz")
    assert text.count("built-in operator") == 1  # the source is named once


class LateHand(Sink):
    """A real hand that is where the command was, 80 ms late, and has no encoder in one joint."""

    measures = True
    label = "late"

    def __init__(self) -> None:
        self.sent: list[Tick] = []
        self.names: list[str] = []

    def open(self, hands: Any, config: Any) -> None:
        self.names.append(hands["right"].name)
        self.sent.clear()

    def send(self, tick: Tick) -> None:
        self.sent.append(tick)

    def close(self) -> None: ...

    def state(self, side: Side) -> HandState | None:
        now = time.perf_counter()
        past = [tick for tick in self.sent[-200:] if tick.time <= now - 0.08]
        if not past:
            return None
        q = past[-1].command.joint_positions.copy()
        q[0] = np.nan
        contact = Contact(np.array([np.nan, 0.25, 0.0, 0.0, 0.0]), np.full(5, np.nan))
        names = past[-1].command.joint_names
        return HandState(side, "late", past[-1].time + 0.08, names, q, contact=contact)


def test_a_measured_hand_and_its_delay_are_shown(stage):
    late = LateHand()
    stage.loop.sinks.add(late)
    eventually(lambda: stage.see()["hands"]["right"]["simulated"])
    shown = stage.see()["hands"]["right"]
    assert np.isfinite(np.array(shown["simulated"], float)).all()  # unknown: as commanded
    contact = [0.0, 0.25, 0.0, 0.0, 0.0]  # unknown: none
    eventually(lambda: stage.see()["hands"]["right"]["contact"] == contact)
    eventually(lambda: stage.see()["status"]["motion_delay"].get("right"))
    status = stage.see()["status"]
    assert status["motion_delay"]["right"] == pytest.approx(0.08, abs=0.02)
    assert "command to motion" in plain(live_texts.summary(status))
    stage.loop.sinks.remove(late)


class Browser:
    """A browser that handles a message after a while, or never."""

    def __init__(self, seconds: float) -> None:
        self.local_storage, self.seconds, self.asked = self, seconds, 0

    def get_item(self, key: str, timeout: float) -> None:
        self.asked += 1
        if self.seconds > timeout:
            raise TimeoutError
        time.sleep(self.seconds)


def test_at_most_one_frame_is_on_its_way_to_a_slow_browser():
    browsers = {1: Browser(0.0), 2: Browser(0.3)}
    server: Any = SimpleNamespace(get_clients=lambda: browsers)
    pace = Pace(server)
    assert pace.delay == 0.0
    begun = time.monotonic()
    pace.wait()
    assert time.monotonic() - begun >= 0.3  # until the slowest has it
    assert 0.3 <= pace.delay < 2.0
    browsers[2].seconds = 1e9  # it hangs
    pace.wait()
    assert pace.delay == 2.0
    assert [browser.asked for browser in browsers.values()] == [2, 2]
    browsers.clear()
    pace.wait()
    assert live_texts.slow(0.1) == ""
    assert "0.4 s late" in live_texts.slow(0.41)


WRIST = {"engaged": False, "released": False, "tracked": True}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"latched": ()}, "pinch latches: none"),
        ({"latched": ("index", "ring")}, "pinch latches: index, ring"),
        ({"closes_at_mm": {"index": 24.4, "ring": 8.0}}, "pinch closes at: index 24, ring 8 mm"),
        ({"mode": "stopped", "wrist": WRIST}, "wrist: held (stopped)"),
        ({"mode": "paused", "wrist": WRIST}, "wrist: held (paused)"),
        ({"wrist": {**WRIST, "released": True}}, "wrist: held (released"),
        ({"mode": "holding", "wrist": {**WRIST, "tracked": False}}, "(the tracker lost it)"),
        ({"wrist": {**WRIST, "engaged": True}}, "tracked (no arm connected)"),
        ({"wrist": None}, "wrist: not tracked"),
        ({"mode": "waiting", "compiling": 0.2}, "compiling the method; the robot holds its pose"),
        ({"mode": "holding", "compiling": 0.2}, "compiling the method; the robot holds its pose"),
        ({"mode": "stopped", "compiling": 0.2}, "STOPPED"),
        ({"arm": ("following", 0.002, 0.2)}, "arm: follows"),
        ({"arm": ("holding", float("nan"), float("inf"))}, "arm: holds"),
        (
            {"arm": ("braking", 0.041, 0.021)},
            "arm: brakes, too near to something, the wrist is 41 mm off, 21 mm from touching "
            "something",
        ),
    ],
)
def test_the_modes_of_a_hand(changes, words):
    hand = {"mode": "tracking", "latched": None, "closes_at_mm": None}
    if "arm" in changes:
        names = ("state", "position_error", "clearance")
        changes = {"arm": dict(zip(names, changes["arm"], strict=True))}
        words += "\n"  # nothing else is said of it
    shown = plain(live_texts.modes({"right": {**hand, **changes}})) + "\n"
    assert words in shown
    if "compiling" in changes:
        assert "tracker" not in shown.split("wrist:")[0]
    before = plain(live_texts.modes({"right": hand}))
    assert "latch" not in before
    assert "closes" not in before
    assert "arm:" not in before


def plain(markup: str) -> str:
    return html.unescape(re.sub(r"<[^>]*>", "", markup))


def take(stage: PageStage) -> dict[str, Any]:
    return stage.see()["controls"]["take"]


@contextlib.contextmanager
def recording(stage: PageStage) -> Iterator[None]:
    """Records a take."""
    stage.session.do("record")
    eventually(lambda: take(stage)["recording"])
    stage.run.passes()
    assert take(stage)["seconds"] > 0
    yield
    stage.session.do("record")
    eventually(lambda: take(stage)["open"])
    assert not stage.loop.sinks.health()


def record(stage: PageStage) -> Path:
    """Records a short take; its file."""
    with recording(stage):
        pass
    return Path(take(stage)["last"][0])


def test_takes_are_recorded_named_kept_and_discarded(stage):
    folder, page = stage.session.takes.folder, stage.session
    said: list[str] = []
    page.takes._say = said.append
    actions = page.takes.actions  # of keys, pedals and pinches

    def refused(name: str, *words: Any) -> str:
        page.do(name, *words)
        return stage.see()["controls"]["message"]

    first = record(stage)
    assert first == folder / "take-001.mcap"
    assert len(read_log(first).commands.stamps) >= 20
    for name in ("../x", ".hidden"):
        assert "can't be called" in refused("keep", name)
    page.do("keep", "pour water")
    assert take(stage)["last"] == [str(folder / "pour_water.mcap")]
    assert (take(stage)["kept"], take(stage)["open"]) == (1, False)
    assert [file.name for file in folder.iterdir()] == ["pour_water.mcap"]
    second = record(stage)
    assert "there is already a take pour_water.mcap: choose" in refused("keep", "pour water")
    page.do("discard")
    assert not second.exists()
    assert (take(stage)["kept"], take(stage)["last"]) == (1, [])
    assert "record one first" in refused("discard")
    third = record(stage)  # nothing is decided: it stays when the next one begins
    assert record(stage) != third
    assert third.exists()
    actions["keep"]()
    assert take(stage)["kept"] == 3
    actions["discard"]()  # too late
    assert said[:2] == ["recording take-001.mcap", "take ended: take-001.mcap"]
    assert said[-2].startswith("take kept: take-0")
    assert "record one first" in said[-1]


def test_the_quality_of_a_take(stage):
    """One with holds of the loop in it, measured against the log itself."""
    kept = take(stage)["kept"]
    with recording(stage):
        stage.loop.controls.change(lambda hand: hand.hold())
        stage.run.passes()
        stage.loop.controls.change(lambda hand: hand.go_on())
        for begin, end in (("pause", "pause"), ("stop", "release")):
            stage.session.do(begin)
            stage.run.passes()
            stage.session.do(end)
        eventually(lambda: stage.mode() is Mode.TRACKING)
    path, hand = Path(take(stage)["last"][0]), load_hand("mimic_p050")
    quality, log = take_quality(path, hand), read_log(path)
    modes, lasted = np.array(log.loop.modes), np.diff(log.loop.times, append=log.loop.times[-1])
    for seconds, those in (
        (quality.paused_s, ["paused"]),
        (quality.stopped_s, ["stopped"]),
        (quality.lost_s, ["waiting", "holding"]),
    ):
        assert seconds == pytest.approx(lasted[np.isin(modes, those)].sum())
        assert np.isin(modes, those).sum() > 10
    assert take(stage)["kept"] == kept  # until it is decided
    assert 0 < quality.seconds < PATIENCE_S
    assert quality.frames == log.loop.answers.sum() > 20
    text = plain(live_texts.take(take(stage), [quality]))
    for words in (
        path.name,
        "s without the tracker",
        f"⚠\xa0stopped {quality.stopped_s:.1f} s",
        f"⚠\xa0paused {quality.paused_s:.1f} s",
        "self-collision",
    ):
        assert words in text
    with pytest.raises(RecordingError, match="a different hand"):
        take_quality(path, load_hand("leap_hand"))
    unmeasured = dataclasses.replace(quality, collision=None, depth_mm=None)
    assert "can't be measured" in plain(live_texts.take(take(stage), [unmeasured]))
    stage.session.do("discard")


def test_what_is_compiled_is_shown_with_its_seconds(stage):
    stage.loop.controls.change(lambda hand: hand.hold())
    eventually(lambda: stage.see()["hands"]["right"]["compiling"] is not None)
    eventually(lambda: stage.see()["hands"]["right"]["compiling"] > 0.2)
    seen = stage.see()
    assert seen["hands"]["right"]["human"]  # the operator's own hand moves meanwhile
    assert "compiling for 0 s" in live_texts.modes(seen["hands"])
    stage.session.switcher.building = "compiling sbr paper"
    assert stage.see()["controls"]["building"] == "compiling sbr paper, 0 s"
    stage.session.switcher.building = ""
    stage.loop.controls.change(lambda hand: hand.go_on())
    eventually(lambda: stage.see()["hands"]["right"]["compiling"] is None)


def test_the_page_cannot_ask_for_what_is_not_there(stage):
    for click in (("explode",), ("stop", "now", "please"), ("calibrate", "left"), ("method", "x")):
        stage.session.do(*click)
        assert stage.see()["controls"]["message"], click


def fetch(port: int, path: str = "/", **headers: str) -> tuple[int, dict[str, str]]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    connection.request("GET", path, headers=headers)
    response = connection.getresponse()
    response.read()
    connection.close()
    return response.status, {name.lower(): value for name, value in response.getheaders()}


def socket_status(port: int, path: str = "/", **headers: str) -> int:
    """101 if the WebSocket opens."""
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
    }
    return fetch(port, path, **upgrade, **headers)[0]


def unframed(*answers: dict[str, str]) -> None:
    """No page can frame one of these answers."""
    for headers in answers:
        assert headers["x-frame-options"] == "DENY"
        assert "frame-ancestors 'none'" in headers["content-security-policy"]


def test_elsewhere_the_page_wants_its_token():
    with serving("0.0.0.0") as server:
        port, url = server.get_port(), page_url("0.0.0.0", server)
        token = url.partition("?token=")[2]
        assert len(token) >= 32
        for path in ("/", "/?token=", f"/?token={token[:-1]}", f"/?token={token}x", "/?token=é"):
            if path.isascii():
                assert fetch(port, path)[0] == 401, path
            assert socket_status(port, path.encode("ascii", "ignore").decode()) == 401, path
        status, refusal = fetch(port, "/", Cookie=f"smooth-operator-page-{port}=guess")
        assert status == 401
        status, welcome = fetch(port, f"/?token={token}")
        assert (status, welcome["location"]) == (303, "/")
        assert {"HttpOnly", "SameSite=Lax"} <= set(welcome["set-cookie"].split("; "))
        for path in ("////elsewhere.example/", "///\\elsewhere.example", "/\\elsewhere.example"):
            status, headers = fetch(port, f"{path}?token={token}")
            assert status == 303, path
            where = headers["location"]  # which stays on the server
            assert where.lstrip("/\\") == where[1:], path
        cookie = welcome["set-cookie"].split(";")[0]
        status, page = fetch(port, "/", Cookie=cookie)
        assert status == 200
        assert "default-src 'self'" in page["content-security-policy"]
        unframed(refusal, welcome, page, fetch(port, "/no-such", Cookie=cookie)[1])
        assert socket_status(port, "/", Cookie=cookie) == 101
        assert socket_status(port, f"/?token={token}") == 101  # a program has no cookies
        assert socket_status(port, "/", Cookie=cookie, Origin="https://elsewhere.example") == 403
        assert socket_status(port, "/", Cookie=cookie, Origin=f"http://127.0.0.1:{port}") == 101


def test_here_other_pages_of_the_same_browser_are_kept_out():
    with serving() as server:
        port = server.get_port()
        assert page_url("127.0.0.1", server) == f"http://127.0.0.1:{port}"
        status, page = fetch(port)
        assert status == fetch(port, Host=f"localhost:{port}")[0] == 200
        assert socket_status(port, Origin=f"http://127.0.0.1:{port}") == 101
        assert socket_status(port, Origin="https://elsewhere.example") == 403
        # a name of theirs that points here would be of one origin with their page
        rebound = {"Host": f"elsewhere.example:{port}"}
        status, refusal = fetch(port, **rebound)
        assert status == 403
        unframed(page, refusal)
        assert socket_status(port, **rebound, Origin=f"http://elsewhere.example:{port}") == 403


class Talk:
    """A loop's end of a page, and the page's end in the hands of a test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        here, out = (os.fdopen(fd, mode) for fd, mode in zip(os.pipe(), ("rb", "wb"), strict=True))
        into, there = (os.fdopen(fd, m) for fd, m in zip(os.pipe(), ("rb", "wb"), strict=True))
        nothing: Any = lambda *_: None  # noqa: E731
        process = SimpleNamespace(stdin=there, stdout=here, terminate=nothing, wait=nothing)
        monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: process)
        self.page, self.pipe = LivePage(PageSetup("mimic_p050")), Link(into, out)
        assert self.pipe.receive()["hand"] == "mimic_p050"
        self.pipe.send({"url": "http://here"})
        self.raw = out
        self.link = LoopLink(self.pipe)

    def close(self) -> None:
        self.raw.close()
        self.page.stop()


@pytest.fixture
def talk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Talk]:
    talk = Talk(monkeypatch)
    yield talk
    talk.close()


@dataclass
class Clicked:
    """A session that notes what is clicked, and whose other work fails or takes its time."""

    stopped: bool = False
    done: list[str] = field(default_factory=list)
    goes_on: threading.Event = field(default_factory=threading.Event)

    def look(self, **_: Any) -> dict[str, Any]:
        raise ValueError("zip() argument 2 is shorter than argument 1")

    def do(self, name: str, *values: Any) -> None:
        if name == "record":
            self.goes_on.wait(PATIENCE_S)
        if name == "keep":
            raise KeyError(name)
        self.done.append(name)

    def close(self) -> None: ...


def test_whatever_fails_or_waits_a_stop_from_the_page_stops(talk, capfd):
    session: Any = Clicked()
    assert talk.page.serve(session) == "http://here"
    trouble = "the page can't show the run: ValueError: zip() argument 2 is shorter"
    for _ in range(2):  # it is asked again and again
        assert talk.link.look(text=True, scenery=0, pictures=())["trouble"].startswith(trouble)
    talk.link.do("keep")  # fails
    talk.link.do("record")  # takes its time
    talk.raw.write(b"no message\n[1, 2]\n")
    talk.pipe.send({"do": 7})
    talk.link.do("stop")
    eventually(lambda: session.done)
    assert session.done == ["stop"]  # before the click that takes its time
    eventually(lambda: talk.link.alive)
    for name in ("release", "stop"):  # in their order, whatever the other clicks do
        talk.link.do(name)
    eventually(lambda: len(session.done) == 3)
    assert session.done == ["stop", "release", "stop"]
    session.goes_on.set()
    eventually(lambda: len(session.done) == 4)
    said = capfd.readouterr().err
    assert said.count(trouble) == 1
    assert "a click on the page failed: KeyError: 'keep'" in said
    assert not talk.page.trouble


def test_a_stop_between_two_loops_stops_the_next(talk):
    first, second, third = Clicked(), Clicked(), Clicked()
    waits: list[Any] = [first, second, third]
    talk.link.do("stop")
    eventually(lambda: talk.link.look(text=True, scenery=0, pictures=()).get("stopped"))
    talk.page.serve(waits[0])
    assert first.done == ["stop"]
    talk.page.change(PageSetup("leap_hand"))
    assert talk.link.look(text=True, scenery=0, pictures=())["setup"]["hand"] == "leap_hand"
    talk.page.serve(waits[1])
    assert second.done == []  # the first one was released elsewhere
    second.stopped = True
    talk.page.change(PageSetup("mimic_p050"))
    talk.page.serve(waits[2])
    assert third.done == ["stop"]


def test_the_page_knows_within_half_a_second_that_the_loop_is_silent(talk, monkeypatch):
    eventually(lambda: talk.link.alive)
    hangs = threading.Event()
    monkeypatch.setattr(talk.page, "_take", lambda message: hangs.wait(PATIENCE_S))
    eventually(lambda: not talk.link.alive)
    hangs.set()


@pytest.mark.browser
@pytest.mark.skipif(sys.platform == "win32", reason="names of files can't hold markup")
def test_what_others_worded_is_shown_and_never_run(chromium, stage, tmp_path):
    words = ("latched", "event", "reason", "stage", "label", "detail", "sink", "of a sink")
    words += ("message", "recording", "title", "instruction", "camera")
    said = {word: f"{ATTACK} {word}" for word in words}
    seen = stage.see()
    seen["hands"]["right"]["latched"] = [said["latched"]]
    taken = {"p50": 1.0, "p99": 2.0}
    sink = {"label": said["sink"], "state": "open", "sent": 1, "failed": 0}
    seen["status"] |= {
        "events": [[0.0, said["event"]]],
        "refused": {"right": {said["reason"]: 3}},
        "stages": {said["stage"]: taken, "total": taken},
        "sinks": [sink | {"detail": said["of a sink"]}],
    }
    seen["status"]["source"] |= {"label": said["label"], "detail": said["detail"]}
    seen["controls"]["message"] = said["message"]
    seen["controls"]["take"]["recording"] = said["recording"]
    trial = {"phase": "waiting", "number": 1, "count": 3, "elapsed_s": 0.0, "limit_s": 60.0}
    seen["trial"] = trial | {"title": said["title"], "instruction": said["instruction"]}
    camera = {"name": said["camera"], "number": 1, "age_s": 0.1, "lost": False, "jpeg": "/9j/"}
    seen["cameras"] = [camera]
    hands: dict[Side, Any] = {"right": load_hand(hostile_hand(tmp_path / ATTACK))}
    with serving() as server, guarded_page(chromium) as page:
        panel = panel_of(server, hands)
        panel.show(seen)
        panel.show_meshes(False, f"{ATTACK} note")
        page.goto(page_url("127.0.0.1", server))
        hidden = ("event", "reason", "stage", "sink", "of a sink")  # in the tab of the timing
        for word, text in said.items():
            state = "attached" if word in hidden else "visible"
            page.get_by_text(text).first.wait_for(state=state)
        page.get_by_role("tab", name="View").click()
        page.get_by_text(f"{ATTACK} note").first.wait_for()


@pytest.mark.browser
def test_contact_is_heard_while_the_operator_moves_the_robot(chromium, stage):
    """A tone in proportion to the contact; none in a stop, after a loss, or with the switch off."""
    seen = stage.see()
    state = seen["hands"]["right"]
    with serving() as server:
        hands: dict[Side, Any] = {"right": load_hand("mimic_p050")}
        panel = panel_of(server, hands, simulated=True)

        def show(mode: str, *contact: float) -> None:
            hand = {**state, "mode": mode, "contact": list(contact) or None}
            panel.show({**seen, "hands": {"right": hand}})

        show("tracking", 0.1, 0.5)
        page, problems = new_page(chromium, 600, 500, drawn=False)
        page.add_init_script("""
            window.gains = [];
            const set = AudioParam.prototype.setTargetAtTime;
            AudioParam.prototype.setTargetAtTime = function (value, ...rest) {
              if (value <= 1) window.gains.push(value); // not a frequency
              return set.call(this, value, ...rest);
            };
        """)
        page.goto(page_url("127.0.0.1", server))
        page.get_by_role("tab", name="View").click()
        page.get_by_label("Sound of contact").wait_for()

        def hears(gain: float) -> None:
            page.wait_for_function(f"Math.abs(window.gains.at(-1) - {gain}) < 1e-6")

        show("tracking", 0.1, 0.5)
        assert page.evaluate("gains") == []  # off by default
        page.get_by_label("Sound of contact").check()
        eventually(lambda: panel._sound.value)
        show("tracking", 0.1, 0.5)
        hears(0.1)
        show("stopped", 0.1, 0.5)
        hears(0.0)
        show("blending", 0.1, 7.0)
        hears(0.2)  # never more
        page.evaluate("document.documentElement.setAttribute('data-lost', '')")
        hears(0.0)
        page.evaluate("document.documentElement.removeAttribute('data-lost')")
        show("tracking")  # the hand measures no contact
        hears(0.0)
        assert [line for line in problems if "AudioContext" in line or "contact" in line] == []
        page.close()


def drawing_of(server: Any, hand: str) -> tuple[LiveDrawing, dict[str, Any]]:
    """A page without a loop, and its setup."""
    link: Any = SimpleNamespace(do=lambda *_: None)
    setup = dataclasses.asdict(PageSetup(hand, details=False, meshes=False))
    return LiveDrawing(server, link, setup, StopPanel(server, link.do, attended=True)), setup


def tracks(page: Any, stage: PageStage) -> None:
    """Release and resume, whatever it was; and the page knows."""
    stage.loop.controls.release()
    stage.loop.controls.resume()
    eventually(lambda: stage.mode() is Mode.TRACKING)
    page.locator('[data-mode="tracking"]').wait_for()
    page.get_by_role("button", name="Pause").wait_for()
    page.wait_for_function("!document.title.includes('STOPPED')")


def test_fingertips_in_contact_are_redder_and_larger():
    hand = load_hand("mimic_p050")
    positions = hand.full_configuration(hand.neutral).tolist()
    with serving() as server:
        scene = LiveScene(server, {"right": hand}, simulated=True)
        tips = scene._sides["right"].row.tips["robot"]
        before, sizes = tips.batched_colors.copy(), tips.batched_scales.copy()
        state = {"positions": positions, "human": None, "latched": None}
        scene.draw({"right": {**state, "contact": [0.0, 1.0, 0.5, 0.0, 0.0]}})
        touched = (tips.batched_colors != before).any(axis=1)
        assert touched.tolist() == [False, True, True, False, False]
        assert (tips.batched_colors[touched, 0] >= before[touched, 0]).all()
        assert tips.batched_scales[1] > tips.batched_scales[2] >= sizes[2] == sizes[1]
        scene.draw({"right": {**state, "contact": None}})
        np.testing.assert_array_equal(tips.batched_colors, before)
        scene.remove()
        assert not [name for name in server.scene._handle_from_node_name if "right" in name]


def test_what_browsers_get_in_one_update(monkeypatch):
    """A frame arrives as one update. A new scene does not wait for its hand, so that a browser gets
    the stop while the hand is loaded."""
    held_back: list[int] = []

    def noted(*_: Any, **__: Any) -> None:
        held_back.append(server._websock_server.get_message_buffer().atomic_counter)

    def loaded(*args: Any, **more: Any) -> Any:
        noted()
        return load_hand(*args, **more)

    monkeypatch.setattr(drawing, "load_hand", loaded)
    with serving() as server:
        page, setup = drawing_of(server, "mimic_p050")
        page._change({**setup, "hand": "leap_hand"})
        assert held_back == [0, 0]
        parts = (page._scene, "draw"), (page._scene, "draw_scenery"), (page._panel, "show")
        for part, name in (*parts, (server, "flush")):
            monkeypatch.setattr(part, name, noted)
        page._draw({"hands": {}, "scenery": {}})
    assert held_back == [0, 0, 1, 1, 1, 0]


@pytest.mark.browser
def test_after_another_hand_an_open_page_shows_what_a_new_one_shows(chromium):
    """Also where a pose of the new scene is one that the page's library does not send."""
    with serving() as server:
        live, setup = drawing_of(server, "leap_hand")
        live._panel._overlay.value = True
        live._scene.set_overlay(True)
        pages = [new_page(chromium, 640, 320)[0] for _ in range(2)]
        pages[0].goto(page_url("127.0.0.1", server))
        first = settled(pages[0], 320, 320)
        live._change({**setup, "hand": "mimic_p050"})  # it faces the viewer as it is
        assert live._panel._overlay.value  # the switches stay
        assert not live._scene._sides["right"].row.labels["human"].visible
        live._scene.set_overlay(False)
        pages[1].goto(page_url("127.0.0.1", server))

        def alike() -> bool:
            """Both pages show the same, and another picture than before."""
            one, other = (picture(page, 320, 320) for page in pages)
            return changed(one, other) < 0.002 and changed(one, first) > 0.02

        eventually(alike)
        for page in pages:
            page.close()


@pytest.mark.browser
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="no such signal")
def test_a_page_without_a_connection_says_that_its_stop_does_not_work(chromium, stage, capfd):
    served = LivePage(PageSetup("mimic_p050", port=0, details=False, attended=True))
    page, _ = new_page(chromium, 600, 500, drawn=False)
    page.goto(served.url)
    page.get_by_text("EMERGENCY STOP").wait_for()
    page.keyboard.press("x")  # before there is a loop
    page.locator("[data-stopped]").wait_for(state="attached")
    assert stage.mode().moves
    served.serve(stage.session)
    eventually(lambda: stage.mode() is Mode.STOPPED)
    page.locator('[data-mode="stopped"]').wait_for()
    tracks(page, stage)
    lost = page.locator("#live-lost")
    assert lost.count() == 0
    try:
        served._process.send_signal(signal.SIGSTOP)
        lost.wait_for()
        words = lost.inner_text()
        assert "CONNECTION LOST" in words
        assert "The stop button does not work." in words
        assert "To stop, press Space, Esc or X in the terminal where teleop runs." in words
        assert lost.evaluate("it => getComputedStyle(it).position") == "fixed"
        page.wait_for_function("document.title.includes('CONNECTION LOST')")
    finally:
        served._process.send_signal(signal.SIGCONT)
    lost.wait_for(state="detached")
    served._process.kill()  # a page that dies harms nothing
    eventually(lambda: served.trouble)
    stage.run.stays(Mode.TRACKING)
    assert "the loop continues without it" in capfd.readouterr().err
    lost.wait_for()
    page.close()
    served._session = None  # the stage's own, which others use
    served.stop()


def test_another_hand_while_it_runs(monkeypatch, tmp_path):
    """The page stays at its address, the sinks get the next hand; what does not fit is refused."""
    monkeypatch.chdir(tmp_path)
    sessions: list[LiveSession] = []
    serve = LivePage.serve

    def noted(page: LivePage, session: LiveSession) -> str:
        sessions.append(session)
        return serve(page, session)

    monkeypatch.setattr(LivePage, "serve", noted)
    sink = LateHand()
    lines: list[str] = []
    reporter: Any = SimpleNamespace(
        note=lambda text, matters=False: lines.append(text),
        waiting=lambda text: contextlib.nullcontext(),
    )
    ended: list[dict[str, Any]] = []
    thread = threading.Thread(
        target=lambda: ended.append(
            teleoperate(
                TeleopRequest(method="joint_angle"),
                sinks=[sink],
                reporter=reporter,
                page=PageSettings(port=0, open_browser=False),
            )
        )
    )
    thread.start()
    try:
        eventually(lambda: sessions and sessions[0].look(text=False)["hands"])
        assert lines[0].startswith("page: http://127.0.0.1:")  # before anything else
        first = sessions[0]
        assert "leap_hand" in first.look(text=True)["controls"]["hands"]
        first.do("hand", "no_such_hand")
        controls = first.look(text=True)["controls"]
        assert "can't continue with the hand 'no_such_hand'" in controls["message"]
        assert len(sessions) == 1
        first.do("hand", "leap_hand")
        changing = first.look(text=True)  # nothing reads as ended or closed
        assert changing == {"hands": {}, "notice": "changing to leap_hand", "stopped": False}
        assert "changing to leap_hand …" in live_texts.modes({}, changing["notice"])
        eventually(lambda: len(sessions) == 2)
        eventually(lambda: sessions[1].look(text=False)["hands"])
        assert sink.names == ["mimic_p050", "leap_hand"]
        assert sum(line.startswith("page: ") for line in lines) == 1
        assert sessions[1].switcher.used.method == "joint_angle"
    finally:
        for session in sessions[-1:]:
            session.loop.controls.quit()
        thread.join(PATIENCE_S)
    assert len(ended) == 1


@pytest.fixture(scope="module")
def served(stage: PageStage) -> Iterator[LivePage]:
    with LivePage(PageSetup("mimic_p050", port=0, details=False, meshes=False)) as page:
        page.serve(stage.session)
        yield page
    assert page._process.returncode is not None
    assert not page.trouble


@pytest.fixture(scope="module")
def shown(chromium: Any, served: LivePage) -> Iterator[Any]:
    """The page in a browser, which takes seconds to draw it first."""
    page = opened(chromium, served)
    yield page
    page.close()


@pytest.fixture
def page(shown: Any) -> Any:
    """The same page, in its first size, whatever the last test left."""
    shown.set_viewport_size({"width": 900, "height": 640})
    shown.wait_for_function("document.body.clientWidth === 900")
    return shown


def opened(chromium: Any, served: LivePage, width: int = 900, height: int = 640) -> Any:
    page, problems = new_page(chromium, width, height, drawn=False)
    page.goto(served.url)
    page.add_style_tag(content=".mantine-Notification-root {display: none !important}")
    page.get_by_text("EMERGENCY STOP").wait_for()
    page.locator("[data-mode]").first.wait_for()
    assert not [p for p in problems if "favicon" not in p]
    return page


@pytest.mark.browser
def test_the_page_shows_the_loop_and_stops_it(page, stage):
    page.locator('[data-mode="tracking"]').wait_for()
    page.locator("#live-timing").get_by_text("solve").wait_for()
    first = len(stage.ticks)
    page.get_by_text("EMERGENCY STOP").click()
    eventually(lambda: stage.mode() is Mode.STOPPED)
    page.locator('[data-mode="stopped"]').wait_for()
    held = np.array(
        [t.command.joint_positions for t in stage.ticks[first:] if t.mode is Mode.STOPPED]
    )
    assert np.ptp(held, axis=0).max() == 0
    page.get_by_text("Release the stop").click()
    eventually(lambda: stage.mode() is Mode.TRACKING)
    page.get_by_role("button", name="Pause").click()
    eventually(lambda: stage.mode() is Mode.PAUSED)
    page.get_by_role("button", name="Resume").click()
    eventually(lambda: stage.mode() is Mode.TRACKING)

    page.get_by_role("tab", name="Method").click()
    before = stage.loop.pipelines["right"].retargeter
    chooser = page.locator("label", has_text=re.compile("^Method$")).get_attribute("for")
    page.locator(f'[id="{chooser}"]').click()
    page.get_by_role("option", name="geort").click()
    eventually(lambda: stage.loop.pipelines["right"].retargeter is not before)
    assert stage.session.switcher.used.method == "geort"
    stage.session.do("method", "joint_angle")
    eventually(lambda: stage.session.switcher.used.method == "joint_angle")


@pytest.mark.browser
def test_nothing_is_cut_off_at_the_usual_sizes(page):
    page.locator("#live-legend [data-chip]").first.wait_for()
    for tab in ("Timing", "Method", "View"):
        page.get_by_role("tab", name=tab).click()
        eventually(lambda: not nameless(page))
    # in one go: the texts are replaced several times a second
    boxes = """() => {
      const box = (found) => { const {left, right, top, bottom} = found.getBoundingClientRect();
                               return {left, right, top, bottom}; };
      const button = (icon) => box(document.querySelector(`button:has(.icon-tabler-${icon})`));
      return {tabs: [...document.querySelectorAll("[role=tab]")].map(box),
              summary: box(document.querySelector("#live-summary")),
              legend: box(document.querySelector("#live-legend")),
              stop: button("hand-stop"),
              pause: button("player-pause"), record: button("player-record")}; }"""
    for width, height in ((1400, 900), (1024, 768), (900, 600)):
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_function(f"document.body.clientWidth === {width}")

        def fits() -> bool:
            """The tabs are in one row below the whole status; a resized page takes a moment."""
            at = page.evaluate(boxes)
            tops = {round(tab["top"]) for tab in at["tabs"]}
            return len(at["tabs"]) == 3 and len(tops) == 1 and at["summary"]["bottom"] <= min(tops)

        eventually(fits)
        at = page.evaluate(boxes)
        legend = at["legend"]  # over the hands, not over the controls
        assert legend["left"] >= 0
        assert legend["right"] <= at["tabs"][0]["left"]
        assert 0 <= legend["top"] < legend["bottom"] <= height
        assert at["pause"]["top"] == at["record"]["top"]
        assert at["pause"]["right"] < at["record"]["left"]
    page.set_viewport_size({"width": 390, "height": 844})  # a phone
    page.wait_for_function("document.body.clientWidth === 390")

    def reachable() -> bool:
        """The buttons are within the window."""
        at = page.evaluate(boxes)
        buttons = [at[name] for name in ("stop", "pause", "record")]
        return all(b["left"] >= 0 and b["right"] <= 390 and b["bottom"] <= 844 for b in buttons)

    eventually(reachable)
    # In a low window, as one enlarged to 200 %, too: an open list leaves the stop button free.
    page.set_viewport_size({"width": 700, "height": 450})
    page.wait_for_function("document.body.clientWidth === 700")
    page.get_by_role("tab", name="Method").click()
    page.locator("input[role=combobox]:visible").first.click()
    page.get_by_role("option").first.wait_for()
    listed = page.locator(".mantine-Select-dropdown:visible").bounding_box()
    stop, record = (page.evaluate(boxes)[name] for name in ("stop", "record"))
    assert stop["bottom"] <= listed["y"]
    assert record["bottom"] <= page.evaluate(boxes)["tabs"][0]["top"]
    page.keyboard.press("Tab")


@pytest.mark.browser
def test_stop_keys_stop_whatever_has_the_focus_and_nothing_else_does(page, stage):
    tracks(page, stage)
    # Space after a click on Pause: the button has no focus any more, and Space stops
    page.get_by_role("button", name="Pause").click()
    eventually(lambda: stage.mode() is Mode.PAUSED)
    page.get_by_role("button", name="Resume").wait_for()
    page.keyboard.press("Space")
    stage.run.stays(Mode.STOPPED)
    tracks(page, stage)

    stop = page.locator("button:has(.icon-tabler-hand-stop)")
    release = page.locator("button:has(.icon-tabler-lock-open)")
    page.get_by_role("tab", name="Method").click()
    text = page.locator("input[role=combobox]:visible").first
    for key in ("Space", "Escape", "x"):
        text.focus()
        page.keyboard.press(key)
        eventually(lambda: stage.mode() is Mode.STOPPED)
        release.wait_for()
        if key == "Space":  # and once more on the button that releases
            release.focus()
            page.keyboard.press(key)
            stage.run.stays(Mode.STOPPED)
        tracks(page, stage)

    # the whole page says so, and each button what it does
    page.keyboard.press("Escape")
    page.locator('[data-mode="stopped"]').wait_for()
    release.wait_for()
    page.wait_for_function("document.title.includes('STOPPED')")
    style = "(({content, pointerEvents}) => [content, pointerEvents])"
    content, events = page.evaluate(f"{style}(getComputedStyle(document.body, '::after'))")
    assert "STOPPED" in content
    assert events == "none"  # the controls below it can be clicked
    assert "STOPPED" in stop.inner_text()
    assert "(U)" in release.inner_text()
    assert page.get_by_role("button", name="Pause").is_disabled()

    page.keyboard.press("p")  # which releases nothing
    stage.run.stays(Mode.STOPPED)
    page.keyboard.press("u")
    eventually(lambda: stage.mode() is Mode.TRACKING)
    page.get_by_role("button", name="EMERGENCY STOP Space, Esc or X").wait_for()
    for name in ("Pause (P)", "Record (R)"):
        page.get_by_role("button", name=name).wait_for()


@pytest.mark.weekly
@pytest.mark.browser
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads /proc")
def test_opened_and_closed_again_and_again_nothing_is_left(chromium, served, stage):
    def figures() -> np.ndarray:
        """Threads of the page's process and of this one, and memory of the page's [MB]."""
        text = Path(f"/proc/{served._process.pid}/status").read_text()
        found = [re.search(rf"{name}:\s+(\d+)", text) for name in ("Threads", "VmRSS")]
        threads, memory = (int(each[1]) for each in found if each)
        return np.array([threads, threading.active_count(), memory / 1024])

    seen = []
    for _ in range(4):
        opened(chromium, served, 300, 300).close()
        time.sleep(0.3)
        seen.append(figures())
    # in the end, whenever the page gets to it; viser's pool grows to its size
    eventually(lambda: (figures() - seen[1] <= (4, 0, 20.0)).all())
    assert stage.mode().moves


def test_a_page_that_cannot_be_served_says_why(stage):
    page = LivePage(PageSetup("mimic_p050", host="192.0.2.1", port=0))
    try:
        with pytest.raises(ConfigError, match=r"192\.0\.2\.1"):
            page.serve(stage.session)
    finally:
        page.stop()

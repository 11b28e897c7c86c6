"""The loop with real threads and clocks, and the command around it."""

import json
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from live_time import PATIENCE_S, until
from ticks import KeptTicks

from smooth_operator import HandFrame, Retargeter, load_hand
from smooth_operator.cli import main
from smooth_operator.errors import SourceError
from smooth_operator.extras import install_command
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop import run as run_module
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.recording import read_log
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig, SafetyConfig
from smooth_operator.teleop.sinks.sink import Sink, SinkRunner
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.teleop.sources.live import Mailbox, Running, SourceHealth, ThreadedSource
from smooth_operator.types import Side

RATE = 50.0


@dataclass
class Player(ThreadedSource):
    """Frames at a pace, with a say in what becomes of each."""

    frames: list[HandFrame]
    rate: float = RATE
    before: Callable[[int], None] = lambda i: None

    @property
    def label(self) -> str:
        return "player"

    def run(self, running: Running) -> None:
        running.health = SourceHealth("running")
        start = time.perf_counter()
        for i, frame in enumerate(self.frames):
            if running.stopping.wait(max(start + i / self.rate - time.perf_counter(), 0)):
                return
            self.before(i)
            running.mailbox.post(frame)


@pytest.fixture(scope="module")
def retargeters() -> dict[Side, Retargeter]:
    built: dict[Side, Retargeter] = {}
    for side in ("right", "left"):
        built[side] = Retargeter(load_hand("mimic_p050", side), method="joint_angle")
        built[side].warm_up()
    return built


@pytest.fixture(scope="module")
def frames() -> list[HandFrame]:
    return list(SyntheticOperator(seed=4, rate_hz=RATE).record(3.0))


def looped(
    retargeters: Mapping[Side, Retargeter],
    source: Player,
    *sinks: KeptTicks,
    sides: tuple[Side, ...] = ("right",),
    config: LoopConfig | None = None,
    retry_s: float = 0.1,
) -> TeleopLoop:
    config = LoopConfig(rate=RATE) if config is None else config
    pipelines = {side: HandPipeline(retargeters[side], config) for side in sides}
    return TeleopLoop(pipelines, source, SinkRunner(sinks, retry_s=retry_s), config)


def run_until(loop: TeleopLoop, done: Callable[[], object]) -> None:
    """Runs a loop until something is true, however long a busy machine takes for it."""
    loop.watch = lambda tick: loop.controls.quit() if done() else None
    loop.run(duration=PATIENCE_S)
    assert done()


def test_every_frame_is_answered(retargeters, frames):
    sink, log = KeptTicks(), KeptTicks(observes=True)
    loop = looped(retargeters, Player(frames), sink, log)
    run_until(loop, lambda: len(sink.ticks) >= 80)
    answered = [tick for tick in sink.ticks if tick.status is not None]
    # a busy machine may lose some, and says so
    assert loop.mailbox.overwritten + len(answered) >= loop.mailbox.received - 1
    stamps = [tick.command.stamp for tick in answered]
    assert stamps == sorted(stamps)
    assert [t.number for t in sink.ticks] == list(range(len(sink.ticks)))
    assert "send" not in answered[0].stages
    seen = next(tick for tick in log.ticks if tick.status is not None)
    assert list(seen.stages) == ["tracker", "receive", "solve", "limit", "send"]
    assert len(log.ticks) == len(sink.ticks)
    assert (sink.calls.count("open"), sink.calls.count("close")) == (1, 1)


def test_both_hands_have_their_own_frames(retargeters, frames):
    left = list(SyntheticOperator(seed=4, rate_hz=RATE, side="left").record(3.0))
    both = [frame for pair in zip(frames, left, strict=True) for frame in pair]
    sink = KeptTicks()

    def answered(side: Side) -> list[Tick]:
        return [t for t in sink.ticks if t.side == side and t.status is not None]

    loop = looped(retargeters, Player(both, 2 * RATE), sink, sides=("right", "left"))
    run_until(loop, lambda: min(len(answered("right")), len(answered("left"))) >= 40)
    for side in loop.pipelines:
        assert {t.arrival.frame.side for t in answered(side) if t.arrival} == {side}


def test_a_source_that_cannot_be_opened_closes_the_sinks(retargeters, frames):
    sink = KeptTicks()

    class Absent(Player):
        def open(self) -> None:
            raise SourceError("no such camera")

    with pytest.raises(SourceError, match="camera"):
        looped(retargeters, Absent(frames), sink).run(duration=1.0)
    assert (sink.calls, sink.ticks) == (["open", "close"], [])


def test_the_watchdog_tells_of_a_loop_that_hangs(retargeters, frames):
    """The loop hangs until the sink is told of it, so that no clock decides."""
    ended: list[float] = []
    sink = KeptTicks()
    config = LoopConfig(rate=RATE, safety=SafetyConfig(watchdog_s=0.1))
    loop = looped(retargeters, Player(frames), sink, config=config)
    loop.controls.change(lambda hand: ended.append(until(lambda: sink.silences)[0]))
    loop.controls.change(lambda hand: loop.controls.quit())
    loop.run(duration=2 * PATIENCE_S)
    assert ended[0] > 0.1
    assert min(sink.silences) > 0.1


class TurnedMailbox(Mailbox):
    """A mailbox whose clock moves only while the loop sleeps in it, and then at once."""

    def __init__(self, at: float, event: Callable[[], None]) -> None:
        self.now, self._at, self._event = 100.0, at, event
        super().__init__(lambda: self.now)

    def sleep(self, timeout: float, received: int | None = None) -> None:
        after = self.now + max(timeout, 1e-4)
        if self.now < self._at <= after:
            self.now = self._at
            self._event()
        else:
            self.now = after


def turned(
    retargeters: Mapping[Side, Retargeter], rate: float, at: float, event: Callable[[Any], None]
) -> list[Tick]:
    """The ticks of a run of five seconds with an event, which gets the loop, at a time [s]."""
    sink, config = KeptTicks(), LoopConfig(rate=rate, safety=SafetyConfig(lost_s=60.0))
    mailbox = TurnedMailbox(at, lambda: event(loop))
    pipelines = {"right": HandPipeline(retargeters["right"], config, mailbox.clock)}
    loop = TeleopLoop(pipelines, Player([], 1.0), SinkRunner([sink]), config, mailbox=mailbox)
    loop.run(duration=5.0)
    return sink.ticks


@pytest.mark.parametrize("after", [0.01, 0.1, 0.24])
def test_an_emergency_stop_does_not_wait_for_the_pace(retargeters, after):
    """Just after a command, of which there is one a second; the clock is the test's."""
    ticks = turned(retargeters, 1.0, 103.75 + after, lambda loop: loop.controls.stop())
    times = [tick.time for tick in ticks if tick.mode is not Mode.STOPPED]
    assert times[-1] == pytest.approx(103.75, abs=1e-3)
    (first, *_) = [tick for tick in ticks if tick.mode is Mode.STOPPED]
    assert first.time == pytest.approx(103.75 + after)


def test_a_frame_between_two_turns_is_answered_as_it_comes(retargeters, frames):
    ticks = turned(retargeters, 50.0, 101.007, lambda loop: loop.mailbox.post(frames[0]))
    (answer,) = [tick for tick in ticks if tick.status is not None]
    assert answer.time == pytest.approx(101.007, abs=1e-6)


def test_the_end_of_a_source_ends_the_loop_after_its_policies(retargeters, frames):
    sink = KeptTicks()
    config = LoopConfig(rate=RATE, safety=SafetyConfig(lost_s=0.3))
    looped(retargeters, Player(frames[:20]), sink, config=config).run()
    modes = [tick.mode for tick in sink.ticks]
    assert modes[-1] in (Mode.HOLDING, Mode.EASING)


def test_a_source_that_fails_is_a_loss_and_not_the_end(retargeters, frames):
    def unplug(i: int) -> None:
        if i == 20:
            raise OSError("unplugged")

    sink = KeptTicks()
    config = LoopConfig(rate=RATE, safety=SafetyConfig(lost_s=0.2))
    loop = looped(retargeters, Player(frames, before=unplug), sink, config=config)
    run_until(loop, lambda: sink.ticks and sink.ticks[-1].mode is Mode.EASING)
    assert loop.source.health() == SourceHealth("failed", "OSError: unplugged")


def test_a_slow_sink_makes_the_loop_skip_frames_not_fall_behind(retargeters, frames):
    sink = KeptTicks(slow_s=0.05)
    loop = looped(retargeters, Player(frames, 100.0), sink)
    run_until(loop, lambda: loop.mailbox.overwritten > 40)
    newest = max(tick.arrival.frame.stamp for tick in sink.ticks if tick.arrival)
    # A loop that takes one frame after the other would be at the frame of its tick's number.
    assert newest * RATE > len(sink.ticks) + 30


def test_a_source_is_opened_once_though_it_was_prepared(frames):
    class Counting(Player):
        opened = 0

        def open(self) -> None:
            self.opened += 1

    source = Counting(frames[:2])
    source.prepare()
    for count in (1, 2):  # started again it is opened again
        source.start(Mailbox())
        source.stop()
        assert source.opened == count


def test_an_emergency_stop_does_not_wait_for_the_next_tick(retargeters, monkeypatch):
    sink = KeptTicks()
    loop = looped(retargeters, Player([], 1.0), sink, config=LoopConfig(rate=1.0))
    monkeypatch.setattr(LoopConfig, "period", 1e6)  # the next tick never comes

    def press() -> None:
        loop.controls.stop()
        loop.controls.change(lambda _: loop.controls.quit())

    threading.Timer(0.3, press).start()
    loop.run(duration=PATIENCE_S)
    assert loop.pipelines["right"].mode_now is Mode.STOPPED


def test_a_source_can_stop_the_loop_and_knows_its_mode(retargeters, frames):
    """As the page of a headset does, by the mailbox."""
    sink = KeptTicks()
    loop = looped(retargeters, Player(frames), sink)
    box = loop.mailbox
    assert box.mode() == "waiting"
    told: list[str] = []
    for change, mode in (
        (lambda hand: hand.hold(), "compiling"),
        (lambda hand: hand.supervisor.pause(), "paused"),
        (lambda hand: hand.supervisor.stop(), "stopped"),
    ):
        change(loop.pipelines["right"])
        told.append(box.mode())
        assert told[-1] == mode
    loop.pipelines["right"].supervisor.release()
    assert box.mode() == "paused"
    box.stop()
    loop.run(0.2)
    assert box.mode() == "stopped"
    assert {tick.mode for tick in sink.ticks} == {Mode.STOPPED}


def sleeping(until: threading.Event) -> None:
    """Holds the thread up and releases the GIL, as XLA does while it compiles."""
    until.wait(PATIENCE_S)


def computing(until: threading.Event) -> None:
    """Holds the thread up and the GIL, too, but for a moment now and then, as tracing does."""
    end = time.perf_counter() + PATIENCE_S
    while not until.is_set() and time.perf_counter() < end:
        sum(range(100_000))


@pytest.mark.parametrize("compiling", [sleeping, computing])
@pytest.mark.parametrize("place", ["solve", "switch", "another thread"])
def test_an_emergency_stop_does_not_wait_for_a_method_that_compiles(
    retargeters, frames, monkeypatch, place, compiling
):
    """The stop ends what it does not wait for, so no clock decides: else it would come after it."""
    busy, reached, ended_by_stop = threading.Event(), threading.Event(), []

    class Telling(KeptTicks):
        def send(self, tick: Tick) -> None:
            super().send(tick)
            if tick.mode is Mode.STOPPED:
                reached.set()

    def held_up() -> None:
        busy.set()
        compiling(reached)
        ended_by_stop.append(reached.is_set())

    def begin(number: int) -> None:
        if number != 30:  # the hand moves by then
            return
        if place == "switch":
            loop.controls.change(lambda hand: held_up())
        elif place == "another thread":
            threading.Thread(target=held_up, daemon=True).start()
        else:
            compile_once.append(held_up)

    def press() -> None:
        busy.wait(PATIENCE_S)
        loop.controls.stop()
        while not ended_by_stop:
            time.sleep(0.001)
        time.sleep(0.2)
        loop.controls.quit()

    compile_once: list[Callable[[], None]] = []
    step = Retargeter.step

    def stepped(self: Retargeter, *args: Any) -> Any:
        while compile_once:
            compile_once.pop()()
        return step(self, *args)

    monkeypatch.setattr(Retargeter, "step", stepped)
    sink = Telling()
    loop = looped(retargeters, Player(frames, before=begin), sink)
    threading.Thread(target=press, daemon=True).start()
    loop.run(duration=2 * PATIENCE_S)
    assert ended_by_stop == [True]
    modes = [tick.mode for tick in sink.ticks]
    first = modes.index(Mode.STOPPED)
    assert set(modes[first:]) == {Mode.STOPPED}  # also after the method has answered
    assert {tick.status for tick in sink.ticks[first:]} == {None}
    assert [tick.number for tick in sink.ticks] == list(range(len(modes)))
    assert np.ptp([tick.command.joint_positions for tick in sink.ticks[-5:]], axis=0).max() == 0
    assert sink.ticks[first].events[-1].endswith(" -> stopped")


def test_a_source_is_told_which_hands_are_wanted():
    for text, told in (("synthetic", "left"), ("udp:0", "left"), ("synthetic:seed=1", "both")):
        assert build_source(text, told).side == told
    assert build_source("synthetic:side=right", "left").side == "right"


@dataclass(frozen=True)
class Unfinished(Sink):
    """A sink without a method."""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--source", "gloves"], "unknown source 'gloves'"),
        (["--source", "replay:{folder}/none.npz"], "none.npz"),
        (["--source", "video:{folder}/none.mp4"], "none.mp4"),
        (["--source", "synthetic:sped=2"], "Did you mean 'speed'"),
        (["--source", "udp:{taken}"], "{taken}"),
        (["--source", "webxr:127.0.0.1,port={taken}"], "{taken}"),
        (["--sink", "robot"], "unknown sink 'robot'"),
        (["--sink", "zmq:tcp://127.0.0.1"], "is not a ZeroMQ address"),
        (["--sink", "zmq:tcp://127.0.0.1:{taken}"], "{taken}"),
        (["--sink", f"{__name__}:Unfinished"], "it lacks close, label, open, send"),
        (["--sink", "record:{folder}/there.mcap"], "the file already exists"),
        (["--sink", "record:{folder}/none/take.mcap"], "does not exist"),
        (["--control", "tcp://127.0.0.1:{taken}"], "{taken}"),
        (["--host", "192.0.2.1"], "192.0.2.1"),
        (["--hand", "my.urdf"], "hands add my.urdf"),
        (["--hand", "mimic_p05"], "Did you mean 'mimic_p050'"),
        (["--rate", "0"], "rate must be 1 to 1000 Hz, not"),
        (["--operator", "/nowhere/operator.json"], "/nowhere"),
        (["--operator", "{folder}/bad.json"], "bad.json"),
        (["--safety.stale-s", "-1"], "stale_s must be positive"),
        (["--limits.margin", "5"], "is too large for hand"),
        (["--no-view", "--model", "hand.xml"], "--no-view disables the page"),
        (["--task", "cube", "--sink", "mujoco"], "remove --sink mujoco"),
    ],
)
def test_mistakes_are_found_before_anything_slow(arguments, words, tmp_path, capsys, nothing_slow):
    (tmp_path / "there.mcap").write_bytes(b"")
    (tmp_path / "bad.json").write_text("{")
    kind = socket.SOCK_DGRAM if "udp" in arguments[1] else socket.SOCK_STREAM
    with socket.socket(socket.AF_INET, kind) as other:
        other.bind(("127.0.0.1", 0))
        if kind == socket.SOCK_STREAM:
            other.listen()
        here = {"folder": tmp_path, "taken": other.getsockname()[1]}
        given = [argument.format(**here) for argument in arguments]
        assert main(["teleop", "--no-browser", "--method", "joint_angle", *given]) == 2
        assert words.format(**here) in capsys.readouterr().err


@pytest.fixture
def nothing_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that compiles, or opens its page, fails."""

    def slow(*args: Any) -> Any:
        raise AssertionError("it goes on though something is wrong")

    monkeypatch.setattr(run_module._Run, "_compile", slow)
    monkeypatch.setattr(run_module, "_open_page", slow)


@pytest.mark.parametrize(
    ("arguments", "library", "extra"),
    [
        (["--source", "webcam"], "cv2", "webcam"),
        (["--source", "zmq:tcp://127.0.0.1:5999"], "zmq", "zmq"),
        (["--sink", "zmq:tcp://127.0.0.1:*"], "zmq", "zmq"),
        (["--control", "tcp://127.0.0.1:*"], "zmq", "zmq"),
        (["--source", "manus"], "zmq", "zmq"),
        (["--source", "ros2"], "cyclonedds", "ros2"),
        (["--sink", "ros2"], "cyclonedds", "ros2"),
        (["--source", "webxr:port=0"], "websockets.asyncio.server", "webxr"),
        (["--source", "webxr:port=0"], "cryptography", "webxr"),
        (["--source", "avp:127.0.0.1"], "grpc", "avp"),
        (["--sink", "rerun"], "rerun", "rerun"),
    ],
)
def test_a_missing_extra_is_found_before_anything_slow(
    arguments, library, extra, monkeypatch, capsys, nothing_slow
):
    for name in [n for n in sys.modules if n.startswith("smooth_operator_devices.ros2")]:
        monkeypatch.delitem(sys.modules, name)  # another test of this process has imported it
    monkeypatch.setitem(sys.modules, library, None)
    assert main(["teleop", "--no-view", "--method", "joint_angle", *arguments]) == 2
    assert install_command(extra) in " ".join(capsys.readouterr().err.split())


@dataclass(frozen=True)
class Mirrored(ThreadedSource):
    """A tracker that sends a left hand for a right one."""

    label: ClassVar[str] = "mirrored"

    def run(self, running: Running) -> None:
        motion = SyntheticOperator(seed=2, rate_hz=100.0).record(8.0)
        mirrored = [replace(f, landmarks=f.landmarks * [-1.0, 1.0, 1.0]) for f in motion]
        Player(mirrored[:60], 60.0).run(running)


def test_refused_frames_are_counted_in_the_summary(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "build_source", lambda *_: Mirrored())
    log = tmp_path / "take.mcap"
    command = f"teleop --sink record:{log} --safety.lost-s 0.3 --method joint_angle --no-view"
    assert main([*command.split(), "--json"]) == 0
    out, err = capsys.readouterr()
    summary = json.loads(out)
    assert summary["sinks"][0]["failed"] == 0
    (why,) = summary["frames_refused"]["right"]
    assert "by its shape, it is a left hand" in why
    refused = summary["frames_refused"]["right"][why]
    assert refused + summary["frames_overwritten"] == summary["frames_received"] == 60
    assert summary["frames_answered"] == summary["frames_unusable"] == 0
    assert f"frames refused: {refused} x judging by its shape, it is a left" in err
    recorded = read_log(log).loop
    events = [event for events in recorded.events.values() for event in events]
    assert sum("frame refused" in event for event in events) == refused

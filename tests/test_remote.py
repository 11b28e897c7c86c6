"""A running teleoperation that other programs switch: methods, operators, tasks, trials, blind."""

import contextlib
import json
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_loop import Stage, panel_of, running, serving, session_of
from live_time import PATIENCE_S, until

from smooth_operator import Retargeter, load_hand, method_names
from smooth_operator.calibration.operator_file import OperatorProfile, write_operator
from smooth_operator.cli import main
from smooth_operator.errors import (
    ConfigError,
    MissingExtraError,
    RemoteError,
    RemoteRefusedError,
    SinkError,
    UnknownNameError,
)
from smooth_operator.planning import make_request
from smooth_operator.simulation.tasks import read_trial
from smooth_operator.simulation.tasks.task_session import TrialRunner
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.control.method_switcher import MethodSwitcher
from smooth_operator.teleop.control.rpc import RpcHandlers, remote
from smooth_operator.teleop.recording import read_log
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.remote_client import RemoteTeleop
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.record import RecordSink
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.teleop.sinks.sink import SinkRunner
from smooth_operator.teleop.sinks.tick import Driver, Mode, Tick

zmq = pytest.importorskip("zmq")


@dataclass
class RemoteStage(Stage):
    """A running loop that listens for commands, and the client that sends them."""

    switcher: MethodSwitcher
    runner: TrialRunner
    folder: Path
    teleop: RemoteTeleop

    def do(self, word: str, **fields: Any) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE_S
        while True:
            try:
                return self.teleop.request(word, **fields)
            except RemoteRefusedError as error:  # of a stalled machine it is true
                if "the loop does not answer" not in str(error) or time.monotonic() > end:
                    raise

    def refused(self, words: str, word: str, **fields: Any) -> None:
        with pytest.raises(RemoteRefusedError, match=words):
            self.do(word, **fields)


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Iterator[RemoteStage]:
    asked = make_request(method="joint_angle")
    retargeter = Retargeter(load_hand("mimic_p050"), config=asked.config)
    retargeter.warm_up()
    config = LoopConfig(rate=50.0)
    folder = tmp_path_factory.mktemp("remote")
    simulation, record = Simulation(), RecordSink(folder / "take.mcap", flush_s=0.05)
    driver = Driver(asked.method, asked.preset, asked.config)
    loop = TeleopLoop(
        {"right": HandPipeline(retargeter, config, driver=driver)},
        build_source("synthetic:rate=50", "right"),
        SinkRunner((simulation, record)),
        config,
    )
    switcher = MethodSwitcher(loop, asked)
    opened: list[TrialRunner] = []
    handlers = RpcHandlers(loop, switcher, lambda: opened[0] if opened else None, blind=True)
    session = session_of(loop, switcher, folder, simulation, blind=True)

    def started() -> None:
        about = lambda: {"method": switcher.used.method}  # noqa: E731
        note = lambda side, text: loop.controls.change(lambda hand: hand.note(text))  # noqa: E731
        runner = TrialRunner(simulation, ("right",), folder / "trials", about, note=note)
        opened.append(runner)

    with (
        remote(loop, "tcp://127.0.0.1:*", handlers.by_command, handlers.status) as address,
        running(loop, session.watch, started) as run,
    ):
        until(lambda: run.mode() is Mode.TRACKING)
        yield RemoteStage(run, session, switcher, opened[0], folder, RemoteTeleop(address, 20.0))
    session.close()


def test_the_rate_is_what_another_program_asks_for(stage):
    assert stage.do("status")["rate"] == 50.0
    assert stage.do("status")["compiling"] == []
    try:
        assert stage.do("rate", rate=20) == {"ok": True, "rate": 20.0}
        assert stage.do("status")["rate"] == 20.0
        begun = len(stage.ticks) + 3  # what was on its way when the rate was changed
        until(lambda: len(stage.ticks) > begun + 12)
        taken = stage.ticks[begun : begun + 13]
        seconds = taken[-1].time - taken[0].time
        assert len(taken) - 1 <= 20.0 * seconds + 2.25 + 1e-6  # never more than was asked for
        until(lambda: stage.ticks[-1].mode is Mode.TRACKING)
        for wrong in (0, 5000, "fast", None, True):
            stage.refused("rate", "rate", rate=wrong)
        assert stage.do("status")["rate"] == 20.0
    finally:
        stage.do("rate", rate=50.0)


def test_the_status_tells_what_runs(stage):
    stage.do("method", method="joint_angle")
    seen = stage.do("status")
    used = [seen[name] for name in ("method", "preset", "hand")]
    assert used == ["joint_angle", "default", "mimic_p050"]
    assert (seen["sides"], seen["blind"], seen["busy"]) == (["right"], True, ["status"][:0])
    assert seen["source"]["state"] == "running"
    assert {sink["label"].split()[0] for sink in seen["sinks"]} == {"mujoco", "record"}
    assert (seen["operators"], seen["task"], seen["trial"]) == ({"right": None}, None, None)


def test_another_method_while_the_hand_moves(stage):
    first, before = len(stage.ticks), stage.loop.pipelines["right"].retargeter
    answer = stage.do("method", method="geort", preset="default")
    assert answer == {"ok": True, "method": "geort", "preset": "default"}
    assert stage.loop.pipelines["right"].retargeter is not before  # in force, not just asked for
    assert stage.do("status")["method"] == "geort"

    def by_geort(tick: Tick) -> bool:
        return tick.driver is not None and tick.driver.method == "geort"

    until(lambda: stage.ticks[-1].mode is Mode.TRACKING and by_geort(stage.ticks[-1]))
    ticks = stage.ticks[first:]
    assert [t.number for t in ticks] == list(range(ticks[0].number, ticks[-1].number + 1))
    assert {t.mode for t in ticks} <= {Mode.TRACKING, Mode.BLENDING, Mode.HOLDING}
    switched = next(i for i, t in enumerate(ticks) if by_geort(t))
    assert any(t.mode is Mode.BLENDING for t in ticks[switched:])
    assert all(t.driver and t.driver.method == "joint_angle" for t in ticks[:switched])
    assert "another method" in " ".join(ticks[switched].events)
    limit = stage.loop.config.limits.velocity
    assert max(np.abs(tick.velocity).max() for tick in ticks) <= limit + 1e-6
    # the same again: nothing is built, nothing blends
    same = stage.loop.pipelines["right"].retargeter
    assert stage.do("method", method="geort")["preset"] == "default"
    assert stage.loop.pipelines["right"].retargeter is same


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"method": "telepathy"}, "unknown method 'telepathy'"),
        ({"method": "geort", "preset": "no-such"}, "no-such"),
        ({}, "name the method"),
        ({"method": 3}, "expected a string, not 3"),
    ],
)
def test_a_method_that_is_none_is_refused_and_the_old_one_goes_on(stage, fields, words):
    before = stage.loop.pipelines["right"].retargeter
    stage.refused(words, "method", **fields)
    assert stage.loop.pipelines["right"].retargeter is before


def test_a_stop_is_answered_while_a_method_is_compiled(stage, monkeypatch):
    # A method that is used already needs no building: begin with another one than is asked for.
    stage.do("method", method="geort")
    go, warm_up = threading.Event(), Retargeter.warm_up

    def slow(retargeter: Retargeter) -> float:
        assert go.wait(PATIENCE_S)
        return warm_up(retargeter)

    monkeypatch.setattr(Retargeter, "warm_up", slow)
    monkeypatch.setattr(Retargeter, "compiled", property(lambda self: go.is_set()))
    hasty = RemoteTeleop(stage.teleop.address, 0.4)
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(hasty.request, "method", method="joint_angle")
        until(lambda: stage.do("status")["busy"] == ["method"])
        until(lambda: stage.switcher.building)
        assert stage.do("status")["building"] == "compiling joint_angle default"
        until(lambda: stage.do("status")["compiling"] == ["right"])
        assert stage.do("stop")["modes"] == {"right": "stopped"}
        assert stage.do("release")["ok"]
        time.sleep(1.0)  # longer than the silence that it puts up with
        assert not first.done()
        second = pool.submit(stage.do, "method", method="geort")
        with pytest.raises(RemoteRefusedError, match="another method was requested"):
            first.result(PATIENCE_S)
        go.set()
        assert second.result(PATIENCE_S)["method"] == "geort"
    assert stage.do("status")["busy"] == []
    until(lambda: stage.do("status")["compiling"] == [])


def test_a_method_that_cannot_be_built_is_said(stage, monkeypatch):
    def broken(*args: Any) -> Any:
        raise MemoryError("no room")

    used = stage.do("status")["method"]
    other = "joint_angle" if used == "geort" else "geort"
    with monkeypatch.context() as patched:
        patched.setattr(Retargeter, "warm_up", broken)
        stage.refused("MemoryError: no room", "method", method=other)
    assert stage.do("status")["method"] == used
    until(lambda: stage.do("status")["compiling"] == [])
    assert stage.do("method", method=other)["method"] == other


def test_an_operators_file_is_loaded_and_dropped(stage, tmp_path):
    def known() -> object:
        return stage.loop.pipelines["right"].retargeter.known_gaps

    path, left = tmp_path / "operator.json", tmp_path / "left.json"
    write_operator(path, OperatorProfile("right", {"index": 0.1}, "here"))
    write_operator(left, OperatorProfile("left"))
    assert stage.do("calibration", path=str(path))["side"] == "right"
    assert known() == {"index": 0.1}
    assert stage.do("status")["operators"] == {"right": "here"}
    stage.do("method", method="geort")
    assert known() == {"index": 0.1}  # it is the operator's, not the method's
    for bad, words in ((left, "no left hand"), (tmp_path / "no", "no such")):
        stage.refused(words, "calibration", path=str(bad))
    assert stage.do("status")["operators"] == {"right": "here"}
    stage.do("calibration")
    assert known() == {}


def test_the_record_knows_which_method_was_used_when(stage):
    for method in ("joint_angle", "geort"):
        stage.do("method", method=method)
        count = len(stage.ticks)
        until(lambda count=count: len(stage.ticks) > count + 5)
    path = stage.folder / "take.mcap"
    until(lambda: [m.method for m in read_log(path).methods][-2:] == ["joint_angle", "geort"])
    log = read_log(path)
    assert (log.methods[0].method, log.methods[0].preset) == ("joint_angle", "default")
    stamps = [use.stamp for use in log.methods]
    assert stamps == sorted(stamps)
    assert set(stamps) <= set(log.commands.stamps.tolist())
    assert stamps[0] == log.commands.stamps[0]
    # A switch that was recorded as an event has the stamp of that command.
    said = [
        log.commands.stamps[index]
        for index, words in log.loop.events.items()
        if "another method" in " ".join(words)
    ]
    assert said == stamps[1:]
    assert "model" in log.methods[-1].config


def test_blind_nothing_that_is_shown_names_the_method(stage):
    stage.do("method", method="joint_angle")
    with contextlib.suppress(RemoteRefusedError):
        stage.do("method", method="geort", preset="no-such")
    for word in (("method", "geort"), ("record",), ("record",)):
        stage.session.do(*word)
    shown = json.dumps(stage.session.look(text=True))
    assert not [name for name in method_names() if name in shown]
    assert '"default"' not in shown  # nor the preset
    open_eyed = session_of(stage.loop, stage.switcher)
    assert "joint_angle" in json.dumps(open_eyed.look(text=True))
    assert stage.do("status")["method"] == "joint_angle"  # whom the page asked in vain
    seen = stage.session.look(text=True)
    assert not {"method", "preset", "presets"} & set(seen["controls"])
    assert not {"solve", "total"} & set(seen["status"]["stages"])
    assert seen["hands"]["right"]["latched"] is None
    hands = {side: p.retargeter.hand for side, p in stage.loop.pipelines.items()}
    with serving() as server:
        panel = panel_of(server, hands, simulated=True, blind=True)
        panel.show(json.loads(json.dumps(seen)))
        texts = (panel._modes, panel._summary, panel._timing, panel._notice)
        shown = " ".join(text.content for text in texts)
        assert not [name for name in (*method_names(), "latches") if name in shown]
        assert not hasattr(panel, "_method")


def test_blind_the_terminal_does_not_name_it(capsys, tmp_path):
    record = tmp_path / "take.mcap"
    sinks = ["--sink", f"record:{record}", "table", "--control", "tcp://127.0.0.1:*"]
    method = ["--method", "joint_angle", "--blind", "--no-view", "--duration", "0.4"]
    with contextlib.suppress(SystemExit):
        main(["teleop", *method, *sinks])
    printed = "".join(capsys.readouterr())
    assert "compiling the method for mimic_p050" in printed
    assert "joint_angle" not in printed
    assert [use.method for use in read_log(record).methods] == ["joint_angle"]


def test_a_task_is_loaded_switched_and_left(stage):
    stage.refused("load one first", "trial", begin=True)
    first = len(stage.ticks)
    answer = stage.do("task", task="A")
    assert (answer["task"], answer["title"]) == ("card", "Card pickup")
    assert {"done", "dropped"} <= {line["name"] for line in answer["rubric"]}
    look = stage.session.look(text=False)["scenery"]
    assert {part["name"] for part in look["parts"]["right"]} == {"platform", "card"}
    assert len(look["poses"]["right"]) == 7
    axes = np.array(look["views"]["right"])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-4)
    again = stage.session.look(text=False, scenery=look["number"])["scenery"]
    assert "parts" not in again
    assert stage.do("status")["task"] == "card"
    stage.do("task", task="cube")
    look = stage.session.look(text=False, scenery=look["number"])["scenery"]
    assert "cube" in {part["name"] for part in look["parts"]["right"]}
    for bad, words in (("chess", "unknown task 'chess'"), (3, "expected a string")):
        stage.refused(words, "task", task=bad)
    assert stage.do("status")["task"] == "cube"
    assert stage.do("task")["task"] is None
    look = stage.session.look(text=False, scenery=look["number"])["scenery"]
    assert (look["parts"], look["poses"]) == ({}, {})
    numbers = [tick.number for tick in stage.ticks[first:]]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))  # no command was left out
    assert all(health.failed == 0 for health in stage.loop.sinks.health())


def test_a_trial_from_begin_to_record(stage):
    stage.do("task", task="screwdriver")
    ready = stage.do("trial")
    assert (ready["phase"], ready["elapsed_s"], ready["time_s"]) == ("ready", 0.0, None)
    stage.do("reset")  # no trial runs: the object is put back, and nothing is capped
    used = stage.do("status")["method"]
    begun = stage.do("trial", begin=True, about={"participant": "P07", "trial": 3})
    assert (begun["phase"], begun["number"], begun["resets"]) == ("running", 1, 0)
    stage.refused("running", "trial", begin=True)
    stage.refused("at the same time", "trial", begin=True, finish=True)
    until(lambda: stage.do("trial")["elapsed_s"] > 0.2)
    assert stage.do("reset")["resets"] == 1
    stage.refused("one reset", "reset")
    until(lambda: not stage.do("trial")["placed"])  # the object waits until the hand has left
    done = stage.do("trial", finish=True, side="right")
    result = [done[name] for name in ("phase", "ended", "line", "score")]
    assert result == ["done", "finished", "not-done", 0.0]
    assert stage.do("status")["trial"] == {k: v for k, v in done.items() if k != "ok"}
    assert done["time_s"] == done["elapsed_s"] > 0.2
    assert done["text"]
    path = stage.folder / "trials" / "screwdriver-001.npz"
    until(path.exists)
    about = read_trial(path).about
    assert about == {"participant": "P07", "trial": 3, "method": used}
    for fields, words in (
        ({"finish": True}, "no trial is running"),
        ({"side": "left"}, "no left hand"),
        ({"side": "up"}, "right or left"),
        ({"begin": True, "about": [1]}, "about: expected an object"),
    ):
        stage.refused(words, "trial", **fields)
    stage.do("trial", begin=True)
    assert stage.do("trial", cancel=True)["phase"] == "ready"
    assert len(stage.runner.outcomes["right"]) == 1
    until(lambda: any("is forgotten" in " ".join(t.events) for t in stage.ticks[-50:]))
    events = [event for tick in stage.ticks for event in tick.events]
    said = [event.replace(" of screwdriver", "") for event in events if event.startswith("trial ")]
    assert said == [
        "trial 1: begins",
        "trial 1: the object is put back",
        "trial 1: ends",
        "trial 2: begins",
        "trial 2: is forgotten",
    ]
    stage.do("trial", begin=True)
    stage.do("task", task="card")  # which forgets it
    assert stage.do("trial")["phase"] == "ready"
    assert len(stage.runner.outcomes["right"]) == 1
    stage.do("task")


def test_without_a_simulation_there_is_no_task(stage):
    handlers = RpcHandlers(stage.loop, stage.switcher)
    assert handlers.status()["task"] is None
    for word in ("task", "trial", "reset"):
        with pytest.raises(ConfigError, match="--task card or with --sink mujoco"):
            handlers.by_command[word]({})
    closed = Simulation()
    with pytest.raises(SinkError, match="not open"):
        closed.change_task("card")
    with pytest.raises(UnknownNameError, match="chess"):
        stage.runner.change("chess")


@contextlib.contextmanager
def answering(answer: bytes, address: str = "tcp://127.0.0.1:*") -> Iterator[str]:
    """Something that answers everything alike."""
    done = threading.Event()
    with zmq.Context() as context, context.socket(zmq.REP) as socket:
        socket.linger = 0
        socket.bind(address)

        def listen() -> None:
            while not done.is_set():
                if socket.poll(20):
                    socket.recv()
                    socket.send(answer)

        thread = threading.Thread(target=listen)
        thread.start()
        try:
            yield socket.last_endpoint.decode()
        finally:
            done.set()
            thread.join()


def test_a_teleoperation_may_end_and_be_started_again():
    with answering(b'{"ok": true, "n": 1}') as address:
        teleop = RemoteTeleop(address, 0.3)
        assert teleop.request("status") == {"ok": True, "n": 1}
    with pytest.raises(RemoteError, match=f"no answer from {address} within 0.3 s") as caught:
        teleop.request("method", method="sbr")
    assert not isinstance(caught.value, RemoteRefusedError)
    with answering(b'{"ok": true, "n": 2}', address):
        assert teleop.request("status")["n"] == 2


@pytest.mark.parametrize("answer", [b"hello", b"[1]", b"\xff"])
def test_something_else_that_answers_is_no_teleoperation(answer):
    with answering(answer) as address, pytest.raises(RemoteError, match="is not a running teleop"):
        RemoteTeleop(address, 5.0).request("status")


def test_a_client_that_is_asked_the_impossible_says_so(monkeypatch):
    for address, seconds, fields, words in (
        ("127.0.0.1:5558", 1.0, {}, "not a ZeroMQ address"),
        ("tcp://127.0.0.1:5558", 0.0, {}, "timeout_s"),
        ("tcp://no such:5558", 1.0, {}, "can't be reached"),
        ("tcp://127.0.0.1:1", 1.0, {"y": {1, 2}}, "can't be written as JSON"),
    ):
        with pytest.raises(ConfigError, match=words):
            RemoteTeleop(address, seconds).request("x", **fields)
    monkeypatch.setitem(sys.modules, "zmq", None)
    with pytest.raises(MissingExtraError, match="zmq"):
        RemoteTeleop("tcp://127.0.0.1:5558")


def test_many_threads_may_ask_at_once(stage):
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(stage.do, ["status"] * 40))
    assert {answer["hand"] for answer in answers} == {"mimic_p050"}

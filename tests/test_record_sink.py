"""The recording of a session: whole, of all ticks, and left readable by whatever ends it."""

import errno
import os
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_time import PATIENCE_S, until
from protobuf_log import rewritten
from ticks import make_tick, record

from smooth_operator import Hand, Retargeter, read_recording
from smooth_operator.errors import OutputError, RecordingError, SinkError
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.recording import Log, LogWriter, read_episode, read_log
from smooth_operator.teleop.recording.log_episode import write_log_episode
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.record import RecordSink
from smooth_operator.teleop.sinks.sink import SinkRunner
from smooth_operator.teleop.sinks.tick import Mode
from smooth_operator.teleop.sources.live import Mailbox


def test_all_of_a_session_comes_back(hand, tmp_path):
    ticks = [make_tick(hand, i, stamp=0.01 * i, at=50.0 + 0.01 * i) for i in range(30)]
    ticks += [
        make_tick(hand, 30 + i, at=50.3 + 0.01 * i, mode=Mode.HOLDING, frame=False)
        for i in range(20)
    ]
    ticks[30] = replace(ticks[30], events=("tracking -> holding",))
    ticks += [  # the tracker is started again, and its stamps with it
        make_tick(hand, 50 + i, stamp=0.01 * i, session=1, at=50.5 + 0.01 * i) for i in range(10)
    ]
    sink = record(tmp_path / "a.mcap", hand, ticks, {"method": "sbr", "rate": 100})
    sink.close()  # again
    assert sink.note == ""

    log = read_log(tmp_path / "a.mcap")
    assert log.truncated is False
    assert log.config == {"method": "sbr", "rate": 100}
    np.testing.assert_array_equal(
        log.commands.joint_positions, [t.command.joint_positions for t in ticks]
    )
    np.testing.assert_array_equal(log.loop.numbers, np.arange(60))
    assert log.loop.modes == tuple(t.mode.value for t in ticks)
    assert log.loop.events == {30: ("tracking -> holding",)}
    np.testing.assert_array_equal(log.loop.answers, [t.arrival is not None for t in ticks])
    np.testing.assert_array_equal(log.loop.times, [t.time for t in ticks])
    assert set(log.stages_ms) == {"tracker", "receive", "solve", "limit"}
    np.testing.assert_allclose(log.stages_ms["solve"], np.where(log.loop.answers, 1.25, np.nan))
    np.testing.assert_allclose(
        log.commands.latency_ms, np.where(log.loop.answers, 2.0, np.nan), atol=1e-9
    )
    # One clock for all: increasing, frames paired with their commands, differences the tracker's.
    assert (np.diff(log.commands.stamps) > 0).all()
    np.testing.assert_array_equal(log.recording.stamps, log.commands.stamps[log.loop.answers])
    np.testing.assert_allclose(np.diff(log.recording.stamps)[:29], 0.01, atol=1e-9)
    own = [t.arrival.frame.stamp for t in ticks if t.arrival is not None]
    np.testing.assert_array_equal(log.loop.tracker_stamps[log.loop.answers], own)


def test_late_frames_keep_their_distances(hand, tmp_path):
    """Ticks without a frame give way to frames that were measured before them."""
    rng = np.random.default_rng(3)
    stamps = 0.01 * np.arange(300) - rng.uniform(0, 0.006, 300)
    ticks = []
    for i, stamp in enumerate(stamps):
        at = 7.0 + 0.01 * i
        ticks.append(make_tick(hand, 2 * i, at=at - 0.003, frame=False))
        ticks.append(make_tick(hand, 2 * i + 1, at=at, stamp=stamp))
    record(tmp_path / "a.mcap", hand, ticks)
    log = read_log(tmp_path / "a.mcap")
    assert (np.diff(log.commands.stamps) > 0).all()
    off = np.abs(np.diff(log.recording.stamps) - np.diff(stamps))
    assert (off < 1e-9).mean() > 0.95
    assert off.max() < 0.006


def test_the_other_readers_take_a_live_log(hand, tmp_path):
    path = tmp_path / "a.mcap"
    ticks = [make_tick(hand, i, at=9.0 + 0.01 * i, frame=i % 4 != 0) for i in range(40)]
    record(path, hand, ticks)
    assert len(read_recording(path)) == 30
    episode = read_episode(path)
    assert len(episode.commands) == 40
    assert (episode.answered() >= 0).sum() == 30
    write_log_episode(tmp_path / "b.mcap", episode)
    again = read_log(tmp_path / "b.mcap")
    assert again.loop is None
    np.testing.assert_array_equal(again.commands.joint_positions, episode.commands.joint_positions)


def test_damaged_loop_messages_are_named(tmp_path, hand):
    record(tmp_path / "b.mcap", hand, [make_tick(hand)])

    def damaged(topic: str, message: Any) -> Any:
        return message.SerializeToString()[:-3] if topic == "/loop" else message

    path = rewritten(tmp_path / "b.mcap", tmp_path / "c.mcap", damaged)
    with pytest.raises(RecordingError, match=r"on /loop is not a valid smooth_operator\.Loop"):
        read_log(path)


def test_two_hands_and_numbered_takes(hands, tmp_path):
    folder = tmp_path / "takes"
    names = []
    for _ in range(3):
        sink = build_sink(f"record:{folder}")
        sink.open(hands, {})
        for side in hands:
            sink.send(make_tick(hands[side], 0))
        sink.close()
        names += [p.name for p in sink.paths]
    assert names == [f"take-00{n}.{s}.mcap" for n in (1, 2, 3) for s in ("right", "left")]
    for side in hands:
        recording = read_log(folder / f"take-002.{side}.mcap").recording
        assert recording.side == side
    one = record(folder, hands["right"], [])
    assert [p.name for p in one.paths] == ["take-004.mcap"]


def test_a_file_that_stands_there(hand, tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(OutputError, match="overwrite=true"):
        RecordSink(path).open({"right": hand}, {})
    assert path.read_bytes() == b"precious"
    sink = RecordSink(path, overwrite=True)
    sink.open({"right": hand}, {})
    sink.send(make_tick(hand, 0))
    sink.close()
    sink.open({"right": hand}, {})  # again, as after a failure: its own first part stays
    sink.send(make_tick(hand, 1))
    with pytest.raises(SinkError, match="already open"):
        sink.open({"right": hand}, {})
    sink.close()
    assert [p.name for p in sink.paths] == ["a.mcap", "a.part2.mcap"]
    for part, number in zip(sink.paths, (0, 1), strict=True):
        loop = read_log(part).loop
        assert loop.numbers.tolist() == [number]


def test_a_slow_disk_never_stops_the_loop_and_losses_are_told(hand, tmp_path, monkeypatch):
    gate, written = threading.Event(), []
    write = LogWriter.write_command

    def slow(self: LogWriter, *args: object, **more: object) -> None:
        gate.wait(PATIENCE_S)
        write(self, *args, **more)
        written.append(1)

    monkeypatch.setattr(LogWriter, "write_command", slow)
    sink = RecordSink(tmp_path / "a.mcap", buffer=10)
    sink.open({"right": hand}, {})
    for i in range(60):
        sink.send(make_tick(hand, i))  # while nothing can be written
    kept = 60 - int(sink.note.split()[0])
    gate.set()
    until(lambda: len(written) == kept)  # now there is room again
    sink.send(make_tick(hand, 60))
    sink.close()
    loop = read_log(tmp_path / "a.mcap").loop
    lost = 61 - len(loop.numbers)
    assert 10 < lost < 51
    assert sink.note.startswith(f"{lost} ticks are not recorded")
    told = [event for events in loop.events.values() for event in events]
    assert sum(int(event.split()[0]) for event in told) == lost


def test_disk_full_reaches_the_loop_once_and_recording_goes_on_in_another_file(
    hand, tmp_path, monkeypatch
):
    full = [False]
    flush = LogWriter.flush

    def may_fail(self: LogWriter, *, sync: bool = False) -> None:
        if full[0]:
            with self._writing():
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(self, sync=sync)

    monkeypatch.setattr(LogWriter, "flush", may_fail)
    sink = RecordSink(tmp_path / "a.mcap", flush_s=0.05)
    runner = SinkRunner([sink], retry_s=0.2)
    runner.open({"right": hand}, {"a": 1})
    number = 0

    def send_until(done: Callable[[], bool], ticks: int) -> None:
        nonlocal number
        end = number + ticks
        while number < end or not done():
            assert number < 10_000
            runner.observe(make_tick(hand, number))
            number += 1
            time.sleep(0.005)

    send_until(lambda: recorded(sink) > 10, 60)  # on the disk, with one flush at least
    full[0] = True
    send_until(lambda: runner.health()[0].failed >= 1, 40)
    (health,) = runner.health()
    assert "no space is left" in health.detail
    full[0] = False
    send_until(lambda: len(sink.paths) > 1, 120)
    runner.close()
    first, *more = sink.paths
    assert first.name == "a.mcap"
    assert more
    assert sorted(tmp_path.iterdir()) == sorted(sink.paths)  # what broke off empty is gone
    early, late = read_log(first).loop, read_log(more[-1]).loop
    assert len(early.numbers) > 10
    assert early.numbers.tolist() == list(range(len(early.numbers)))
    assert late.numbers[-1] == number - 1
    (health,) = runner.health()
    assert number == recorded(sink) + not_recorded(sink) + health.missed


def recorded(sink: RecordSink) -> int:
    """Ticks in all its files."""
    loops = [read_log(path).loop for path in sink.paths]
    return sum(len(loop.numbers) for loop in loops if loop is not None)


def not_recorded(sink: RecordSink) -> int:
    """Ticks that are not, as it says."""
    return int(sink.note.split()[0]) if sink.note else 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_killed_at_any_moment_all_but_the_last_second_is_there(tmp_path):
    """Five processes that record at 200 Hz, each killed at its own moment."""
    child = """
        import os, signal, sys, time
        from pathlib import Path
        sys.path.insert(0, sys.argv[2])
        from ticks import make_tick
        from smooth_operator.hands.registry import load_hand
        from smooth_operator.teleop.sinks.record import RecordSink
        hand = load_hand("mimic_p050")
        os.fsync = lambda _: None  # a busy disk is slow; only the process dies here
        for life in (0.02, 0.4, 0.9, 1.3, 1.6):
            if os.fork() == 0:
                path = Path(sys.argv[1]) / f"{life}.mcap"
                sink = RecordSink(path)
                sink.open({"right": hand}, {})
                number, now, stall = 0, time.perf_counter(), 0.0
                end = now + life
                while now < end:
                    sink.send(make_tick(hand, number))
                    number += 1
                    time.sleep(0.005)
                    before, now = now, time.perf_counter()
                    stall = max(stall, now - before)  # a busy machine
                path.with_suffix(".died").write_text(f"{number} {now} {stall}")
                os.kill(os.getpid(), signal.SIGKILL)
        for _ in range(5):
            os.wait()
    """
    program = [sys.executable, "-c", textwrap.dedent(child), tmp_path, Path(__file__).parent]
    subprocess.run(program, check=True, timeout=PATIENCE_S)
    notes = sorted(tmp_path.glob("*.died"))
    assert len(notes) == 5
    recorded = 0
    for note in notes:
        number, died, stall = map(float, note.read_text().split())
        log = read_log(note.with_suffix(".mcap"))
        assert log.truncated
        if log.loop is None:
            assert float(note.stem) < 1.0 + 2 * stall
            continue
        np.testing.assert_array_equal(log.loop.numbers, np.arange(len(log.loop.numbers)))
        assert len(log.loop.numbers) <= number
        assert died - log.loop.times[-1] < 1.0 + 2 * stall
        recorded += 1
    assert recorded


def _recorded(hand: Hand, path: Path, stamps: list[float]) -> Log:
    """The log of a tracker with these stamps, a frame every 10 ms; through mailbox and pipeline."""
    mailbox = Mailbox(clock=lambda: 0.0)
    retargeter = Retargeter(hand, method="joint_angle")
    pipeline = HandPipeline(retargeter, LoopConfig(rate=100.0), clock=lambda: now)
    operator = SyntheticOperator(seed=3, rate_hz=100).record(len(stamps) / 100)
    ticks = []
    for k, (frame, stamp) in enumerate(zip(operator, stamps, strict=True)):
        now = 50.0 + 0.01 * k
        mailbox.post(replace(frame, stamp=stamp), received=now)
        ticks.append(pipeline.step(now, mailbox.take("right")))
    record(path, hand, ticks)
    return read_log(path)


@pytest.mark.parametrize("jump", [1000.0, 5.0, -1000.0, 1e12, 1e300, float("inf"), float("nan")])
def test_one_bad_stamp_spoils_nothing(hand, tmp_path, jump):
    stamps = [7.0 + 0.01 * k for k in range(100)]
    stamps[40] += jump
    log = _recorded(hand, tmp_path / "a.mcap", stamps)
    assert len(log.commands) == 100
    np.testing.assert_allclose(np.diff(log.commands.stamps), 0.01, atol=1e-6)
    assert len(log.recording) == (100 if abs(jump) < 1e6 else 99)
    answered = np.flatnonzero(log.loop.answers) if log.loop is not None else np.empty(0)
    np.testing.assert_allclose(log.recording.stamps, 50.0 + 0.01 * answered, atol=1e-6)
    assert len(read_recording(tmp_path / "a.mcap")) == len(log.recording)
    found = log.stages_ms["tracker"][np.isfinite(log.stages_ms["tracker"])]
    assert found.max() < 1.0  # ms: the bad one is not taken for the fastest


def test_a_clock_that_is_set_while_it_runs_keeps_its_pace(hand, tmp_path):
    set_by = [0.0] * 30 + [3600.0] * 30 + [-3600.0] * 30
    stamps = [7.0 + 0.01 * k + by for k, by in enumerate(set_by)]
    log = _recorded(hand, tmp_path / "a.mcap", stamps)
    np.testing.assert_allclose(log.recording.stamps, 50.0 + 0.01 * np.arange(90), atol=1e-6)

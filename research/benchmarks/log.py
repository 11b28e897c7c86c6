"""Time to write and to read a log of a session, by the recorder.

    python research/benchmarks/log.py --frames 20000 --seconds 20

Three measurements:

- ``write``: the log writer alone, time of the processor for each frame with its command, timing,
  status and state of the loop, the chunk that it ends included.
- ``session``: ``record:FILE`` fed at 100 Hz for so many seconds, as by a live loop: time of the
  processor for each tick in the loop's thread and in the recorder's.
- ``read``: the whole log, as ``read_log`` gives it.

The hand moves as the built-in operator does; the robot is drawn for Foxglove.
"""

from __future__ import annotations

import gc
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))

from ticks import make_tick

from smooth_operator import load_hand
from smooth_operator.hands.hand import Hand
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.recording.log_reader import read_log
from smooth_operator.teleop.sinks import record as recorder
from smooth_operator.teleop.sinks.record import RecordSink
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator_research.run_report import BenchmarkError, Report

RATE = 100.0


@dataclass(frozen=True)
class Settings:
    """What to write and read.

    Attributes:
        frames: of the log that is written and read.
        repeats: how often it is written and read; the best is reported.
        seconds: length of the session at 100 Hz.
        hand: the robot hand.
        output: JSON file; build/benchmarks/log.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    frames: int = 20_000
    repeats: int = 3
    seconds: float = 20.0
    hand: str = "mimic_p050"
    output: Path | None = None
    compare: Path | None = None


def main(settings: Settings) -> None:
    report = Report("log", vars(settings))
    hand = load_hand(settings.hand)
    ticks = session(hand, max(settings.frames, round(settings.seconds * RATE)))
    written, live, read = [], [], []
    name = "Protocol Buffers"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        runs = [write(path, hand, ticks[: settings.frames]) for _ in range(settings.repeats)]
        spent, total = min(runs, key=lambda run: run[1])
        row = [spent.mean(), *np.percentile(spent, (50, 95, 99)), total / settings.frames]
        size = path.stat().st_size
        report.add(f"{name}/write", dict(zip(WRITE, row, strict=True)))
        written.append([name, *(1e3 * value for value in row)])
        tries = [timed(path, settings.frames) for _ in range(settings.repeats)]
        times = np.array(tries).min(axis=0)
        report.add(f"{name}/read", {"s": times[0], "cpu_s": times[1], "bytes": float(size)})
        read.append([name, *times, size / 1e6, size / settings.frames])
        rate = round(settings.seconds * RATE)
        loop, worker = record(Path(folder) / "s.mcap", hand, ticks[:rate])
        row = [loop.mean(), *np.percentile(loop, (50, 95, 99)), worker, loop.mean() + worker]
        report.add(f"{name}/session", dict(zip(SESSION, row, strict=True)))
        live.append([name, *(1e3 * value for value in row)])
    header = ("", "mean", "p50", "p95", "p99", "with its end")
    report.table(
        f"Writing {settings.frames} frames, best of {settings.repeats}: "
        "processor time of a frame [ms]",
        header,
        written,
    )
    header = ("", "loop mean", "p50", "p95", "p99", "recorder mean", "both")
    report.table(
        f"{settings.seconds:g} s at {RATE:g} Hz: processor time of a tick [ms]", header, live
    )
    report.table(
        f"Reading {settings.frames} frames, best of {settings.repeats}",
        ("", "time [s]", "of the processor [s]", "size [MB]", "bytes a frame"),
        read,
    )
    report.finish(settings.output, settings.compare)


WRITE = ("mean_s", "p50_s", "p95_s", "p99_s", "with_end_s")
SESSION = ("loop_mean_s", "loop_p50_s", "loop_p95_s", "loop_p99_s", "recorder_s", "both_s")


def session(hand: Hand, count: int) -> list[Tick]:
    """Ticks of a loop that follows the built-in operator; ten seconds, again and again."""
    frames = SyntheticOperator(seed=1, rate_hz=RATE).record(10.0)
    ticks = []
    for number in range(count):
        tick = make_tick(hand, number, at=50.0 + number / RATE, stamp=number / RATE)
        assert tick.arrival is not None
        frame = replace(frames[number % len(frames)], stamp=number / RATE)
        arrival = replace(tick.arrival, frame=frame)
        ticks.append(replace(tick, arrival=arrival))
    return ticks


def write(path: Path, hand: Hand, ticks: list[Tick]) -> tuple[np.ndarray, float]:
    """Processor time of each frame [s], and of all with opening and closing."""
    spent = np.empty(len(ticks))
    path.unlink(missing_ok=True)
    with quiet():
        begun = time.thread_time()
        log = recorder._HandLog(path, hand, {"hand": hand.name}, overwrite=False)
        for k, tick in enumerate(ticks):
            start = time.thread_time()
            log.write(tick, ())
            spent[k] = time.thread_time() - start
        log.close()
        return spent, time.thread_time() - begun


def record(path: Path, hand: Hand, ticks: list[Tick]) -> tuple[np.ndarray, float]:
    """Processor time of each tick in the loop's thread [s], and of one in the recorder's."""
    spent = np.empty(len(ticks))
    with quiet():
        sink = RecordSink(path)
        sink.open({"right": hand}, {"hand": hand.name})
        (thread,) = (one for one in threading.enumerate() if one.name == "record")
        assert thread.ident is not None
        clock = time.pthread_getcpuclockid(thread.ident)
        begun, due = time.clock_gettime(clock), time.perf_counter()
        for k, tick in enumerate(ticks):
            due += 1.0 / RATE
            time.sleep(max(due - time.perf_counter(), 0.0))
            start = time.thread_time()
            sink.send(tick)
            spent[k] = time.thread_time() - start
        time.sleep(1.0)  # two flushes: all is on the disk
        worker = time.clock_gettime(clock) - begun
        sink.close()
    log = read_log(path)
    if log.commands is None or len(log.commands) != len(ticks):
        raise BenchmarkError(f"{path.name}: ticks are missing")
    return spent, worker / len(ticks)


def timed(path: Path, count: int) -> tuple[float, float]:
    """Time to read a log, and that of the processor [s]."""
    start, begun = time.perf_counter(), time.process_time()
    log = read_log(path)
    spent = time.perf_counter() - start, time.process_time() - begun
    if log.recording is None or len(log.recording) != count:
        raise BenchmarkError(f"{path.name}: frames are missing")
    return spent


@contextmanager
def quiet() -> Iterator[None]:
    """Without the garbage collector, which would count to whichever frame it comes in."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))

"""Time to write and to read files: episodes, data sets and the log of a session, and their sizes.

    python research/benchmarks/files.py --frames 20000 --clips 2000

- Episodes: one synthetic episode in each format of ``smooth-operator convert``.
- Data sets: synthetic clips of two hands in each format of ``smooth-operator dataset``; one process
  writes clips that were made before the clock starts. The last column opens the finished folder
  again, as a run that goes on does.
- Log: ``record:FILE`` fed at 100 Hz as by a live loop: processor time of a tick in the loop's
  thread and in the recorder's.

A format whose extra is not installed is named as a gap.
"""

from __future__ import annotations

import gc
import resource
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from smooth_operator import HandRecording, Retargeter, SyntheticOperator
from smooth_operator.episode_files.lerobot import write_dataset
from smooth_operator.errors import MissingExtraError
from smooth_operator.formats.episode import Episode
from smooth_operator.lab.datasets.clip import SIDES, Clip, ObjectTrack, RobotClip
from smooth_operator.lab.datasets.writers.registry import WRITERS, WritingOptions
from smooth_operator.teleop.recording.convert import read_episode, write_episode
from smooth_operator.teleop.recording.log_reader import read_log
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.record import RecordSink
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import CommandTrajectory
from smooth_operator_research.run_report import (
    BenchmarkError,
    Report,
    ReportSettings,
    run_program,
)

EPISODES = {"npz": "e.npz", "HDF5": "e.h5", "LeRobot v3.0": "e", "MCAP": "e.mcap"}
"""Format -> name of its file or folder."""
JOINTS = tuple(f"joint_{i}" for i in range(20))
DIFFERENT = 40
"""Clips that differ; the others are these with other names and keys."""


@dataclass(frozen=True)
class Settings(ReportSettings):
    """What to write.

    Attributes:
        frames: number of frames of the episode, at 100 Hz; 0 leaves episodes out.
        clips: of each data set; 0 for no data sets.
        formats: of data sets; all built-in ones if left out.
        seconds: length of the session that is logged; 0 for no log.
    """

    frames: int = 20_000
    clips: int = 2000
    formats: tuple[str, ...] = ()
    seconds: float = 20.0


def main(settings: Settings) -> None:
    report = Report("files", vars(settings))
    if settings.frames:
        whole = episode(settings.frames)
        compare(
            report, f"An episode of {settings.frames} frames", tuple(EPISODES),
            lambda name, folder: episode_figures(whole, folder / EPISODES[name]),
        )  # fmt: skip
    if settings.clips:
        clips = [clip(number) for number in range(DIFFERENT)]
        compare(
            report, f"{settings.clips} clips of 2 to 20 s, two hands, one process",
            settings.formats or tuple(WRITERS.built_in),
            lambda name, folder: data_set_figures(name, folder / "out", clips, settings.clips),
        )  # fmt: skip
    if settings.seconds:
        compare(
            report, f"Processor time of a tick, {settings.seconds:g} s at 100 Hz", ("record",),
            lambda name, folder: log_figures(folder / "log.mcap", settings.seconds),
        )  # fmt: skip
    report.finish(settings.output, settings.compare)


def compare(
    report: Report,
    title: str,
    names: tuple[str, ...],
    measure: Callable[[str, Path], dict[str, float]],
) -> None:
    """Adds a table with a row for each format to the report."""
    rows: dict[str, dict[str, float]] = {}
    for name in names:
        try:
            with tempfile.TemporaryDirectory() as folder:
                rows[name] = measure(name, Path(folder))
        except MissingExtraError as error:
            report.notes.append(f"{name}: not measured; {error}")
            continue
        report.add(name, rows[name])
    columns = next(iter(rows.values()), {})
    report.table(title, ("format", *columns), [[n, *own.values()] for n, own in rows.items()])


def episode(frames: int) -> Episode:
    """A hand with metacarpals and orientations, the commands for it and two stage times."""
    hand = SyntheticOperator().record((frames + 0.5) / 100)[:frames]
    rng = np.random.default_rng(0)
    hand = replace(
        hand,
        metacarpals=rng.normal(0.0, 0.02, (frames, 4, 3)),
        orientations=rng.normal(size=(frames, 21, 4)),
    )
    commands = CommandTrajectory(
        rng.normal(size=(frames, len(JOINTS))), JOINTS, hand.stamps,
        rng.uniform(0.1, 2.0, frames), np.zeros(frames, np.int8),
    )  # fmt: skip
    stages = {name: rng.uniform(0.1, 1.0, frames) for name in ("align", "solve")}
    return Episode(hand, commands, stages_ms=stages)


def episode_figures(whole: Episode, path: Path) -> dict[str, float]:
    """Seconds to write and to read an episode, and megabytes of its files."""
    started = time.perf_counter()
    if path.suffix:
        write_episode(path, whole)
    else:
        write_dataset(path, [lambda: whole])
    written = time.perf_counter()
    back = read_episode(path)
    done = time.perf_counter()
    if len(back) != len(whole):
        raise BenchmarkError(f"{path.name}: {len(back)} of {len(whole)} frames came back")
    return {"write_s": written - started, "read_s": done - written, "size_mb": size(path) / 1e6}


def size(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    files = [path] if path.is_file() else [one for one in path.rglob("*") if one.is_file()]
    return sum(one.stat().st_size for one in files)


def clip(number: int) -> RobotClip:
    """Two hands that move, as retargeted, with a camera and one object."""
    rng = np.random.default_rng(number)
    frames = int(rng.integers(60, 601))
    stamps = np.arange(frames) / 30.0
    points = SyntheticOperator().record((frames + 0.5) / 100).landmarks[:frames]
    hands, commands, wrists = {}, {}, {}
    for side in SIDES:
        wrist = wrists[side] = movement(stamps, rng)
        placed = points * ([1, 1, 1] if side == "right" else [-1, 1, 1]) + wrist[:, None, :3]
        hands[side] = HandRecording(
            placed + rng.normal(0.0, 0.0005, placed.shape), stamps, side, T_world_wrist=wrist,
            world="room", name=f"clip {number}",
        )  # fmt: skip
        phase = rng.uniform(0.0, 6.0, 20) + stamps[:, None] * rng.uniform(0.5, 3, 20)
        commands[side] = CommandTrajectory(
            0.8 + 0.7 * np.sin(phase), JOINTS, stamps, np.full(frames, 0.3), np.zeros(frames, int)
        )
    scene = Clip(
        f"clip/{number}", hands, "synthetic", task=f"task {number % 10}",
        confidence={side: rng.uniform(0.5, 1.0, frames) for side in SIDES},
        T_world_camera=movement(stamps, rng), objects=(ObjectTrack("cup", movement(stamps, rng)),),
    )  # fmt: skip
    return RobotClip(
        scene, commands, dict.fromkeys(SIDES, "mimic_p050"), wrists,
        {side: np.ones(frames, bool) for side in SIDES}, figures={"jump_mm": 1.0},
        config={"method": "smooth", "preset": "live", "seed": 0}, key=f"{number:064x}",
    )  # fmt: skip


def movement(stamps: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(T, 7) poses of something that is carried around."""
    speed = rng.uniform(0.3, 2, 3)
    place = 0.3 * np.sin(rng.uniform(0, 6, 3) + stamps[:, None] * speed) + [0, 0, 1]
    half = 0.4 * np.sin(rng.uniform(0, 6) + stamps * rng.uniform(0.3, 2))[:, None]
    axis = rng.normal(size=3)
    return np.concatenate([place, np.cos(half), np.sin(half) * axis / np.linalg.norm(axis)], 1)


def all_clips(clips: list[RobotClip], count: int) -> Iterator[RobotClip]:
    for number in range(count):
        one = clips[number % len(clips)]
        yield replace(one, clip=replace(one.clip, name=f"clip/{number}"), key=f"{number:064x}")


def data_set_figures(
    name: str, output: Path, clips: list[RobotClip], count: int
) -> dict[str, float]:
    """Speed, size and peak memory of one format of data sets."""
    if name == "flashdex":  # which needs a mesh for each object
        mesh = output.parent / "cup.obj"
        mesh.write_text(
            "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4"
        )
        clips = [
            replace(one, clip=replace(one.clip, objects=(replace(one.clip.objects[0], mesh=mesh),)))
            for one in clips
        ]
    frames = sum(len(one.clip) for one in all_clips(clips, count))
    started, cpu = time.perf_counter(), time.process_time()
    with WRITERS.load(name).open(output, WritingOptions()) as writer:
        for one in all_clips(clips, count):
            writer.write(one)
    seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
    started = time.perf_counter()
    again = WRITERS.load(name).open(output, WritingOptions())
    opened = time.perf_counter() - started
    if len(again.written) != count:
        raise BenchmarkError(f"{name}: {len(again.written)} of {count} clips stand in the folder")
    return {
        "clips_per_s": count / seconds,
        "cpu_ms_per_clip": 1000.0 * cpu / count,
        "frames_per_s": frames / seconds,
        "bytes_per_frame": size(output) / frames,
        "files": sum(path.is_file() for path in output.rglob("*")),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "open_again_s": opened,
    }


def log_figures(path: Path, seconds: float) -> dict[str, float]:
    """Processor time of a tick in both threads [ms], size of the log and time to read it."""
    retargeter = Retargeter("mimic_p050", method="joint_angle")
    pipeline = HandPipeline(retargeter, LoopConfig(), clock=lambda: 0.0)
    ticks = [
        pipeline.step(50.0 + frame.stamp, Arrival(frame, 50.0 + frame.stamp, 0))
        for frame in SyntheticOperator(seed=1, rate_hz=100.0).record(seconds)
    ]
    sink = RecordSink(path)
    sink.open({"right": retargeter.hand}, {"hand": "mimic_p050"})
    (thread,) = (one for one in threading.enumerate() if one.name == "record")
    assert thread.ident is not None
    clock = time.pthread_getcpuclockid(thread.ident)
    gc.collect()
    gc.disable()  # it would count to whichever tick it comes in
    begun, due, spent = time.clock_gettime(clock), time.perf_counter(), []
    for tick in ticks:
        due += 0.01
        time.sleep(max(due - time.perf_counter(), 0.0))
        start = time.thread_time()
        sink.send(tick)
        spent.append(1e3 * (time.thread_time() - start))
    time.sleep(1.0)  # two flushes: all is on the disk
    recorder = 1e3 * (time.clock_gettime(clock) - begun) / len(ticks)
    sink.close()
    gc.enable()
    start = time.perf_counter()
    log = read_log(path)
    if log.commands is None or len(log.commands) != len(ticks):
        raise BenchmarkError(f"{path.name}: ticks are missing")
    p50, p99 = np.percentile(spent, (50, 99))
    return {
        "loop_mean_ms": float(np.mean(spent)), "loop_p50_ms": float(p50),
        "loop_p99_ms": float(p99), "recorder_ms": recorder,
        "read_s": time.perf_counter() - start, "size_mb": size(path) / 1e6,
    }  # fmt: skip


if __name__ == "__main__":
    run_program(main, Settings, __doc__)

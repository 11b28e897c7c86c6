"""Clips a second and bytes a frame of each format of output of data sets.

    python research/benchmarks/dataset_writers.py --clips 2000

The clips are synthetic, of 2 to 20 s at 30 Hz: two hands of 20 joints, wrists, landmarks with half
a millimetre of noise, a camera, one object. They are made before the clock starts, and one process
writes them. The last column opens the finished folder again, as a run that goes on does.
"""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from smooth_operator import HandRecording, SmoothOperatorError, SyntheticOperator
from smooth_operator.errors import MissingExtraError
from smooth_operator.lab.datasets.clip import SIDES, Clip, ObjectTrack, RobotClip
from smooth_operator.lab.datasets.writers.registry import WRITERS, WritingOptions
from smooth_operator.types import CommandTrajectory
from smooth_operator_research.run_report import BenchmarkError, Report

RATE = 30.0
JOINTS = tuple(f"joint_{i}" for i in range(20))


@dataclass(frozen=True)
class Settings:
    """What to write.

    Attributes:
        clips: how many.
        formats: which; all built-in ones if left out.
        different: how many clips are different; the others are these with other names and keys.
        output: JSON file; build/benchmarks/dataset_writers.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    clips: int = 2000
    formats: tuple[str, ...] = ()
    different: int = 40
    output: Path | None = None
    compare: Path | None = None


def main(settings: Settings) -> None:
    report = Report("dataset_writers", vars(settings))
    clips = [clip(number) for number in range(settings.different)]
    rows = []
    for name in settings.formats or tuple(WRITERS.built_in):
        try:
            with tempfile.TemporaryDirectory() as folder:
                figures = measured(name, Path(folder) / "out", clips, settings.clips)
        except MissingExtraError as error:
            report.notes.append(f"{name}: not measured; {error}")
            continue
        report.add(name, figures)
        rows.append([name, *figures.values()])
    report.table(
        f"{settings.clips} clips of 2 to 20 s, two hands, one process",
        ("format", "clips/s", "CPU ms a clip", "frames/s", "bytes a frame", "files", "peak MB",
         "open again [s]"),
        rows,
    )  # fmt: skip
    report.finish(settings.output, settings.compare)


def clip(number: int) -> RobotClip:
    """Two hands that move, as retargeted."""
    rng = np.random.default_rng(number)
    frames = int(rng.integers(60, 601))
    stamps = np.arange(frames) / RATE
    operator = SyntheticOperator().record((frames + 0.5) / 100)
    points = operator.landmarks[:frames]
    hands, commands, wrists = {}, {}, {}
    for side in SIDES:
        wrist = movement(stamps, rng)
        wrists[side] = wrist
        placed = points * ([1, 1, 1] if side == "right" else [-1, 1, 1]) + wrist[:, None, :3]
        noise = rng.normal(0.0, 0.0005, placed.shape)
        hands[side] = HandRecording(
            placed + noise, stamps, side, T_world_wrist=wrist, world="room", name=f"clip {number}"
        )
        phase = rng.uniform(0.0, 6.0, len(JOINTS)) + stamps[:, None] * rng.uniform(
            0.5, 3, len(JOINTS)
        )
        commands[side] = CommandTrajectory(
            0.8 + 0.7 * np.sin(phase), JOINTS, stamps, np.full(frames, 0.3), np.zeros(frames, int)
        )
    scene = Clip(
        f"clip/{number}",
        hands,
        "synthetic",
        task=f"task {number % 10}",
        confidence={side: rng.uniform(0.5, 1.0, frames) for side in SIDES},
        T_world_camera=movement(stamps, rng),
        objects=(ObjectTrack("cup", movement(stamps, rng)),),
    )
    return RobotClip(
        scene,
        commands,
        dict.fromkeys(SIDES, "mimic_p050"),
        wrists,
        {side: np.ones(frames, bool) for side in SIDES},
        figures={"jump_mm": 1.0},
        config={"method": "smooth", "preset": "live", "seed": 0},
        key=f"{number:064x}",
    )


def movement(stamps: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(T, 7) poses of something that is carried around."""
    place = 0.3 * np.sin(rng.uniform(0, 6, 3) + stamps[:, None] * rng.uniform(0.3, 2, 3)) + [
        0,
        0,
        1,
    ]
    half = 0.4 * np.sin(rng.uniform(0, 6) + stamps * rng.uniform(0.3, 2))[:, None]
    axis = rng.normal(size=3)
    return np.concatenate([place, np.cos(half), np.sin(half) * axis / np.linalg.norm(axis)], 1)


def all_clips(clips: list[RobotClip], count: int) -> Iterator[RobotClip]:
    for number in range(count):
        one = clips[number % len(clips)]
        yield replace(one, clip=replace(one.clip, name=f"clip/{number}"), key=f"{number:064x}")


def measured(name: str, output: Path, clips: list[RobotClip], count: int) -> dict[str, float]:
    """Figures of one format."""
    if name == "flashdex":  # which needs a mesh for each object
        mesh = output.parent / "cup.obj"
        corners = [(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
        faces = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
        mesh.write_text("".join([f"v {x} {y} {z}\n" for x, y, z in corners]
                                + [f"f {face}\n" for face in faces]))  # fmt: skip
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
    files = [path for path in output.rglob("*") if path.is_file()]
    return {
        "clips_per_s": count / seconds,
        "cpu_ms_per_clip": 1000.0 * cpu / count,
        "frames_per_s": frames / seconds,
        "bytes_per_frame": sum(path.stat().st_size for path in files) / frames,
        "files": len(files),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "open_again_s": opened,
    }


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error

"""Time to write and to read an episode in each format of ``smooth-operator convert``, and its size.

    python research/benchmarks/conversion.py --frames 20000

The episode is synthetic: landmarks, metacarpals, orientations, 20 joints and two stage times. A
format whose extra is not installed is named as a gap.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from smooth_operator import HandRecording, SmoothOperatorError
from smooth_operator.episode_files.lerobot import write_dataset
from smooth_operator.errors import MissingExtraError
from smooth_operator.formats.episode import Episode
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.recording.convert import read_episode, write_episode
from smooth_operator.types import CommandTrajectory
from smooth_operator_research.run_report import BenchmarkError, Report

FORMATS = {"`.npz`": "e.npz", "HDF5": "e.h5", "LeRobot v3.0": "e", "MCAP": "e.mcap"}
"""Format -> name of its file or folder."""
JOINTS = 20


@dataclass(frozen=True)
class Settings:
    """What to convert.

    Attributes:
        frames: of the episode, at 100 Hz.
        repeats: how often; medians are reported.
        output: JSON file; build/benchmarks/conversion.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    frames: int = 20_000
    repeats: int = 1
    output: Path | None = None
    compare: Path | None = None


def main(settings: Settings) -> None:
    report = Report("conversion", vars(settings))
    whole = episode(settings.frames)
    rows = []
    for name, file in FORMATS.items():
        figures = []
        try:
            for _ in range(settings.repeats):
                with tempfile.TemporaryDirectory() as folder:
                    figures.append(measured(whole, Path(folder) / file))
        except MissingExtraError as error:
            report.notes.append(f"{name}: not measured; {error}")
            continue
        middle = {key: float(np.median([one[key] for one in figures])) for key in figures[0]}
        report.add(name.strip("`"), middle)
        rows.append([name, *middle.values()])
    report.table(
        f"{settings.frames} frames, medians of {settings.repeats}",
        ("format", "write [s]", "read [s]", "size [MB]"),
        rows,
    )
    report.finish(settings.output, settings.compare)


def episode(frames: int) -> Episode:
    """A hand and the commands for it."""
    hand = SyntheticOperator().record((frames + 0.5) / 100)[:frames]
    rng = np.random.default_rng(0)
    hand = HandRecording(
        hand.landmarks,
        hand.stamps,
        hand.side,
        metacarpals=rng.normal(0.0, 0.02, (frames, 4, 3)),
        orientations=rng.normal(size=(frames, 21, 4)),
    )
    commands = CommandTrajectory(
        rng.normal(size=(frames, JOINTS)),
        tuple(f"joint_{i}" for i in range(JOINTS)),
        hand.stamps,
        rng.uniform(0.1, 2.0, frames),
        np.zeros(frames, np.int8),
    )
    stages = {name: rng.uniform(0.1, 1.0, frames) for name in ("align", "solve")}
    return Episode(hand, commands, stages_ms=stages)


def measured(whole: Episode, path: Path) -> dict[str, float]:
    """Seconds to write and to read, and megabytes of the result."""
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
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    size = sum(file.stat().st_size for file in files)
    return {"write_s": written - started, "read_s": done - written, "size_mb": size / 1e6}


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error

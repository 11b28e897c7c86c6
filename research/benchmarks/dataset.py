"""Frames a second over a folder of recordings: by one process, a pool, and Ray on this machine.

    python research/benchmarks/dataset.py --workers 2

Start-up (processes, imports, compiling) is what the same folder takes with two frames in each
recording. JAX's compilation cache is filled beforehand. ``batch.py`` measures recordings side by
side in one process, and methods against each other.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from smooth_operator import SmoothOperatorError
from smooth_operator.errors import MissingExtraError
from smooth_operator.lab.offline.folder import retarget_all, survey
from smooth_operator.parallel import usable_cores as cores
from smooth_operator.planning import make_request
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator_research.run_report import BenchmarkError, Report


@dataclass(frozen=True)
class Settings:
    """What to run.

    Attributes:
        ways: of one (this process alone), pool, ray.
        workers: of pool and ray; as many as there are cores unless given.
        recordings: how many, equally long; four for each worker at least.
        seconds: length of each, at 100 Hz [s].
        repeats: how often; medians are reported.
        hand: robot hand.
        method: retargeting method.
        preset: of the method.
        output: JSON file; build/benchmarks/dataset.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    ways: tuple[str, ...] = ("one", "pool", "ray")
    workers: int | None = None
    recordings: int = 24
    seconds: float = 30.0
    repeats: int = 3
    hand: str = "mimic_p050"
    method: str = "sbr"
    preset: str | None = None
    output: Path | None = None
    compare: Path | None = None


def main(settings: Settings) -> None:
    ways = [way for way in settings.ways if way]
    if unknown := {*ways} - {"one", "pool", "ray"}:
        raise BenchmarkError(f"unknown ways {sorted(unknown)}; there are one, pool and ray")
    if settings.recordings < 4 * (settings.workers or cores()):
        raise BenchmarkError("recordings must be four for each worker at least")
    report = Report("dataset", vars(settings))
    if ways:
        with tempfile.TemporaryDirectory() as at:
            throughput(report, settings, ways, Path(at))
    report.finish(settings.output, settings.compare)


def throughput(report: Report, settings: Settings, ways: list[str], at: Path) -> None:
    workers = settings.workers or cores()
    frames = 0
    for i in range(settings.recordings):
        recording = SyntheticOperator(seed=i).record(settings.seconds)
        frames += len(recording)
        for name, part in (("recordings", recording), ("short", recording[:2])):
            path = at / name / f"{i:04d}.npz"
            path.parent.mkdir(exist_ok=True)
            np.savez(path, landmarks=part.landmarks, timestamps=part.stamps, side="right")
    request = make_request(hand=settings.hand, method=settings.method, preset=settings.preset)
    options: dict[str, dict[str, Any]] = {
        "one": {"workers": 0},
        "pool": {"workers": workers},
        "ray": {"workers": workers, "cluster": "local"},
    }
    digests: set[str] = set()
    times: dict[str, list[dict[str, float]]] = {way: [] for way in ways}

    def seconds(way: str, source: str) -> tuple[float, str]:
        with tempfile.TemporaryDirectory(dir=at) as output:
            todo = survey(at / source, Path(output), request)
            started = time.perf_counter()
            for entry in retarget_all(todo.jobs, **options[way]):
                if entry.reason is not None:
                    raise BenchmarkError(f"{entry.name}: {entry.reason}")
            total = time.perf_counter() - started
            content = b"".join(file.read_bytes() for file in sorted(Path(output).glob("*.npz")))
        return total, hashlib.sha256(content).hexdigest()

    def run(way: str) -> dict[str, float]:
        total, digest = seconds(way, "recordings")
        startup, _ = seconds(way, "short")
        digests.add(digest)
        return {"total_s": total, "work_s": total - startup, "startup_s": startup}

    for way in list(ways):  # fills the cache, and builds what later runs of 'one' find built
        try:
            run(way)
        except MissingExtraError as error:
            report.notes.append(f"{way}: not measured; {error}")
            ways.remove(way)
    for _ in range(settings.repeats):  # in turn, so that noise hits all alike
        for way in ways:
            times[way].append(run(way))
    rows = []
    for way in ways:
        middle = {k: float(np.median([r[k] for r in times[way]])) for k in times[way][0]}
        middle["frames_per_s"] = frames / middle["work_s"]
        middle["frames_per_s_with_startup"] = frames / middle["total_s"]
        report.add(way, middle)
        count = 1 if way == "one" else workers
        rows.append([way, count, *middle.values()])
    report.table(
        f"{settings.recordings} recordings, {frames} frames, medians of {settings.repeats}",
        ("way", "workers", "total [s]", "work [s]", "start-up [s]", "frames/s", "with start-up"),
        rows,
    )
    report.figures["different_results"] = float(len(digests))
    report.notes.append(
        "all ways gave the same bytes" if len(digests) == 1 else f"{len(digests)} DIFFERENT results"
    )
    report.notes.append("'one' is compiled before: its start-up is that of reading and writing")


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error

"""Frames a second over a folder of recordings: by one process, a pool, and Ray on this machine.

    python benchmarks/dataset.py --workers 2
    python benchmarks/dataset.py --ways "" --batches 256 1024 4096     # on a GPU

Start-up (processes, imports, compiling) is told apart from the work itself by the pace at which
results come once every worker has had two. JAX's compilation cache is filled beforehand. The
second table is about one process: frames through the compiled program one by one, 64 at a time, and
as a batch of recordings side by side, which on a GPU is the way to fill it.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from smooth_operator import HandRecording, Retargeter, SmoothOperatorError
from smooth_operator.errors import MissingExtraError
from smooth_operator.lab.offline.dataset import retarget_all, survey
from smooth_operator.lab.offline.scan import CHUNK, Scan
from smooth_operator.methods.program import compiled, frame_step
from smooth_operator.parallel import usable_cores as cores
from smooth_operator.planning import make_request
from smooth_operator.reporting.run_report import BenchmarkError, Report
from smooth_operator.synthetic import SyntheticOperator


@dataclass(frozen=True)
class Settings:
    """What to run.

    Attributes:
        ways: of one (this process alone), pool, ray.
        workers: of pool and ray; as many as there are cores unless given.
        recordings: how many, equally long; four for each worker at least.
        seconds: length of each, at 100 Hz [s].
        repeats: how often; medians are reported.
        batches: how many recordings side by side in one process.
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
    batches: tuple[int, ...] = (8,)
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
    one_process(report, settings)
    report.finish(settings.output, settings.compare)


def throughput(report: Report, settings: Settings, ways: list[str], at: Path) -> None:
    workers = settings.workers or cores()
    for i in range(settings.recordings):
        recording = SyntheticOperator(seed=i).record(settings.seconds)
        path = at / "recordings" / f"{i:04d}.npz"
        path.parent.mkdir(exist_ok=True)
        np.savez(path, landmarks=recording.landmarks, timestamps=recording.stamps, side="right")
    frames = settings.recordings * len(recording)
    asked = make_request(hand=settings.hand, method=settings.method, preset=settings.preset)
    options: dict[str, dict[str, Any]] = {
        "one": {"workers": 0},
        "pool": {"workers": workers},
        "ray": {"workers": workers, "cluster": "local"},
    }
    digests: set[str] = set()
    found: dict[str, list[dict[str, float]]] = {way: [] for way in ways}

    def run(way: str) -> dict[str, float]:
        settled = 2 * (1 if way == "one" else workers)
        with tempfile.TemporaryDirectory(dir=at) as output:
            todo = survey(path.parent, Path(output), asked)
            started, times = time.perf_counter(), []
            for entry in retarget_all(todo.jobs, **options[way]):
                if entry.reason is not None:
                    raise BenchmarkError(f"{entry.name}: {entry.reason}")
                times.append(time.perf_counter() - started)
            total = time.perf_counter() - started
            content = b"".join(file.read_bytes() for file in sorted(Path(output).glob("*.npz")))
        digests.add(hashlib.sha256(content).hexdigest())
        pace = (times[-1] - times[settled - 1]) / (len(times) - settled)
        work = pace * len(times)
        return {"total_s": total, "work_s": work, "startup_s": total - work}

    for way in list(ways):  # fills the cache, and builds what later runs of 'one' find built
        try:
            run(way)
        except MissingExtraError as error:
            report.notes.append(f"{way}: not measured; {error}")
            ways.remove(way)
    for _ in range(settings.repeats):  # in turn, so that noise hits all alike
        for way in ways:
            found[way].append(run(way))
    rows = []
    for way in ways:
        middle = {k: float(np.median([r[k] for r in found[way]])) for k in found[way][0]}
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


def one_process(report: Report, settings: Settings) -> None:
    """Frame by frame, in chunks, and in batches; on JAX's default device."""
    retargeter = Retargeter(settings.hand, method=settings.method, preset=settings.preset)
    recording = SyntheticOperator().record(settings.seconds)

    def loop() -> np.ndarray:
        return retargeter.run(recording)[0].joint_positions

    reference = loop()
    rows: list[list[object]] = [["one by one", 1, *timed(report, "loop", recording, 1, loop), 0.0]]
    if retargeter.method.host is not None:
        report.notes.append("the solver of this method runs on the host: no chunks, no batches")
    else:
        scan = Scan(retargeter)
        figures = timed(
            report, "scan", recording, 1, lambda: scan.run(recording)[0].joint_positions
        )
        apart = np.abs(scan.run(recording)[0].joint_positions - reference).max()
        rows.append([f"{CHUNK} at a time", 1, *figures, float(apart)])
        for size in settings.batches:
            batch = Batch(retargeter, recording, size)
            figures = timed(report, f"batch {size}", recording, size, batch.run)
            apart = np.abs(batch.run() - reference).max()
            report.figures[f"batch {size}/apart_rad"] = float(apart)
            rows.append(["batch", size, *figures, float(apart)])
    report.table(
        "One process, one recording or several side by side",
        ("way", "recordings", "frames/s", "µs a frame", "largest difference [rad]"),
        rows,
    )


class Batch:
    """As many recordings as one likes in one program: a scan over time of a map over recordings."""

    def __init__(self, retargeter: Retargeter, recording: HandRecording, size: int) -> None:
        self._hand = retargeter.hand
        step = frame_step(retargeter.shared.method, retargeter.config.alignment)  # type: ignore[arg-type]

        def program(state: Any, landmarks: Any, valid: Any) -> Any:
            def frame(carry: Any, now: Any) -> Any:
                carry, answer = jax.vmap(step)(carry, *now)
                return carry, answer.q

            return jax.lax.scan(frame, state, (landmarks, valid))[1]

        self._program = compiled(program)
        initial = retargeter.init()
        self._state = jax.tree.map(lambda leaf: jnp.stack([leaf] * size), initial)
        # All the same, so that each can be held against the reference.
        landmarks = np.asarray(recording.landmarks, np.float32)
        self._landmarks = np.repeat(landmarks[:, None], size, axis=1)
        self._valid = np.repeat(np.asarray(recording.valid)[:, None], size, axis=1)

    def run(self) -> np.ndarray:
        """Commands of the last recording, (T, n)."""
        q = np.asarray(self._program(self._state, self._landmarks, self._valid), float)[:, -1]
        limits = self._hand.limits
        expanded: np.ndarray = self._hand.full_configuration(np.clip(q, limits[:, 0], limits[:, 1]))
        return expanded


def timed(
    report: Report, name: str, recording: HandRecording, size: int, run: Callable[[], np.ndarray]
) -> tuple[float, float]:
    """Frames a second, and microseconds a frame; the best of three after a warm-up."""
    run()
    times = []
    for _ in range(3):
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    per_frame = min(times) / (len(recording) * size)
    report.add(name, {"frames_per_s": 1.0 / per_frame, "us_per_frame": per_frame * 1e6})
    return 1.0 / per_frame, per_frame * 1e6


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error

"""Frames alone and recordings side by side on JAX's default device, such as a GPU.

    python research/benchmarks/gpu.py                    # on a GPU; gpu.sh installs wheels before
    python research/benchmarks/gpu.py --samples 1024 --batches smooth:teleop:8:100     # on a CPU

Commands of preset ``paper`` are compared with a CPU's. Batches are those of ``BatchRetargeter``,
as arrays and as an object for each recording. The GPU's busy time is what ``nvidia-smi`` samples
while batches run one after another.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from smooth_operator import HandFrame, Retargeter
from smooth_operator.errors import ConfigError
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator_research.run_report import (
    BenchmarkError,
    Report,
    ReportSettings,
    child_json,
    operator_frames,
    percentiles,
    retargeter_of,
    run_program,
)

MOTIONS = 32
COMPARED = 50
"""Number of frames that are compared with those of the CPU."""


QUERY = ("--query-gpu=utilization.gpu", "--format=csv,noheader,nounits", "-lms", "250")
"""Options of ``nvidia-smi`` that print the share of time with a running kernel, four times a
second."""


@dataclass(frozen=True)
class Settings(ReportSettings):
    """Settings of a run.

    Attributes:
        samples: N of Algorithm 1; the preset's 8192 unless given.
        cycles: L; the preset's 20 unless given.
        frames: how many frames.
        batches: METHOD:PRESET:LANES:FRAMES of each batch.
        repeats: runs of each batch; the median is reported.
        hand: built-in robot hand.
        commit: revision of the code, where it is no clone.
        commands: only save the first commands of preset ``paper`` in this file (.npy).
    """

    samples: int = 8192
    cycles: int = 20
    frames: int = 200
    batches: tuple[str, ...] = (
        "smooth:teleop:2048:300",
        "sbr:paper:256:60",
        "sbr:realtime:4096:100",
    )
    repeats: int = 5
    hand: str = "mimic_p050"
    commit: str = ""
    commands: Path | None = None


def main(settings: Settings) -> None:
    report = Report("gpu", vars(settings))
    ours = retargeter_of(settings.hand, "sbr:paper")
    if not isinstance(ours.config, SbrConfig):
        raise ConfigError(f"preset 'paper' must be an SbrConfig, not {type(ours.config).__name__}")
    sampling = replace(ours.config.sampling, samples=settings.samples, cycles=settings.cycles)
    ours = Retargeter(ours.hand, config=replace(ours.config, sampling=sampling))
    frames = list(operator_frames(settings.frames))
    if settings.commands is not None:
        np.save(settings.commands, answers(ours, frames[:COMPARED])[0])
        print("{}")
        return
    q, losses, times = answers(ours, frames)
    p, loss = percentiles(times), float(losses.mean())
    report.add("ours", p | {"tracking_loss": loss})
    header = ("program", "p50 [ms]", "p95 [ms]", "p99 [ms]", "max [ms]", "tracking loss")
    title = f"Algorithm 1, N = {settings.samples}, L = {settings.cycles}, landmarks to command"
    report.table(title, header, [["ours", *p.values(), loss]])
    p = percentiles(answers(Retargeter(settings.hand), frames)[2])
    report.add("smooth", p)
    report.table("`smooth`, one frame", tuple(p), [list(p.values())])
    batches(report, settings)
    if jax.devices()[0].platform != "cpu":
        against_cpu(report, settings, q[:COMPARED])
    report.finish(settings.output, settings.compare)


def answers(
    retargeter: Retargeter, frames: list[HandFrame]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joint positions (T, n) [rad], tracking losses (T,) and times (T,) [ms] of some frames."""
    state = retargeter.init()
    for frame in frames[:5]:  # warm-up
        state, _ = retargeter.step(state, frame)
    state, rows = retargeter.init(), []
    for frame in frames:
        before = time.perf_counter()
        state, result = retargeter.step(state, frame)
        ms = (time.perf_counter() - before) * 1e3
        rows.append((result.command.joint_positions, result.tracking_loss, ms))
    q, losses, times = (np.array(values) for values in zip(*rows, strict=True))
    return q, losses, times


def batches(report: Report, settings: Settings) -> None:
    """Frames per second of many recordings at once, and the share of time in which the GPU is
    busy."""
    rows: list[list[object]] = []
    for name in settings.batches:
        method, preset, lanes, length = name.split(":")
        count, size = int(lanes), int(length)
        retargeter = retargeter_of(settings.hand, f"{method}:{preset}")
        motions = [operator_frames(size, seed) for seed in range(min(MOTIONS, count))]
        recordings = [motions[i % len(motions)] for i in range(count)]
        landmarks = np.stack([r.landmarks for r in recordings]).astype(np.float32)
        stamps = np.stack([r.stamps for r in recordings])
        started = time.perf_counter()
        retargeter.batch_arrays(landmarks, stamps, lanes=count)
        first = time.perf_counter() - started
        seconds: dict[str, list[float]] = {"arrays": [], "objects": []}
        for _ in range(settings.repeats):
            started = time.perf_counter()
            retargeter.batch_arrays(landmarks, stamps, lanes=count)
            middle = time.perf_counter()
            retargeter.batch(recordings, lanes=count)
            seconds["arrays"].append(middle - started)
            seconds["objects"].append(time.perf_counter() - middle)
        frames = count * size
        figures: dict[str, float | None] = {
            f"{way}_frames_per_s": frames / float(np.median(times))
            for way, times in seconds.items()
        }
        best = frames / min(seconds["arrays"])
        run = lambda: retargeter.batch_arrays(landmarks, stamps, lanes=count)  # noqa: E731, B023
        figures |= {"arrays_best_frames_per_s": best, "busy": busy_share(run), "first_s": first}
        report.add(f"batch/{name}", figures)
        rows.append([f"{method}:{preset}", f"{count} × {size}", *figures.values()])
    header = (
        "method",
        "recordings",
        "arrays [frames/s]",
        "objects [frames/s]",
        "arrays, best [frames/s]",
        "GPU busy",
        "first call [s]",
    )
    report.table("Recordings side by side", header, rows)


def busy_share(run: Callable[[], Any], least_s: float = 3.0) -> float | None:
    """Share of time in which the GPU runs a kernel while a function is called repeatedly."""
    if jax.devices()[0].platform == "cpu":
        return None
    program = shutil.which("nvidia-smi")
    if program is None:
        return None
    with subprocess.Popen([program, *QUERY], stdout=subprocess.PIPE, text=True) as sampler:
        end = time.perf_counter() + least_s
        while time.perf_counter() < end:
            run()
        sampler.terminate()
        lines = sampler.communicate()[0].split()
    shares = [float(line) / 100 for line in lines if line.isdigit()][4:]  # without the start
    return float(np.mean(shares)) if shares else None


def against_cpu(report: Report, settings: Settings, q: np.ndarray) -> None:
    """Computes the same frames on this machine's CPU, with the same random numbers."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cpu.npy"
        options = {"samples": settings.samples, "cycles": settings.cycles, "hand": settings.hand}
        words = [f"--{name}={value}" for name, value in (options | {"commands": path}).items()]
        try:
            child_json([sys.executable, __file__, *words], {"JAX_PLATFORMS": "cpu"})
        except BenchmarkError as error:
            report.notes.append(f"not compared with the CPU: {error}")
            return
        apart = np.abs(q - np.load(path))
    report.figures["from_cpu_mean_rad"] = float(apart.mean())
    report.figures["from_cpu_max_rad"] = float(apart.max())
    report.notes.append(
        f"commands differ from those of the CPU by {apart.mean():.1e} rad on average, "
        f"{apart.max():.1e} rad at most, over {COMPARED} frames"
    )


if __name__ == "__main__":
    run_program(main, Settings, __doc__)

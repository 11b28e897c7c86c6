"""Frames per second of many recordings in one program, compared with frame by frame.

    python research/benchmarks/batch.py                                   # lanes, on this CPU
    python research/benchmarks/batch.py --methods smooth:teleop --lanes 256 1024 4096 --device gpu

Frames go one by one, as live, and recordings side by side in 1, 2, 4 ... lanes, in turns.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal

import jax
import numpy as np

from smooth_operator_research.run_report import (
    BenchmarkError,
    Report,
    ReportSettings,
    memory_mib,
    operator_frames,
    retargeter_of,
    run_program,
)


@dataclass(frozen=True)
class Settings(ReportSettings):
    """Settings of a run.

    Attributes:
        methods: METHOD or METHOD:PRESET of each row.
        lanes: recordings side by side in one process.
        frames: frames of each recording.
        repeats: how often; medians are reported.
        hand: robot hand.
        device: cpu or gpu; stops where JAX has none of that kind.
    """

    methods: tuple[str, ...] = ("smooth:teleop", "sbr:realtime", "geort", "joint_angle")
    lanes: tuple[int, ...] = (1, 2, 4, 8, 16)
    frames: int = 1000
    repeats: int = 3
    hand: str = "mimic_p050"
    device: Literal["cpu", "gpu"] = "cpu"


def main(settings: Settings) -> None:
    if jax.default_backend() != settings.device:
        raise BenchmarkError(f"JAX's default device is a {jax.default_backend()}; see --device")
    report = Report("batch", vars(settings))
    side_by_side(report, settings)
    memory = memory_mib()
    if memory is not None:
        report.figures["peak_memory_mib"] = memory
        report.notes.append(f"peak memory of this process: {memory:.0f} MiB")
    report.finish(settings.output, settings.compare)


def side_by_side(report: Report, settings: Settings) -> None:
    rows: list[list[object]] = []
    for name in settings.methods:
        retargeter = retargeter_of(settings.hand, name)
        if retargeter.method.on_host:
            report.notes.append(f"{name}: its solver runs on the host, so a batch is a loop")
            continue
        size = max(settings.lanes)
        # as many motions as a batch needs at most, each of its own; few where there are thousands
        motions = [operator_frames(settings.frames, seed) for seed in range(min(size, 32))]
        recordings = [motions[i % len(motions)] for i in range(size)]
        single, _ = retargeter.run(motions[0])
        apart, memory = {}, {}
        for lanes in settings.lanes:
            commands, _ = retargeter.batch(recordings[:lanes], lanes=lanes)[0]
            own_tips = retargeter.hand.tips(commands.joint_positions)
            tips = retargeter.hand.tips(single.joint_positions)
            apart[lanes] = np.linalg.norm(own_tips - tips, axis=-1).max(axis=1) * 1e3
            memory[lanes] = device_memory_mib()
        times: dict[int, list[float]] = {lanes: [] for lanes in settings.lanes}
        live = []
        for _ in range(settings.repeats):  # in turn, so that noise hits all alike
            live.append(float(np.median(retargeter.run(motions[0])[0].latency_ms)))
            for lanes in settings.lanes:
                started = time.perf_counter()
                retargeter.batch(recordings[:lanes], lanes=lanes)
                times[lanes].append(time.perf_counter() - started)
        one = float(np.median(live)) * 1e-3
        report.add(f"{name}/live", {"p50_ms": one * 1e3})
        rows.append([name, "live", 1 / one, one * 1e6, 1.0, None, None, None])
        for lanes, seconds in times.items():
            each = float(np.median(seconds)) / (lanes * settings.frames)
            middle, worst = np.percentile(apart[lanes], (50, 100))
            figures = {
                "frames_per_s": 1 / each,
                "us_per_frame": each * 1e6,
                "ratio_to_live": one / each,
                "tips_apart_p50_mm": float(middle),
                "tips_apart_max_mm": float(worst),
                "device_memory_mib": memory[lanes],
            }
            report.add(f"{name}/{lanes} lanes", figures)
            rows.append([name, str(lanes), *figures.values()])
    header = ("method", "lanes", "frames/s", "µs a frame", "ratio", "apart p50 [mm]")
    report.table(
        f"One process, recordings of {settings.frames} frames side by side",
        (*header, "apart max [mm]", "device memory [MiB]"),
        rows,
    )
    report.notes.append(
        "live: median latency of a single frame. apart: distance of fingertips of the batch's "
        "first recording from those frame by frame"
    )


def device_memory_mib() -> float | None:
    """Peak memory of the device that JAX has used so far [MiB]; None if unknown."""
    stats = jax.devices()[0].memory_stats()
    return None if not stats else stats.get("peak_bytes_in_use", 0) / 2**20


if __name__ == "__main__":
    run_program(main, Settings, __doc__)

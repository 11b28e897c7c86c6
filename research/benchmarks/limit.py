"""Distance of a preset from the arithmetic limit of the machine.

    python research/benchmarks/limit.py --preset paper

Counts the operations of one frame in the traced program, measures how fast this machine does each
kind of operation at best (numbers in the first-level cache, pipes full), and compares the time that
those would take with the time that a frame takes. The same on a GPU, where JAX has one.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
from arithmetic import FLOAT, KINDS, operations

from smooth_operator import HandFrame, Retargeter
from smooth_operator.parallel import usable_cores as cores
from smooth_operator_research.run_report import (
    Report,
    ReportSettings,
    child_json,
    operator_frames,
    percentiles,
    run_program,
)


@dataclass(frozen=True)
class Settings(ReportSettings):
    """Settings of a run.

    Attributes:
        preset: which preset.
        frames: how many frames to time.
        hand: robot hand.
        method: retargeting method.
    """

    preset: str = "paper"
    frames: int = 300
    hand: str = "mimic_p050"
    method: str = "sbr"


def main(settings: Settings) -> None:
    report = Report("limit", vars(settings))
    retargeter = Retargeter(settings.hand, method=settings.method, preset=settings.preset)
    frames = list(operator_frames(settings.frames))
    seconds, busy = frame_time(retargeter, frames)
    p50 = percentiles(seconds * 1e3)["p50_ms"]
    counts = operations(
        jax.make_jaxpr(retargeter.method.step)(
            retargeter.init().method, frames[0].landmarks.astype(np.float32), np.uint32(0)
        ).jaxpr
    )
    on_cpu = jax.devices()[0].platform == "cpu"
    teams = {"1 core": 1, f"{cores()} cores": cores()} if on_cpu else {"device": 1}
    attained = {name: rates(count) for name, count in teams.items()}

    rows = []
    totals = dict.fromkeys(teams, 0.0)
    for kind in KINDS:
        if not counts[kind]:
            continue
        row: list[object] = [kind, counts[kind] / 1e6]
        for team, rate in attained.items():
            at_best = counts[kind] / rate[kind] * 1e3
            totals[team] += at_best
            row += [rate[kind] / 1e9, at_best]
        rows.append(row)
        report.figures[f"operations/{kind}"] = float(counts[kind])
    columns = [c for team in teams for c in (f"{team} [G/s]", f"{team} [ms]")]
    header = ("operation", "per frame [M]", *columns)
    report.table("One frame at the best rate of each kind of operation", header, rows)

    share = []
    for team, rate in attained.items():
        alone = counts[FLOAT] / rate[FLOAT] * 1e3
        product = counts[FLOAT] / rate["matrix product"] * 1e3
        figures = {
            "floor_multiply_add_ms": alone,
            "floor_matrix_product_ms": product,
            "floor_all_ms": totals[team],
            "fraction_multiply_add": alone / p50,
            "fraction_all": totals[team] / p50,
        }
        report.add(team, figures | {f"rate/{kind}": rate[kind] for kind in rate})
        share.append([team, *figures.values()])
    report.table(
        f"Floor of a frame, and the share of it in the measured {p50:.2f} ms",
        (
            "by the rates of",
            "multiply-adds [ms]",
            "the same, BLAS rate [ms]",
            "all operations [ms]",
            "share, multiply-adds",
            "share, all",
        ),
        share,
    )
    traffic(report, retargeter, frames[0], next(iter(reversed(attained.values()))))
    gflops = counts[FLOAT] / p50 / 1e6
    report.add("frame", {"p50_ms": p50, "cores_busy": busy, "gflops": gflops})
    report.notes.append(
        f"frame: p50 {p50:.3f} ms over {len(frames)} synthetic frames, {busy:.2f} cores busy, "
        f"{gflops:.1f} GFlop/s of multiplications and additions"
    )
    report.notes.append(
        "floors assume that every multiplication finds an addition to fuse with, and 'all "
        "operations' that kinds follow one another; loads, stores and waiting are left out. Rates "
        "are the best of several rounds."
    )
    report.finish(settings.output, settings.compare)


def frame_time(retargeter: Retargeter, frames: list[HandFrame]) -> tuple[np.ndarray, float]:
    """Time of each frame [s], and the mean number of busy cores."""
    retargeter.warm_up()
    state = retargeter.init()
    for frame in frames[:10]:
        state, _ = retargeter.step(state, frame)
    state = retargeter.init()
    seconds = []
    wall, processor = time.perf_counter(), time.process_time()
    for frame in frames:
        start = time.perf_counter()
        state, _ = retargeter.step(state, frame)
        seconds.append(time.perf_counter() - start)
    busy = (time.process_time() - processor) / (time.perf_counter() - wall)
    return np.array(seconds), busy


def rates(count: int) -> dict[str, float]:
    """Attainable rates with a number of cores, measured in a process that is pinned to them."""
    script = Path(__file__).with_name("arithmetic.py")
    figures: dict[str, float] = child_json(
        [sys.executable, script, count], {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    )
    return figures


def traffic(
    report: Report, retargeter: Retargeter, frame: HandFrame, rate: dict[str, float]
) -> None:
    """Memory traffic of the cycles by the compiler's estimate, and its time."""
    state = retargeter.init().method
    landmarks = frame.landmarks.astype(np.float32)
    compiled = jax.jit(retargeter.method.step).lower(state, landmarks, np.uint32(0)).compile()
    analysis = compiled.cost_analysis() or {}
    moved = float(analysis.get("bytes accessed", float("nan")))
    if not np.isfinite(moved):
        report.notes.append("memory traffic: not known, the compiler gives no estimate")
        return
    sampling = getattr(retargeter.config, "sampling", None)
    cycles = 1 if sampling is None else sampling.cycles - 1
    ms = moved * cycles / rate["bytes copied"] * 1e3
    memory = compiled.memory_analysis()
    temporary = float(getattr(memory, "temp_size_in_bytes", 0) or 0)
    report.add(
        "compiler",
        {
            "bytes_per_cycle": moved,
            "flops_loops_once": float(analysis.get("flops", 0.0)),
            "transcendentals_loops_once": float(analysis.get("transcendentals", 0.0)),
            "temporary_bytes": temporary,
        },
    )
    report.notes.append(
        f"memory traffic: the compiler estimates {moved / 2**20:.2f} MiB, loops counted once; "
        f"times {cycles} cycles that is {ms:.3f} ms even at the rate of main memory "
        f"({rate['bytes copied'] / 1e9:.1f} GB/s); the working set is "
        f"{temporary / 2**20:.2f} MiB. The compiler's own count of operations, loops counted once: "
        f"{float(analysis.get('flops', 0.0)) / 1e6:.2f} M"
    )


if __name__ == "__main__":
    run_program(main, Settings, __doc__)

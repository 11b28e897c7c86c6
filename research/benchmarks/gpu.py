"""Frames alone and recordings side by side on JAX's default device, such as a GPU.

    python research/benchmarks/gpu.py                    # on a GPU; gpu.sh installs wheels before
    python research/benchmarks/gpu.py --samples 1024 --batches smooth:teleop:8:100     # on a CPU
    python research/benchmarks/gpu.py --page JSON > research/docs/gpu.md

Commands of preset ``paper`` are compared with a CPU's. Batches are ``Retargeter.batch_arrays``, and
``batch``, which makes an object for each recording. The GPU's busy time is what ``nvidia-smi``
samples while batches run one after another.
"""

from __future__ import annotations

import datetime
import json
import os
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
from timing import percentiles

from smooth_operator import HandFrame, Retargeter
from smooth_operator.errors import ConfigError
from smooth_operator.lab.datasets.pipeline import gpu_samples
from smooth_operator.methods.sbr import SbrConfig
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator_research.run_report import Report, ReportSettings, run_program

BLOCK = 10
MOTIONS = 32
COMPARED = 50
"""Frames that are compared with the CPU's."""


@dataclass(frozen=True)
class Settings(ReportSettings):
    """What to run.

    Attributes:
        samples: N of Algorithm 1; the preset's 8192 unless given.
        cycles: L; the preset's 20 unless given.
        frames: how many frames.
        batches: METHOD:PRESET:LANES:FRAMES of each batch.
        repeats: of each batch; the median is reported.
        hand: built-in robot hand.
        commit: revision of the code, where it is no clone.
        commands: only save the first commands of preset ``paper`` in this file (.npy).
        page: only print the page of an earlier JSON file.
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
    page: Path | None = None


Step = Callable[[Any, HandFrame], tuple[Any, np.ndarray, float]]
"""state, frame -> next state, all joint positions [rad], tracking loss."""


def main(settings: Settings) -> None:
    if settings.page is not None:
        sys.stdout.write(page(json.loads(settings.page.read_text("utf-8"))))
        return
    report = Report("gpu", vars(settings))
    ours = Retargeter(settings.hand, method="sbr", preset="paper")
    if not isinstance(ours.config, SbrConfig):
        raise ConfigError(f"preset 'paper' must be an SbrConfig, not {type(ours.config).__name__}")
    sampling = replace(ours.config.sampling, samples=settings.samples, cycles=settings.cycles)
    config = replace(ours.config, sampling=sampling)
    ours = Retargeter(ours.hand, config=config)
    frames = list(SyntheticOperator().record(settings.frames / 100 + 0.1))[: settings.frames]

    if settings.commands is not None:
        state, step = ours.init(), wrap(ours)
        positions = []
        for frame in frames[:COMPARED]:
            state, q, _ = step(state, frame)
            positions.append(q)
        np.save(settings.commands, np.array(positions))
        return
    steps: dict[str, tuple[Any, Step]] = {"ours": (ours.init(), wrap(ours))}
    runs = interleave(steps, frames)

    rows = []
    for name, (_, losses, latency) in runs.items():
        p = percentiles(latency)
        loss = float(losses.mean())
        report.add(name, p | {"tracking_loss": loss})
        rows.append([name, *p.values(), loss])
    header = ("program", "p50 [ms]", "p95 [ms]", "p99 [ms]", "max [ms]", "tracking loss")
    report.table(
        f"Algorithm 1, N = {settings.samples}, L = {settings.cycles}, landmarks to command",
        header,
        rows,
    )
    live(report, settings, frames)
    batches(report, settings)
    if jax.devices()[0].platform != "cpu":
        against_cpu(report, settings)
    report.finish(settings.output, settings.compare)


def live(report: Report, settings: Settings, frames: list[HandFrame]) -> None:
    """Times frames of the default method."""
    retargeter = Retargeter(settings.hand)
    timings = interleave({"smooth": (retargeter.init(), wrap(retargeter))}, frames)
    p = percentiles(timings["smooth"][2])
    report.add("smooth", p)
    report.table("`smooth`, one frame", tuple(p), [list(p.values())], 0)


def batches(report: Report, settings: Settings) -> None:
    """Frames a second of recordings side by side, and the share of time that the GPU is busy."""
    rows: list[list[object]] = []
    for name in settings.batches:
        method, preset, lanes, length = name.split(":")
        count, size = int(lanes), int(length)
        retargeter = Retargeter(settings.hand, method=method, preset=preset or None)
        motions = [
            SyntheticOperator(seed=seed).record((size + 0.5) / 100)[:size]
            for seed in range(min(MOTIONS, count))
        ]
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
    header = ("method", "recordings", "arrays [frames/s]", "objects [frames/s]")
    header = (*header, "arrays, best [frames/s]", "GPU busy", "first call [s]")  # type: ignore
    report.table("Recordings side by side", header, rows, 2)


def busy_share(run: Callable[[], Any], least_s: float = 3.0) -> float | None:
    """Share of time that the GPU runs a kernel while a function is called again and again."""
    if jax.devices()[0].platform == "cpu":
        return None
    with gpu_samples() as samples:
        end = time.perf_counter() + least_s
        while time.perf_counter() < end:
            run()
    shares = samples[4:]  # the first are of the time before
    return float(np.mean(shares)) if shares else None


def page(result: dict[str, Any]) -> str:
    """The page of the documentation, from a result of this program."""
    figures, hardware, arguments = result["figures"], result["hardware"], result["arguments"]
    device = hardware["jax_device"].removeprefix("gpu (").removesuffix(")")
    day = datetime.datetime.fromisoformat(result["date"]).date()
    versions = result["versions"]
    lines = [
        "# On a GPU",
        "",
        "Printed by `python research/benchmarks/gpu.py --page JSON`; `research/benchmarks/gpu.sh` "
        "measures.",
        "",
        "For one live hand a GPU is no faster than a core of a laptop: a frame of `smooth` takes "
        f"{figures['smooth/p50_ms']:.1f} ms, and 0.3 ms on a CPU. For archives it is worth "
        "hundreds of cores.",
        "",
        f"{device}, {hardware['cores']} CPU cores, jax {versions['jax']}, {day}, commit "
        f"{arguments['commit'] or versions['smooth-operator']}, {arguments['hand']}.",
        "",
        "| one frame | p50 [ms] | p95 [ms] | p99 [ms] |",
        "|---|---:|---:|---:|",
    ]
    for name, text in (
        ("ours", f"`sbr:paper`, {arguments['samples']} × {arguments['cycles']}"),
        ("smooth", "`smooth`"),
    ):
        if f"{name}/p50_ms" in figures:
            values = " | ".join(f"{figures[f'{name}/{p}_ms']:.2f}" for p in ("p50", "p95", "p99"))
            lines.append(f"| {text} | {values} |")
    if "from_cpu_mean_rad" in figures:
        lines += [
            "",
            f"Commands of `sbr:paper` differ from a CPU's by {figures['from_cpu_mean_rad']:.1e} "
            f"rad on average, {figures['from_cpu_max_rad']:.1e} rad at most, over {COMPARED} "
            "frames.",
        ]
    lines += [
        "",
        "| recordings × frames | arrays [frames/s] | objects [frames/s] | GPU busy | "
        "first call [s] |",
        "|---|---:|---:|---:|---:|",
    ]
    for name in arguments["batches"]:
        method, preset, lanes, length = name.split(":")
        row = {key: figures.get(f"batch/{name}/{key}") for key in _COLUMNS}
        if row["arrays_frames_per_s"] is not None:
            busy = "" if row["busy"] is None else f"{row['busy']:.0%}"
            lines.append(
                f"| `{method}:{preset}`, {lanes} × {length} | {row['arrays_frames_per_s']:,.0f} | "
                f"{row['objects_frames_per_s']:,.0f} | {busy} | {row['first_s']:.0f} |"
            )
    return "\n".join(
        [
            *lines,
            "",
            "*Arrays* is `Retargeter.batch_arrays`, *objects* `Retargeter.batch`; medians of "
            f"{arguments['repeats']}. *First call*: it traces and compiles.",
            "",
        ]
    )


_COLUMNS = ("arrays_frames_per_s", "objects_frames_per_s", "busy", "first_s")


def interleave(
    steps: dict[str, tuple[Any, Step]], frames: list[HandFrame]
) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """name -> joint positions (T, n), tracking losses (T,), latencies (T,) [ms]."""
    states: dict[str, Any] = {}
    timings: dict[str, tuple[list[Any], list[Any], list[Any]]] = {}
    for name, (state, step) in steps.items():
        states[name], timings[name] = state, ([], [], [])
        for frame in frames[:5]:  # warm-up
            state, _, _ = step(state, frame)
    for turn, start in enumerate(range(0, len(frames), BLOCK)):
        for name in list(steps) if turn % 2 == 0 else list(reversed(steps)):
            step = steps[name][1]
            for frame in frames[start : start + BLOCK]:
                before = time.perf_counter()
                states[name], q, loss = step(states[name], frame)
                latency = (time.perf_counter() - before) * 1e3
                for values, value in zip(timings[name], (q, loss, latency), strict=True):
                    values.append(value)
    return {name: tuple(np.array(v) for v in values) for name, values in timings.items()}  # type: ignore[misc]


def wrap(retargeter: Retargeter) -> Step:
    def step(state: Any, frame: HandFrame) -> tuple[Any, np.ndarray, float]:
        state, result = retargeter.step(state, frame)
        return state, result.command.positions, result.tracking_loss

    return step


def against_cpu(report: Report, settings: Settings) -> None:
    """The same frames on this machine's CPU: the random numbers are the same on every device."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / "device.npy", Path(folder) / "cpu.npy"]
        main(replace(settings, commands=paths[0]))
        options = {
            "samples": settings.samples,
            "cycles": settings.cycles,
            "hand": settings.hand,
        }
        command = [
            f"--{name}={value}" for name, value in (options | {"commands": paths[1]}).items()
        ]
        environment = os.environ | {"JAX_PLATFORMS": "cpu"}
        if subprocess.run([sys.executable, __file__, *command], env=environment).returncode:
            report.notes.append("not compared with the CPU: the same program failed there")
            return
        apart = np.abs(np.load(paths[0]) - np.load(paths[1]))
    report.figures["from_cpu_mean_rad"] = float(apart.mean())
    report.figures["from_cpu_max_rad"] = float(apart.max())
    report.notes.append(
        f"commands differ from those of the CPU by {apart.mean():.1e} rad on average, "
        f"{apart.max():.1e} rad at most, over {COMPARED} frames"
    )


if __name__ == "__main__":
    run_program(main, Settings, __doc__)

"""Latency and quality of the presets on recordings, side by side in one run.

    python research/benchmarks/retarget.py RECORDING [RECORDING ...] --frames 0:500

Without a recording the built-in synthetic operator is used. The presets take turns in blocks of
frames, each with a state of its own, so that whatever else the machine does hits both alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from timing import peak_memory_mib, percentiles

from smooth_operator import (
    HandRecording,
    Result,
    Retargeter,
    SmoothOperatorError,
    Status,
    align_recording,
)
from smooth_operator.errors import RecordingError
from smooth_operator.formats.frames import frame_slice
from smooth_operator.formats.readers import read_recording
from smooth_operator.metrics import Trace, evaluate
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator_research.run_report import BenchmarkError, Report

QUALITY = {
    "cosine_similarity": "cos thumb",
    "cosine_similarity_all": "cos all",
    "scale_ratio": "scale",
    "motion_preservation": "motion",
    "flatness": "flatness [m²]",
    "velocity_correlation": "vel. corr.",
    "lag_ms": "lag [ms]",
    "pinch_error_mm": "pinch [mm]",
}


@dataclass(frozen=True)
class Settings:
    """What to run.

    Attributes:
        recordings: files to retarget; none for the synthetic operator.
        frames: range A:B of frames of each recording.
        presets: which presets, the reference of ratios first.
        hand: robot hand.
        method: retargeting method.
        rate: frame rate of files without stamps [Hz].
        block: frames that one preset handles before the next takes its turn.
        passes: how often each recording is gone through; latencies are pooled.
        seed: of the synthetic operator.
        output: JSON file; build/benchmarks/retarget.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    frames: str = "0:500"
    presets: tuple[str, ...] = ("paper", "realtime")
    hand: str = "mimic_p050"
    method: str = "sbr"
    rate: float | None = None
    block: int = 20
    passes: int = 1
    seed: int = 0
    output: Path | None = None
    compare: Path | None = None


def main(settings: Settings) -> None:
    report = Report("retarget", vars(settings))
    retargeters: dict[tuple[str, str], Retargeter] = {}
    timing, quality, ratios = [], [], []
    for recording in load(settings):
        chosen = {}
        for preset in settings.presets:
            key = preset, recording.side
            if key not in retargeters:
                retargeters[key] = Retargeter(
                    settings.hand, side=recording.side, method=settings.method, preset=preset
                )
                warm_up(retargeters[key], recording)
            chosen[preset] = retargeters[key]
        runs = interleave(chosen, recording, settings.block, settings.passes)
        medians, merits = {}, {}
        for preset, (results, latency) in runs.items():
            p = percentiles(latency)
            merit = score(chosen[preset], recording, results)
            report.add(f"{recording.name}/{preset}", p | {"first_ms": latency[0]} | merit)
            held = sum(result.status != Status.OK for result in results)
            timing.append([recording.name, preset, *p.values(), float(latency[0]), held])
            quality.append([recording.name, preset, *merit.values()])
            medians[preset], merits[preset] = p, merit
        first = settings.presets[0]
        for preset in settings.presets[1:]:
            speed = {
                f"{q}_ratio": medians[preset][f"{q}_ms"] / medians[first][f"{q}_ms"]
                for q in ("p50", "p99")
            }
            change = {k: difference(merits[preset][k], merits[first][k]) for k in QUALITY}
            report.add(f"{recording.name}/{preset} against {first}", speed)
            ratios.append([recording.name, *speed.values(), *change.values()])
    report.figures["peak_memory_mib"] = peak_memory_mib() or float("nan")
    if np.isnan(report.figures["peak_memory_mib"]):
        del report.figures["peak_memory_mib"]
    else:
        report.notes.append(
            f"peak memory of the process, all presets: {report.figures['peak_memory_mib']:.0f} MiB"
        )
    header = ("recording", "preset", "p50 [ms]", "p95 [ms]", "p99 [ms]", "max [ms]", "first [ms]")
    report.table("Latency per frame, landmarks to command", (*header, "held"), timing)
    report.table("Quality", ("recording", "preset", *QUALITY.values()), quality)
    if ratios:
        names = ("recording", "p50 ratio", "p99 ratio", *(f"Δ {q}" for q in QUALITY.values()))
        title = f"{' and '.join(settings.presets[1:])} against {settings.presets[0]}"
        report.table(title, names, ratios)
    report.notes.append(
        "first: latency of the first frame, which may settle on the operator's pose; it counts in "
        "max. held: frames answered with the last good command. Quality: means over frames, human "
        "aligned as the retargeter saw it, still frames masked."
    )
    report.finish(settings.output, settings.compare)


def load(settings: Settings) -> list[HandRecording]:
    if not settings.recordings:
        full = [SyntheticOperator(seed=settings.seed).record(60.0)]
    else:
        full = [read(path, settings.rate) for path in settings.recordings]
    return [recording[frame_slice(settings.frames, len(recording))] for recording in full]


def read(path: Path, rate: float | None) -> HandRecording:
    try:
        return read_recording(path)
    except RecordingError:
        if rate is None:
            raise
        return read_recording(path, rate=rate)  # the rate is for the files that need one


def warm_up(retargeter: Retargeter, recording: HandRecording) -> None:
    retargeter.warm_up()
    state = retargeter.init()
    for frame in recording[:10]:
        state, _ = retargeter.step(state, frame)


def interleave(
    retargeters: dict[str, Retargeter], recording: HandRecording, block: int, passes: int
) -> dict[str, tuple[list[Result], np.ndarray]]:
    """preset -> (results of one pass, latencies of all passes [ms])."""
    names = list(retargeters)
    results: dict[str, list[Result]] = {name: [] for name in names}
    for _ in range(passes):
        states = {name: retargeter.init() for name, retargeter in retargeters.items()}
        for turn, start in enumerate(range(0, len(recording), block)):
            frames = list(recording[start : start + block])
            for name in names if turn % 2 == 0 else reversed(names):
                for frame in frames:
                    states[name], result = retargeters[name].step(states[name], frame)
                    results[name].append(result)
    return {
        name: (timings[: len(recording)], np.array([r.latency_ms for r in timings]))
        for name, timings in results.items()
    }


def score(
    retargeter: Retargeter, recording: HandRecording, results: list[Result]
) -> dict[str, float | None]:
    hand = retargeter.hand
    q = np.stack([result.command.positions for result in results])
    figures = evaluate(
        Trace(
            human=align_recording(recording, hand, retargeter.config.alignment),
            robot_tips=hand.tips(q),
            robot_wrist=hand.wrist,
            fingers=hand.fingers,
            joint_positions=q,
            joint_limits=hand.joint_limits,
            stamps=recording.stamps,
            status=np.array([int(result.status) for result in results]),
            latency_ms=np.array([result.latency_ms for result in results]),
        )
    )
    return {name: number(figures[name]) for name in QUALITY}


def number(value: object) -> float | None:
    return float(value) if isinstance(value, float | int) else None


def difference(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a - b


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error

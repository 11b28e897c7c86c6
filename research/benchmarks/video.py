"""Hands in a video: how fast they are found, how well, alone and with a retargeter.

    python research/benchmarks/video.py clip.mp4 --photos thumb_to_index_tip.jpg

First the tracker alone, on every picture as fast as it goes; then the source ``video`` at the pace
of the file, while this thread retargets the newest hand; then what the filter does to the commands;
then the gaps between thumb and fingertips on photographs of pinches. Needs the extra ``webcam``.
"""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, get_args

import numpy as np
import tyro
from timing import percentiles

from smooth_operator import HandFrame, HandRecording, Retargeter, Status
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.sources.live import Mailbox
from smooth_operator.teleop.sources.webcam.camera import VideoFile, opencv
from smooth_operator.teleop.sources.webcam.picture_tracker import (
    OneEuroState,
    PictureConfig,
    PictureTracker,
    Points,
    one_euro,
)
from smooth_operator.teleop.sources.webcam.webcam_source import Video
from smooth_operator.types import Side
from smooth_operator_research.run_report import BenchmarkError, Report, ReportSettings, run_program

QUALITY = {
    "flatness": "flatness [m²]",
    "fingertip_acceleration": "acceleration [m/s²]",
    "motion_preservation": "motion",
    "cosine_similarity": "cos thumb",
    "lag_ms": "lag [ms]",
}


@dataclass(frozen=True)
class Settings(ReportSettings):
    """What to run.

    Attributes:
        video: the file.
        photos: pictures of pinches.
        model: the hand-landmarker file; fetched once if left out.
        side: which hand to retarget.
        hand: robot hand.
        method: retargeting method.
        cutoffs: of the filter [Hz]; 0 is none.
        seed: of the built-in operator and its noise.
    """

    video: Annotated[Path, tyro.conf.Positional]
    photos: tuple[Path, ...] = ()
    model: Path | None = None
    side: Side = "right"
    hand: str = "mimic_p050"
    method: str = "sbr"
    cutoffs: tuple[float, ...] = (0.0, 8.0, 4.0, 2.0, 1.0)
    seed: int = 0


def main(settings: Settings) -> None:
    report = Report("video", vars(settings))
    recording = alone(report, settings)
    retargeter = Retargeter(settings.hand, method=settings.method, side=settings.side)
    retargeter.warm_up()
    beside(report, settings, retargeter)
    filtered(report, settings, retargeter, recording)
    if settings.photos:
        pinches(report, settings)
    report.finish(settings.output, settings.compare)


def alone(report: Report, settings: Settings) -> HandRecording:
    """Every picture, as fast as it goes; gives the hand as a recording."""
    rows = []
    frames: list[HandFrame] = []
    for most in (1, 2):
        wall, busy, read, detected, pictures = [], [], [], 0, 0
        frames.clear()
        config = PictureConfig(max_hands=most, model=settings.model)
        with closing(PictureTracker(config)) as tracker, closing(VideoFile(settings.video)) as file:
            while True:
                started = time.perf_counter()
                stamp = file.advance()
                if stamp is None or (pixels := file.picture()) is None:
                    break
                pictures += 1
                read.append((time.perf_counter() - started) * 1e3)
                started, processor = time.perf_counter(), time.process_time()
                tracked = tracker.frames(pixels, stamp)
                busy.append((time.process_time() - processor) * 1e3)
                wall.append((time.perf_counter() - started) * 1e3)
                mine = [frame for frame in tracked if frame.side == settings.side]
                frames += mine
                detected += bool(mine)
        figures = {
            "pictures": float(pictures),
            "found": detected / pictures,
            "per_s": 1e3 / float(np.mean(np.add(wall, read))),
            "processor_ms": float(np.median(busy)),
            "read_p50_ms": percentiles(read)["p50_ms"],
            **percentiles(wall),
        }
        report.add(f"alone/{most}", figures)
        names = ("found", "p50_ms", "p95_ms", "processor_ms", "read_p50_ms", "per_s")
        rows.append([f"up to {most}", *(figures[name] for name in names)])
    report.table(
        f"The tracker alone, {pictures} pictures",
        ("hands", "found", "p50 [ms]", "p95 [ms]", "processor [ms]", "read p50 [ms]", "pictures/s"),
        rows,
    )
    if len(frames) < 3:
        raise BenchmarkError(f"{settings.video}: there is no {settings.side} hand")
    landmarks = np.array([frame.landmarks for frame in frames])
    palm = np.linalg.norm(landmarks[:, 9] - landmarks[:, 0], axis=1)
    report.add("palm", {"p50_m": float(np.median(palm)), "std_m": float(palm.std())})
    report.notes.append(f"palm: {np.median(palm):.4f} m, standard deviation {palm.std():.4f} m")
    return HandRecording(landmarks, np.array([f.stamp for f in frames]), settings.side)


def beside(report: Report, settings: Settings, retargeter: Retargeter) -> None:
    """The source at the pace of the file, while this thread answers the newest hand."""
    rows = []
    for most in (1, 2):
        source, mailbox = Video(settings.video, max_hands=most, model=settings.model), Mailbox()
        state, solve, age, held = retargeter.init(), [], [], 0
        source.start(mailbox)
        started, stamps = time.perf_counter(), []
        while source.health().state in ("waiting", "running"):
            if not mailbox.wait((settings.side,), 0.2):
                continue
            arrival = mailbox.take(settings.side)
            assert arrival is not None  # nobody else takes them
            state, result = retargeter.step(state, arrival.frame)
            held += result.status is not Status.OK
            now = time.perf_counter()
            solve.append(result.latency_ms)
            age.append((now - arrival.received) * 1e3)
            stamps.append(arrival.frame.stamp)
        seconds = time.perf_counter() - started
        source.stop()
        added = percentiles(age)
        figures = {
            "commands_per_s": len(age) / seconds,
            "held": held / len(age),
            "solve_p50_ms": percentiles(solve)["p50_ms"],
            "added_p50_ms": added["p50_ms"],
            "added_p99_ms": added["p99_ms"],
            "longest_gap_s": float(np.diff(stamps).max()),
        }
        report.add(f"beside/{most}", figures)
        rows.append([f"up to {most}", *figures.values()])
        report.notes.append(f"beside a retargeter, up to {most}: {source.health().detail}")
    header = ("hands", "commands/s", "held", "solve p50 [ms]", "added p50 [ms]", "added p99 [ms]",
              "longest gap [s]")  # fmt: skip
    report.table(f"The source live, with {settings.method} in the same process", header, rows)


def filtered(
    report: Report, settings: Settings, retargeter: Retargeter, recording: HandRecording
) -> None:
    """The commands against the unfiltered hand, by the filter's cutoff."""
    rows = []
    for cutoff in settings.cutoffs:
        landmarks = smoothed(recording, cutoff) if cutoff else recording.landmarks
        hand = HandRecording(landmarks, recording.stamps, recording.side, recording.valid)
        commands, _ = retargeter.run(hand)
        trace = assemble_trace(recording, commands, retargeter.hand, retargeter.config.alignment)
        values = evaluate(trace)
        figures = {name: v for name in QUALITY if isinstance(v := values[name], float)}
        report.add(f"cutoff/{cutoff:g}", figures)
        rows.append([f"{cutoff:g} Hz" if cutoff else "none", *(figures.get(n) for n in QUALITY)])
    report.table("The filter, before the commands", ("cutoff", *QUALITY.values()), rows)
    truth = SyntheticOperator(side=settings.side, rate_hz=30.0, seed=settings.seed).record(20.0)
    noise = np.random.default_rng(settings.seed).normal(scale=1e-3, size=truth.landmarks.shape)
    noisy = replace(truth, landmarks=truth.landmarks + noise)
    velocity = np.gradient(truth.landmarks, truth.stamps, axis=0)
    rows = []
    for cutoff in settings.cutoffs:
        error = (smoothed(noisy, cutoff) if cutoff else noisy.landmarks) - truth.landmarks
        clean = (smoothed(truth, cutoff) if cutoff else truth.landmarks) - truth.landmarks
        figures = {
            "error_mm": float(np.sqrt(np.mean(np.sum(error**2, axis=-1)))) * 1e3,
            # By how much of the velocity it is behind, over all landmarks and axes.
            "delay_ms": -float(np.sum(clean * velocity) / np.sum(velocity**2)) * 1e3,
        }
        report.add(f"truth/{cutoff:g}", figures)
        rows.append([f"{cutoff:g} Hz" if cutoff else "none", *figures.values()])
    report.table(
        "The filter, against the truth: the built-in operator at 30 Hz with 1 mm of noise",
        ("cutoff", "error [mm]", "delay [ms]"),
        rows,
    )


def smoothed(recording: HandRecording, cutoff: float) -> np.ndarray:
    """The landmarks of a recording, filtered frame by frame as the source does."""
    state: OneEuroState | None = None
    out = []
    for points, stamp in zip(recording.landmarks, recording.stamps, strict=True):
        state = one_euro(state, points, float(stamp), cutoff)
        out.append(state.points)
    return np.array(out)


def pinches(report: Report, settings: Settings) -> None:
    """Gaps between the thumb's tip and the others' [mm], on photographs."""
    rows = []
    for path in settings.photos:
        pixels = opencv().imread(str(path))
        if pixels is None:
            raise BenchmarkError(f"{path}: it can't be read as a picture")
        for points in get_args(Points):
            config = PictureConfig(model=settings.model, points=points)
            with closing(PictureTracker(config)) as tracker:
                for k in range(4):  # as in a video, where a hand is followed
                    frames = tracker.frames(pixels, k / 30)
            if not frames:
                rows.append([path.stem, points, "no hand", *[None] * 4])
                continue
            tips = frames[0].landmarks[list(TIPS)]
            gaps = np.linalg.norm(tips[1:] - tips[0], axis=1) * 1e3
            report.add(
                f"pinch/{path.stem}/{points}",
                dict(zip(FINGERS[1:], map(float, gaps), strict=True)),
            )
            rows.append([path.stem, points, frames[0].side, *gaps])
    header = ("photograph", "points", "side", *(f"{name} [mm]" for name in FINGERS[1:]))
    report.table("Thumb to fingertips", header, rows)


if __name__ == "__main__":
    run_program(main, Settings, __doc__)

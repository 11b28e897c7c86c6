"""What the removal of tracker noise costs behind trackers whose palm bends, drifts or flickers.

    python -m smooth_operator_research.judging.tracker_faults --data RECORDINGS

The built-in operator is tracked by each of ``FAULTS`` at each rate, and the default method follows
with the removal of noise and without: a row each, and two for each real recording. What such a
tracker shows is no noise that a palm tells, so both rows should agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import tyro
from jaxtyping import Float

from smooth_operator import SmoothOperatorError, load_hand
from smooth_operator.lab.benchmark.recordings import load_sources, parse_request
from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.metrics import summary
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.metrics.consistency import motion_preservation
from smooth_operator.synthetic import SyntheticOperator, WristMotion
from smooth_operator.types import HandRecording
from smooth_operator_research.judging.judge import FILES
from smooth_operator_research.judging.noise_front import CHOSEN, SETTING, run_of
from smooth_operator_research.run_report import RESULTS, BenchmarkError, Report

LARGE_STEP: Final = 3e-3
"""Step of a human fingertip whose answer counts in ``StepFigures`` [m]."""
JUMP: Final = 12e-3
"""By how much longer than the human's a step is a jump [m]."""


@dataclass(frozen=True)
class Fault:
    """What a tracker does to landmarks.

    Attributes:
        bend: by how much each palm landmark moves between straight and bent fingers [m]; a base
            takes its finger along.
        noise: standard deviation of white noise on each coordinate [m].
        drift: by which share the whole hand slowly grows and shrinks.
        quantum: what coordinates are rounded to [m].
        flip_every: a single frame of so many is mirrored.
    """

    bend: float = 0.0
    noise: float = 0.0
    drift: float = 0.0
    quantum: float = 0.0
    flip_every: int = 0


FAULTS: Final = {
    "bends by 2 mm": Fault(bend=2e-3),
    "bends by 6 mm": Fault(bend=6e-3),
    "bends by 2 mm, 0.2 mm noise": Fault(bend=2e-3, noise=2e-4),
    "bends by 6 mm, 0.5 mm noise": Fault(bend=6e-3, noise=5e-4),
    "grows and shrinks by 5 %": Fault(drift=0.05),
    "rounds to 1 mm": Fault(quantum=1e-3),
    "rounds to 2 mm": Fault(quantum=2e-3),
    "flips for a frame": Fault(flip_every=45),
}


class StepFigures(NamedTuple):
    """How fingertip steps are answered; None where there are none.

    Attributes:
        motion: mean cosine of the steps, the metric ``motion_preservation``.
        gain: median length of the robot's step by the human's, of the human's large ones.
        lost: share of those that are answered by less than a third.
        jumps: frames of 1,000 in which a fingertip steps ``JUMP`` further than the human's.
    """

    motion: float | None
    gain: float | None
    lost: float | None
    jumps: float | None


@dataclass(frozen=True)
class Settings:
    """What to measure.

    Attributes:
        data: folder of the judge's recordings; without it, trackers with faults alone.
        rates: frames a second [Hz].
        seconds: length of each of the operator's recordings [s].
        seed: random seed of the operator and the tracker.
        hand: the robot hand.
        output: JSON file; Markdown stands next to it.
    """

    data: Path | None = None
    rates: tuple[float, ...] = (30.0, 60.0)
    seconds: float = 12.0
    seed: int = 41
    hand: str = "mimic_p050"
    output: Path = RESULTS / "tracker_faults.json"


def faulty(fault: Fault, rate_hz: float, seconds: float, seed: int) -> HandRecording:
    """The built-in operator, with a moving wrist, behind a tracker with a fault."""
    wrist = WristMotion(0.1, 0.4, seed=seed)
    operator = SyntheticOperator(seed=seed, rate_hz=rate_hz, speed=2.0, wrist=wrist)
    recording = operator.record(seconds)
    rng = np.random.default_rng(seed)
    points = bent(recording.landmarks, fault.bend, rng)
    points += rng.normal(0.0, 1.0, points.shape) * fault.noise
    points *= 1 + fault.drift * np.sin(2 * np.pi * recording.stamps / 5)[:, None, None]
    if fault.quantum:
        points = np.round(points / fault.quantum) * fault.quantum
    if fault.flip_every:
        some = points[fault.flip_every - 1 :: fault.flip_every]
        some[:] = some[:, :1] + (some - some[:, :1]) * [-1, 1, 1]
    return HandRecording(points, recording.stamps, side=recording.side, name=recording.name)


def bent(
    points: Float[np.ndarray, "T 21 3"], amount: float, rng: np.random.Generator
) -> Float[np.ndarray, "T 21 3"]:
    """A hand whose palm landmarks move with the fingers' curl, by ``amount`` at most [m]."""
    fingers = np.stack([points[:, base : base + 4] for base in BASES[1:]], axis=1)
    bones = np.linalg.norm(np.diff(fingers, axis=2), axis=-1).sum(-1)
    curl = 1 - np.linalg.norm(fingers[:, :, 3] - fingers[:, :, 0], axis=-1) / bones
    curl = (curl - curl.min(0)) / np.ptp(curl, axis=0)  # of each finger, 0 to 1
    # directions that turn with the hand
    across = points[:, BASES[1]] - points[:, BASES[4]]
    along = points[:, BASES[2]] - points[:, WRIST]
    axes = np.stack([across, along, np.cross(across, along)], axis=1)
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    out = points.copy()
    for landmarks in (slice(WRIST, WRIST + 1), *(slice(base, base + 4) for base in BASES)):
        way = rng.normal(size=3)
        shift = (curl @ rng.dirichlet(np.ones(4)))[:, None] * (way / np.linalg.norm(way) @ axes)
        out[:, landmarks] += amount * shift[:, None]
    return out


def step_figures(
    human: Float[np.ndarray, "T F 3"], robot: Float[np.ndarray, "T F 3"]
) -> StepFigures:
    """The figures of wrist to tip vectors [m], NaN where unknown."""
    human_steps, done = (np.linalg.norm(np.diff(tips, axis=0), axis=-1) for tips in (human, robot))
    large = human_steps > LARGE_STEP  # NaN compares as False
    gains = done[large] / human_steps[large]
    jumps = ((done - human_steps) > JUMP).any(axis=-1)
    return StepFigures(
        motion_preservation(human, robot),
        summary.median(gains),
        summary.mean(gains < 1 / 3),
        summary.scaled(summary.mean(jumps), 1e3),
    )


def followed(recording: HandRecording, hand_name: str, off: bool) -> StepFigures:
    """The figures of the default method, with the removal of noise or without."""
    answer = run_of(hand_name, off).run(recording, {SETTING: 0.0 if off else CHOSEN})
    trace = assemble_trace(recording, answer, load_hand(hand_name), reach_samples=0)
    return step_figures(trace.human_reaches, trace.robot_reaches)


def recordings(settings: Settings) -> Iterator[tuple[str, HandRecording]]:
    """Trackers with faults and real recordings, with their names.

    Raises:
        BenchmarkError: a recording can't be read.
    """
    for name, fault in FAULTS.items():
        for rate in settings.rates:
            recording = faulty(fault, rate, settings.seconds, settings.seed)
            yield f"{name}, {rate:g} Hz", recording
    if settings.data is not None:
        files = (*FILES[:2], *FILES[3:], "wilor_workspace_21x3.npz@30hz")
        for source in load_sources([parse_request(f"{settings.data}/{name}") for name in files]):
            if source.recording is None:
                raise BenchmarkError(str(source.error))
            yield source.name, source.recording


def main(settings: Settings) -> None:
    """Measures all recordings with the removal and without, and prints the table."""
    report, cells = Report("tracker_faults", vars(settings)), []
    for name, recording in recordings(settings):
        on, off = (followed(recording, settings.hand, off) for off in (False, True))
        report.add(name, on._asdict())
        report.add(f"{name}, not removed", off._asdict())
        cells.append([name, *(f"{a:.3g} / {b:.3g}" for a, b in zip(on, off, strict=True))])
    columns = ("motion", "gain", "answered by less than a third", "jumps of 1,000 frames")
    report.table("With the removal of noise / without", ("tracker", *columns), cells)
    settings.output.parent.mkdir(parents=True, exist_ok=True)
    report.finish(settings.output, None)
    settings.output.with_suffix(".md").write_text(report.tables() + "\n", encoding="utf-8")


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error

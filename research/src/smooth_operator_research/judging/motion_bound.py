r"""An upper bound on the motion preservation of a hand whose fingers have one motor each.

    python -m smooth_operator_research.judging.motion_bound glove.npz@0:500 synthetic:11 \
        --hands inspire_hand ability_hand

A finger with one motor moves its tip along one curve, to and fro. Motion preservation is the mean
cosine between the steps of the robot's and the human's fingertips, so it is bounded by how well
that curve points the human's way. For each such finger, dynamic programming over its motor's
positions finds the motion with the largest mean cosine among all motions at any speed up to a
limit, whatever poses it leads through. A method can be better only by resting while the human
moves, for the metric leaves rest out, and here it counts as 0. Most must be worse, since they also
have to show the human's pose. Fingers with more motors count as 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import numpy as np
import tyro
from jaxtyping import Float

from smooth_operator import SmoothOperatorError, load_hand
from smooth_operator.hands.hand import Hand
from smooth_operator.human.aligned_recording import align_recording
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.lab.benchmark.recordings import load_sources, parse_request
from smooth_operator.landmarks import FINGERS, TIPS, WRIST
from smooth_operator.metrics.consistency import HUMAN_STILL
from smooth_operator.types import HandRecording
from smooth_operator_research.run_report import RESULTS, BenchmarkError, Report

SPEED: Final = 26.0
"""Largest speed of a motor [rad/s]: that of ``smooth``."""


@dataclass(frozen=True)
class Settings:
    """What to bound.

    Attributes:
        recordings: named as for ``smooth-operator bench``.
        hands: robot hands.
        positions: of a motor, evenly spread over its range; twice as many gain 0.002.
        output: JSON file.
        compare: an earlier JSON file to compare this run with.
    """

    recordings: Annotated[tuple[str, ...], tyro.conf.Positional] = ("synthetic:11",)
    hands: tuple[str, ...] = ("inspire_hand", "ability_hand")
    positions: int = 241
    output: Path = RESULTS / "motion_bound.json"
    compare: Path | None = None


def single_motors(hand: Hand) -> tuple[int | None, ...]:
    """(F,) the motor that alone moves each fingertip; None where there are several."""
    low, high = hand.limits.T
    middle = np.tile((low + high) / 2, (len(low), 1))
    ends = (middle + np.diag(side - middle[0]) for side in (low, high))
    first, last = (hand.tips(hand.full_configuration(q)) for q in ends)
    moves = np.linalg.norm(last - first, axis=-1) > 1e-4  # (m, F)
    return tuple(int(np.argmax(one)) if one.sum() == 1 else None for one in moves.T)


def tip_curve(hand: Hand, finger: int, motor: int, positions: int) -> Float[np.ndarray, "N 3"]:
    """Places of a fingertip at evenly spread positions of its motor [m]."""
    low, high = hand.limits.T
    q = np.tile((low + high) / 2, (positions, 1))
    q[:, motor] = np.linspace(low[motor], high[motor], positions)
    curve: np.ndarray = hand.tips(hand.full_configuration(q))[:, finger]
    return curve


def curve_bound(
    steps: Float[np.ndarray, "T 3"], curve: Float[np.ndarray, "N 3"], reach: int
) -> float | None:
    """Largest mean cosine between a human fingertip's steps and those of a point on a curve.

    Args:
        steps: (T, 3) the human's [m]; a step below ``HUMAN_STILL`` or with NaN counts as rest.
        curve: (N, 3) the places where the robot's may be [m].
        reach: how many places it may go in one step; it may also stay, which counts as 0.

    Returns:
        the bound, or None for a human who rests.
    """
    count = len(curve)
    apart = curve[None] - curve[:, None]
    size = np.linalg.norm(apart, axis=-1, keepdims=True)
    ways = np.divide(apart, size, out=np.zeros_like(apart), where=size > 0)
    far = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) > reach
    length = np.linalg.norm(steps, axis=-1)
    moving = length > HUMAN_STILL  # NaN compares as False
    if not moving.any():
        return None
    value = np.zeros(count)  # of the best motion that ends at each place
    for step, size_of_step, moves in zip(steps, length, moving, strict=True):
        gain = ways @ (step / size_of_step) if moves else np.zeros((count, count))
        gain[far] = -np.inf
        value = (value[:, None] + gain).max(axis=0)
    return float(value.max() / moving.sum())


def motion_bounds(hand: Hand, recording: HandRecording, positions: int) -> dict[str, float | None]:
    """The bound of each finger, and 1 for those with several motors."""
    aligned = align_recording(recording, hand, AlignmentConfig())
    low, high = hand.limits.T
    dt = float(np.median(np.diff(recording.stamps)))
    bounds: dict[str, float | None] = {}
    for f, motor in enumerate(single_motors(hand)):
        name = hand.fingers[f]
        if motor is None:
            bounds[name] = 1.0
            continue
        tip = aligned[:, TIPS[FINGERS.index(name)]] - aligned[:, WRIST]
        spacing = (high[motor] - low[motor]) / (positions - 1)
        reach = max(1, round(SPEED * dt / spacing))
        curve = tip_curve(hand, f, motor, positions)
        bounds[name] = curve_bound(np.diff(tip, axis=0), curve, reach)
    return bounds


def main(settings: Settings) -> None:
    """Prints a table of bounds."""
    if settings.positions < 3:
        raise BenchmarkError("--positions must be 3 or more")
    report = Report("motion_bound", vars(settings))
    rows: list[list[object]] = []
    sources = load_sources([parse_request(word) for word in settings.recordings])
    for source in sources:
        if source.recording is None:
            raise BenchmarkError(source.error or f"{source.name} has no frames")
        for name in settings.hands:
            hand = load_hand(name, source.side)
            bounds = motion_bounds(hand, source.recording, settings.positions)
            values = [value for value in bounds.values() if value is not None]
            mean = float(np.mean(values)) if values else None
            rows.append([name, source.name, mean, *(bounds.get(finger) for finger in FINGERS)])
            report.add(f"{name}/{source.name}", {"mean": mean, **bounds})
    header = ("hand", "recording", "mean", *FINGERS)
    report.table("Largest motion preservation", header, rows, texts=2)
    report.finish(settings.output, settings.compare)


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error

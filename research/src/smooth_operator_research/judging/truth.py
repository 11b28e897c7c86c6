"""Figures against the noise-free operator: does a method follow the hand or the noise?

The judge's lines compare a robot with the landmarks as they were tracked, so noise that a method
removes counts there as motion that it loses. What the built-in operator did without its tracker's
noise is known, and these figures compare with that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.lab.benchmark.recordings import Source, load_sources
from smooth_operator.metrics import Trace, consistency, evaluate
from smooth_operator.types import HandRecording
from smooth_operator_research.judging.targets import HumanFigures, human_figures


@dataclass(frozen=True)
class TruthFigures:
    """How the fingertips moved, compared with the noise-free operator's.

    Attributes:
        motion_preservation: mean cosine of fingertip steps; the metric of that name.
        velocity_correlation: at the best delay; the metric of that name.
        lag_ms: that delay [ms].
        jitter_mm: root mean square of the difference between a fingertip's step and the
            operator's, over frames and fingers [mm].
    """

    motion_preservation: float | None
    velocity_correlation: float | None
    lag_ms: float | None
    jitter_mm: float | None


@dataclass(frozen=True)
class AgainstTruth:
    """The figures of a method, and what a robot that copies the tracked landmarks exactly has.

    Attributes:
        robot: of the robot's fingertips.
        tracked: of the human's own, with the noise.
        metrics: as evaluate() gives them, of the run against the operator without noise.
        human: what the operator without noise did.
    """

    robot: TruthFigures
    tracked: TruthFigures
    metrics: dict[str, Any]
    human: HumanFigures

    @classmethod
    def kept(cls, values: dict[str, Any]) -> AgainstTruth:
        """From what ``asdict`` made of one."""
        robot, tracked = (TruthFigures(**values[name]) for name in ("robot", "tracked"))
        return cls(robot, tracked, values["metrics"], HumanFigures(**values["human"]))


def without_noise(source: Source) -> HandRecording | None:
    """The same operator's recording without tracker noise; None where that isn't known.

    Args:
        source: of the judge.

    Raises:
        RecordingError: if the frames are not at the same times, so that they can't be compared.
    """
    if not source.request.noise or source.recording is None:
        return None
    clean = load_sources([replace(source.request, noise=0.0)])[0].recording
    if clean is None or not np.array_equal(clean.stamps, source.recording.stamps):
        raise RecordingError(
            f"{source.name}: the operator without noise must have the frames of the one with it"
        )
    return clean


def against_truth(trace: Trace, clean: Float[np.ndarray, "T 21 3"]) -> AgainstTruth:
    """Compares a run with the operator without noise.

    Args:
        trace: the run.
        clean: (T, 21, 3) the operator's landmarks without noise, aligned as in the trace [m].
    """
    known = replace(trace, human=clean)
    robot, tracked = (
        _figures(known.human_reaches, moved, trace)
        for moved in (trace.robot_reaches, trace.human_reaches)
    )
    return AgainstTruth(robot, tracked, evaluate(known), human_figures(clean, trace.fingers))


def _figures(
    truth: Float[np.ndarray, "T F 3"], moved: Float[np.ndarray, "T F 3"], trace: Trace
) -> TruthFigures:
    off = np.diff(moved, axis=0) - np.diff(truth, axis=0)
    squares = (off**2).sum(axis=-1)
    known = squares[np.isfinite(squares)]
    delay, correlation = consistency.lag(truth, moved, trace.stamps)
    return TruthFigures(
        consistency.motion_preservation(truth, moved),
        correlation,
        delay,
        1e3 * float(np.sqrt(known.mean())) if known.size else None,
    )

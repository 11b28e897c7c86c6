"""Targets of "better than every other method", one line each.

Every line compares figures of ``evaluate``, definition ``sound``, of
one method on one recording with those of the others on the same frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.lab.benchmark.recordings import Source, load_sources
from smooth_operator.lab.benchmark.results import value_of
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import METRICS, Trace, accuracy, consistency, evaluate, summary
from smooth_operator.types import HandRecording


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
    clean_trace = replace(trace, human=clean)
    robot, tracked = (
        _figures(clean_trace.human_reaches, moved, trace)
        for moved in (trace.robot_reaches, trace.human_reaches)
    )
    return AgainstTruth(robot, tracked, evaluate(clean_trace), human_figures(clean, trace.fingers))


def _figures(
    truth: Float[np.ndarray, "T F 3"], moved: Float[np.ndarray, "T F 3"], trace: Trace
) -> TruthFigures:
    off = np.diff(moved, axis=0) - np.diff(truth, axis=0)
    squares = (off**2).sum(axis=-1)
    finite = squares[np.isfinite(squares)]
    delay, correlation = consistency.lag(truth, moved, trace.stamps)
    return TruthFigures(
        consistency.motion_preservation(truth, moved),
        correlation,
        delay,
        1e3 * float(np.sqrt(finite.mean())) if finite.size else None,
    )


Figures: TypeAlias = Mapping[str, Any]
"""What ``evaluate`` gives."""

SBR: Final = "sbr"
"""The method whose lag must not be exceeded, and that other hands are compared with."""
SBR_PAPER: Final = "sbr:paper"
"""The method whose flatness is to be halved."""

ACCURATE: Final = 0.95
"""Thumb cosine from which a method counts in scale and motion: the rest points elsewhere."""
FOLLOWING: Final = 0.8
"""Motion preservation from which a method counts as smooth, and not as standing still."""
COLLIDING: Final = 0.05
"""Share of frames that may have links over 2 mm inside each other."""
PINCH_MARGIN_MM: Final = 2.0
"""How much further apart than the human's the robot's tips may be while the human pinches [mm]."""
P50_MS: Final = 2.0
P99_MS: Final = 5.0
JOINT_STEP: Final = 0.25
"""Largest change of a joint in one frame [rad], at ``STEP_RATE``."""
STEP_RATE: Final = 115.0
"""Rate that ``JOINT_STEP`` is for [Hz]; at others it is scaled, to the same speed."""

_METRIC: Final = {metric.name: metric for metric in METRICS}


@dataclass(frozen=True)
class HumanFigures:
    """What the human did on the same frames, on the robot's scale: what a perfect copy would have.

    Attributes:
        flatness: of the aligned fingertips in the palm frame [m^2].
        pinch_mm: mean thumb to tip distance of pinches (15 mm) [mm]; None without any.
        pinch_strict_mm: the same of firmer ones (12 mm) [mm].
    """

    flatness: float | None
    pinch_mm: float | None
    pinch_strict_mm: float | None


@dataclass(frozen=True)
class TargetLine:
    """One thing that is asked for.

    Attributes:
        name: what.
        unit: of the figures; "" for a plain number.
        sense: how ``reached`` is to lie to ``asked``; "" for a fact that is no target.
        asked: the target; None where there is nothing to be measured, or to be compared with.
        reached: the method's figure.
        other: the method that sets the target, or None.
        other_value: its figure.
        passed: None where the line does not apply.
        note: why it does not, or how the target came about.
    """

    name: str
    unit: str
    sense: Literal[">=", "<=", ">", "<", ""]
    asked: float | None
    reached: float | None
    other: str | None = None
    other_value: float | None = None
    passed: bool | None = None
    note: str = ""


def human_figures(aligned: Float[np.ndarray, "T 21 3"], fingers: Sequence[str]) -> HumanFigures:
    """What a perfect copy of the human would have.

    Args:
        aligned: landmarks in the robot's palm frame [m], NaN where unknown
            (``align_recording``).
        fingers: that the robot has, thumb first.
    """
    tips = aligned[:, [TIPS[FINGERS.index(name)] for name in fingers]]
    thumb = tips[:, 1:] - tips[:, :1]

    def gap(distance: float) -> float | None:
        return summary.scaled(summary.mean(accuracy.pinch_gaps(thumb, thumb, distance)), 1e3)

    return HumanFigures(
        consistency.flatness(tips),
        gap(accuracy.PINCH_DISTANCE),
        gap(accuracy.PINCH_DISTANCE_STRICT),
    )


def judge(own: Figures, others: Mapping[str, Figures], human: HumanFigures) -> list[TargetLine]:
    """All lines of one method on one recording.

    Args:
        own: figures of the method, its latency among them where it was measured.
        others: label -> figures of the methods to be beaten on the same frames; among them
            ``SBR`` and ``SBR_PAPER``.
        human: figures of the human on these frames.
    """
    accurate = {
        label: figures
        for label, figures in others.items()
        if (_figure(figures, "cosine_similarity") or 0.0) > ACCURATE
    }
    nobody = f"no method has a thumb cosine above {ACCURATE}"
    rate = _figure(own, "rate_hz")
    return [
        _cosine(own, others),
        _at_least(own, others, "cosine_similarity_all", "all-15 cosine"),
        _scale(own, accurate, nobody),
        _at_least(own, accurate, "motion_preservation", "motion preservation", nobody),
        _at_least(own, others, "velocity_correlation", "velocity correlation"),
        _lag(own, others, rate),
        _flatness(own, others, human),
        _fact("flatness, human's own", "m²", human.flatness, "fingertips, scaled"),
        _at_most(own, "self_collision.share", "collision deeper than 2 mm", "", COLLIDING),
        _pinch(own, "pinch_error_mm", "pinch gap", human.pinch_mm),
        _pinch(own, "pinch_error_strict_mm", "pinch gap, under 12 mm", human.pinch_strict_mm),
        _at_most(own, "latency_ms.p50", "latency p50", "ms", P50_MS),
        _at_most(own, "latency_ms.p99", "latency p99", "ms", P99_MS),
        _joint_step(own, rate),
        _at_most(own, "frozen_share", "frozen frames", "", 0.0),
        _at_most(own, "limit_violation_share", "frames beyond limits", "", 0.0),
    ]  # fmt: skip


def judge_hand(own: Figures, sbr: Figures) -> list[TargetLine]:
    """The lines for hands that the method was not made on: better than ``sbr`` on all of them.

    Where both are at the best value that there is (no collision), that is enough.
    """
    return [
        _better(own, sbr, "cosine_similarity", "thumb cosine", "", up=True),
        _better(own, sbr, "cosine_similarity_all", "all-keyvector cosine", "", up=True),
        _better(own, sbr, "flatness", "flatness", "m²", up=False),
        _better(own, sbr, "self_collision.share", "collision deeper than 2 mm", "", up=False),
        _better(own, sbr, "pinch_error_mm", "pinch gap", "mm", up=False),
    ]


def _figure(figures: Figures, name: str) -> float | None:
    return value_of({"metrics": figures}, _METRIC[name])


def _best(
    others: Mapping[str, Figures], name: str, merit: Callable[[float], float]
) -> tuple[str, float] | None:
    values = {label: v for label, one in others.items() if (v := _figure(one, name)) is not None}
    if not values:
        return None
    label = max(values, key=lambda one: merit(values[one]))
    return label, values[label]


def _cosine(own: Figures, others: Mapping[str, Figures]) -> TargetLine:
    name, note = "thumb cosine", "a quarter of the way from the best to 1"
    reached = _figure(own, "cosine_similarity")
    best = _best(others, "cosine_similarity", float)
    if best is None or reached is None:
        return TargetLine(name, "", ">=", None, reached, note="nothing to compare with")
    goal = best[1] + 0.25 * (1.0 - best[1])
    return TargetLine(name, "", ">=", goal, reached, *best, reached >= goal, note)


def _at_least(
    own: Figures, others: Mapping[str, Figures], metric: str, name: str, nobody: str = ""
) -> TargetLine:
    reached, best = _figure(own, metric), _best(others, metric, float)
    if best is None or reached is None:
        note = nobody if reached is not None else "not to be measured"
        return TargetLine(name, "", ">=", None, reached, note=note)
    return TargetLine(name, "", ">=", best[1], reached, *best, reached >= best[1])


def _scale(own: Figures, accurate: Mapping[str, Figures], nobody: str) -> TargetLine:
    name = "scale ratio, distance from 1"
    reached = _figure(own, "scale_ratio")
    best = _best(accurate, "scale_ratio", lambda value: -abs(value - 1.0))
    if best is None or reached is None:
        note = nobody if reached is not None else "not to be measured"
        off = None if reached is None else abs(reached - 1.0)
        return TargetLine(name, "", "<", None, off, note=note)
    off, goal = abs(reached - 1.0), abs(best[1] - 1.0)
    note = f"ratio {reached:.4f}, theirs {best[1]:.4f}"
    return TargetLine(name, "", "<", goal, off, best[0], goal, off < goal, note)


def _lag(own: Figures, others: Mapping[str, Figures], rate: float | None) -> TargetLine:
    name, unit = "lag", "frames"
    reached = _figure(own, "lag_ms")
    if reached is None or rate is None:
        return TargetLine(name, unit, "<=", None, None, note="nothing moves")
    frames = reached * 1e-3 * rate
    theirs = _figure(others.get(SBR, {}), "lag_ms")
    bound = 1.0 if theirs is None else min(1.0, theirs * 1e-3 * rate)
    other = None if theirs is None else SBR
    sbr_frames = None if theirs is None else theirs * 1e-3 * rate
    # A parabola through three correlations is not good to a thousandth of a frame.
    return TargetLine(name, unit, "<=", bound, frames, other, sbr_frames, frames <= bound + 1e-3)


def _flatness(own: Figures, others: Mapping[str, Figures], human: HumanFigures) -> TargetLine:
    name, unit = "flatness", "m²"
    reached, paper = _figure(own, "flatness"), _figure(others.get(SBR_PAPER, {}), "flatness")
    if reached is None or paper is None:
        note = "not to be measured" if reached is None else f"{SBR_PAPER} was not measured"
        return TargetLine(name, unit, "<=", None, reached, note=note)
    goal = 0.5 * paper
    if human.flatness is None or human.flatness <= goal:
        note = f"half of {SBR_PAPER}"
        return TargetLine(name, unit, "<=", goal, reached, SBR_PAPER, paper, reached <= goal, note)
    following = {
        label: figures
        for label, figures in others.items()
        if (_figure(figures, "motion_preservation") or 0.0) > FOLLOWING
    }
    best = _best(following, "flatness", lambda value: -value)
    forbids = f"the human's own is above half of {SBR_PAPER} ({goal:.2e})"
    if best is None:
        note = f"{forbids}, and no method preserves motion above {FOLLOWING}"
        return TargetLine(name, unit, "<=", None, reached, note=note)
    note = f"smoothest with motion above {FOLLOWING}, since {forbids}"
    return TargetLine(name, unit, "<=", best[1], reached, *best, reached <= best[1], note)


def _at_most(own: Figures, metric: str, name: str, unit: str, goal: float) -> TargetLine:
    reached = _figure(own, metric)
    if reached is None:
        return TargetLine(name, unit, "<=", goal, None, note="not measured")
    return TargetLine(name, unit, "<=", goal, reached, passed=reached <= goal)


def _pinch(own: Figures, metric: str, name: str, human: float | None) -> TargetLine:
    reached = _figure(own, metric)
    if reached is None or human is None:
        return TargetLine(name, "mm", "<=", None, reached, note="the human does not pinch")
    goal = human + PINCH_MARGIN_MM
    return TargetLine(
        name, "mm", "<=", goal, reached, "human", human, reached <= goal, "human's own + 2 mm"
    )


def _joint_step(own: Figures, rate: float | None) -> TargetLine:
    name, reached = "largest joint step", _figure(own, "max_joint_step")
    if reached is None or rate is None:
        return TargetLine(name, "rad", "<=", None, reached, note="one frame only")
    goal = JOINT_STEP * STEP_RATE / rate
    note = f"{JOINT_STEP} rad at {STEP_RATE:g} Hz, here {rate:.4g} Hz"
    return TargetLine(name, "rad", "<=", goal, reached, passed=reached <= goal, note=note)


def _fact(name: str, unit: str, value: float | None, note: str) -> TargetLine:
    return TargetLine(name, unit, "", None, value, note=note)


def _better(
    own: Figures, sbr: Figures, metric: str, name: str, unit: str, *, up: bool
) -> TargetLine:
    reached, theirs = _figure(own, metric), _figure(sbr, metric)
    sense: Literal[">", "<"] = ">" if up else "<"
    if reached is None or theirs is None:
        return TargetLine(name, unit, sense, theirs, reached, note="not to be measured here")
    goal = 1.0 if up else 0.0
    best = reached == theirs == goal
    passed = best or (reached > theirs if up else reached < theirs)
    return TargetLine(name, unit, sense, theirs, reached, SBR, theirs, passed)

"""Methods on degraded recordings, as cells; and what is measured of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.alignment import AlignmentConfig, align_recording
from smooth_operator.lab.benchmark.built import built_for
from smooth_operator.lab.benchmark.cells import Cell, benchmark_code, fingerprint
from smooth_operator.lab.benchmark.settings import Choice, Settings, method_label, select_methods
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.metrics import consistency, joints
from smooth_operator.metrics.accuracy import cosine_similarity
from smooth_operator.metrics.trace import Trace
from smooth_operator.planning import Plan
from smooth_operator.result_cache import Job
from smooth_operator_research.paper.degraded_recordings import LEAD, DegradedRecording
from smooth_operator_research.paper.delay import sub_frame_lag
from smooth_operator_research.paper.experiment_context import Compute, ExperimentContext, cell_job
from smooth_operator_research.paper.intervals import (
    Contrast,
    Estimate,
    Samples,
    contrast,
    mean_of,
    typical,
)

PUBLISHED_SBR: Final = "sbr:paper"
"""Label of the paper's method with the paper's settings."""

BASELINES: Final = ("dexpilot:published", "geort", "hybrid:published")
"""Labels of the baselines of the paper's table, as their authors run them; GeoRT with our model."""

METHODS: Final = (PUBLISHED_SBR, *BASELINES, "sbr", "smooth", "ako", "joint_angle")
"""Those of the paper's table as published, and ours."""

_EFFORT_MS: Final = {"sbr:paper": 20.0, "ako": 5.0, "hybrid": 4.0, "keyvector": 1.5,
                     "dexpilot": 2.0, "dexpilot:published": 8.0,
                     "hybrid:published": 8.0}  # fmt: skip
"""About how long a frame takes [ms], for the time that is left; 0.7 for others."""


@dataclass(frozen=True)
class Field:
    """The methods that can serve a hand.

    Attributes:
        choices: label -> method.
        gaps: label -> why a method is missing.
    """

    choices: Mapping[str, Choice]
    gaps: Mapping[str, str]

    def note(self) -> str:
        """The gaps as a sentence, empty where there are none."""
        return "".join(f" {label} is missing: {why}." for label, why in self.gaps.items())


def field_of(context: ExperimentContext, names: Sequence[str] = METHODS) -> Field:
    """Which of some methods can serve the hand.

    Raises:
        ConfigError: none can.
    """
    choices: dict[str, Choice] = {}
    gaps: dict[str, str] = {}
    hand = load_hand(context.hand, context.sources[0].side)
    for choice in select_methods(tuple(names)):
        label = method_label(choice.method, choice.preset)
        try:
            choice.config.build(hand)
            choices[label] = choice
        except SmoothOperatorError as error:
            gaps[label] = str(error)
    if not choices:
        raise ConfigError(
            f"no method can serve the hand {hand.name!r}: {next(iter(gaps.values()))}"
        )
    return Field(choices, gaps)


def effort_ms(label: str) -> float:
    """About how long a frame takes on two cores [ms]."""
    return _EFFORT_MS.get(label, 0.7)


def follow_job(
    context: ExperimentContext,
    label: str,
    choice: Choice,
    degraded: DegradedRecording,
    seed: int = 0,
) -> Job[Compute]:
    """A method on a degraded recording, as a cell: ``q`` (T, n) [rad] and ``status`` (T,)."""
    seen = replace(degraded.source, recording=degraded.seen, digest=degraded.digest)
    cell = Cell(seen, context.hand, choice.method, choice.preset, choice.config)

    def compute(advance: Callable[[float], None]) -> dict[str, np.ndarray]:
        hand = load_hand(context.hand, degraded.seen.side)
        todo = Plan(degraded.seen, hand, choice.method, choice.preset, choice.config, 0)
        retargeter, _ = built_for(todo)

        def tracked(frames: Iterable[int]) -> Iterator[int]:
            for i in frames:
                yield i
                if i % 20 == 19:
                    advance(20 / len(degraded.seen))

        commands, _ = retargeter.run(degraded.seen, seed=seed, track=tracked)
        return {"q": commands.joint_positions[LEAD:], "status": commands.status[LEAD:]}

    return cell_job(
        f"{label} on {degraded.source.name}",
        {"kind": f"follow-{choice.method}", "lead": LEAD,
         "cell": fingerprint(cell, Settings(output=Path(), seed=seed))},
        300.0 + effort_ms(label) * len(degraded.seen),
        compute,
        benchmark_code(),
    )  # fmt: skip


def measure_following(
    hand: Hand,
    degraded: DegradedRecording,
    cell: Mapping[str, np.ndarray],
    alignment: AlignmentConfig,
    timing: bool = False,
) -> dict[str, float]:
    """Figures of a method on a degraded recording, against the hand as it was.

    Returns:
        ``cosine_similarity`` (thumb to tips), ``motion_preservation``, ``flatness`` [m²],
        ``jitter`` [rad], ``acceleration`` [rad/s²], ``tip_acceleration`` [m/s²], ``step`` (largest
        of a joint in a frame) [rad], ``held``: share of frames whose command repeats the last; with
        ``timing``, which takes longer than all of these, ``lag_ms`` and ``correlation`` of the
        velocities there. NaN where there is none.
    """
    q = np.asarray(cell["q"], float)
    trace = Trace(
        human=align_recording(degraded.clean, hand, alignment),
        robot_tips=hand.tips(q),
        robot_wrist=hand.wrist,
        fingers=hand.fingers,
        joint_positions=q,
        joint_limits=hand.joint_limits,
        stamps=degraded.clean.stamps,
        status=cell["status"],
        latency_ms=np.full(len(q), np.nan),
    )
    thumb = trace.thumb_vectors
    figures = {
        "cosine_similarity": cosine_similarity(
            trace.human_keyvectors[:, thumb], trace.robot_keyvectors[:, thumb]
        ),
        "motion_preservation": consistency.motion_preservation(
            trace.human_reaches, trace.robot_reaches
        ),
        "flatness": consistency.flatness(trace.robot_tips),
        "tip_acceleration": consistency.fingertip_acceleration(trace.robot_tips, trace.stamps),
        "jitter": joints.joint_jitter(q),
        "acceleration": joints.joint_acceleration(q, trace.stamps),
        "step": joints.max_joint_step(q),
        "held": float(np.mean(trace.status != 0)),
    }
    if timing:
        figures["lag_ms"], figures["correlation"] = sub_frame_lag(
            trace.human_reaches, trace.robot_reaches, trace.stamps
        )
    return {name: float("nan") if value is None else value for name, value in figures.items()}


def measure_human(hand: Hand, degraded: DegradedRecording) -> dict[str, float]:
    """``flatness`` [m²] and ``tip_acceleration`` [m/s²] of the human's own fingertips, aligned: as
    they were, and as seen (``seen_flatness``, ``seen_tip_acceleration``)."""
    figures: dict[str, float] = {}
    for prefix, recording in (("", degraded.clean), ("seen_", degraded.seen[LEAD:])):
        aligned = align_recording(recording, hand, AlignmentConfig())
        tips = _tips(hand, aligned)
        for name, value in (
            ("flatness", consistency.flatness(tips)),
            ("tip_acceleration", consistency.fingertip_acceleration(tips, recording.stamps)),
        ):
            figures[prefix + name] = float("nan") if value is None else value
    return figures


def _tips(hand: Hand, aligned: Float[np.ndarray, "T 21 3"]) -> Float[np.ndarray, "T F 3"]:
    return np.asarray(aligned[:, [LANDMARKS.index(name) for name in hand.tip_names]])


_SIGNED_OR_BOUNDED: Final = (
    "cosine_similarity", "motion_preservation", "lag_ms", "correlation", "held"
)  # fmt: skip
"""Figures that are averaged as they are; the others are positive and differ manifold."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Methods over conditions, recordings and seeds.

    Attributes:
        conditions: in their order; what they are is the experiment's.
        labels: of the methods.
        measured: (label, condition, recording) -> one set of figures for each seed.
        human: (condition, recording) -> the same of the human.
        units: name of a recording -> the independent unit that it belongs to.
    """

    conditions: Sequence[Any]
    labels: Sequence[str]
    measured: Mapping[tuple[str, Any, str], list[dict[str, float]]]
    human: Mapping[tuple[Any, str], list[dict[str, float]]]
    units: Mapping[str, str]

    def mean(self, label: str, condition: Any, metric: str) -> Estimate | None:
        """With an interval, geometric for figures of smoothness; None where no recording has it."""
        return self._averaged(self.known(label, condition, metric), metric)

    def human_mean(self, condition: Any, metric: str) -> Estimate | None:
        """The same of the human."""
        return self._averaged(_known(self.human, (condition,), self.units, metric), metric)

    def known(self, label: str, condition: Any, metric: str) -> dict[str, list[float]]:
        """Recording -> a figure by seed; recordings without it are left out."""
        return _known(self.measured, (label, condition), self.units, metric)

    def _averaged(self, values: Mapping[str, list[float]], metric: str) -> Estimate | None:
        if not values:
            return None
        over = mean_of if metric in _SIGNED_OR_BOUNDED else typical
        return over(self.samples(values))

    def samples(self, values: Mapping[str, Sequence[float]]) -> Samples:
        """With the units of the recordings."""
        return Samples(list(values.values()), [self.units[name] for name in values])

    def against(
        self, a: str, b: str, condition: Any, metric: str, kind: Contrast = "ratio"
    ) -> Estimate | None:
        """One method against another, recording by recording; None where they can't be compared."""
        return self.compared(
            self.known(a, condition, metric), self.known(b, condition, metric), kind
        )

    def compared(
        self, x: Mapping[str, list[float]], y: Mapping[str, list[float]], kind: Contrast
    ) -> Estimate | None:
        """Figures of the recordings that are in both; None where there is none."""
        both = [name for name in x if name in y]
        if not both:
            return None
        a, b = (self.samples({name: own[name] for name in both}) for own in (x, y))
        return contrast(a, b, kind)

    def figures(self) -> list[dict[str, Any]]:
        """All numbers, for results.json."""
        return [
            {"method": label, "condition": condition, "recording": recording, "seeds": own}
            for (label, condition, recording), own in self.measured.items()
        ] + [
            {"method": "human", "condition": condition, "recording": recording, "seeds": own}
            for (condition, recording), own in self.human.items()
        ]


def run_sweep(
    context: ExperimentContext,
    name: str,
    field: Field,
    inputs: Mapping[tuple[Any, str], Sequence[DegradedRecording]],
    timing: bool = False,
) -> Sweep:
    """Runs what is missing.

    Args:
        context: the recordings, the size and the folder.
        name: of the phase, for the display.
        field: the methods.
        inputs: (condition, recording) -> one degraded recording for each seed.
        timing: measure the lag, too.
    """
    # recording by recording, so that a run which is stopped has whole comparisons
    order = [
        (label, condition, recording, seed)
        for recording in dict.fromkeys(recording for _, recording in inputs)
        for label in field.choices
        for (condition, own), several in inputs.items()
        if own == recording
        for seed in range(len(several))
    ]
    jobs = [
        follow_job(
            context,
            label,
            field.choices[label],
            inputs[condition, recording][seed],
            seed,
        )
        for label, condition, recording, seed in order
    ]
    measured: dict[tuple[str, Any, str], list[dict[str, float]]] = {}
    for (label, condition, recording, seed), cell in zip(
        order, context.finish(name, jobs), strict=True
    ):
        degraded = inputs[condition, recording][seed]
        hand = load_hand(context.hand, degraded.seen.side)
        alignment = field.choices[label].config.alignment
        measured.setdefault((label, condition, recording), []).append(
            measure_following(hand, degraded, cell, alignment, timing)
        )
    human = {
        at: [
            measure_human(load_hand(context.hand, degraded.seen.side), degraded)
            for degraded in several
        ]
        for at, several in inputs.items()
    }
    return Sweep(
        list(dict.fromkeys(condition for condition, _ in inputs)),
        list(field.choices),
        measured,
        human,
        {name: context.unit_of[name] for name in dict.fromkeys(own for _, own in inputs)},
    )


def _known(
    table: Mapping[Any, list[dict[str, float]]],
    at: tuple[Any, ...],
    recordings: Iterable[str],
    metric: str,
) -> dict[str, list[float]]:
    found = {
        name: [one[metric] for one in table.get((*at, name), []) if np.isfinite(one[metric])]
        for name in recordings
    }
    return {name: values for name, values in found.items() if values}

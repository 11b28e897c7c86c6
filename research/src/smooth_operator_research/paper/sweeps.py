"""Experiments ``noise`` and ``rate``: methods with a worse tracker, and at several frame rates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from smooth_operator.errors import RecordingError, counted
from smooth_operator.synthetic.tracker import TrackerModel
from smooth_operator_research.paper.experiment import (
    Drawing,
    ExperimentContext,
    Outcome,
    Table,
)
from smooth_operator_research.paper.figures import Column, Row, sweep_figure
from smooth_operator_research.paper.follow import (
    BASELINES,
    LEAD,
    PUBLISHED_SBR,
    DegradedRecording,
    Sweep,
    at_rate,
    field_of,
    middle,
    recording_of,
    run_sweep,
    through_tracker,
)
from smooth_operator_research.paper.intervals import Estimate
from smooth_operator_research.paper.verdicts import Direction, Equality, Verdict, judge

NOISE: Final = 1e-3
"""Noise at which claims are judged [m], as of a glove or a good camera; or the nearest value."""


@dataclass(frozen=True)
class Condition:
    """Faults of the tracker.

    Attributes:
        noise: standard deviation of each coordinate of each landmark [m].
        loss: fraction of frames that never arrive.
    """

    noise: float = 0.0
    loss: float = 0.0

    def __str__(self) -> str:
        if self.loss:
            return f"{100 * self.loss:g} % lost"
        return f"{1e3 * self.noise:g} mm" if self.noise else "clean"


class TrackerNoise:
    """Compares methods at noise from 0 to 5 mm and drop-outs from 0 to 20 %."""

    title = "Tracker noise and drop-outs"
    claim = "ours: smoothness with a worse tracker. The paper: SBR is a low-pass filter"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        size, field = context.size, field_of(context)
        noises = [Condition(noise=noise) for noise in size.noises]
        losses = [Condition(loss=loss) for loss in size.losses]
        inputs = {
            (condition, source.name): [
                through_tracker(
                    source,
                    middle(recording_of(source), size.noise_frames),
                    TrackerModel(frame_loss=condition.loss, seed=seed),
                    condition.noise,
                )
                # a clean tracker has no seed; the methods' own is not what is looked at
                for seed in range(size.tracker_seeds if condition.noise or condition.loss else 1)
            ]
            for condition in dict.fromkeys([*noises, *losses])
            for source in context.sources
        }
        sweep = run_sweep(context, "tracker noise", field, inputs)
        frames = sum(len(inputs[noises[0], source.name][0].clean) for source in context.sources)
        rates = sorted({round(s.recording.rate_hz) for s in context.sources if s.recording})
        return Outcome(
            f"{len(field.choices)} methods on {context.hand}, {frames:,} frames of "
            f"{context.recordings} at {' and '.join(map(str, rates))} Hz, "
            f"{counted(size.tracker_seeds, 'seed')} of the tracker for each condition. Noise is "
            "white and Gaussian, independent for each coordinate of each landmark and each frame; "
            "frames are lost in bursts of 30 ms on average, in which commands repeat the last one. "
            "Methods see the degraded tracker and are compared with the true hand; recordings of "
            "real trackers have their own noise in both. The first frame is shown "
            f"{LEAD} times before measuring starts. The methods of the paper's table have their "
            "authors' settings (sbr:paper, dexpilot:published, hybrid:published), except GeoRT, "
            "which has our model; the others have our default presets (for sbr, realtime)."
            f"{field.note()}",
            [
                _smooth_verdict(sweep, noises),
                _step_verdict(sweep, losses),
                _price_verdict(sweep, noises),
            ],
            [
                _table(sweep, noises, "Under noise"),
                _table(sweep, losses, "With frames lost"),
            ],
            [
                Drawing(
                    "noise",
                    "Smoothness and fidelity over the tracker's noise (left) and over the fraction "
                    "of lost frames (right). Grey: the human's own fingertips, the true ones and "
                    "as the methods see them. Bars: 95 % intervals over recordings.",
                    sweep_figure(
                        sweep.mean,
                        sweep.human_mean,
                        sweep.labels,
                        _NOISE_ROWS,
                        [
                            Column(
                                "noise of a coordinate [mm]",
                                range(len(noises)),
                                noises,
                                marks=[f"{1e3 * c.noise:g}" for c in noises],
                            ),
                            Column("frames lost [%]", [100 * c.loss for c in losses], losses),
                        ],
                    ),
                )
            ],
            {"cells": sweep.figures(), "gaps": field.gaps},
        )


CONTROL_HZ: Final = 30.0
"""Rate of the paper's user study."""


class FrameRate:
    """Compares methods at several frame rates: smoothness independent of the rate, lag in ms."""

    title = "Frame rate"
    claim = "ours: smoothness and lag by frame rate. The paper: smooth and responsive"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        size, field = context.size, field_of(context)
        inputs: dict[tuple[float, str], list[DegradedRecording]] = {}
        slow = []
        for rate in size.rates:
            for source in context.sources:
                degraded = at_rate(source, rate, size.rate_seconds)
                if degraded is None:
                    slow.append(f"{source.name} at {rate:g} Hz")
                else:
                    inputs[rate, source.name] = [degraded]
        if not inputs:
            raise RecordingError(
                f"no recording has {size.rates[0]:g} frames per second, the lowest rate of this "
                "experiment"
            )
        sweep = run_sweep(context, "frame rate", field, inputs, timing=True)
        gap = (
            f" Left out, because the frame rate of the recording is lower: {', '.join(slow)}."
            if slow
            else ""
        )
        seconds = sum(
            max(own[0].clean.duration for (_, name), own in inputs.items() if name == source.name)
            for source in context.sources
            if any(name == source.name for _, name in inputs)
        )
        return Outcome(
            f"{len(field.choices)} methods on {context.hand}, {seconds:.3g} s of "
            f"{context.recordings} at each rate. The built-in operator is recorded again "
            "at each rate with the same motion; from other recordings, frames are left out. "
            "Accelerations use the real timestamps. Lag is the shift between cubic splines through "
            "the commands and through the human's motion that best aligns their velocities; it is "
            "finer than a frame. The computing time (latency) and the time until the next command "
            "(half a period on average) add to it. No method knows the rate: weights of "
            f"velocity terms are per frame, as published. The first frame is shown {LEAD} times "
            f"before measuring starts.{gap}{field.note()}",
            [_smooth_rate_verdict(sweep), _lag_verdict(sweep), _filter_verdict(sweep)],
            [_table(sweep, sweep.conditions, "Methods by frame rate")],
            [
                Drawing(
                    "rate",
                    "Smoothness and lag over the frame rate. Grey: the human's own fingertips. "
                    "Bars: 95 % intervals over recordings.",
                    sweep_figure(
                        sweep.mean,
                        sweep.human_mean,
                        sweep.labels,
                        _RATE_ROWS,
                        [Column("frames a second [Hz]", sweep.conditions, sweep.conditions, True)],
                    ),
                )
            ],
            {"cells": sweep.figures(), "gaps": field.gaps, "too_slow": slow},
        )


_NOISE_ROWS: Final = (
    Row("jitter", 1e3, "joint jitter [mrad]", log=True),
    Row(
        "flatness",
        1e6,
        "flatness [mm²]",
        log=True,
        human={"human, as it was": "flatness", "human, as seen": "seen_flatness"},
    ),
    Row("cosine_similarity", 1.0, "cosine similarity"),
    Row("motion_preservation", 1.0, "motion preservation"),
)

_RATE_ROWS: Final = (
    Row(
        "tip_acceleration",
        1.0,
        "fingertip acceleration\n[m/s²]",
        log=True,
        human={"human": "tip_acceleration"},
    ),
    Row("acceleration", 1.0, "joint acceleration\n[rad/s²]", log=True),
    Row("lag_ms", 1.0, "lag [ms]"),
    Row("motion_preservation", 1.0, "motion preservation"),
)

_NOISE_HEADERS: Final = (
    ("jitter", "jitter [mrad]", 1e3),
    ("flatness", "flatness [mm²]", 1e6),
    ("cosine_similarity", "cosine", 1.0),
    ("motion_preservation", "motion", 1.0),
    ("step", "largest step [rad]", 1.0),
)

_RATE_HEADERS: Final = (
    ("tip_acceleration", "fingertips [m/s²]", 1.0),
    ("acceleration", "joints [rad/s²]", 1.0),
    ("lag_ms", "lag [ms]", 1.0),
    ("correlation", "velocity correlation", 1.0),
    ("motion_preservation", "motion", 1.0),
    ("cosine_similarity", "cosine", 1.0),
    ("flatness", "flatness [mm²]", 1e6),
)

_NOISE_NOTE: Final = (
    "Means over independent recordings with 95 % intervals, geometric for jitter, flatness and "
    "the largest step. Flatness and jitter depend on this frame rate, and include the human's "
    "own acceleration."
)
_RATE_NOTE: Final = (
    "Means over independent recordings with 95 % intervals, geometric for accelerations and "
    "flatness. Flatness is the paper's metric, per frame and not per time, so compare it only at "
    "equal rates."
)


def _table(sweep: Sweep, conditions: Sequence[Any], title: str) -> Table:
    """Table with a row for each method and condition (tracker or frame rate [Hz])."""
    tracker = isinstance(conditions[0], Condition)
    headers = _NOISE_HEADERS if tracker else _RATE_HEADERS
    rows = []
    for label in sweep.labels:
        for condition in conditions:
            means = [(sweep.mean(label, condition, name), factor) for name, _, factor in headers]
            shown = ["–" if mean is None else mean.shown(3, factor) for mean, factor in means]
            rows.append([label, str(condition) if tracker else f"{condition:g} Hz", *shown])
    names = ["method", "tracker" if tracker else "rate", *(header for _, header, _ in headers)]
    return Table(title, names, rows, _NOISE_NOTE if tracker else _RATE_NOTE)


def _at(conditions: Sequence[Condition], noise: float) -> Condition:
    noisy = [condition for condition in conditions if condition.noise] or list(conditions)
    return min(noisy, key=lambda condition: abs(condition.noise - noise))


def compared(sweep: Sweep, condition: Any, metric: str, kind: Any = "ratio") -> dict[str, Estimate]:
    """Compares the paper's SBR with each available baseline of the paper."""
    estimates = {
        name: sweep.against(PUBLISHED_SBR, name, condition, metric, kind) for name in BASELINES
    }
    return {name: estimate for name, estimate in estimates.items() if estimate is not None}


def listed(estimates: dict[str, Estimate]) -> str:
    """Formats ratios by name."""
    return ", ".join(f"{name} × {e.shown(3)}" for name, e in estimates.items())


def listed_changes(estimates: dict[str, Estimate]) -> str:
    """Formats differences by name."""
    return ", ".join(f"{name} {signed(e)}" for name, e in estimates.items())


def signed(change: Estimate, unit: str = "") -> str:
    """Formats a difference."""
    return ("+" if change.value > 0 else "") + change.shown(3, 1.0, unit)


def not_compared(claim: str, paper: str, sweep: Sweep) -> Verdict:
    """Verdict if the paper's SBR or all its rivals are missing."""
    absent = ", ".join(n for n in (PUBLISHED_SBR, *BASELINES) if n not in sweep.labels)
    note = f"Missing on this hand: {absent or 'methods to compare'}."
    return Verdict(claim, paper, "not measured", "not shown", note)


def compared_verdict(
    claim: str, paper: str, figure: str, sweep: Sweep, ratios: dict[str, Estimate]
) -> Verdict:
    """Verdict on the ratio of SBR's value to those of the baselines, claimed to be below 1."""
    if not ratios:
        return not_compared(claim, paper, sweep)
    held = judge(Direction(1.0, upwards=False), list(ratios.values()))
    return Verdict(claim, paper, f"{figure}: {listed(ratios)}", held)


def _smooth_verdict(sweep: Sweep, noises: Sequence[Condition]) -> Verdict:
    at = _at(noises, NOISE)
    return compared_verdict(
        "SBR is a low-pass filter: with a noisy tracker it is smoother than the baselines",
        "7.17e-7 m² against 3.01e-6 and more, no noise added",
        f"flatness at {at}",
        sweep,
        compared(sweep, at, "flatness"),
    )


def _step_verdict(sweep: Sweep, losses: Sequence[Condition]) -> Verdict:
    return compared_verdict(
        "ours: after lost frames SBR returns with smaller steps than the baselines",
        "no claim",
        f"largest step at {losses[-1]}",
        sweep,
        compared(sweep, losses[-1], "step"),
    )


def _price_verdict(sweep: Sweep, noises: Sequence[Condition]) -> Verdict:
    claim = "with a noisy tracker SBR keeps more of the human's motion than the baselines"
    paper = "0.776 against 0.675 to 0.727, no noise added"
    at = _at(noises, NOISE)
    estimates = compared(sweep, at, "motion_preservation", "difference")
    if not estimates:
        return not_compared(claim, paper, sweep)
    held = judge(Direction(0.0, upwards=True), list(estimates.values()))
    return Verdict(
        claim,
        paper,
        f"motion preservation at {at}: {listed_changes(estimates)}",
        held,
        "Measured against the true hand, without the noise.",
    )


def _smooth_rate_verdict(sweep: Sweep) -> Verdict:
    claim = "SBR is smoother than the baselines, at any frame rate"
    paper = "7.17e-7 m² against 3.01e-6 and more, at about 100 Hz only"
    by_rate = {rate: compared(sweep, rate, "tip_acceleration") for rate in sweep.conditions}
    ratios = [one for estimates in by_rate.values() for one in estimates.values()]
    if not ratios:
        return not_compared(claim, paper, sweep)
    near = _near(sweep, 100.0)
    return Verdict(
        claim,
        paper,
        f"fingertip acceleration at {near:g} Hz: {listed(by_rate[near])}",
        judge(Direction(1.0, upwards=False), ratios),
        "; ".join(f"{rate:g} Hz: {listed(estimates)}" for rate, estimates in by_rate.items()),
    )


def _lag_verdict(sweep: Sweep) -> Verdict:
    claim = "SBR is responsive: its lag stays below one frame, at any frame rate"
    paper = "participants called it responsive; no figure"
    lags = {rate: sweep.mean(PUBLISHED_SBR, rate, "lag_ms") for rate in sweep.conditions}
    finite = {rate: lag for rate, lag in lags.items() if lag is not None}
    if not finite:
        return not_compared(claim, paper, sweep)
    # in frames, so that one margin serves all rates
    frames = [
        Estimate(tuple(1e-3 * rate * ms for ms in lag.points)) for rate, lag in finite.items()
    ]
    at = _near(sweep, CONTROL_HZ)
    slower = listed_changes(compared(sweep, at, "lag_ms", "difference"))
    return Verdict(
        claim,
        paper,
        ", ".join(f"{rate:g} Hz {lag.shown(3, 1.0, ' ms')}" for rate, lag in finite.items()),
        judge(Equality(-1.0, 1.0), frames),
        f"At {at:g} Hz, the rate nearest to that of the paper's study, against the baselines: "
        f"{slower} ms. Methods without a memory (joint_angle, geort) can't lag: their lag in the "
        "table is the error of the measurement. If velocities hardly correlate, lag means little.",
    )


def _filter_verdict(sweep: Sweep) -> Verdict:
    claim = "ours: a velocity term per frame makes SBR's lag grow as the rate falls"
    low, high = sweep.conditions[0], sweep.conditions[-1]
    slow, fast = (sweep.known(PUBLISHED_SBR, rate, "lag_ms") for rate in (low, high))
    change = sweep.compared(slow, fast, "difference") if low != high else None
    if change is None:
        return not_compared(claim, "no claim", sweep)
    return Verdict(
        claim,
        "no claim",
        f"{low:g} Hz over {high:g} Hz: {signed(change, ' ms')}",
        judge(Direction(0.0, upwards=True), [change]),
        "w_v pulls a command to the last one, regardless of the time between them. If you change "
        "the rate, scale w_v with it.",
    )


def _near(sweep: Sweep, rate: float) -> float:
    return float(min(sweep.conditions, key=lambda one: abs(one - rate)))

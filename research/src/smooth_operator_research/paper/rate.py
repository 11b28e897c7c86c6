"""Experiment ``rate``: methods at several frame rates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from smooth_operator.errors import RecordingError
from smooth_operator_research.paper.experiment import Drawing, ExperimentContext, Outcome, Table
from smooth_operator_research.paper.figures import Column, Row, sweep_figure
from smooth_operator_research.paper.follow import (
    LEAD,
    PUBLISHED_SBR,
    DegradedRecording,
    Sweep,
    at_rate,
    field_of,
    run_sweep,
)
from smooth_operator_research.paper.intervals import Estimate
from smooth_operator_research.paper.more_sizes import more_size
from smooth_operator_research.paper.noise import (
    compared,
    listed,
    listed_changes,
    not_compared,
    signed,
)
from smooth_operator_research.paper.verdicts import Direction, Equality, Verdict, judge

CONTROL_HZ: Final = 30.0
"""Rate of the paper's user study."""


class FrameRate:
    """The same motion at several frame rates; smoothness free of the rate, lag in milliseconds."""

    title = "Frame rate"
    claim = "ours: at which rate is who smooth, and who late? The paper: smooth and responsive"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        size, field = more_size(context), field_of(context)
        inputs: dict[tuple[float, str], list[DegradedRecording]] = {}
        slow = []
        for rate in size.rates:
            for source in context.sources:
                degraded = at_rate(source, rate, size.seconds)
                if degraded is None:
                    slow.append(f"{source.name} at {rate:g} Hz")
                else:
                    inputs[rate, source.name] = [degraded]
        if not inputs:
            raise RecordingError(
                f"no recording has the {size.rates[0]:g} frames a second that this experiment "
                "begins at"
            )
        sweep = run_sweep(context, "frame rate", field, inputs, timing=True)
        gap = f" Recorded too slowly, and left out: {', '.join(slow)}." if slow else ""
        seconds = sum(
            max(own[0].clean.duration for (_, name), own in inputs.items() if name == source.name)
            for source in context.sources
            if any(name == source.name for _, name in inputs)
        )
        return Outcome(
            f"{len(field.choices)} methods on {context.hand}, {seconds:.3g} s of "
            f"{context.recordings} at each rate. The built-in operator is recorded again "
            "at each rate, the motion being the same; of other recordings frames are left out. "
            "Accelerations are by the real stamps. Lag is the shift of cubic splines through the "
            "commands against those through the human's motion that best aligns their velocities, "
            "finer than a frame; the time of computing (latency) and of holding a command until "
            "the next, half a period in the mean, come on top. No method knows the rate: weights "
            f"of velocity terms are per frame, as published. The first frame is shown {LEAD} times "
            f"before anything counts.{gap}{field.note()}",
            [_smooth_verdict(sweep), _lag_verdict(sweep), _filter_verdict(sweep)],
            [_table(sweep)],
            [
                Drawing(
                    "rate",
                    "Smoothness and lag over the frame rate. Grey: the human's own fingertips. "
                    "Bars: 95 % intervals over recordings.",
                    sweep_figure(
                        sweep.mean, sweep.human_mean, sweep.labels, _ROWS,
                        [Column("frames a second [Hz]", sweep.conditions, sweep.conditions, True)],
                    ),
                )
            ],
            {"cells": sweep.figures(), "gaps": field.gaps, "too_slow": slow},
        )  # fmt: skip


_ROWS: Final = (
    Row("tip_acceleration", 1.0, "fingertip acceleration\n[m/s²]", log=True,
        human={"human": "tip_acceleration"}),
    Row("acceleration", 1.0, "joint acceleration\n[rad/s²]", log=True),
    Row("lag_ms", 1.0, "lag [ms]"),
    Row("motion_preservation", 1.0, "motion preservation"),
)  # fmt: skip


def _smooth_verdict(sweep: Sweep) -> Verdict:
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
        "table is the error of the measure; where velocities hardly correlate, it says little.",
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
        "w_v holds a command to the last one, whatever time lies between them. Who changes the "
        "rate ought to scale w_v with it.",
    )


def _near(sweep: Sweep, rate: float) -> float:
    return float(min(sweep.conditions, key=lambda one: abs(one - rate)))


_HEADERS: Final[Sequence[tuple[str, str, float]]] = (
    ("tip_acceleration", "fingertips [m/s²]", 1.0),
    ("acceleration", "joints [rad/s²]", 1.0),
    ("lag_ms", "lag [ms]", 1.0),
    ("correlation", "velocity correlation", 1.0),
    ("motion_preservation", "motion", 1.0),
    ("cosine_similarity", "cosine", 1.0),
    ("flatness", "flatness [mm²]", 1e6),
)


def _table(sweep: Sweep) -> Table:
    rows = []
    for label in sweep.labels:
        for rate in sweep.conditions:
            means = [sweep.mean(label, rate, metric) for metric, _, _ in _HEADERS]
            shown = [
                "–" if mean is None else mean.shown(3, factor)
                for mean, (_, _, factor) in zip(means, _HEADERS, strict=True)
            ]
            rows.append([label, f"{rate:g} Hz", *shown])
    return Table(
        "Methods by frame rate",
        ["method", "rate", *(header for _, header, _ in _HEADERS)],
        rows,
        "Means over independent recordings with 95 % intervals, geometric ones for accelerations "
        "and flatness. Flatness is the paper's: by frame, "
        "not by time, so it may be compared within a rate only.",
    )

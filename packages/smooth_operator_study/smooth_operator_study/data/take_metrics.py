"""Simulation metrics of each operator with each retargeter, from the study's own recordings.

A recording holds the operator's landmarks and the commands that answered them. It is cut to the
trials that count. Metrics are means over the frames of these trials; workspace utilisation is that
of all trials together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any, Final

import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.metrics.assemble import assemble_trace, sample_reach
from smooth_operator.metrics.table import find_metric
from smooth_operator.metrics.trace import Trace
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.types import CommandTrajectory, HandRecording
from smooth_operator_study.store.progress import Trial

METRIC_NAMES: Final = (
    "cosine_similarity",
    "scale_ratio",
    "motion_preservation",
    "flatness",
    "workspace_utilisation",
    "latency_ms",
)
"""Columns of the table; units as in ``smooth_operator.metrics``, latency as its mean [ms]."""
_POOLED: Final = "workspace_utilisation"
_FEWEST: Final = 3  # frames of a trial, or there is no motion to measure
_APART_S: Final = 1.0  # between trials that are put together


@dataclass(frozen=True, eq=False)
class Take:
    """A recording of teleoperation, reduced to the frames from which a command was computed.

    Attributes:
        recording: T frames of the human hand.
        commands: T commands, one computed from each frame.
        hand: robot hand.
        begin: time of stamp 0, UTC.
        alignments: stamp of the first use [s] and alignment, in order.
    """

    recording: HandRecording
    commands: CommandTrajectory
    hand: Hand
    begin: datetime
    alignments: Sequence[tuple[float, AlignmentConfig]] = ()

    def cut(self, trial: Trial) -> Trace | None:
        """Cuts out the frames of a trial; None if the recording has fewer than three of them."""
        stamps = self.recording.stamps
        start = (trial.started - self.begin).total_seconds()
        length = (trial.time_s or 0.0) + trial.paused_s
        first, last = np.searchsorted(stamps, (start, start + length))
        if last - first < _FEWEST:
            return None
        used = [alignment for since, alignment in self.alignments if since <= stamps[first]]
        alignment = used[-1] if used else None
        recording, commands = self.recording[first:last], self.commands[first:last]
        return assemble_trace(recording, commands, self.hand, alignment, reach_samples=0)


def take_metrics(
    pieces: Sequence[tuple[tuple[str, str], Trace]], hand: Hand
) -> list[dict[str, object]]:
    """Computes the metrics of each operator with each retargeter.

    Args:
        pieces: operator and retargeter of each trial, and its frames; at least one.

    Returns:
        One row for each operator and retargeter.
    """
    reach = sample_reach(hand)
    of: dict[tuple[str, str], list[Trace]] = {}
    for who, trace in pieces:
        of.setdefault(who, []).append(trace)
    return [
        {"operator": operator, "retargeter": retargeter, **_row(traces, reach)}
        for (operator, retargeter), traces in sorted(of.items())
    ]


def _row(traces: Sequence[Trace], reach: np.ndarray) -> Mapping[str, float | None]:
    row: dict[str, float | None] = {}
    for name in METRIC_NAMES:
        if name == _POOLED:
            row[name] = _measured(name, replace(_together(traces), reach=reach))
            continue
        measured = [(len(trace), _measured(name, trace)) for trace in traces]
        frames = sum(count for count, value in measured if value is not None)
        total = sum(count * value for count, value in measured if value is not None)
        row[name] = total / frames if frames else None
    return row


def _measured(name: str, trace: Trace) -> float | None:
    compute = find_metric("latency_ms.mean" if name == "latency_ms" else name).compute
    assert compute is not None  # it is built in
    value = compute(trace)
    value = value.get("mean") if isinstance(value, Mapping) else value
    return None if value is None or not np.isfinite(value) else float(value)


def _together(traces: Sequence[Trace]) -> Trace:
    """Joins the traces of trials into one trace."""
    stamps, now = [], 0.0
    for trace in traces:
        stamps.append(trace.stamps - trace.stamps[0] + now)
        now = float(stamps[-1][-1]) + _APART_S
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(trace, name) for trace in traces])
        for name in ("human", "robot_tips", "joint_positions", "status", "latency_ms")
    }
    return replace(
        traces[0], **joined, stamps=np.concatenate(stamps), penetration=None, robot_landmarks=None
    )


def utc_of_zero(started: str, clock: float) -> datetime:
    """Time of stamp 0 of a recording, UTC.

    Args:
        started: ISO date and time of some moment, with its zone.
        clock: clock of the recording at that moment [s].
    """
    moment = datetime.fromisoformat(started)
    if moment.tzinfo is None:
        raise ValueError(f"{started!r} has no time zone")
    return moment - timedelta(seconds=clock)

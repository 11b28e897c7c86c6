"""Measures the quality of cells in worker processes, and their latency while this program does
nothing else.

While other workers run, latency shows how busy the machine is, not how fast a method is. Therefore
latencies are measured in a separate phase, in one process. Methods alternate in short blocks, each
with its own state, so that other load affects all methods equally; the order changes from round to
round."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.execution import built_for, execute, measure
from smooth_operator.metrics import Metric, Trace, accuracy, consistency, service, summary
from smooth_operator.metrics.table import add_metrics
from smooth_operator.planning import configuration
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.types import CommandTrajectory
from smooth_operator_benchmark.cells import Cell, Settings


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of a cell, except latency.

    Attributes:
        commands: the joint commands. Their latency is NaN, because a latency measured next to other
            workers is not meaningful, and because equal cells then have equal bytes.
        metrics: result of ``evaluate``.
        fingers: result of ``finger_metrics``.
        configuration: configuration, with versions and machine.
        seconds: elapsed time [s]; None if unknown.
    """

    commands: CommandTrajectory
    metrics: dict[str, Any]
    fingers: dict[str, dict[str, float | None]]
    configuration: dict[str, Any]
    seconds: float | None = None


def measure_cell(task: tuple[Cell, Settings]) -> Measured:
    """Retargets the recording of a cell and measures it, in a worker; SmoothOperatorError if the
    method can't be used with the hand, or the recording can't be used."""
    cell, settings = task
    add_metrics(settings.metrics)
    todo = cell.plan(settings.seed)
    outcome = execute(todo, built_for(todo))
    untimed = np.full(len(outcome.commands), np.nan)
    outcome = replace(outcome, commands=replace(outcome.commands, latency_ms=untimed))
    trace, metrics = measure(todo, outcome, settings.definition)
    return Measured(
        outcome.commands, metrics, finger_metrics(trace, metrics), configuration("bench", todo)
    )


PER_FINGER: Final = (
    Metric(
        "tip_error_mm",
        "mm",
        "down",
        "distance between the robot's fingertip and the aligned human fingertip",
    ),
    Metric("thumb_cosine", "", "->1", "direction of the thumb-to-tip vector"),
    Metric("reach_cosine", "", "->1", "direction of the wrist-to-tip vector"),
    Metric("motion_preservation", "", "->1", "direction of the fingertip's motion"),
    Metric(
        "flatness",
        "m²",
        "down",
        "squared second difference of the fingertip position, at this frame rate",
    ),
    Metric(
        "pinch_touch_share",
        "",
        "up",
        "fraction of the human's pinches in which the robot's surfaces touch",
    ),
    Metric(
        "workspace_utilisation",
        "",
        "up",
        "fraction of the fingertip's reachable positions that were visited",
    ),
)
"""Metrics of single fingers. They always use the sound definition."""


def finger_metrics(trace: Trace, metrics: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
    """Computes the metrics of each finger.

    Args:
        metrics: result of ``evaluate``.

    Returns:
        Finger name -> metric of ``PER_FINGER`` -> value; None if it can't be measured, such as the
        distance of the thumb from itself.
    """
    human, robot = trace.human_keyvectors, trace.robot_keyvectors
    count = len(trace.fingers)
    error = 1e3 * np.linalg.norm(trace.human_tips - trace.robot_tips, axis=-1)
    table: dict[str, dict[str, float | None]] = {}
    for i, finger in enumerate(trace.fingers):
        at, thumb = slice(i, i + 1), slice(count + i - 1, count + i)
        table[finger] = {
            "tip_error_mm": summary.mean(error[:, i]),
            "thumb_cosine": accuracy.cosine_similarity(human[:, thumb], robot[:, thumb])
            if i
            else None,
            "reach_cosine": accuracy.cosine_similarity(human[:, at], robot[:, at]),
            "motion_preservation": consistency.motion_preservation(
                trace.human_reaches[:, at], trace.robot_reaches[:, at]
            ),
            "flatness": consistency.flatness(trace.robot_tips[:, at]),
            "pinch_touch_share": metrics["pinch_touch_share_per_finger"].get(finger),
            "workspace_utilisation": metrics["workspace_utilisation_per_finger"].get(finger),
        }
    return table


BLOCK: Final = 20
"""Number of frames per block before the next method runs."""
WARM_UP: Final = 50
"""Number of warm-up frames that are not counted."""


@dataclass(frozen=True, eq=False)
class Latency:
    """Latency of one cell.

    Attributes:
        samples_ms: (N,) time of each counted frame, landmarks to command [ms].
        first_ms: time of the first frame of a fresh, compiled retargeter [ms]; not counted.
        warm_up: frames between the first and the counted ones.
        load: load average of the machine at the end, over one minute, which may include load from
            before the measurement. None if the system does not report it.
        others: fraction of the machine's cores that other processes used in the meantime; None if
            the system does not report it.
        reason: reason why there are no samples; None if there are samples.
    """

    samples_ms: Float[np.ndarray, " N"]
    first_ms: float | None = None
    warm_up: int = 0
    load: float | None = None
    others: float | None = None
    reason: str | None = None

    @property
    def summary(self) -> dict[str, float | None]:
        """Mean, p50, p95, p99 and first [ms]."""
        return {**service.latency(self.samples_ms), "first": self.first_ms}

    @property
    def facts(self) -> dict[str, Any]:
        """The summary, and how the latency was measured."""
        return {
            **self.summary,
            "frames": len(self.samples_ms),
            "warm_up": self.warm_up,
            "load_average": self.load,
            "other_processes": self.others,
            "measured": "with nothing else running, alternating between methods",
            "reason": self.reason,
        }


def measure_latency(
    cells: Sequence[Cell], frames: int, seed: int, advance: Callable[[Cell], None]
) -> list[Latency]:
    """Measures the latency of methods on one recording and one hand, in this process.

    Args:
        cells: cells of one recording and one hand.
        frames: number of frames to count; fewer if the recording is shorter.
        seed: seed of the methods' random numbers.
        advance: called as each cell is done.

    Returns:
        The latency of each cell, in their order; for a failed method, the reason.
    """
    runs = [_Run(cell, frames, seed) for cell in cells]
    watch = Watch()  # starts after the methods are built
    total = max((run.total for run in runs), default=0)
    for turn, start in enumerate(range(0, total, BLOCK)):
        first = turn % len(runs)
        for run in runs[first:] + runs[:first]:
            run.go_on(start, start + BLOCK)
    load, others = watch.load(), watch.others()
    for run in runs:
        advance(run.cell)
    return [run.result(load, others) for run in runs]


class _Run:
    """A method that is being measured, with its position in the recording."""

    def __init__(self, cell: Cell, frames: int, seed: int) -> None:
        assert cell.source.recording is not None  # a cell without frames has no latency
        self.cell = cell
        self._recording = cell.source.recording
        self._warm_up = min(WARM_UP, len(self._recording) // 4)
        self.total = min(len(self._recording), 1 + self._warm_up + frames)
        self._times: list[float] = []
        self._reason: str | None = None
        try:
            self._retargeter = _built(cell, seed)
            self._state = self._retargeter.init()
        except Exception as error:  # a failed method must not stop the others
            self._fail(error)

    def go_on(self, start: int, stop: int) -> None:
        if self._reason is not None:
            return
        try:
            for i in range(start, min(stop, self.total)):
                self._state, result = self._retargeter.step(self._state, self._recording[i])
                self._times.append(result.latency_ms)
        except Exception as error:
            self._fail(error)

    def result(self, load: float | None, others: float | None) -> Latency:
        if self._reason is not None:
            return Latency(np.empty(0), load=load, others=others, reason=self._reason)
        counted = np.array(self._times[1 + self._warm_up :] or self._times)
        return Latency(counted, self._times[0], self._warm_up, load, others)

    def _fail(self, error: Exception) -> None:
        self._reason = f"{type(error).__name__}: {error}"


def _built(cell: Cell, seed: int) -> Retargeter:
    built, _ = built_for(cell.plan(seed))
    if not isinstance(built, Retargeter):
        raise ConfigError("this method solves whole recordings, so single frames have no latency")
    return built


_STAT: Final = Path("/proc/stat")
_IDLE: Final = (3, 4)  # idle and iowait, among the numbers of the line "cpu"
_GUEST: Final = 8  # from here on counted a second time in user and nice


class Watch:
    """Observes the load of the machine, starting when it is created."""

    def __init__(self) -> None:
        self._busy = _busy_seconds()
        self._own = time.process_time()
        self._started = time.monotonic()

    def others(self) -> float | None:
        """Fraction of all cores that other processes have used since the start, 0 to 1. None if the
        system does not report it, or if too little time has passed for its clock ticks."""
        busy, elapsed = _busy_seconds(), time.monotonic() - self._started
        if busy is None or self._busy is None or elapsed < 0.1:
            return None
        own = time.process_time() - self._own
        share = (busy - self._busy - own) / (elapsed * (os.cpu_count() or 1))
        return float(min(max(share, 0.0), 1.0))

    @staticmethod
    def load() -> float | None:
        """Load average over the last minute; None on systems that have no load average, such as
        Windows."""
        try:
            return os.getloadavg()[0]
        except (AttributeError, OSError):
            return None


def _busy_seconds() -> float | None:
    """CPU time that all processes have taken since the system started [s]; Linux only."""
    try:
        first = _STAT.read_text(encoding="ascii").splitlines()[0].split()
        ticks = [int(number) for number in first[1:]][:_GUEST]
        busy = sum(n for i, n in enumerate(ticks) if i not in _IDLE)
        return busy / float(os.sysconf("SC_CLK_TCK"))
    except (OSError, ValueError, IndexError, AttributeError):
        return None

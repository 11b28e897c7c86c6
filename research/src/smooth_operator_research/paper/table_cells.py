"""What the experiment ``table`` computes of a cell: its metrics, and the latency of several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from smooth_operator.formats.jsonable import to_json
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.built import built_for
from smooth_operator.lab.benchmark.cells import Cell
from smooth_operator.lab.benchmark.latency import measure_latency
from smooth_operator.lab.offline import execute, measure
from smooth_operator.lab.offline.execution import Outcome as Execution
from smooth_operator.metrics import evaluate
from smooth_operator.planning import Plan
from smooth_operator_research.paper.degraded_recordings import LEAD, led, recording_of


def table_quality(cell: Cell, advance: object) -> dict[str, np.ndarray]:
    """Metrics of a cell by both definitions, ``sound`` and ``paper``, each as JSON."""
    todo = _plan(cell)
    outcome = execute(replace(todo, recording=led(todo.recording)), built_for(todo))
    trace, metrics = measure(todo, settled(outcome))
    return {
        "sound": np.array(to_json(metrics)),
        "paper": np.array(to_json(evaluate(trace, "paper"))),
    }


def settled(outcome: Execution) -> Execution:
    """Without the frames of the lead."""
    commands = outcome.commands
    kept = replace(
        commands,
        joint_positions=commands.joint_positions[LEAD:],
        stamps=commands.stamps[LEAD:],
        latency_ms=commands.latency_ms[LEAD:],
        status=commands.status[LEAD:],
    )
    return replace(outcome, commands=kept, tracking_loss=outcome.tracking_loss[LEAD:])


def table_latency(
    cells: Sequence[Cell], frames: int, advance: Callable[[float], None]
) -> dict[str, np.ndarray]:
    """Median latency of each cell [ms], and the share of the cores that others took."""
    for cell in cells:  # compiled before the machine is watched
        built_for(_plan(cell))
    found = measure_latency(cells, frames, 0, lambda cell: advance(1 / len(cells)))
    p50 = [one.summary["p50"] for one in found]
    others = found[0].others
    return {
        "p50": np.array([np.nan if value is None else value for value in p50]),
        "others": np.array(np.nan if others is None else others),
    }


def _plan(cell: Cell) -> Plan:
    recording = recording_of(cell.source)
    hand = load_hand(cell.hand, recording.side)
    return Plan(recording, hand, cell.method, cell.preset, cell.config, 0)

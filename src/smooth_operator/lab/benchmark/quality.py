"""The work of a quality cell: task, execution in a worker, result; metrics finger by finger."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.offline import built_for, execute, measure
from smooth_operator.methods.method import MethodConfig
from smooth_operator.metrics import Metric, Trace, accuracy, consistency, summary
from smooth_operator.metrics.evaluation import Definition
from smooth_operator.metrics.registry import add_metrics
from smooth_operator.planning import Plan, configuration
from smooth_operator.types import CommandTrajectory, HandRecording


@dataclass(frozen=True, eq=False)
class Task:
    """A cell as a worker needs it; whole, so that a worker need not see the recording's file.

    Attributes:
        recording: the human hand.
        hand: name of the robot hand.
        method: name of the method.
        preset: name of its preset.
        config: its configuration.
        seed: seed of its random numbers.
        definition: definition of the metrics.
        fingers: robot finger -> human finger that drives it; None for all.
        metrics: further metrics, for ``add_metrics``.
    """

    recording: HandRecording
    hand: str
    method: str
    preset: str
    config: MethodConfig
    seed: int
    definition: Definition
    fingers: Mapping[str, str] | None = None
    metrics: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of a cell, without latency.

    Attributes:
        commands: the joint commands. Their latency is NaN: measured with other workers it would
            not be to believe, and without it the same cell has the same bytes.
        metrics: result of ``evaluate``.
        fingers: result of ``finger_metrics``.
        configuration: configuration, with versions and machine.
        seconds: time that it took [s]; None while unknown.
    """

    commands: CommandTrajectory
    metrics: dict[str, Any]
    fingers: dict[str, dict[str, float | None]]
    configuration: dict[str, Any]
    seconds: float | None = None


def measure_cell(task: Task) -> Measured:
    """Retargets a recording and measures it.

    Raises:
        SmoothOperatorError: the method can't serve the hand, or the recording can't be used.
    """
    add_metrics(task.metrics)
    hand = load_hand(task.hand, task.recording.side, fingers=task.fingers)
    todo = Plan(
        task.recording, hand, task.method, task.preset, task.config, task.seed, task.fingers
    )
    outcome = execute(todo, built_for(todo))
    untimed = np.full(len(outcome.commands), np.nan)
    outcome = replace(outcome, commands=replace(outcome.commands, latency_ms=untimed))
    trace, metrics = measure(todo, outcome, task.definition)
    return Measured(
        outcome.commands, metrics, finger_metrics(trace, metrics), configuration("bench", todo)
    )


PER_FINGER: Final = (
    Metric("tip_error_mm", "mm", "down", "distance of the robot's tip from the aligned human's"),
    Metric("thumb_cosine", "", "->1", "direction of the thumb-to-tip vector"),
    Metric("reach_cosine", "", "->1", "direction of the wrist-to-tip vector"),
    Metric("motion_preservation", "", "->1", "direction of the tip's motion"),
    Metric("flatness", "m²", "down", "squared second difference of the tip, at this rate"),
    Metric("pinch_error_mm", "mm", "down", "tip gap to the thumb while the human's is under 15 mm"),
    Metric("workspace_utilisation", "", "up", "share of the tip's reachable set in use"),
)
"""Figures of each finger. All follow the sound definition, whichever the run's metrics do."""


def finger_metrics(trace: Trace, metrics: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
    """Metrics of each finger.

    Args:
        metrics: result of ``evaluate``.

    Returns:
        Finger name -> name of ``PER_FINGER`` -> value; None where it can't be measured, as the
        thumb's distance from itself.
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
            "pinch_error_mm": metrics["pinch_error_per_finger_mm"].get(finger),
            "workspace_utilisation": metrics["workspace_utilisation_per_finger"].get(finger),
        }
    return table

"""The metrics finger by finger, for those that have a meaning there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from smooth_operator.metrics import Metric, Trace, accuracy, consistency, summary

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
        trace: the run.
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

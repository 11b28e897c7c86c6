"""The names of the metrics: what reports, plots and the command line call them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from smooth_operator.errors import UnknownNameError


@dataclass(frozen=True)
class Metric:
    """One line of the table.

    Attributes:
        name: key in the result of ``evaluate``; a dot steps into a
            nested one.
        unit: "" for a plain number.
        goal: ``"->1"`` best at one, ``"down"`` or ``"up"``; ``""`` for a fact that is not a merit.
        meaning: one line for a person.
        group: key of ``GROUPS``; "" for a figure that stands alone.
    """

    name: str
    unit: str
    goal: Literal["->1", "down", "up", ""]
    meaning: str
    group: str = ""

    def of(self, result: Mapping[str, object]) -> object:
        """This metric's value in a result.

        Raises:
            UnknownNameError: if the result has no such key.
        """
        value: object = result
        for key in self.name.split("."):
            if not isinstance(value, Mapping) or key not in value:
                available = value.keys() if isinstance(value, Mapping) else ()
                raise UnknownNameError("metric", self.name, available)
            value = value[key]
        return value


GROUPS: Final[Mapping[str, str]] = {
    "accuracy": "Accuracy: does the robot hand have the human hand's shape?",
    "grasping": "Grasping: do pinches close, and do fingers stay out of each other?",
    "motion": "Motion: does the robot hand move as the human hand does?",
    "smoothness": "Smoothness: does it move without jitter?",
    "reach": "Reach: how much of its range is in use?",
    "latency": "Latency: how long does a command take?",
    "run": "Run: what was measured?",
}
"""Groups of metrics, in the order of reports, and the question that each answers."""

METRICS: Final[tuple[Metric, ...]] = (
    Metric("cosine_similarity", "", "->1", "direction of the thumb-to-tip vectors", "accuracy"),
    Metric("cosine_similarity_all", "", "->1", "direction of all keyvectors", "accuracy"),
    Metric(
        "scale_ratio", "", "->1", "length of the thumb-to-tip vectors, robot over human", "accuracy"
    ),
    Metric("tracking_loss", "", "down", "mean of the method's own tracking objective", "accuracy"),
    Metric(
        "pinch_error_mm", "mm", "down", "robot tip gap while the human's is under 15 mm", "grasping"
    ),
    Metric(
        "pinch_error_strict_mm",
        "mm",
        "down",
        "robot tip gap while the human's is under 12 mm",
        "grasping",
    ),
    Metric(
        "pinch_error_per_finger_mm",
        "mm",
        "down",
        "robot tip gap at 15 mm for each finger",
        "grasping",
    ),
    Metric(
        "self_collision.share",
        "",
        "down",
        "share of frames with links over 2 mm inside",
        "grasping",
    ),
    Metric(
        "self_collision.mean_depth_mm",
        "mm",
        "down",
        "depth of overlap, mean over frames",
        "grasping",
    ),
    Metric("self_collision.max_depth_mm", "mm", "down", "depth of overlap, deepest", "grasping"),
    Metric("motion_preservation", "", "->1", "direction of the fingertips' motion", "motion"),
    Metric(
        "velocity_correlation",
        "",
        "->1",
        "correlation of fingertip velocity at that delay",
        "motion",
    ),
    Metric(
        "lag_ms", "ms", "down", "delay of the robot's fingertip motion behind the human's", "motion"
    ),
    Metric("frozen_share", "", "down", "share of human motion that the robot sits out", "motion"),
    Metric(
        "flatness",
        "m²",
        "down",
        "squared second difference of fingertips, at this rate",
        "smoothness",
    ),
    Metric("fingertip_acceleration", "m/s²", "down", "mean fingertip acceleration", "smoothness"),
    Metric(
        "joint_jitter", "rad", "down", "second difference of joints, at this rate", "smoothness"
    ),
    Metric("joint_jitter_rate_free", "rad/s²", "down", "mean joint acceleration", "smoothness"),
    Metric("max_joint_step", "rad", "down", "largest change of a joint in one frame", "smoothness"),
    Metric(
        "workspace_utilisation", "", "up", "share of the reachable fingertip set in use", "reach"
    ),
    Metric("workspace_utilisation_per_finger", "", "up", "the same for each finger", "reach"),
    Metric("limit_violation_rad", "rad", "down", "furthest command beyond a joint limit", "reach"),
    Metric("limit_violation_share", "", "down", "share of frames beyond a joint limit", "reach"),
    Metric("latency_ms.mean", "ms", "down", "time per command, mean", "latency"),
    Metric("latency_ms.p50", "ms", "down", "time per command, median", "latency"),
    Metric("latency_ms.p95", "ms", "down", "time per command, 95th percentile", "latency"),
    Metric("latency_ms.p99", "ms", "down", "time per command, 99th percentile", "latency"),
    Metric("latency_ms.first", "ms", "down", "time of the first command", "latency"),
    Metric("frames", "", "", "frames measured", "run"),
    Metric("rate_hz", "Hz", "", "median frame rate", "run"),
    Metric("status", "", "", "frames by status", "run"),
    Metric("definition", "", "", "which definitions these figures follow", "run"),
    Metric("human_fit", "", "", "what the human hand was fitted to before comparing", "run"),
)
"""Every key of a result, group by group, in the order of reports."""

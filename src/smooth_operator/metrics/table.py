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
        name: key in the result of :func:`smooth_operator.metrics.evaluate`; a dot steps into a
            nested one.
        unit: "" for a plain number.
        goal: ``"->1"`` best at one, ``"down"`` or ``"up"``; ``""`` for a fact that is not a merit.
        meaning: one line for a person.
    """

    name: str
    unit: str
    goal: Literal["->1", "down", "up", ""]
    meaning: str

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


METRICS: Final[tuple[Metric, ...]] = (
    Metric("cosine_similarity", "", "->1", "direction of the thumb-to-tip vectors"),
    Metric("cosine_similarity_all", "", "->1", "direction of all keyvectors"),
    Metric("scale_ratio", "", "->1", "length of the thumb-to-tip vectors, robot over human"),
    Metric("motion_preservation", "", "->1", "direction of the fingertips' motion"),
    Metric("flatness", "m²", "down", "squared second difference of fingertips, at this rate"),
    Metric("fingertip_acceleration", "m/s²", "down", "mean fingertip acceleration"),
    Metric("workspace_utilisation", "", "up", "share of the reachable fingertip set in use"),
    Metric("workspace_utilisation_per_finger", "", "up", "the same for each finger"),
    Metric("latency_ms.mean", "ms", "down", "time per command, mean"),
    Metric("latency_ms.p50", "ms", "down", "time per command, median"),
    Metric("latency_ms.p95", "ms", "down", "time per command, 95th percentile"),
    Metric("latency_ms.p99", "ms", "down", "time per command, 99th percentile"),
    Metric("latency_ms.first", "ms", "down", "time of the first command"),
    Metric("self_collision.share", "", "down", "share of frames with links over 2 mm inside"),
    Metric("self_collision.mean_depth_mm", "mm", "down", "depth of overlap, mean over frames"),
    Metric("self_collision.max_depth_mm", "mm", "down", "depth of overlap, deepest"),
    Metric("pinch_error_mm", "mm", "down", "robot tip gap while the human's is under 15 mm"),
    Metric("pinch_error_strict_mm", "mm", "down", "robot tip gap while the human's is under 12 mm"),
    Metric("pinch_error_per_finger_mm", "mm", "down", "robot tip gap at 15 mm for each finger"),
    Metric("lag_ms", "ms", "down", "delay of the robot's fingertip motion behind the human's"),
    Metric("velocity_correlation", "", "->1", "correlation of fingertip velocity at that delay"),
    Metric("tracking_loss", "", "down", "mean of the method's own tracking objective"),
    Metric("joint_jitter", "rad", "down", "second difference of joints, at this rate"),
    Metric("joint_jitter_rate_free", "rad/s²", "down", "mean joint acceleration"),
    Metric("max_joint_step", "rad", "down", "largest change of a joint in one frame"),
    Metric("frozen_share", "", "down", "share of human motion that the robot sits out"),
    Metric("limit_violation_rad", "rad", "down", "furthest command beyond a joint limit"),
    Metric("limit_violation_share", "", "down", "share of frames beyond a joint limit"),
    Metric("frames", "", "", "frames measured"),
    Metric("rate_hz", "Hz", "", "median frame rate"),
    Metric("status", "", "", "frames by status"),
    Metric("definition", "", "", "which definitions these figures follow"),
    Metric("human_fit", "", "", "what the human hand was fitted to before comparing"),
)
"""Every key of a result, in the order of reports."""

"""Lists all metrics, including those of plugins: name, unit, better direction, meaning and
function.

``evaluate`` gives all metrics of a run as one JSON-serialisable dictionary."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias, TypeVar, get_args
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.landmarks import BASES, FINGERS, TIPS, WRIST
from smooth_operator.metrics import (
    accuracy,
    consistency,
    joints,
    pinches,
    posture,
    published,
    safety,
    service,
    summary,
)
from smooth_operator.metrics.trace import Trace, keyvectors
from smooth_operator.plugins import Entry, Registry
from smooth_operator.terminal import print_note

Value: TypeAlias = float | int | str | Mapping[str, float | int | None] | None
"""Value of a metric: usually a number; None if it can't be measured."""

_DIRECTIONS: Final = {
    "->1": ("→ 1", "best at 1"),
    "down": ("↓", "less is better"),
    "up": ("↑", "more is better"),
    "": ("", ""),
}


@dataclass(frozen=True)
class Metric:
    """Definition of one metric of a run.

    Attributes:
        name: key in the result of ``evaluate``; a dot separates the keys of nested results.
        unit: "" for a plain number.
        goal: ``"->1"`` best at one, ``"down"`` or ``"up"``; ``""`` for a fact without a better
            direction.
        meaning: one human-readable line.
        group: key of ``GROUPS``; "" for a metric without a group.
        compute: function from a run to the value; None if the caller of ``evaluate`` provides the
            value.
        published: function by the paper's definition, if that is different.
        short: heading of its column in the main tables of a benchmark; "" where it has none.
    """

    name: str
    unit: str
    goal: Literal["->1", "down", "up", ""]
    meaning: str
    group: str = ""
    compute: Callable[[Trace], Any] | None = None
    published: Callable[[Trace], Any] | None = None
    short: str = ""

    @property
    def key(self) -> str:
        """Top-level key in a result: the name up to the dot."""
        return self.name.partition(".")[0]

    @property
    def sign(self) -> str:
        """Better direction as a sign; empty for a metric that is neither good nor bad."""
        return _DIRECTIONS[self.goal][0]

    @property
    def better(self) -> str:
        """Better direction in words; empty for a metric that is neither good nor bad."""
        return _DIRECTIONS[self.goal][1]

    def of(self, result: Mapping[str, object]) -> object:
        """Returns this metric's value in a result; UnknownNameError if the result has no such
        key."""
        value: object = result
        for key in self.name.split("."):
            if not isinstance(value, Mapping) or key not in value:
                available = value.keys() if isinstance(value, Mapping) else ()
                raise UnknownNameError("metric", self.name, available)
            value = value[key]
        return value


GROUPS: Final[Mapping[str, str]] = {
    "posture": "Posture: does the robot hand open and close like the human hand?",
    "grasping": "Grasping: do pinches close, and do fingers avoid self-collision?",
    "motion": "Motion: does the robot hand move like the human hand?",
    "smoothness": "Smoothness: does the robot hand move without jitter?",
    "accuracy": (
        "Accuracy: do the vectors between wrist and fingertips agree, as the Smooth Operator "
        "paper measures it?"
    ),
    "reach": "Reach: how much of its workspace does the robot hand use?",
    "latency": "Latency: how long does a command take?",
    "run": "Run: what was measured?",
}
"""Groups of metrics, in the order of reports, and the question that each answers."""


_Result = TypeVar("_Result")


def _once(compute: Callable[[Trace], _Result]) -> Callable[[Trace], _Result]:
    """Computes values that several metrics share once per run."""
    results: WeakKeyDictionary[Trace, _Result] = WeakKeyDictionary()

    @functools.wraps(compute)
    def once(trace: Trace) -> _Result:
        if trace not in results:
            results[trace] = compute(trace)
        return results[trace]

    return once


def _of(compute: Callable[[Trace], Mapping[str, Any]], key: str) -> Callable[[Trace], Any]:
    """One value of a nested result."""
    return lambda trace: compute(trace)[key]


def _thumb(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Thumb-to-tip vectors of human and robot [m]."""
    thumb = trace.thumb_vectors
    return trace.human_keyvectors[:, thumb], trace.robot_keyvectors[:, thumb]


@_once
def _fitted(trace: Trace) -> tuple[Float[np.ndarray, "T F 3"], Float[np.ndarray, "T K 3"]]:
    """Human tips and keyvectors [m] as the paper fits them: to the robot's pose, where known."""
    if trace.robot_landmarks is None:
        return trace.human_tips, trace.human_keyvectors
    using = published.fit_landmarks(trace.fingers, trace.palm_landmarks)
    fitted = published.fit_to_robot(trace.human, trace.robot_landmarks, using)
    tips = fitted[:, [TIPS[FINGERS.index(name)] for name in trace.fingers]]
    return tips, keyvectors(tips, fitted[:, WRIST])


def _fitted_thumb(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    thumb = trace.thumb_vectors
    return _fitted(trace)[1][:, thumb], trace.robot_keyvectors[:, thumb]


@_once
def _lag(trace: Trace) -> tuple[float | None, float | None]:
    return consistency.lag(trace.human_reaches, trace.robot_reaches, trace.stamps)


@_once
def _limit_violation(trace: Trace) -> tuple[float | None, float | None]:
    return joints.limit_violation(trace.joint_positions, trace.joint_limits)


@_once
def _latency(trace: Trace) -> dict[str, float | None]:
    return service.latency(trace.latency_ms)


@_once
def _self_collision(trace: Trace) -> dict[str, float | None]:
    if trace.penetration is None:
        return {"share": None, "mean_depth_mm": None, "max_depth_mm": None}
    return safety.self_collision(trace.penetration)


@_once
def _workspace(trace: Trace) -> dict[str, float | None]:
    shares: list[float | None] = [None] * len(trace.fingers)
    if trace.reach is not None:
        shares = safety.workspace_utilisation(trace.robot_tips, trace.reach)
    return dict(zip(trace.fingers, shares, strict=True))


def _mean_workspace(trace: Trace) -> float | None:
    shares = [share for share in _workspace(trace).values() if share is not None]
    return sum(shares) / len(shares) if shares else None


@_once
def _extensions(trace: Trace) -> tuple[Float[np.ndarray, "T L"], Float[np.ndarray, "T L"]]:
    """Extension of the long fingers, human and robot."""
    human = posture.human_extensions(trace.human_fingers[:, 1:])
    if trace.straight_lengths is None:
        return human, np.full_like(human, np.nan)
    return human, posture.robot_extensions(trace.robot_fingers[:, 1:], trace.straight_lengths[1:])


@_once
def _directions(trace: Trace) -> Float[np.ndarray, "T F"]:
    return posture.direction_errors(trace.human_fingers, trace.robot_fingers)


def _curl_error(trace: Trace) -> float | None:
    human, robot = trace.human_fingers[:, 1:], trace.robot_fingers[:, 1:]
    return summary.mean(np.abs(posture.curls(robot) - posture.curls(human)))


def _spread_error(trace: Trace) -> float | None:
    across = trace.human[:, BASES[1]] - trace.human[:, BASES[-1]]
    if len(trace.fingers) < 5:  # a hand of four fingers has no little one
        across = trace.human_fingers[:, 1, 0] - trace.human_fingers[:, -1, 0]
    human, robot = trace.human_fingers[:, 1:], trace.robot_fingers[:, 1:]
    return summary.mean(np.abs(posture.spreads(robot, across) - posture.spreads(human, across)))


@_once
def _steps(trace: Trace) -> tuple[Float[np.ndarray, "S F"], Float[np.ndarray, "S F"]]:
    return posture.steps(trace.human_reaches), posture.steps(trace.robot_reaches)


def _jumps(trace: Trace) -> float | None:
    if trace.straight_lengths is None:
        return None
    gains = posture.finger_gains(trace.human_fingers, trace.straight_lengths)
    return posture.jumps_per_1000(*_steps(trace), gains)


def _settling(trace: Trace) -> float | None:
    return summary.median(posture.settling_times(*_extensions(trace), trace.stamps))


def _pinch_distances(trace: Trace) -> Float[np.ndarray, "T f"]:
    if trace.pinch_distances is None:
        return np.full((len(trace), len(trace.fingers) - 1), np.nan)
    return trace.pinch_distances


def _touching_by_finger(trace: Trace) -> dict[str, float | None]:
    return {
        name: pinches.touching_share(own)
        for name, own in zip(trace.fingers[1:], _pinch_distances(trace).T, strict=True)
    }


# fmt: off
METRICS: Final[tuple[Metric, ...]] = (
    Metric("cosine_similarity", "", "->1", "direction of the thumb-to-tip vectors", "accuracy",
           lambda t: accuracy.cosine_similarity(*_thumb(t)),
           published=lambda t: published.cosine_similarity(*_fitted_thumb(t)), short="cosine"),
    Metric("cosine_similarity_all", "", "->1", "direction of all keyvectors", "accuracy",
           lambda t: accuracy.cosine_similarity(t.human_keyvectors, t.robot_keyvectors),
           published=lambda t: published.cosine_similarity(_fitted(t)[1], t.robot_keyvectors),
           short="cosine, all"),
    Metric("scale_ratio", "", "->1", "ratio of thumb-to-tip vector lengths, robot to human",
           "accuracy",
           lambda t: accuracy.scale_ratio(*_thumb(t)),
           published=lambda t: published.scale_ratio(*_fitted_thumb(t)), short="scale"),
    Metric("tracking_loss", "", "down", "mean of the method's own tracking objective", "accuracy"),
    Metric("finger_extension_error", "", "down",
           "difference between robot and human finger extension; 1 is straight", "posture",
           lambda t: posture.extension_error(*_extensions(t)), short="extension"),
    Metric("flat_extension_lack", "", "down", "missing extension while the human hand is flat",
           "posture", lambda t: posture.flat_extension_lack(*_extensions(t))),
    Metric("fist_extension_excess", "", "down", "excess extension while the human makes a fist",
           "posture", lambda t: posture.fist_extension_excess(*_extensions(t))),
    Metric("finger_direction_error_deg", "°", "down", "base-to-tip direction of the long fingers",
           "posture", lambda t: summary.mean(_directions(t)[:, 1:]), short="fingers"),
    Metric("thumb_direction_error_deg", "°", "down", "base-to-tip direction of the thumb",
           "posture", lambda t: summary.mean(_directions(t)[:, 0]), short="thumb"),
    Metric("curl_error_deg", "°", "down", "bend of the two outer joints of the long fingers",
           "posture", _curl_error),
    Metric("spread_error_deg", "°", "down", "sideways angle between neighbouring long fingers",
           "posture", _spread_error),
    Metric("common_shift_mm", "mm", "down", "shared error of all wrist-to-tip vectors", "posture",
           lambda t: summary.scaled(posture.common_shift(t.human_reaches, t.robot_reaches), 1e3)),
    Metric("pinch_touch_share", "", "up", "share of the human's pinches in which the robot touches",
           "grasping", lambda t: pinches.touching_share(_pinch_distances(t)), short="touch"),
    Metric("pinch_deep_share", "", "down", "share of pinches that overlap by over 2 mm",
           "grasping", lambda t: pinches.deep_share(_pinch_distances(t)), short="deep"),
    Metric("pinch_touch_share_per_finger", "", "up", "pinch_touch_share for each finger",
           "grasping", _touching_by_finger),
    Metric("self_collision.share", "", "down", "share of frames with an overlap over 2 mm",
           "grasping", _of(_self_collision, "share"), short="collision"),
    Metric("self_collision.mean_depth_mm", "mm", "down", "overlap depth, mean over frames",
           "grasping", _of(_self_collision, "mean_depth_mm")),
    Metric("self_collision.max_depth_mm", "mm", "down", "overlap depth, maximum", "grasping",
           _of(_self_collision, "max_depth_mm")),
    Metric("motion_preservation", "", "->1", "direction of the fingertips' motion", "motion",
           lambda t: consistency.motion_preservation(t.human_reaches, t.robot_reaches),
           published=lambda t: published.motion_preservation(_fitted(t)[0], t.robot_tips),
           short="motion"),
    Metric("velocity_correlation", "", "->1",
           "correlation of fingertip velocities at the delay lag_ms", "motion",
           lambda t: _lag(t)[1]),
    Metric("lag_ms", "ms", "down", "delay between the human's and the robot's fingertip motion",
           "motion", lambda t: _lag(t)[0]),
    Metric("frozen_share", "", "down",
           "share of frames with human motion in which the robot does not move", "motion",
           lambda t: consistency.frozen_share(t.human_reaches, t.joint_positions)),
    Metric("step_gain", "", "->1", "median ratio of robot to human steps over 3 mm", "motion",
           lambda t: summary.median(posture.step_gains(*_steps(t)))),
    Metric("stalled_share", "", "down",
           "share of human steps over 3 mm in which the robot moves less than a third as far",
           "motion", lambda t: posture.stalled_share(posture.step_gains(*_steps(t)))),
    Metric("settling_s", "s", "down", "time until a robot finger is as open as the human's",
           "motion", _settling),
    Metric("jumps_per_1000", "", "down", "frames per 1000 in which a robot fingertip jumps",
           "smoothness", _jumps, short="jumps"),
    Metric("shake_at_rest", "", "down", "ratio of robot to human tip steps while the human rests",
           "smoothness",
           lambda t: consistency.shake_at_rest(t.human_reaches, t.robot_reaches, t.stamps)),
    Metric("flatness", "m²", "down", "squared second difference of tips at this frame rate",
           "smoothness", lambda t: consistency.flatness(t.robot_tips), short="flatness"),
    Metric("fingertip_acceleration", "m/s²", "down", "mean fingertip acceleration", "smoothness",
           lambda t: consistency.fingertip_acceleration(t.robot_tips, t.stamps)),
    Metric("joint_jitter", "rad", "down", "second difference of joints at this frame rate",
           "smoothness", lambda t: joints.joint_jitter(t.joint_positions)),
    Metric("joint_jitter_rate_free", "rad/s²", "down", "mean joint acceleration", "smoothness",
           lambda t: joints.joint_acceleration(t.joint_positions, t.stamps)),
    Metric("max_joint_step", "rad", "down", "largest change of a joint in one frame", "smoothness",
           lambda t: joints.max_joint_step(t.joint_positions)),
    Metric("workspace_utilisation", "", "up", "share of reachable fingertip positions visited",
           "reach", _mean_workspace, short="workspace"),
    Metric("workspace_utilisation_per_finger", "", "up", "share visited, per finger", "reach",
           _workspace),
    Metric("limit_violation_rad", "rad", "down", "largest overrun of a joint limit", "reach",
           lambda t: _limit_violation(t)[0]),
    Metric("limit_violation_share", "", "down", "fraction of frames beyond a joint limit", "reach",
           lambda t: _limit_violation(t)[1]),
    Metric("latency_ms.mean", "ms", "down", "time per command, mean", "latency",
           _of(_latency, "mean")),
    Metric("latency_ms.p50", "ms", "down", "time per command, median", "latency",
           _of(_latency, "p50"), short="p50"),
    Metric("latency_ms.p95", "ms", "down", "time per command, 95th percentile", "latency",
           _of(_latency, "p95")),
    Metric("latency_ms.p99", "ms", "down", "time per command, 99th percentile", "latency",
           _of(_latency, "p99")),
    Metric("latency_ms.first", "ms", "down", "time of the first command", "latency",
           _of(_latency, "first")),
    Metric("frames", "", "", "frames measured", "run", len),
    Metric("rate_hz", "Hz", "", "median frame rate", "run", lambda t: t.rate_hz),
    Metric("status", "", "", "frames by status", "run",
           lambda t: service.status_counts(t.status)),
    Metric("definition", "", "", "metric definitions that were used", "run",
           lambda t: "sound", published=lambda t: "paper"),
    Metric("human_fit", "", "", "how the human hand was aligned before the comparison", "run",
           lambda t: "palm",
           published=lambda t: "palm" if t.robot_landmarks is None else "robot pose"),
)
# fmt: on
"""Every key of a result except those of plugins, by group, in the order of reports."""


REGISTRY: Final = Registry(
    "metric",
    {
        metric.name: Entry("smooth_operator.metrics.table:METRICS", metric.meaning)
        for metric in METRICS
    },
)
"""Maps names to a ``Metric``, or to a tuple of metrics that contains that name."""


def find_metric(name: str) -> Metric:
    """Finds a metric by its name, or by ``package.module:attribute``.

    Raises:
        UnknownNameError: there is none.
        ConfigError: the metric of a plugin can't be loaded or is not a ``Metric`` of that name.
    """
    for metric in _offered(name):
        if isinstance(metric, Metric) and (metric.name == name or name not in REGISTRY):
            return metric
    raise ConfigError(
        f"{REGISTRY.find(name).target} can't be a metric: it must be a Metric called "
        f"{name!r}, or a tuple of metrics that contains one of that name"
    )


def _offered(name: str) -> tuple[object, ...]:
    metrics: object = REGISTRY.load(name)
    return metrics if isinstance(metrics, tuple) else (metrics,)


def add_metrics(targets: Iterable[str]) -> None:
    """Adds metrics in this process; ``evaluate`` then computes them like those of plugins.

    Args:
        targets: ``package.module:attribute`` of a ``Metric`` or of a tuple of them.

    Raises:
        UnknownNameError: a target does not have this form and is not the name of a metric.
        ConfigError: a target can't be loaded, is not a metric, or has the name of another metric.
    """
    for target in targets:
        find_metric(target)
        for metric in () if target in REGISTRY else _offered(target):
            if isinstance(metric, Metric):
                REGISTRY.add(metric.name, Entry(target, metric.meaning))


def known_metrics() -> tuple[Metric, ...]:
    """The built-in metrics, then those of plugins. Metrics that can't be loaded are skipped."""
    return tuple(REGISTRY.loadable(find_metric).values())


def plugin_metrics() -> tuple[Metric, ...]:
    """Metrics of plugins."""
    return known_metrics()[len(METRICS) :]


Definition: TypeAlias = Literal["sound", "paper"]
"""``sound``: means over frames, human aligned as the retargeter saw it, still frames masked.
``paper``: as published (``smooth_operator.metrics.published``)."""


def evaluate(
    trace: Trace,
    definition: Definition = "sound",
    extra: Mapping[str, float | None] | None = None,
) -> dict[str, Value]:
    """Computes the metrics of a run.

    Args:
        trace: the run.
        definition: ``"sound"`` (default) or ``"paper"``; they differ only in cosine similarity,
            scale ratio and motion preservation, and should never be mixed in one table.
        extra: values that need more than the trace, such as ``tracking_loss``.

    Returns:
        The keys of ``METRICS``, in that order, then those of plugins' metrics and any others of
        ``extra``. Numbers are finite; what could not be measured (too few frames, a missing input,
        no pinch) is None.

    Raises:
        UnknownNameError: if there is no such definition.
        ConfigError: if ``extra`` contains a metric that is computed here.
    """
    if definition not in get_args(Definition):
        raise UnknownNameError("metric definition", str(definition), get_args(Definition))
    values: dict[str, Any] = {}
    metrics = known_metrics()
    for metric in metrics:
        value = _computed(metric, trace, definition)
        if metric.name == metric.key:
            values[metric.name] = value
        else:
            values.setdefault(metric.key, {})[metric.name.partition(".")[2]] = value
    finite = {name: _finite(value) for name, value in (extra or {}).items()}
    computed = {metric.key for metric in metrics if metric.compute is not None}
    if clash := sorted(set(finite) & computed):
        raise ConfigError(
            f"extra must not contain metrics that are computed from the trace: {', '.join(clash)}"
        )
    return values | finite


def _computed(metric: Metric, trace: Trace, definition: Definition) -> Any:
    compute = metric.compute
    if definition == "paper" and metric.published is not None:
        compute = metric.published
    if compute is None or metric.name in REGISTRY.built_in:
        return None if compute is None else compute(trace)
    try:
        value = compute(trace)
        return value if value is None else _finite(value)
    except Exception as error:  # a plugin's: the other figures still count
        print_note(f"metric {metric.name!r} is skipped: {type(error).__name__}: {error}")
        return None


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None

"""All metrics of one run, as one JSON-serialisable dictionary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal, TypeAlias, get_args

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.landmarks import FINGERS, TIPS, WRIST
from smooth_operator.metrics import (
    accuracy,
    consistency,
    joints,
    published,
    safety,
    service,
    summary,
)
from smooth_operator.metrics.table import METRICS
from smooth_operator.metrics.trace import Trace, keyvectors

Definition: TypeAlias = Literal["sound", "paper"]
"""``sound``: means over frames, human aligned as the retargeter saw it, still frames masked.
``paper``: as published (``smooth_operator.metrics.published``)."""

Value: TypeAlias = float | int | str | Mapping[str, float | int | None] | None

_HEADLINES: Final = (
    "cosine_similarity",
    "cosine_similarity_all",
    "scale_ratio",
    "motion_preservation",
)


def evaluate(
    trace: Trace,
    definition: Definition = "sound",
    extra: Mapping[str, float | None] | None = None,
) -> dict[str, Value]:
    """Measures a run.

    Args:
        trace: the run.
        definition: ``"sound"`` (default) or ``"paper"``; they differ in cosine similarity, scale
            ratio and motion preservation only, and never should be mixed in one table.
        extra: figures that need more than the trace, such as ``tracking_loss``.

    Returns:
        The keys of ``METRICS``, in that order, then any others of
        ``extra``. Numbers are finite; what could not be measured (too few frames, an absent input,
        no pinch) is None.

    Raises:
        UnknownNameError: if there is no such definition.
        ConfigError: if ``extra`` gives a metric that is computed here.
    """
    if definition not in get_args(Definition):
        raise UnknownNameError("metric definition", str(definition), get_args(Definition))
    computed: dict[str, Value] = {**_definitional(trace, definition), **_common(trace)}
    given = {name: _finite(value) for name, value in (extra or {}).items()}
    if clash := sorted(set(given) & set(computed)):
        raise ConfigError(
            f"extra must not give metrics that are computed from the trace: {', '.join(clash)}"
        )
    values: dict[str, Value] = {"tracking_loss": None, **computed, **given}
    order = dict.fromkeys(metric.name.split(".")[0] for metric in METRICS)
    return {name: values[name] for name in [*order, *(n for n in values if n not in order)]}


def _definitional(trace: Trace, definition: Definition) -> dict[str, Value]:
    """What the two definitions disagree about, and which was used."""
    human, robot, thumb = trace.human_keyvectors, trace.robot_keyvectors, trace.thumb_vectors
    fit = "palm"
    figures: tuple[float | None, ...]
    if definition == "sound":
        figures = (
            accuracy.cosine_similarity(human[:, thumb], robot[:, thumb]),
            accuracy.cosine_similarity(human, robot),
            accuracy.scale_ratio(human[:, thumb], robot[:, thumb]),
            consistency.motion_preservation(trace.human_reaches, trace.robot_reaches),
        )
    else:
        tips = trace.human_tips
        if trace.robot_landmarks is not None:
            using = published.fit_landmarks(trace.fingers, trace.palm_landmarks)
            fitted = published.fit_to_robot(trace.human, trace.robot_landmarks, using)
            tips = fitted[:, [TIPS[FINGERS.index(name)] for name in trace.fingers]]
            human, fit = keyvectors(tips, fitted[:, WRIST]), "robot pose"
        figures = (
            published.cosine_similarity(human[:, thumb], robot[:, thumb]),
            published.cosine_similarity(human, robot),
            published.scale_ratio(human[:, thumb], robot[:, thumb]),
            published.motion_preservation(tips, trace.robot_tips),
        )
    return {
        **dict(zip(_HEADLINES, figures, strict=True)),
        "definition": definition,
        "human_fit": fit,
    }


def _common(trace: Trace) -> dict[str, Value]:
    """What both definitions share."""
    q, stamps = trace.joint_positions, trace.stamps
    lag_ms, correlation = consistency.lag(trace.human_reaches, trace.robot_reaches, stamps)
    excess, excess_share = joints.limit_violation(q, trace.joint_limits)
    return {
        "flatness": consistency.flatness(trace.robot_tips),
        "fingertip_acceleration": consistency.fingertip_acceleration(trace.robot_tips, stamps),
        **_workspace(trace),
        "latency_ms": service.latency(trace.latency_ms),
        "self_collision": _collision(trace),
        **_pinches(trace),
        "lag_ms": lag_ms,
        "velocity_correlation": correlation,
        "joint_jitter": joints.joint_jitter(q),
        "joint_jitter_rate_free": joints.joint_acceleration(q, stamps),
        "max_joint_step": joints.max_joint_step(q),
        "frozen_share": consistency.frozen_share(trace.human_reaches, q),
        "limit_violation_rad": excess,
        "limit_violation_share": excess_share,
        "frames": len(trace),
        "rate_hz": trace.rate_hz,
        "status": service.status_counts(trace.status),
    }


def _workspace(trace: Trace) -> dict[str, Value]:
    shares: list[float | None] = [None] * len(trace.fingers)
    if trace.reach is not None:
        shares = safety.workspace_utilisation(trace.robot_tips, trace.reach)
    known = [share for share in shares if share is not None]
    return {
        "workspace_utilisation": sum(known) / len(known) if known else None,
        "workspace_utilisation_per_finger": dict(zip(trace.fingers, shares, strict=True)),
    }


def _collision(trace: Trace) -> dict[str, float | None]:
    if trace.penetration is None:
        return {"share": None, "mean_depth_mm": None, "max_depth_mm": None}
    return safety.self_collision(trace.penetration)


def _pinches(trace: Trace) -> dict[str, Value]:
    human = trace.human_keyvectors[:, trace.thumb_vectors]
    robot = trace.robot_keyvectors[:, trace.thumb_vectors]
    gaps = accuracy.pinch_gaps(human, robot) * 1e3
    strict = accuracy.pinch_gaps(human, robot, accuracy.PINCH_DISTANCE_STRICT) * 1e3
    return {
        "pinch_error_mm": summary.mean(gaps),
        "pinch_error_strict_mm": summary.mean(strict),
        "pinch_error_per_finger_mm": {
            name: summary.mean(gaps[:, i]) for i, name in enumerate(trace.fingers[1:])
        },
    }


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None

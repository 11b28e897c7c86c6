"""All metrics of one run, as one JSON-serialisable dictionary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias, get_args

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.metrics.metric import Metric, Value
from smooth_operator.metrics.registry import REGISTRY, known_metrics
from smooth_operator.metrics.trace import Trace
from smooth_operator.terminal import print_note

Definition: TypeAlias = Literal["sound", "paper"]
"""``sound``: means over frames, human aligned as the retargeter saw it, still frames masked.
``paper``: as published (``smooth_operator.metrics.published``)."""


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
        The keys of ``METRICS``, in that order, then those of plugins' metrics and any others of
        ``extra``. Numbers are finite; what could not be measured (too few frames, an absent input,
        no pinch) is None.

    Raises:
        UnknownNameError: if there is no such definition.
        ConfigError: if ``extra`` gives a metric that is computed here.
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
            f"extra must not give metrics that are computed from the trace: {', '.join(clash)}"
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
        print_note(f"metric {metric.name!r} is left out: {type(error).__name__}: {error}")
        return None


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None

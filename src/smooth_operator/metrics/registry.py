"""All metrics by name: the built-in ones and those of plugins."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from smooth_operator.errors import ConfigError
from smooth_operator.metrics.metric import Metric
from smooth_operator.metrics.table import METRICS
from smooth_operator.plugins import Entry, Registry

REGISTRY: Final = Registry(
    "metric",
    {
        metric.name: Entry("smooth_operator.metrics.table:METRICS", metric.meaning)
        for metric in METRICS
    },
)
"""Name -> ``Metric``, or a tuple of them in which that name occurs."""


def find_metric(name: str) -> Metric:
    """A metric by its name, or by ``package.module:attribute``.

    Raises:
        UnknownNameError: there is none.
        ConfigError: it is a plugin's, and can't be loaded or is no ``Metric`` of that name.
    """
    for metric in _offered(name):
        if isinstance(metric, Metric) and (metric.name == name or name not in REGISTRY):
            return metric
    raise ConfigError(
        f"{REGISTRY.find(name).target} can't be a metric: it must be a Metric called "
        f"{name!r}, or a tuple of metrics in which one is called so"
    )


def _offered(name: str) -> tuple[object, ...]:
    metrics: object = REGISTRY.load(name)
    return metrics if isinstance(metrics, tuple) else (metrics,)


def add_metrics(targets: Iterable[str]) -> None:
    """Adds metrics to this process: ``evaluate`` then measures them as it does those of plugins.

    Args:
        targets: ``package.module:attribute`` of a ``Metric`` or of a tuple of them.

    Raises:
        UnknownNameError: a text is neither that nor the name of a metric, which is measured anyway.
        ConfigError: one can't be loaded, is no metric, or has the name of another metric.
    """
    for target in targets:
        find_metric(target)
        for metric in () if target in REGISTRY else _offered(target):
            if isinstance(metric, Metric):
                REGISTRY.add(metric.name, Entry(target, metric.meaning))


def known_metrics() -> tuple[Metric, ...]:
    """The built-in metrics, then those of plugins; one that can't be loaded is left out."""
    return tuple(REGISTRY.loadable(find_metric).values())


def plugin_metrics() -> tuple[Metric, ...]:
    """Metrics of plugins."""
    return known_metrics()[len(METRICS) :]

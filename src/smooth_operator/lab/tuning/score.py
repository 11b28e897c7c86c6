"""Score of a trial relative to the start configuration.

On each recording, each term is ``weight * log((error + floor) / (error of the start + floor))``; a
score is their sum over the terms, averaged over the recordings, so the start has 0 if it breaks no
bound, and 0.1 less is 10 % less of an error of weight 1. Bounds add ``PENALTY`` times the
relative excess on each recording: a tenth beyond one is as bad as an error of weight 1 that is 2.7
times as large.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.lab.benchmark.results import value_of
from smooth_operator.metrics.registry import REGISTRY, find_metric

PENALTY: Final = 10.0

_STEP_RATE: Final = 115.0


@dataclass(frozen=True)
class Term:
    """A part of the score.

    Attributes:
        name: name of the term.
        error: from figures to what should be small; None where it was not measured.
        floor: an error that is as good as none.
        weight: in the sum, unless said otherwise.
    """

    name: str
    error: Callable[[Mapping[str, Any]], float | None]
    floor: float
    weight: float


def figure(metrics: Mapping[str, Any], name: str) -> float | None:
    """A figure by the name of a metric, or one of two more:
    ``lag_frames``, and ``joint_step``, the largest one at 115 Hz [rad]."""
    if name == "lag_frames":
        lag, rate = figure(metrics, "lag_ms"), figure(metrics, "rate_hz")
        return None if lag is None or rate is None else lag * 1e-3 * rate
    if name == "joint_step":
        step, rate = figure(metrics, "max_joint_step"), figure(metrics, "rate_hz")
        return None if step is None or rate is None else step * rate / _STEP_RATE
    return value_of({"metrics": metrics}, find_metric(name))


def _from_one(name: str) -> Callable[[Mapping[str, Any]], float | None]:
    def error(metrics: Mapping[str, Any]) -> float | None:
        value = figure(metrics, name)
        return None if value is None else abs(1.0 - value)

    return error


def _itself(name: str) -> Callable[[Mapping[str, Any]], float | None]:
    return lambda metrics: figure(metrics, name)


TERMS: Final = (
    Term("cosine", _from_one("cosine_similarity"), 1e-4, 1.0),
    Term("cosine_all", _from_one("cosine_similarity_all"), 1e-4, 0.5),
    Term("scale", _from_one("scale_ratio"), 0.02, 0.25),
    Term("motion", _from_one("motion_preservation"), 1e-3, 1.0),
    Term("velocity", _from_one("velocity_correlation"), 1e-3, 1.0),
    Term("flatness", _itself("flatness"), 1e-9, 1.0),
    Term("collision", _itself("self_collision.share"), 0.02, 0.5),
    Term("pinch", _itself("pinch_error_mm"), 1.0, 0.5),
)


@dataclass(frozen=True)
class Bound:
    """Lower or upper bound of a figure.

    Attributes:
        name: name of the figure, see ``figure``.
        limit: its bound.
        lower: True for a lower bound.
    """

    name: str
    limit: float
    lower: bool = False

    def excess(self, metrics: Mapping[str, Any]) -> float:
        """Excess over the bound, relative to it; 0 within, or where it was not measured."""
        value = figure(metrics, self.name)
        if value is None:
            return 0.0
        beyond = self.limit - value if self.lower else value - self.limit
        return max(beyond, 0.0) / max(abs(self.limit), 0.05)


BOUNDS: Final = (
    Bound("lag_frames", 1.0),
    Bound("joint_step", 0.25),
    Bound("frozen_share", 0.0),
)
"""Held unless another bound of the same figure is given."""


@dataclass(frozen=True)
class Scoring:
    """Scoring of trials.

    Attributes:
        weights: name of a term -> its weight; the terms' own for the rest.
        bounds: in place of those of ``BOUNDS`` with the same name.

    Raises:
        UnknownNameError: there is no such term or figure.
        ConfigError: a weight is negative.
    """

    weights: Mapping[str, float]
    bounds: tuple[Bound, ...]

    def __post_init__(self) -> None:
        names = [term.name for term in TERMS]
        for name, weight in self.weights.items():
            if name not in names:
                raise UnknownNameError("term of the score", name, names)
            if not (weight >= 0 and math.isfinite(weight)):
                raise ConfigError(f"the weight of {name} must be 0 or more, not {weight}")
        for bound in self.bounds:
            metrics = [*REGISTRY, "lag_frames", "joint_step"]
            if bound.name not in metrics:
                raise UnknownNameError("figure", bound.name, metrics)
        bounded = {bound.name for bound in self.bounds}
        others = tuple(bound for bound in BOUNDS if bound.name not in bounded)
        object.__setattr__(self, "bounds", (*others, *self.bounds))

    def score(
        self, metrics: Sequence[Mapping[str, Any]], start: Sequence[Mapping[str, Any]]
    ) -> float:
        """The score of a trial; less is better.

        Args:
            metrics: metrics of the trial, one for each recording.
            start: metrics of the configuration that the search began at.
        """
        pairs = list(zip(metrics, start, strict=True))
        return sum(self._one(own, first) for own, first in pairs) / len(pairs)

    def _one(self, own: Mapping[str, Any], first: Mapping[str, Any]) -> float:
        total = 0.0
        for term in TERMS:
            weight = self.weights.get(term.name, term.weight)
            now, before = term.error(own), term.error(first)
            if weight and now is not None and before is not None:
                total += weight * math.log((now + term.floor) / (before + term.floor))
        return total + PENALTY * sum(bound.excess(own) for bound in self.bounds)

"""Means and contrasts over independent recordings, with Student's t intervals.

An independent unit is a person with a tracker: one file, or the built-in operator of one seed.
Parts of one recording share their hand, their tracker and their habits, so they are averaged and
count as one unit. The seeds of a random solver are averaged in the same way. By simulation,
``interval_coverage`` shows how often these intervals contain the true value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

Contrast: TypeAlias = Literal["ratio", "change", "difference"]

LEVEL: Final = 0.95
"""Fraction of the intervals that should contain the true value."""


@dataclass(frozen=True)
class Samples:
    """Values of a figure for each recording and seed.

    Attributes:
        values: by recording, then by seed; a deterministic solver has one seed.
        units: independent unit of each recording.
    """

    values: Sequence[Sequence[float]]
    units: Sequence[str]

    def __post_init__(self) -> None:
        if len(self.values) != len(self.units):
            raise ValueError(f"{len(self.values)} recordings, but {len(self.units)} units")
        if not self.values or not all(len(own) for own in self.values):
            raise ValueError("every sample needs a recording, and every recording a value")

    @property
    def means(self) -> Float[np.ndarray, " R"]:
        """Means of the recordings, over their seeds."""
        return np.array([float(np.mean(own)) for own in self.values])


def independent(values: Sequence[float]) -> Samples:
    """Makes independent samples of one value each."""
    return Samples([[value] for value in values], [str(i) for i in range(len(values))])


@dataclass(frozen=True)
class Estimate:
    """The mean of independent units with its 95 % interval (Student's t).

    The units are averaged on the scale of ``points``; the value shown is
    ``factor * f(mean) + offset``, where f is exp for a logarithmic scale.

    Attributes:
        points: one value for each independent unit.
        log: True if these are logarithms.
        factor, offset: conversion from that scale to the value shown.
        value: the mean, as shown.
        low, high: ends of the interval; None for one unit, or if a point is not finite.
    """

    points: tuple[float, ...]
    log: bool = False
    factor: float = 1.0
    offset: float = 0.0
    value: float = field(init=False)
    low: float | None = field(init=False)
    high: float | None = field(init=False)

    def __post_init__(self) -> None:
        low, high = self.interval()
        object.__setattr__(self, "value", self._shown(float(np.mean(self.points))))
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)

    @property
    def units(self) -> int:
        """Number of independent units."""
        return len(self.points)

    def interval(self, among: int = 1) -> tuple[float, float] | tuple[None, None]:
        """The ends of the interval.

        Args:
            among: number of intervals that together should contain their true values with the
                level's probability (Bonferroni); more intervals are wider.
        """
        points = np.asarray(self.points)
        count = len(points)
        if count < 2 or not np.isfinite(points).all():
            return None, None
        quantile = _quantile(1 - (1 - LEVEL) / (2 * among), count - 1)
        half = quantile * float(points.std(ddof=1)) / math.sqrt(count)
        ends = [self._shown(float(points.mean()) + move) for move in (-half, half)]
        return min(ends), max(ends)

    def part_of(self, target: float, none: float, share: float) -> float:
        """Value between no effect and a target, on the scale of the points."""
        a, b = (self._scaled(x) for x in (none, target))
        return self._shown(a + share * (b - a))

    def _shown(self, x: float) -> float:
        return self.factor * (float(np.exp(x)) if self.log else x) + self.offset

    def _scaled(self, shown: float) -> float:
        x = (shown - self.offset) / self.factor
        return float(np.log(x)) if self.log else x

    def __str__(self) -> str:
        return self.shown()

    def shown(self, digits: int = 3, scale: float = 1.0, unit: str = "") -> str:
        """Formats the figure, with its interval in brackets."""

        def number(value: float) -> str:
            text = f"{scale * value:.{digits}g}"
            return f"{float(text):.0f}" if "e+" in text else text.replace("-", "−")

        if self.low is None or self.high is None:
            return f"{number(self.value)}{unit} (no interval: n = {self.units})"
        return f"{number(self.value)}{unit} [{number(self.low)}, {number(self.high)}]"


def mean_of(samples: Samples) -> Estimate:
    """Arithmetic mean over independent units."""
    return Estimate(_by_unit(samples.means, samples.units))


def typical(samples: Samples) -> Estimate:
    """Geometric mean over independent units, for positive figures of very different size.

    The ratio of two methods' means is their ``contrast``. If a value is zero, there is no
    interval.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return Estimate(_by_unit(np.log(samples.means), samples.units), log=True)


def contrast(a: Samples, b: Samples, kind: Contrast) -> Estimate:
    """Compares A with B by recording, since both come from the same frames.

    Args:
        a, b: samples of the same recordings in the same order.
        kind: ``ratio``: geometric mean of a / b; ``change``: that ratio minus 1; ``difference``:
            mean of a - b.
    """
    return pooled([(a, b)], kind)


def pooled(pairs: Sequence[tuple[Samples, Samples]], kind: Contrast) -> Estimate:
    """Averages several contrasts, such as those of solvers, unit by unit."""
    units = pairs[0][0].units
    if any(list(one.units) != list(units) for pair in pairs for one in pair):
        raise ValueError("figures of different recordings can't be compared")
    if kind == "difference":
        return Estimate(_by_unit(np.mean([a.means - b.means for a, b in pairs], axis=0), units))
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.mean([np.log(a.means) - np.log(b.means) for a, b in pairs], axis=0)
    offset = -1.0 if kind == "change" else 0.0
    return Estimate(_by_unit(logs, units), log=True, offset=offset)


def _by_unit(values: Float[np.ndarray, " R"], units: Sequence[str]) -> tuple[float, ...]:
    """Means over the recordings of each unit."""
    groups: dict[str, list[float]] = {}
    for value, unit in zip(values, units, strict=True):
        groups.setdefault(unit, []).append(float(value))
    return tuple(float(np.mean(own)) for own in groups.values())


@cache
def _quantile(probability: float, degrees: int) -> float:
    """Quantile of Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(degrees, probability))

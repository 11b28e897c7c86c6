"""Confidence intervals over recordings, and over seeds within them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int

Samples: TypeAlias = Sequence[Sequence[float]]
"""A figure of each recording and seed; a solver without a seed has one for each recording."""

Contrast: TypeAlias = Literal["ratio", "difference"]

REPEATS: Final = 4000
LEVEL: Final = 0.95


@dataclass(frozen=True)
class Estimate:
    """A figure with its interval.

    Attributes:
        value: the figure.
        low, high: 95 % percentile interval; None where one recording and one seed are all there is.
        recordings: how many it is over.
        seeds: the most seeds of one of them.
    """

    value: float
    low: float | None
    high: float | None
    recordings: int
    seeds: int

    def __str__(self) -> str:
        return self.shown()

    def shown(self, digits: int = 3, scale: float = 1.0, unit: str = "") -> str:
        """As text: the figure, and its interval in brackets."""

        def number(value: float) -> str:
            text = f"{scale * value:.{digits}g}"
            return f"{float(text):.0f}" if "e+" in text else text.replace("-", "−")

        if self.low is None or self.high is None:
            return f"{number(self.value)}{unit} (no interval: one run)"
        return f"{number(self.value)}{unit} [{number(self.low)}, {number(self.high)}]"

    def mapped(self, scale: float, offset: float) -> Estimate:
        """scale x + offset, of a figure x and its interval."""
        ends = [None if x is None else scale * x + offset for x in (self.low, self.high)]
        low, high = ends if scale >= 0 else ends[::-1]
        return Estimate(scale * self.value + offset, low, high, self.recordings, self.seeds)


def mean_of(samples: Samples, seed: int = 0) -> Estimate:
    """Mean over recordings of the mean over seeds."""
    drawn = _draws([samples], seed)
    value = float(np.mean([np.mean(own) for own in samples]))
    return _estimate(value, None if drawn is None else drawn[0].mean(axis=1), samples)


def contrast(a: Samples, b: Samples, kind: Contrast, seed: int = 0) -> Estimate:
    """A against B, recording by recording: both stem from the same frames.

    Args:
        a, b: of the same recordings in the same order.
        kind: ``ratio``: geometric mean over recordings of a / b; ``difference``: mean of a - b.
        seed: of the bootstrap.
    """
    return pooled([(a, b)], kind, seed)


def pooled(pairs: Sequence[tuple[Samples, Samples]], kind: Contrast, seed: int = 0) -> Estimate:
    """The mean of several contrasts, as over solvers; they share the recordings that are drawn."""
    flat = [samples for pair in pairs for samples in pair]

    def combine(means: Sequence[Float[np.ndarray, "B R"]]) -> Float[np.ndarray, " B"]:
        several = list(zip(means[0::2], means[1::2], strict=True))
        if kind == "difference":
            return np.asarray(np.mean([(a - b).mean(axis=1) for a, b in several], axis=0))
        logs = [(np.log(a) - np.log(b)).mean(axis=1) for a, b in several]
        return np.asarray(np.exp(np.mean(logs, axis=0)))

    own = [np.array([[np.mean(values) for values in samples]]) for samples in flat]
    drawn = _draws(flat, seed)
    return _estimate(float(combine(own)[0]), None if drawn is None else combine(drawn), *flat)


def _draws(several: Sequence[Samples], seed: int) -> list[Float[np.ndarray, "B R"]] | None:
    """Means over seeds, of recordings and of seeds within them that are drawn with replacement.

    The recordings drawn are the same for all; the seeds are each one's own. None where there is
    nothing to draw from.
    """
    count = len(several[0])
    if count < 2 and all(len(own) < 2 for samples in several for own in samples):
        return None
    rng = np.random.default_rng(seed)
    chosen = rng.integers(0, count, (REPEATS, count))
    return [_resampled(samples, chosen, rng) for samples in several]


def _resampled(
    samples: Samples, chosen: Int[np.ndarray, "B R"], rng: np.random.Generator
) -> Float[np.ndarray, "B R"]:
    sizes = np.array([len(own) for own in samples])
    most = int(sizes.max())
    table = np.array([list(own) + [np.nan] * (most - len(own)) for own in samples])
    # as many draws as the recording has seeds
    at = (rng.random((*chosen.shape, most)) * sizes[chosen][..., None]).astype(int)
    values = table[chosen[..., None], at]
    counted = np.arange(most) < sizes[chosen][..., None]
    return np.asarray(np.where(counted, values, 0.0).sum(axis=-1) / sizes[chosen])


def _estimate(value: float, drawn: Float[np.ndarray, " B"] | None, *several: Samples) -> Estimate:
    recordings = len(several[0])
    seeds = max(len(own) for samples in several for own in samples)
    if drawn is None:
        return Estimate(value, None, None, recordings, seeds)
    tail = 50 * (1 - LEVEL)
    low, high = np.percentile(drawn, [tail, 100 - tail])
    return Estimate(value, float(low), float(high), recordings, seeds)

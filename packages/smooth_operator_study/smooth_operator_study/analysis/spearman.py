"""Rank correlations of simulation metrics with the outcomes of operators.

A point is one operator with one retargeter: the metric, and the operator's mean outcome. Points of
one operator are not independent, so the bootstrap interval, which draws whole operators, is valid;
Fisher's interval, which assumes independent points, is reported as well.

The correlation over all points mixes two others. The one within operators compares the metric's
ranks of the retargeters with those of each operator's outcomes. The one over the means compares
them with those of the study, and has one point for each retargeter. All figures hold for these
retargeters: operators are drawn, retargeters are not.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pandas as pd
from jaxtyping import Float

from smooth_operator_study.analysis.dunnett import holm, quantile, two_sided
from smooth_operator_study.analysis.models import correlation_in_words
from smooth_operator_study.analysis.results import Outcome
from smooth_operator_study.data.rows import StudyData

_DIGITS: Final = 9
"""Digits of means before ranking, so that equal means tie whatever their order of summation."""
_FEWEST: Final = 4
DRAWS: Final = 4000
_NAMES: Final[dict[Outcome, str]] = {"success": "success", "time": "time_s", "tlx": "raw_tlx"}


def correlations(data: StudyData, *, seed: int = 11, draws: int = DRAWS) -> dict[str, Any]:
    """Computes Spearman's ρ of each metric with each outcome.

    Args:
        draws: number of samples of the bootstrap.

    Returns:
        ``METRIC~OUTCOME`` -> ``rho``, ``n``, ``operators``, ``p_t``, ``ci_fisher`` and
        ``ci_boot_operators`` with ``lcl`` and ``ucl``, ``effect_words``; or ``refused``. ``within``
        has the correlation of ranks within operators: ``rho``, ``n``, ``operators``, ``lcl`` and
        ``ucl`` of the bootstrap, ``p`` by changing the signs of operators, ``p_holm`` over all
        pairs. ``means`` has that of the retargeters' means, ``rho`` and ``n``. Outcomes are
        ``success``, ``time_s`` and ``raw_tlx``. Empty without metrics.
    """
    if data.metrics is None:
        return {}
    pair = ["operator", "retargeter"]
    table: dict[str, Any] = {}
    for metric in data.metrics.columns.drop(pair):
        for outcome, rows in data.outcomes().items():
            means = rows.groupby(pair).value.mean().rename("y")
            points = data.metrics[pair].assign(x=data.metrics[metric])
            points = points.join(means, on=pair).round(_DIGITS).dropna()
            # All pairs draw the same operators, so that their figures are comparable.
            entry = correlation(points, seed=seed, draws=draws)
            if "rho" in entry:
                entry["within"] = correlation_within(points, seed=seed, draws=draws)
                entry["means"] = _over_means(points)
            table[f"{metric}~{_NAMES[outcome]}"] = entry
    tested = [e["within"] for e in table.values() if "p" in e.get("within", {})]
    for entry, p in zip(tested, holm([entry["p"] for entry in tested]), strict=True):
        entry["p_holm"] = p
    return table


def correlation_within(points: pd.DataFrame, *, seed: int, draws: int) -> dict[str, Any]:
    """Computes the correlation of ranks within operators.

    Args:
        points: ``operator``, ``retargeter``, ``x`` and ``y``, a row for each operator and
            retargeter.
        seed: seed of bootstrap and sign changes.
        draws: number of samples of both.

    Returns:
        ``within`` of ``correlations``; ``refused`` if ranks never vary within an operator.
    """
    ranks = points.groupby("operator")[["x", "y"]].rank()
    x, y = (ranks - ranks.groupby(points.operator).transform("mean")).to_numpy().T
    products = pd.DataFrame({"xy": x * y, "xx": x * x, "yy": y * y}, index=points.index)
    sums = products.groupby(points.operator).sum().to_numpy()
    if not np.all(sums[:, 1:].sum(axis=0) > 0):
        return {"refused": "the metric or the outcome is constant within operators"}
    drawn = operator_weights(len(sums), seed=seed, draws=draws) @ sums
    scale = np.sqrt(drawn[:, 1] * drawn[:, 2])
    rho = np.divide(drawn[:, 0], scale, out=np.full(len(scale), np.nan), where=scale > 0)
    low, high = np.nanpercentile(rho[1:], [2.5, 97.5])
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (draws, len(sums)))
    as_far = np.abs(signs @ sums[:, 0]) >= abs(sums[:, 0].sum()) - 1e-9
    return {
        "rho": float(rho[0]),
        "n": len(points),
        "operators": len(sums),
        "lcl": float(low),
        "ucl": float(high),
        "p": float((1 + as_far.sum()) / (1 + draws)),
    }


def _over_means(points: pd.DataFrame) -> dict[str, Any]:
    """Computes the correlation of the retargeters' means of metric and outcome."""
    means = points.groupby("retargeter")[["x", "y"]].mean().round(_DIGITS)
    return {"rho": spearman(*means.to_numpy().T), "n": len(means)}


def spearman(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> float:
    """Computes the correlation of mean ranks; NaN if one of the two is constant."""
    return float(_weighted(x, y, np.ones((1, len(x))))[0])


def _weighted(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], times: Float[np.ndarray, "k n"]
) -> Float[np.ndarray, " k"]:
    """Computes ρ of samples with ``times[:, i]`` copies of point i; NaN if one is constant."""
    total = times.sum(axis=1, keepdims=True)
    a, b = (_ranks(values, times) - (total + 1) / 2 for values in (x, y))
    scale = np.sqrt(np.sum(times * a**2, axis=1) * np.sum(times * b**2, axis=1))
    product = np.sum(times * a * b, axis=1)
    constant = np.full(len(times), np.nan)
    return np.asarray(np.divide(product, scale, out=constant, where=scale > 0))


def _ranks(
    values: Float[np.ndarray, " n"], times: Float[np.ndarray, "k n"]
) -> Float[np.ndarray, "k n"]:
    """Computes the mean ranks of the points in each sample."""
    _, level = np.unique(values, return_inverse=True)
    counts = np.zeros((len(times), int(level.max()) + 1))
    for i, j in enumerate(level):
        counts[:, j] += times[:, i]
    below = np.cumsum(counts, axis=1) - counts
    return np.asarray((below + (counts + 1) / 2)[:, level])


def correlation(points: pd.DataFrame, *, seed: int, draws: int) -> dict[str, Any]:
    """Computes the correlation over all points.

    Args:
        points: ``operator``, ``x`` and ``y``.
        seed: seed of the bootstrap.
        draws: number of its samples.

    Returns:
        Figures of ``correlations`` without ``within`` and ``means``; or ``refused`` and ``n``.
    """
    count, (owner, operators) = len(points), pd.factorize(points.operator, sort=True)
    if count < _FEWEST or len(operators) < 2:
        return {
            "refused": f"{count} points of {len(operators)} operator(s): at least {_FEWEST} points "
            "of two operators are needed",
            "n": count,
        }
    x, y = points[["x", "y"]].to_numpy().T
    rho = spearman(x, y)
    if np.isnan(rho):
        return {"refused": "the metric or the outcome is constant", "n": count}
    times = operator_weights(len(operators), seed=seed, draws=draws)[1:]
    drawn = _weighted(x, y, times[:, owner])
    low, high = np.nanpercentile(drawn, [2.5, 97.5])
    reach = quantile(np.inf) / np.sqrt(count - 3)
    exact = abs(rho) >= 1 - 1e-12
    statistic = np.inf if exact else rho * np.sqrt((count - 2) / (1 - rho**2))
    return {
        "rho": rho,
        "n": count,
        "operators": len(operators),
        "p_t": two_sided(statistic, count - 2),
        "ci_fisher": {
            "lcl": rho if exact else float(np.tanh(np.arctanh(rho) - reach)),
            "ucl": rho if exact else float(np.tanh(np.arctanh(rho) + reach)),
        },
        "ci_boot_operators": {"lcl": float(low), "ucl": float(high)},
        "effect_words": correlation_in_words(rho),
    }


def operator_weights(operators: int, *, seed: int, draws: int) -> Float[np.ndarray, "k g"]:
    """Draws counts of each operator in each sample; the first sample has each operator once.

    Args:
        operators: number of operators.
        draws: number of samples after the first.
    """
    rng = np.random.default_rng(seed)
    chosen = rng.integers(operators, size=(draws, operators))
    counts = np.zeros((draws + 1, operators))
    counts[0] = 1
    np.add.at(counts, (np.arange(1, draws + 1)[:, None], chosen), 1)
    return counts

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

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.study.analysis.dunnett import holm, quantile, two_sided
from smooth_operator.study.analysis.models import correlation_in_words
from smooth_operator.study.analysis.results import operator_signs, operator_weights
from smooth_operator.study.data.rows import StudyData

_DIGITS: Final = 9
"""Digits of means before ranking, so that equal means tie whatever their order of summation."""
_FEWEST: Final = 4
DRAWS: Final = 4000


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
    means = _means(data)
    table: dict[str, Any] = {}
    for j, metric in enumerate(data.metrics.names):
        for name, mean in means.items():
            points = [
                (operator, retargeter, value, mean[operator, retargeter])
                for operator, retargeter, value in zip(
                    map(str, data.metrics.operator),
                    map(str, data.metrics.retargeter),
                    np.round(data.metrics.values[:, j], _DIGITS),
                    strict=True,
                )
                if np.isfinite(value) and (operator, retargeter) in mean
            ]
            # All pairs draw the same operators, so that their figures are comparable.
            entry = _correlate([(p[0], p[2], p[3]) for p in points], seed, draws)
            if "rho" in entry:
                entry["within"] = correlation_within(points, seed=seed, draws=draws)
                entry["means"] = _over_means(points)
            table[f"{metric}~{name}"] = entry
    tested = [e["within"] for e in table.values() if "p" in e.get("within", {})]
    for entry, p in zip(tested, holm([entry["p"] for entry in tested]), strict=True):
        entry["p_holm"] = p
    return table


Point = tuple[str, str, float, float]
"""Operator, retargeter, metric, mean outcome."""


def correlation_within(points: Sequence[Point], *, seed: int, draws: int) -> dict[str, Any]:
    """Computes the correlation of ranks within operators.

    Args:
        points: points, one for each operator and retargeter.
        seed: seed of bootstrap and sign changes.
        draws: number of samples of both.

    Returns:
        ``within`` of ``correlations``; ``refused`` if ranks never vary within an operator.
    """
    parts = []
    for operator in sorted({point[0] for point in points}):
        own = [point for point in points if point[0] == operator]
        one = np.ones((1, len(own)))
        x, y = (_ranks(np.array([p[k] for p in own]), one)[0] for k in (2, 3))
        x, y = x - x.mean(), y - y.mean()
        parts.append((x @ y, x @ x, y @ y))
    sums = np.array(parts)
    if not np.all(sums[:, 1:].sum(axis=0) > 0):
        return {"refused": "within operators the metric or the outcome never varies"}
    drawn = operator_weights(len(sums), seed=seed, draws=draws) @ sums
    scale = np.sqrt(drawn[:, 1] * drawn[:, 2])
    rho = np.divide(drawn[:, 0], scale, out=np.full(len(scale), np.nan), where=scale > 0)
    low, high = np.nanpercentile(rho[1:], [2.5, 97.5])
    signs = operator_signs(len(sums), seed=seed, draws=draws)
    as_far = np.abs(signs @ sums[:, 0]) >= abs(sums[:, 0].sum()) - 1e-9
    return {
        "rho": float(rho[0]),
        "n": len(points),
        "operators": len(sums),
        "lcl": float(low),
        "ucl": float(high),
        "p": float((1 + as_far.sum()) / (1 + draws)),
    }


def _over_means(points: Sequence[Point]) -> dict[str, Any]:
    """Computes the correlation of the retargeters' means of metric and outcome."""
    names = sorted({point[1] for point in points})
    means = np.array(
        [np.mean([p[2:] for p in points if p[1] == name], axis=0) for name in names]
    ).round(_DIGITS)
    return {"rho": spearman(means[:, 0], means[:, 1]), "n": len(names)}


def _means(data: StudyData) -> dict[str, dict[tuple[str, str], float]]:
    trials = data.trials
    timed = trials.success & np.isfinite(trials.time)
    means = {
        "success": _by_pair(trials.operator, trials.retargeter, trials.success.astype(float)),
        "time_s": _by_pair(trials.operator[timed], trials.retargeter[timed], trials.time[timed]),
    }
    if data.questionnaires is not None:
        table = data.questionnaires
        answered = np.isfinite(table.workload)
        means["raw_tlx"] = _by_pair(
            table.operator[answered], table.retargeter[answered], table.workload[answered]
        )
    return means


def _by_pair(
    operator: np.ndarray, retargeter: np.ndarray, values: Float[np.ndarray, " n"]
) -> dict[tuple[str, str], float]:
    gathered: dict[tuple[str, str], list[float]] = {}
    for one, other, value in zip(operator, retargeter, values, strict=True):
        gathered.setdefault((str(one), str(other)), []).append(float(value))
    return {key: round(float(np.mean(group)), _DIGITS) for key, group in gathered.items()}


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


def _correlate(points: list[tuple[str, float, float]], seed: int, draws: int) -> dict[str, Any]:
    count = len(points)
    operators = sorted({operator for operator, _, _ in points})
    if count < _FEWEST or len(operators) < 2:
        return {
            "refused": f"{count} points of {len(operators)} operator(s): at least {_FEWEST} points "
            "of two operators are needed",
            "n": count,
        }
    x, y = np.array([p[1] for p in points]), np.array([p[2] for p in points])
    rho = spearman(x, y)
    if np.isnan(rho):
        return {"refused": "the metric or the outcome is constant", "n": count}
    place = {operator: i for i, operator in enumerate(operators)}
    owner = np.array([place[operator] for operator, _, _ in points])
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

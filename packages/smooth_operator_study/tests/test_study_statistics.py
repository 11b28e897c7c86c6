"""Models and corrections against closed forms, other implementations, and R's figures."""

import json
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.special
import scipy.stats
from nested_cases import intercepts_with_t
from study_cases import Case, holes, simulate

from smooth_operator.errors import StudyError
from smooth_operator_study.analysis.dunnett import dunnett, holm, outside, quantile, two_sided
from smooth_operator_study.analysis.frame import frame_of, make_frame
from smooth_operator_study.analysis.gee import fit_gee, separating
from smooth_operator_study.analysis.learning import logistic_slope
from smooth_operator_study.analysis.mixed import fit_mixed
from smooth_operator_study.analysis.outcomes import analyze
from smooth_operator_study.analysis.spearman import _weighted, correlation, spearman
from smooth_operator_study.data.reading import Checked, make_trials
from smooth_operator_study.data.rows import successes, times

REFERENCE = json.loads(Path(__file__).with_name("study_reference.json").read_text("utf-8"))
"""Figures of lme4, lmerTest, geepack and emmeans for two simulated studies of ``study_cases``.

``holes`` is ``simulate(4, keep=holes)``, ``alternate`` ``simulate(5, alternate=True, spread=0,
effect=0)``. Mixed models by bobyqa to 1e-12, GEE to 1e-12, means and pairs on the response scale;
pairs are baseline first.
"""

# Mixed models.


def balanced(
    spread: float, operators: int = 9, levels: int = 4, repeats: int = 3, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    groups = np.repeat(np.arange(operators), levels * repeats)
    level = np.tile(np.repeat(np.arange(levels), repeats), operators)
    y = level + spread * rng.normal(size=operators)[groups] + rng.normal(size=len(groups))
    design = np.column_stack([np.ones(len(y)), *(level == j for j in range(1, levels))])
    return design.astype(float), y, groups


def test_reml_of_a_balanced_design_is_anova():
    """Variances from mean squares, contrasts with the residual's degrees of freedom."""
    design, y, groups = balanced(2.0)
    operators, levels, repeats = 9, 4, 3
    fit = fit_mixed(design, y, {"operator": groups})
    cells = y.reshape(operators, levels, repeats)
    between = levels * repeats * np.sum((cells.mean((1, 2)) - y.mean()) ** 2) / (operators - 1)
    model = cells.mean((1, 2))[:, None] + cells.mean((0, 2))[None] - y.mean()
    freedom = len(y) - operators - levels + 1
    residual = np.sum((cells - model[:, :, None]) ** 2) / freedom
    assert fit.residual_variance == pytest.approx(residual, rel=1e-10)
    assert fit.variances["operator"] == pytest.approx(
        (between - residual) / (levels * repeats), rel=1e-9
    )
    contrast = np.array([0.0, 1.0, -1.0, 0.0])
    error = np.sqrt(contrast @ fit.covariance @ contrast)
    assert error == pytest.approx(np.sqrt(2 * residual / (operators * repeats)), rel=1e-10)
    assert fit.satterthwaite(contrast) == pytest.approx(freedom, rel=1e-8)
    # The overall mean varies with the operators alone.
    mean = np.array([1.0, 0.25, 0.25, 0.25])
    assert fit.satterthwaite(mean) == pytest.approx(operators - 1, rel=1e-8)
    assert mean @ fit.covariance @ mean == pytest.approx(between / len(y), rel=1e-9)


def test_a_singular_fit_is_ordinary_regression():
    design, y, groups = balanced(0.0, seed=3)
    y = y - np.bincount(groups, y)[groups] / np.bincount(groups)[groups]  # less alike than chance
    fit = fit_mixed(design, y, {"operator": groups})
    assert fit.variances["operator"] == 0
    beta, squares, *_ = np.linalg.lstsq(design, y, rcond=None)
    np.testing.assert_allclose(fit.beta, beta, atol=1e-12)
    assert fit.residual_variance == pytest.approx(squares[0] / (len(y) - 4), rel=1e-12)
    assert fit.satterthwaite(np.eye(4)[1]) == pytest.approx(len(y) - 4, rel=1e-12)


def test_operators_that_differ_hugely_lose_no_digits():
    design, y, groups = balanced(1.0, seed=5)
    fit = fit_mixed(design, y + 1e5 * groups, {"operator": groups})
    assert fit.ratios[0] > 1e8
    # Within operators all is as if they were fixed effects.
    dummies = np.column_stack([design[:, 1:], groups[:, None] == np.arange(9)])
    beta = np.linalg.lstsq(dummies, y, rcond=None)[0]
    np.testing.assert_allclose(fit.beta[1:], beta[:3], rtol=1e-8)


def test_an_outcome_without_residual_is_refused():
    design, _, groups = balanced(1.0)
    with pytest.raises(StudyError, match="without any residual"):
        fit_mixed(design, design @ [1.0, 2, 3, 4] + groups, {"operator": groups})
    with pytest.raises(StudyError, match="more rows"):
        fit_mixed(design[:4], np.arange(4.0), {"operator": np.array([0, 0, 1, 1])})


def test_gee_of_means_is_closed_form():
    """One mean of equal clusters: errors are those between clusters, leverage is 1 / clusters."""
    y = np.array([[1, 1, 0, 1], [0, 0, 1, 0], [1, 1, 1, 1], [0, 1, 0, 0], [1, 0, 1, 0]], float)
    count, size = y.shape
    fit = fit_gee(np.ones((y.size, 1)), y.ravel(), np.repeat(np.arange(count), size))
    mean = y.mean()
    assert fit.beta[0] == pytest.approx(np.log(mean / (1 - mean)), rel=1e-12)
    spread = mean * (1 - mean)
    between = np.sum((y.mean(axis=1) - mean) ** 2) / count**2
    assert fit.robust[0, 0] == pytest.approx(between / spread**2, rel=1e-12)
    leverage = 1 - 1 / count  # of a cluster's own mean in the overall one
    assert fit.mancl_derouen[0, 0] == pytest.approx(between / spread**2 / leverage**2, rel=1e-12)
    residuals = (y - mean) / np.sqrt(spread)
    assert fit.phi == pytest.approx(np.mean(residuals**2), rel=1e-12)
    products = [residuals[:, a] * residuals[:, b] for a, b in combinations(range(size), 2)]
    assert fit.alpha == pytest.approx(np.mean(products) / fit.phi, rel=1e-12)


def test_gee_is_what_whole_matrices_say():
    """Estimating equation and both covariances with D, V and H written out for each operator."""
    rng = np.random.default_rng(2)
    groups = rng.permutation(np.repeat(np.arange(8), [3, 9, 6, 12, 5, 7, 8, 10]))
    x = np.column_stack([np.ones(60), rng.normal(size=(60, 2))])
    y = (rng.random(60) < 1 / (1 + np.exp(-x @ [0.2, 0.7, -0.4]))).astype(float)
    fit = fit_gee(x, y, groups)
    mean = 1 / (1 + np.exp(-x @ fit.beta))
    bread, parts = np.zeros((3, 3)), []
    for i in range(8):
        rows = groups == i
        n, m = rows.sum(), mean[rows]
        root = np.sqrt(m * (1 - m))
        d = x[rows] * (root**2)[:, None]
        working = (1 - fit.alpha) * np.eye(n) + fit.alpha
        v = root[:, None] * working * root
        parts.append((d, np.linalg.inv(v), y[rows] - m))
        bread += d.T @ parts[-1][1] @ d
    assert np.max(np.abs(sum(d.T @ w @ r for d, w, r in parts))) < 1e-10
    inverse = np.linalg.inv(bread)
    plain, corrected = np.zeros((3, 3)), np.zeros((3, 3))
    for d, w, r in parts:
        hat = d @ inverse @ d.T @ w
        score, fixed = d.T @ w @ r, d.T @ w @ np.linalg.solve(np.eye(len(r)) - hat, r)
        plain += np.outer(score, score)
        corrected += np.outer(fixed, fixed)
    np.testing.assert_allclose(fit.robust, inverse @ plain @ inverse, rtol=1e-10)
    np.testing.assert_allclose(fit.mancl_derouen, inverse @ corrected @ inverse, rtol=1e-10)


def test_separation_is_found_and_overlap_is_not_called_so():
    x = np.column_stack([np.ones(8), np.arange(8.0)])
    assert separating(x, (np.arange(8) > 3).astype(float)) is not None
    assert separating(x, np.array([0, 1, 0, 1, 0, 1, 0, 1.0])) is None
    half = np.column_stack([np.ones(6), [0, 0, 0, 1, 1, 1]])  # only where the second is one
    assert separating(half, np.array([0, 1, 0, 1, 1, 1.0])) is not None


# Figures of R on studies that no optimiser of ours was made with.


CASES: dict[str, Case] = {
    "holes": simulate(4, keep=holes),
    "alternate": simulate(5, alternate=True, spread=0.0, effect=0.0),
}


def trials_of(rows: list[dict[str, Any]]) -> pd.DataFrame:
    return make_trials(Checked("trials", "trials", list(enumerate(_text(rows), 2))))[0]


@pytest.mark.parametrize("scope", ["pooled", "A"])
@pytest.mark.parametrize("name", list(CASES))
def test_times_are_as_r_has_them(name, scope):
    expected = REFERENCE[name][f"time {scope}"]
    trials = trials_of(CASES[name].trials)
    found = intercepts_with_t(frame_of(times(trials), scope, "dexpilot"))
    assert list(found.coefficients) == expected["names"]
    of = found.coefficients.values()
    np.testing.assert_allclose([c.estimate for c in of], expected["estimate"], rtol=1e-6)
    np.testing.assert_allclose([c.se for c in of], expected["se"], rtol=1e-6)
    np.testing.assert_allclose([c.df for c in of], expected["df"], rtol=1e-5)
    means = found.emm.values()
    np.testing.assert_allclose([m.estimate for m in means], expected["emm"], rtol=1e-6)
    np.testing.assert_allclose([m.se for m in means], expected["emm_se"], rtol=1e-6)
    np.testing.assert_allclose([m.df for m in means], expected["emm_df"], rtol=1e-5)
    pairs = found.pairs.values()
    np.testing.assert_allclose([p.df for p in pairs], expected["pair_df"], rtol=1e-5)
    np.testing.assert_allclose([p.p_raw for p in pairs], expected["pair_p"], atol=1e-6)
    assert found.model["log_likelihood"] == pytest.approx(expected["log_likelihood"], abs=1e-7)
    for mean in means:  # 95 %, each by itself
        reach = scipy.stats.t.ppf(0.975, mean.df) * mean.se
        expected_ends = (mean.estimate - reach, mean.estimate + reach)
        assert (mean.lower, mean.upper) == pytest.approx(expected_ends)
    for name, against in found.dunnett.items():  # the other way round: from the baseline to it
        pair = found.pairs[f"dexpilot-{name}"]
        assert (against.difference, against.effect) == (-pair.difference, -pair.effect)


@pytest.mark.parametrize("scope", ["pooled", "A"])
def test_success_is_as_r_has_it(scope):
    expected = REFERENCE["holes"][f"success {scope}"]
    trials = trials_of(CASES["holes"].trials)
    by_mode = analyze("success", frame_of(successes(trials), scope, "dexpilot"))
    for mode, suffix in (("paper", ""), ("small-sample", "_mancl_derouen")):
        found = by_mode[mode]
        assert list(found.coefficients) == expected["names"]
        of = found.coefficients.values()
        np.testing.assert_allclose([c.estimate for c in of], expected["estimate"], rtol=1e-8)
        np.testing.assert_allclose([c.se for c in of], expected[f"se{suffix}"], rtol=1e-8)
        means = found.emm.values()
        np.testing.assert_allclose([m.estimate for m in means], expected["emm"], rtol=1e-8)
        np.testing.assert_allclose([m.se for m in means], expected[f"emm_se{suffix}"], rtol=1e-8)
    assert by_mode["paper"].model["alpha"] == pytest.approx(expected["alpha"], rel=1e-8)
    assert by_mode["paper"].model["phi"] == pytest.approx(expected["phi"], rel=1e-8)
    errors = [pair.se for pair in by_mode["paper"].pairs.values()]
    np.testing.assert_allclose(errors, expected["pair_se"], rtol=1e-8)


@pytest.mark.parametrize("scope", ["pooled", "A"])
def test_a_negative_working_correlation_is_as_r_has_it_and_refused(scope):
    """At the edge of what is possible and beyond it, R reports figures that mean nothing."""
    expected = REFERENCE["alternate"][f"success {scope}"]
    trials = trials_of(CASES["alternate"].trials)
    frame = frame_of(successes(trials), scope, "dexpilot")
    fit = fit_gee(frame.design()[0], frame.outcome, frame.group)
    np.testing.assert_allclose(fit.beta, expected["estimate"], rtol=1e-8)
    np.testing.assert_allclose(np.sqrt(np.diag(fit.robust)), expected["se"], rtol=1e-8)
    assert fit.alpha == pytest.approx(expected["alpha"], rel=1e-8)
    for result in analyze("success", frame).values():
        assert "the model could not be fitted" in (result.refused or "")
        assert "working correlation -0.0" in (result.refused or "")
        assert not result.emm
        assert set(result.observed) == set(frame.retargeters)
    assert "at or beyond its lowest" in logistic_slope(frame)["refused"]


def test_a_mildly_negative_working_correlation_is_flagged():
    """Three quarters of the way to the edge."""
    draw = np.random.default_rng(3)
    rows = []
    for operator in range(8):
        for name in ("dexpilot", "sbr"):
            won = np.array([1, 0, 1, 0, 1, 0]) if operator % 4 else draw.integers(0, 2, 6)
            rows += [(float(y), name, "A", f"P{operator}", k) for k, y in enumerate(won, 1)]
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    frame = make_frame(columns[0].astype(float), *columns[1:], baseline="dexpilot")
    found = analyze("success", frame)["small-sample"]
    assert -1 / 11 * 0.99 < found.model["alpha"] < 0
    assert any("working correlation is negative" in text for text in found.warnings)


def _text(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: str(value) for key, value in row.items()} for row in rows]


@pytest.mark.parametrize(
    ("comparisons", "freedom", "critical"),
    # Dunnett's table of two-sided 5 % points (1964), equal group sizes: correlation 0.5.
    [
        (2, 10, 2.57),
        (2, 20, 2.38),
        (3, 5, 3.29),
        (3, 10, 2.76),
        (3, 20, 2.54),
        (3, 60, 2.41),
        (4, 12, 2.81),
        (3, np.inf, 2.35),
        pytest.param(6, np.inf, 2.57, marks=pytest.mark.weekly),
    ],
)
def test_critical_values_are_dunnetts(comparisons, freedom, critical):
    correlation = np.full((comparisons, comparisons), 0.5) + 0.5 * np.eye(comparisons)
    found = dunnett([1.0], correlation[:1, :1], [freedom]).critical[0]
    assert found == pytest.approx(quantile(freedom))  # one comparison is a plain test
    probability, error = outside(critical, correlation, freedom)
    assert probability == pytest.approx(0.05, abs=8e-4)  # the table has two decimals
    assert error <= 1e-5  # six variables go to SciPy's points


def test_dunnett_is_scipys_for_one_way_layouts():
    rng = np.random.default_rng(0)
    control, *others = (rng.normal(m, 1, n) for m, n in ((0, 12), (0.9, 8), (0.2, 10), (-0.6, 9)))
    reference = scipy.stats.dunnett(*others, control=control, rng=np.random.default_rng(1))
    sizes = np.array([len(x) for x in others])
    groups = [control, *others]
    freedom = sum(len(x) - 1 for x in groups)
    variance = sum(np.sum((x - x.mean()) ** 2) for x in groups) / freedom
    statistics = [
        (x.mean() - control.mean()) / np.sqrt(variance * (1 / len(x) + 1 / 12)) for x in others
    ]
    share = np.sqrt(sizes / (sizes + 12))
    correlation = np.outer(share, share)
    np.fill_diagonal(correlation, 1)
    found = dunnett(statistics, correlation, [float(freedom)] * 3)
    np.testing.assert_allclose(statistics, reference.statistic, rtol=1e-12)
    np.testing.assert_allclose(found.p, reference.pvalue, atol=2e-3)  # scipy's is random


def test_the_integral_is_what_one_factor_says():
    """With equal correlations it is one integral over the shared factor, and one over chi."""
    for count, freedom in ((3, np.inf), (3, 7.3), (4, np.inf)):
        points, weights = np.polynomial.hermite_e.hermegauss(120)
        scales = (
            np.ones(1)
            if np.isinf(freedom)
            else np.sqrt(scipy.stats.chi2(freedom).ppf((np.arange(20000) + 0.5) / 20000) / freedom)
        )
        limit = 2.1 * scales[:, None]
        shared = np.sqrt(0.4) * points
        inside = scipy.stats.norm.cdf((limit - shared) / np.sqrt(0.6))
        inside = inside - scipy.stats.norm.cdf((-limit - shared) / np.sqrt(0.6))
        expected = 1 - np.mean(inside**count @ weights) / np.sqrt(2 * np.pi)
        correlation = np.full((count, count), 0.4) + 0.6 * np.eye(count)
        found, error = outside(2.1, correlation, freedom)
        assert found == pytest.approx(expected, abs=3e-6)  # of the midpoint rule over chi
        assert error < 1e-7


@pytest.mark.weekly
def test_more_variables_than_nodes_can_do_come_out_the_same():
    correlation = np.full((7, 7), 0.5) + 0.5 * np.eye(7)
    points, weights = np.polynomial.hermite_e.hermegauss(120)
    shared = np.sqrt(0.5) * points
    inside = scipy.stats.norm.cdf((2.5 - shared) / np.sqrt(0.5))
    inside = inside - scipy.stats.norm.cdf((-2.5 - shared) / np.sqrt(0.5))
    expected = 1 - inside**7 @ weights / np.sqrt(2 * np.pi)
    found, error = outside(2.5, correlation)
    assert abs(found - expected) < max(error, 1e-6)
    assert error <= 1e-5
    assert outside(2.5, correlation) == (found, error)  # no randomness


def test_five_comparisons_are_exact():
    """A correlation with two factors, against the integral over both."""
    one, two = np.array([0.7, 0.6, 0.8, 0.5, 0.65]), np.array([0.3, -0.2, 0.1, 0.4, -0.3])
    correlation = np.outer(one, one) + np.outer(two, two)
    np.fill_diagonal(correlation, 1.0)
    points, weights = np.polynomial.hermite_e.hermegauss(60)
    weights = weights / weights.sum()
    mean = points[:, None, None] * one + points[None, :, None] * two
    own = np.sqrt(1 - one**2 - two**2)

    def truth(limit: float) -> float:
        ends = [scipy.stats.norm.cdf((side * limit - mean) / own) for side in (1, -1)]
        return float(1 - weights @ (ends[0] - ends[1]).prod(axis=2) @ weights)

    for limit in (1.5, 2.5, 3.5, 4.5):
        found, error = outside(limit, correlation)
        assert found == pytest.approx(truth(limit), abs=2e-8)
        assert error < 1e-6
    # Of a t: the same, averaged over the chi variable that divides it.
    halves, shares = scipy.special.roots_genlaguerre(40, 9.0)
    expected = shares @ [truth(2.4 * np.sqrt(half / 10)) for half in halves] / shares.sum()
    assert outside(2.4, correlation, 20.0)[0] == pytest.approx(expected, abs=2e-8)
    found = dunnett([2.1, 2.5, -3.0, 0.4, 1.9], correlation, [14.0, 15.5, 17.0, 20.0, 30.0])
    assert len(set(found.critical)) == 5
    assert max(found.critical) == found.critical[0]


def test_singular_correlations_are_no_trouble():
    one = np.ones((3, 3))
    assert outside(1.7, one)[0] == pytest.approx(two_sided(1.7, np.inf), abs=1e-12)
    assert outside(1.7, one, 6.0)[0] == pytest.approx(two_sided(1.7, 6.0), abs=1e-12)
    # The third is told by the first two: x, y, (x + y) / sqrt 2.
    factor = np.array([[1, 0], [0, 1], [1, 1]]) / np.array([[1], [1], [np.sqrt(2)]])
    x = np.linspace(-2, 2, 40001)[:-1] + 5e-5
    low, high = np.maximum(-2, -2 * np.sqrt(2) - x), np.minimum(2, 2 * np.sqrt(2) - x)
    inside = scipy.stats.norm.cdf(high) - scipy.stats.norm.cdf(low)
    expected = 1 - np.sum(scipy.stats.norm.pdf(x) * inside) * 1e-4
    found, error = outside(2.0, factor @ factor.T)
    assert found == pytest.approx(expected, abs=1e-9)
    assert error <= 1e-8
    # With rank three there is no such integral, and the error is said.
    far = np.linalg.qr(np.random.default_rng(3).normal(size=(5, 3)))[0]
    scale = np.linalg.norm(far, axis=1)
    assert outside(2.0, far @ far.T / np.outer(scale, scale))[1] == 1e-4


def test_dunnett_lies_between_its_bounds():
    rng = np.random.default_rng(4)
    for _ in range(8):
        root = rng.normal(size=(3, 4))
        spread = root @ root.T
        scale = np.sqrt(np.diag(spread))
        statistics = 3 * rng.normal(size=3)
        freedom = [float(f) for f in rng.uniform(3, 40, 3)]
        found = dunnett(statistics, spread / np.outer(scale, scale), freedom, level=None)
        for p, statistic, df in zip(found.p, statistics, freedom, strict=True):
            raw = two_sided(statistic, df)
            assert raw <= p <= min(1, 3 * raw)


def test_simultaneous_limits_agree_with_p_values():
    correlation = np.array([[1, 0.3, 0.6], [0.3, 1, 0.2], [0.6, 0.2, 1]])
    found = dunnett([2.0, 2.0, 2.0], correlation, [9.0, 20.0, np.inf])
    for critical, df in zip(found.critical, (9.0, 20.0, np.inf), strict=True):
        assert outside(critical, correlation, df)[0] == pytest.approx(0.05, abs=2e-4)


def test_holm_steps_down():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0])
    assert holm([0.7, 0.9]) == [1.0, 1.0]
    assert holm([]) == []


@pytest.mark.parametrize("scope", ["B", "C"])
def test_a_correlation_near_its_lowest_does_not_keep_a_fit_from_converging(scope):
    """There rounding keeps the estimating equations off by 1e-7 to 1e-3, but the fit stands."""
    trials = trials_of(CASES["alternate"].trials)
    frame = frame_of(successes(trials), scope, "dexpilot", "in block")
    design = np.column_stack([frame.factors()[0], frame.index - frame.index_mean])
    fit = fit_gee(design, frame.outcome, frame.group)
    assert 0 < fit.margin < 0.001


def test_the_error_of_an_average_change_is_by_the_delta_method() -> None:
    trials = trials_of(CASES["holes"].trials)
    frame = frame_of(successes(trials), "A", "dexpilot")
    found = logistic_slope(frame)
    design = np.column_stack([frame.factors()[0], frame.index - frame.index_mean])
    fit = fit_gee(design, frame.outcome, frame.group)

    def change(beta: np.ndarray) -> float:
        """Per step of the index, on average over the rows."""
        step = np.zeros(design.shape[1])
        step[-1] = 1e-5
        ahead, behind = (scipy.special.expit((design + s * step) @ beta) for s in (1, -1))
        return float(np.mean(ahead - behind) / 2e-5)

    assert found["ame_prob_per_unit"] == pytest.approx(change(fit.beta), rel=1e-6)
    slopes = [
        (change(fit.beta + 1e-4 * axis) - change(fit.beta - 1e-4 * axis)) / 2e-4
        for axis in np.eye(len(fit.beta))
    ]
    assert found["ame_se"] == pytest.approx(np.sqrt(slopes @ fit.robust @ slopes), rel=1e-4)


def test_spearman_is_scipys_with_ties_and_with_repeats():
    rng = np.random.default_rng(6)
    x, y = rng.integers(0, 6, 30).astype(float), rng.integers(0, 5, 30).astype(float)
    assert spearman(x, y) == pytest.approx(scipy.stats.spearmanr(x, y).statistic, abs=1e-13)
    times = rng.integers(0, 3, (5, 30)).astype(float)
    for row, found in zip(times, _weighted(x, y, times), strict=True):
        drawn = np.repeat(np.arange(30), row.astype(int))
        expected = scipy.stats.spearmanr(x[drawn], y[drawn]).statistic
        assert found == pytest.approx(expected, abs=1e-12)
    assert np.isnan(spearman(np.ones(5), np.arange(5.0)))


def test_intervals_and_p_of_a_rank_correlation_are_scipys():
    rng = np.random.default_rng(7)
    x = rng.normal(size=24)
    y = x + rng.normal(size=24)
    points = pd.DataFrame({"operator": [f"P{i // 3}" for i in range(24)], "x": x, "y": y})
    found = correlation(points, seed=0, draws=200)
    assert found["p_t"] == pytest.approx(scipy.stats.spearmanr(x, y).pvalue, rel=1e-9)
    ranks = scipy.stats.pearsonr(scipy.stats.rankdata(x), scipy.stats.rankdata(y))
    fisher = ranks.confidence_interval(0.95)
    assert tuple(found["ci_fisher"].values()) == pytest.approx((fisher.low, fisher.high), rel=1e-9)
    boot = found["ci_boot_operators"]
    assert boot["lcl"] < found["rho"] < boot["ucl"]

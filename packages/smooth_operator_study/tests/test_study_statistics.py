"""Models and corrections against closed forms, other implementations, and R's figures."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.special
import scipy.stats
from study_cases import Case, holes, simulate

from smooth_operator.errors import StudyError
from smooth_operator_study.analysis.dunnett import dunnett, holm, outside, quantile, two_sided
from smooth_operator_study.analysis.frame import frame_of, make_frame
from smooth_operator_study.analysis.gee import fit_gee, separating
from smooth_operator_study.analysis.learning import logistic_slope
from smooth_operator_study.analysis.mixed import fit_mixed
from smooth_operator_study.analysis.outcomes import analyze
from smooth_operator_study.analysis.spearman import _weighted, spearman
from smooth_operator_study.data.reading import Checked, make_trials
from smooth_operator_study.data.rows import successes

REFERENCE = json.loads(Path(__file__).with_name("study_reference.json").read_text("utf-8"))
"""Figures of geepack and emmeans for two simulated studies of ``study_cases``.

``holes`` is ``simulate(4, keep=holes)``, ``alternate`` ``simulate(5, alternate=True, spread=0,
effect=0)``. GEE to 1e-12, means and pairs on the response scale; pairs are baseline first.
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


def test_a_singular_fit_is_ordinary_regression():
    design, y, groups = balanced(0.0, seed=3)
    y = y - np.bincount(groups, y)[groups] / np.bincount(groups)[groups]  # less alike than chance
    fit = fit_mixed(design, y, {"operator": groups})
    assert fit.variances["operator"] == 0
    beta, squares, *_ = np.linalg.lstsq(design, y, rcond=None)
    np.testing.assert_allclose(fit.beta, beta, atol=1e-12)
    assert fit.residual_variance == pytest.approx(squares[0] / (len(y) - 4), rel=1e-12)
    assert fit.satterthwaite(np.eye(4)[1]) == pytest.approx(len(y) - 4, rel=1e-12)


def test_an_outcome_without_residual_is_refused():
    design, _, groups = balanced(1.0)
    with pytest.raises(StudyError, match="without any residual"):
        fit_mixed(design, design @ [1.0, 2, 3, 4] + groups, {"operator": groups})
    with pytest.raises(StudyError, match="more rows"):
        fit_mixed(design[:4], np.arange(4.0), {"operator": np.array([0, 0, 1, 1])})


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
        (3, 5, 3.29),
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

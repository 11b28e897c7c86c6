"""R's figures for one simulated study: lme4, lmerTest, geepack, emmeans, mvtnorm, to 15 digits."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import SHARED
from smooth_operator_study.analysis import analyze_study
from smooth_operator_study.data import StudyData, read_study

pytestmark = pytest.mark.shared

ORACLE = SHARED / "study_oracle"
SCOPES = ("pooled", "A", "B", "C")
OTHERS = ("geort", "hybrid", "sbr")
LMM, SE = 1e-6, 3e-6  # the oracle's own accuracy is about 1e-7
GEE = 1e-8


@pytest.fixture(scope="module")
def folder() -> Path:
    if not (ORACLE / "oracle.json").is_file():
        pytest.skip("the oracle of a simulated study is not beside this checkout")
    return ORACLE


@pytest.fixture(scope="module")
def oracle(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "oracle.json").read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def data(folder: Path) -> StudyData:
    return read_study([folder])


@pytest.fixture(scope="module")
def results(data: StudyData) -> dict[str, Any]:
    return analyze_study(data, "dexpilot").to_json()


def close(found: Any, expected: Any, rel: float = 0.0, abs_: float = 0.0) -> None:
    np.testing.assert_allclose(np.array(found, float), np.array(expected, float), rel, abs_)


def column(table: dict[str, dict[str, Any]], name: str) -> list[Any]:
    return [entry[name] for entry in table.values()]


@pytest.mark.parametrize("scope", SCOPES)
@pytest.mark.parametrize("outcome", ["time", "tlx"])
def test_mixed_models(oracle, results, outcome, scope):
    """Random intercepts of operators, as mode paper has them."""
    expected, found = oracle[outcome][scope]["REML"], results["paper"][outcome][scope]
    of = expected["asymptotic"]
    assert found["n"] == oracle[outcome][scope]["n_obs"]
    assert found["operators"] == oracle[outcome][scope]["n_groups"]
    for name, reference, columns in (
        ("coefficients", expected["coef"], {"estimate": ("est", LMM, 0), "p": ("p_z", 0, 1e-7)}),
        ("emm", of["emm"], {"estimate": ("emm", LMM, 0), "lower": ("lcl", SE, 0)}),
        (
            "dunnett",
            of["vs_dexpilot"],
            {
                "difference": ("estimate", LMM, 0),
                "p_raw": ("p_raw", 0, 1e-7),
                "p_dunnett": ("p_dunnett_exact", 0, 1e-8),
                "lower": ("simult_lcl", 1e-6, 1e-6),
                "upper": ("simult_ucl", 1e-6, 1e-6),
            },
        ),
        (
            "pairs",
            of["pairwise"],
            {"difference": ("estimate", LMM, 0), "p_holm": ("p_holm", 0, 1e-7)},
        ),
    ):
        assert list(found[name]) == list(reference)
        for mine, (theirs, rel, abs_) in ({"se": ("se", SE, 0)} | columns).items():
            close(column(found[name], mine), column(reference, theirs), rel, abs_)
    model = found["model"]
    close(model["dunnett_correlation"], of["dunnett_corr"], 1e-6)
    close(model["sd_operator"], expected["sd_operator"], 1e-5)
    close(model["sd_residual"], expected["sd_residual"], 1e-6)
    close(model["log_likelihood"], expected["loglik"], 1e-10)
    effects = model["operator_effects"]
    assert list(effects) == list(expected["ranef"])
    close(list(effects.values()), list(expected["ranef"].values()), 1e-5, 1e-6)


@pytest.mark.parametrize("scope", SCOPES)
def test_success(oracle, results, scope):
    expected = oracle["success"][scope]
    for mode, error, of in (
        ("paper", "se_robust", "emm_robust"),
        ("small-sample", "se_mancl_derouen", "emm_mancl_derouen"),
    ):
        found = results[mode]["success"][scope]
        assert found["n"] == expected["n_obs"]
        assert found["operators"] == expected["n_clusters"]
        table = found["coefficients"]
        assert list(table) == list(expected["coef"])
        close(column(table, "estimate"), column(expected["coef"], "est"), GEE)
        close(column(table, "se"), column(expected["coef"], error), GEE)
        close(found["model"]["alpha"], expected["alpha"], GEE)
        close(found["model"]["phi"], expected["phi"], GEE)
        reference = expected[of]["response"]
        close(column(found["emm"], "estimate"), column(reference["emm"], "emm"), GEE)
        close(column(found["emm"], "se"), column(reference["emm"], "se"), GEE)
        tests, against = found["dunnett"], reference["vs_dexpilot"]
        close(column(tests, "difference"), column(against, "estimate"), GEE)
        close(column(tests, "se"), column(against, "se"), GEE)
        close(found["model"]["dunnett_correlation"], reference["dunnett_corr"], GEE)
        small = mode == "small-sample"
        raw = "p_raw_t_Gm1" if small else "p_raw"
        exact = "p_dunnett_t_Gm1" if small else "p_dunnett_exact"
        close(column(tests, "p_raw"), column(against, raw), abs_=1e-9)
        close(column(tests, "p_dunnett"), column(against, exact), abs_=1e-9)
        pairs = found["pairs"]
        assert list(pairs) == list(reference["pairwise"])
        holm = "p_holm_t_Gm1" if small else "p_holm"
        close(column(pairs, "difference"), column(reference["pairwise"], "estimate"), 1e-7)
        close(column(pairs, "p_holm"), column(reference["pairwise"], holm), abs_=1e-9)
        odds, link = found["model"]["odds_ratios"], expected[of]["link"]["vs_dexpilot"]
        close(column(odds, "log_odds_ratio"), column(link, "estimate"), GEE)
        close(column(odds, "se"), column(link, "se"), GEE)
        close(column(odds, "p_dunnett"), column(link, exact), abs_=1e-9)


@pytest.mark.parametrize("scope", SCOPES)
def test_learning(oracle, results, scope):
    for index, outcomes in oracle["learning"][scope].items():
        for outcome, expected in outcomes.items():
            found = results["learning"][scope][index][outcome]
            for name, value in expected.items():
                if name == "per_retargeter":
                    for retargeter, slope in value.items():
                        own = found["per_retargeter"][retargeter]
                        close(own["slope"], slope["slope"], 1e-4, 1e-9)
                        close(own["se"], slope["se"], 1e-5)
                elif name.startswith("p_"):
                    close(found[name], value, abs_=1e-6)
                else:
                    close(found[name], value, 1e-5, 1e-9)


def test_rank_correlations(oracle, results):
    assert set(results["spearman"]) == set(oracle["spearman"])
    for pair, expected in oracle["spearman"].items():
        found = results["spearman"][pair]
        assert found["n"] == expected["n"]
        close(found["rho"], expected["rho"], abs_=1e-10)
        close(found["p_t"], expected["p_t"], abs_=1e-10)
        for end in ("lcl", "ucl"):
            close(found["ci_fisher"][end], expected["ci_fisher"][end], abs_=1e-10)
            # Both are of 4,000 random draws.
            boot = expected["ci_boot_operators"][end]
            close(found["ci_boot_operators"][end], boot, abs_=0.03)

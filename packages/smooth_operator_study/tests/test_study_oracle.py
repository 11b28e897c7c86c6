"""R's figures for one simulated study: lme4, lmerTest, geepack, emmeans, mvtnorm, to 15 digits."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nested_cases import intercepts_with_t

from conftest import SHARED
from smooth_operator_study.analysis import analyze_study
from smooth_operator_study.analysis.frame import frame_of
from smooth_operator_study.analysis.results import plain
from smooth_operator_study.data import StudyData, read_study
from smooth_operator_study.data.rows import answers

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


@pytest.fixture(scope="module")
def of_t(data: StudyData) -> dict[str, Any]:
    assert data.questionnaires is not None
    rows = data.outcomes()
    return {
        outcome: {
            scope: plain(intercepts_with_t(frame_of(rows[outcome], scope, "dexpilot")))
            for scope in SCOPES
        }
        for outcome in ("time", "tlx")
    }


def close(found: Any, expected: Any, rel: float = 0.0, abs_: float = 0.0) -> None:
    np.testing.assert_allclose(np.array(found, float), np.array(expected, float), rel, abs_)


def column(table: dict[str, dict[str, Any]], name: str) -> list[Any]:
    return [entry[name] for entry in table.values()]


@pytest.mark.parametrize("scope", SCOPES)
@pytest.mark.parametrize("outcome", ["time", "tlx"])
def test_mixed_models(oracle, results, of_t, outcome, scope):
    """Random intercepts of operators: as mode paper has them, and with Satterthwaite's t."""
    expected = oracle[outcome][scope]["REML"]
    for mode, of in (("paper", "asymptotic"), ("t", "satterthwaite")):
        found = results[mode][outcome][scope] if mode == "paper" else of_t[outcome][scope]
        assert found["n"] == oracle[outcome][scope]["n_obs"]
        assert found["operators"] == oracle[outcome][scope]["n_groups"]
        table, reference = found["coefficients"], expected["coef"]
        assert list(table) == list(reference)
        close(column(table, "estimate"), column(reference, "est"), LMM)
        close(column(table, "se"), column(reference, "se"), SE)
        p = "p_z" if mode == "paper" else "p_satterthwaite"
        close(column(table, "p"), column(reference, p), abs_=1e-7)
        means, reference = found["emm"], expected[of]["emm"]
        assert list(means) == list(reference)
        for name, other, rel in (
            ("estimate", "emm", LMM),
            ("se", "se", SE),
            ("lower", "lcl", SE),
            ("upper", "ucl", SE),
        ):
            close(column(means, name), column(reference, other), rel)
        tests, reference = found["dunnett"], expected[of]["vs_dexpilot"]
        assert tuple(tests) == OTHERS
        close(column(tests, "difference"), column(reference, "estimate"), LMM)
        close(column(tests, "se"), column(reference, "se"), SE)
        close(column(tests, "p_raw"), column(reference, "p_raw"), abs_=1e-7)
        close(column(tests, "p_dunnett"), column(reference, "p_dunnett_exact"), abs_=1e-8)
        close(found["model"]["dunnett_correlation"], expected[of]["dunnett_corr"], 1e-6)
        if mode == "paper":
            close(column(tests, "lower"), column(reference, "simult_lcl"), 1e-6, 1e-6)
            close(column(tests, "upper"), column(reference, "simult_ucl"), 1e-6, 1e-6)
        else:
            close(column(table, "df"), column(expected["coef"], "df_satterthwaite"), 1e-5)
            close(column(means, "df"), column(expected[of]["emm"], "df"), 1e-5)
            close(column(tests, "df"), column(reference, "df"), 1e-5)
        pairs, reference = found["pairs"], expected[of]["pairwise"]
        assert list(pairs) == list(reference)
        close(column(pairs, "difference"), column(reference, "estimate"), LMM)
        close(column(pairs, "se"), column(reference, "se"), SE)
        close(column(pairs, "p_holm"), column(reference, "p_holm"), abs_=1e-7)
    model = results["paper"][outcome][scope]["model"]
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


def test_single_scales_of_the_tlx(oracle, data):
    for item, expected in oracle["tlx_items"].items():
        frame = frame_of(answers(data.questionnaires, item), "pooled", "dexpilot")
        found = plain(intercepts_with_t(frame))
        close(column(found["emm"], "estimate"), column(expected["emm"], "emm"), LMM)
        close(column(found["emm"], "se"), column(expected["emm"], "se"), SE)
        against = expected["vs_dexpilot"]
        close(column(found["dunnett"], "difference"), column(against, "estimate"), LMM)
        close(found["model"]["sd_operator"], expected["sd_operator"], 1e-5)

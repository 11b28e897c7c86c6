"""Further readings of a study: their arithmetic against R, plain loops and worked examples."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from study_cases import simulate, write_rows

from smooth_operator.errors import StudyError
from smooth_operator_study.analysis import Analysis, analyze_study
from smooth_operator_study.analysis.models import clustered_wald, model_wald
from smooth_operator_study.analysis.readings import (
    Preference,
    equivalences,
    preference,
    reading_rows,
)
from smooth_operator_study.analysis.results import Pair, Refused, ScopeResult
from smooth_operator_study.analysis.spearman import correlation_within, operator_weights
from smooth_operator_study.data import read_study
from smooth_operator_study.design.protocol import Condition, Protocol, Task


def test_operators_are_drawn_whole_and_the_first_sample_is_everybody():
    weights = operator_weights(7, seed=3, draws=50)
    assert weights.shape == (51, 7)
    assert (weights[0] == 1).all()
    assert (weights.sum(axis=1) == 7).all()
    assert len(np.unique(weights, axis=0)) > 40
    np.testing.assert_array_equal(weights, operator_weights(7, seed=3, draws=50))


def pair(a: str, b: str, difference: float, se: float, df: float) -> Pair:
    return Pair(a, b, difference, se, df, difference / se, 0.5, 0.5, 0.1, "small")


def test_equivalence_is_two_one_sided_tests():
    result = ScopeResult(
        pairs={
            "base-one": pair("base", "one", -0.02, 0.04, 17.0),
            "base-two": pair("base", "two", -0.02, 0.03, 17.0),
            "one-two": pair("one", "two", 0.0, 0.2, 17.0),
        }
    )
    found = equivalences(result, "base", 0.1)
    assert list(found) == ["one-base", "two-base", "one-two"]
    one = found["one-base"]
    # qt(0.95, 17) and pt(-2, 17) of R
    assert one.difference == 0.02
    assert one.upper == pytest.approx(0.02 + 1.739606726 * 0.04)
    assert one.p == pytest.approx(0.0308693032651, rel=1e-9)
    assert one.p_holm == pytest.approx(one.p)
    assert found["two-base"].p_holm == pytest.approx(2 * found["two-base"].p)
    for test in found.values():
        inside = test.lower > -0.1 and test.upper < 0.1
        assert test.equivalent == inside == (test.smallest_margin < 0.1)
    assert found["one-two"].equivalent is False
    assert found["one-two"].p_holm is None
    without = equivalences(result, "base", None)["one-base"]
    assert (without.p, without.equivalent) == (None, None)
    assert without.smallest_margin == one.smallest_margin


def test_joint_tests_are_those_of_one_difference_where_there_is_one():
    test = clustered_wald(np.array([0.6]), np.array([[0.04]]), 12)
    assert (test.f, test.df1, test.df2) == (pytest.approx(9.0), 1, 11)
    assert test.p == pytest.approx(0.0120798394719, rel=1e-9)  # 2 * pt(-3, 11)
    same = model_wald(np.array([0.6]), np.array([[0.04]]), np.eye(1), lambda _: 11.0)
    assert (same.f, same.p) == (pytest.approx(test.f), pytest.approx(test.p))
    with pytest.raises(StudyError, match="too few"):
        clustered_wald(np.ones(5), np.eye(5), 5)


def test_rankings_are_tested():
    rankings = {f"P{i}": ("b", "a", "c") for i in range(7)}
    rankings |= {"P7": ("a", "b", "c"), "P8": ("b", "a")}
    found = preference(rankings, ("a", "b", "c"))
    assert isinstance(found, Preference)
    assert (found.operators, found.left_out) == (8, 1)
    assert found.mean_rank["a"] == pytest.approx(15 / 8)
    assert found.wins["b"] == {"a": 7, "c": 8}
    # friedman.test of R: 12 / (8 * 3 * 4) * sum((R - 16)^2) with R = 15, 9, 24
    assert found.friedman == pytest.approx(12 / 96 * (1 + 49 + 64))
    assert found.kendall_w == pytest.approx(found.friedman / 16)
    assert found.p < 0.001
    assert isinstance(preference({"P1": ("a", "b")}, ("a", "b")), Refused)


def test_two_operators_who_disagree_prefer_nothing():
    found = preference({"P1": ("a", "b"), "P2": ("b", "a")}, ("a", "b"))
    assert isinstance(found, Preference)
    assert (found.friedman, found.p, found.kendall_w) == (0, 1, 0)


@pytest.fixture(scope="module")
def analysis(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    """A study with everything that a reading can use."""
    case = simulate(2, operators=range(12), retargeters=("dexpilot", "sbr", "hybrid"))
    folder = tmp_path_factory.mktemp("study")
    files = case.write(folder)
    data = read_study(files)
    names = [f"P{i:02d}" for i in range(12)]
    plan = Protocol(
        name="x",
        conditions=tuple(Condition(name) for name in ("sbr", "dexpilot", "hybrid")),
        baseline="dexpilot",
        tasks=tuple(Task(name, trials=6, time_limit_s=60.0) for name in "ABC"),
        operators=12,
        margins={"success": 0.15, "tlx": 10.0},
    )
    ranking = dict.fromkeys(names, ("sbr", "hybrid", "dexpilot"))
    return analyze_study(replace(data, plan=plan, ranking=ranking))


def test_correlations_within_operators_leave_out_what_operators_differ_in():
    # Operators who score high have a high metric, but each ranks retargeters against it.
    rows = [
        (f"P{i}", name, 10.0 * i + j, 10.0 * i - j)
        for i in range(6)
        for j, name in enumerate("abc")
    ]
    points = pd.DataFrame(rows, columns=["operator", "retargeter", "x", "y"])
    found = correlation_within(points, seed=1, draws=500)
    assert found["rho"] == pytest.approx(-1)
    assert (found["n"], found["operators"]) == (18, 6)
    assert found["p"] == pytest.approx(2 / 64, abs=0.025)  # two of 2^6 changes of signs
    assert "refused" in correlation_within(points.assign(x=1.0), seed=1, draws=10)


def test_a_difference_that_depends_on_the_task_is_warned_of(tmp_path: Path) -> None:
    case = simulate(8, operators=range(8), retargeters=("dexpilot", "sbr"))
    rows = [
        row | {"time_s": f"{float(str(row['time_s'])) + 25:.2f}"}
        if row["time_s"] and row["task"] == "A" and row["retargeter"] == "sbr"
        else row
        for row in case.trials
    ]
    study = read_study([write_rows(tmp_path / "made_up.csv", rows)])
    small = analyze_study(study).results["small-sample"]
    assert any("depend on the task" in text for text in small["time"]["pooled"].warnings)
    assert not any("depend on the task" in text for text in small["success"]["pooled"].warnings)


def test_what_one_retargeter_leaves_is_refused_and_never_an_error(tmp_path: Path) -> None:
    """The other never succeeds, so sensitivity fits of success have one retargeter."""
    rows = [
        row | {"score": 0, "time_s": ""} if row["retargeter"] == "sbr" else row
        for row in simulate(8, operators=range(6), retargeters=("dexpilot", "sbr")).trials
    ]
    study = read_study([write_rows(tmp_path / "made_up.csv", rows)])
    readings = analyze_study(study).readings
    assert isinstance(readings.interaction["success"], Refused)
    assert readings.full_success["pooled"].separated["sbr"].rate == 0


def test_a_whole_study_has_every_reading(analysis):
    content = analysis.to_json()["readings"]
    json.dumps(content, allow_nan=False)

    def refused(entry: object) -> bool:
        if isinstance(entry, dict):
            return bool(entry.get("refused")) or any(map(refused, entry.values()))
        return False

    assert [name for name, entry in content.items() if refused(entry)] == []
    assert all(content.values())
    assert content["equivalence"]["success"]["A"]["sbr-dexpilot"]["margin"] == 0.15
    assert content["equivalence"]["time"]["A"]["sbr-dexpilot"]["margin"] is None
    assert content["preference"]["mean_rank"]["sbr"] == 1


def test_readings_agree_with_the_models_where_they_are_the_same(analysis):
    readings = analysis.readings
    trials = analysis.data.trials
    observed = readings.full_success["pooled"].observed["sbr"]["mean"]
    assert observed == np.mean(trials.score[trials.retargeter == "sbr"] == 1)


def test_the_table_of_readings_names_every_figure(analysis):
    rows = reading_rows(analysis.readings)
    assert {row["reading"] for row in rows} == set(vars(analysis.readings))
    (one,) = [
        row
        for row in rows
        if (row["reading"], row["where"], row["term"])
        == ("equivalence", "success/A", "sbr-dexpilot")
    ]
    assert one["upper"] == analysis.readings.equivalence["success"]["A"]["sbr-dexpilot"].upper

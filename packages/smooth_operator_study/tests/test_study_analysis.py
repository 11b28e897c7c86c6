"""The analysis as a whole: what it holds, and that what can't be known is refused or flagged."""

import json
import math
import random
from pathlib import Path

import pytest
from study_cases import FOUR, ITEMS, Case, Row, simulate, write_rows

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator_study.analysis import Analysis, analyze_study
from smooth_operator_study.analysis.methods_text import CITATIONS, cited, methods_paragraph
from smooth_operator_study.analysis.results import MODES, OUTCOMES
from smooth_operator_study.data import StudyData, read_study


def load(folder: Path, trials: list[Row], tlx: list[Row] | None = None) -> StudyData:
    files = [write_rows(folder / "trials.csv", trials)]
    if tlx is not None:
        files.append(write_rows(folder / "tlx.csv", tlx))
    return read_study(files)


@pytest.fixture(scope="module")
def case() -> Case:
    return simulate(2, operators=range(6))


@pytest.fixture(scope="module")
def analysis(case: Case, tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    folder = tmp_path_factory.mktemp("study")
    metrics: list[Row] = [
        {"operator": f"P{i:02d}", "retargeter": name, "quality": j + 0.1 * i, "constant": 1}
        for i in range(6)
        for j, name in enumerate(("dexpilot", "geort", "hybrid", "sbr"))
    ]
    files = [*case.write(folder), write_rows(folder / "sim_metrics.csv", metrics)]
    return analyze_study(read_study(files))


def without(rows: list[Row], **values: object) -> list[Row]:
    """Rows that do not have all of the values."""
    return [row for row in rows if any(row[key] != value for key, value in values.items())]


def altered(rows: list[Row], where: dict[str, object], **values: object) -> list[Row]:
    return [
        row | values if all(row[key] == value for key, value in where.items()) else row
        for row in rows
    ]


def failed(rows: list[Row], **where: object) -> list[Row]:
    return altered(rows, where, score=0, time_s="")


def test_the_layout_is_the_one_that_is_promised(analysis):
    content = json.loads(json.dumps(analysis.to_json(), allow_nan=False))
    names = ["dexpilot", "geort", "hybrid", "sbr"]
    for mode in MODES:
        assert set(content[mode]) == set(OUTCOMES)
        for outcome in OUTCOMES:
            assert set(content[mode][outcome]) == {"pooled", "A", "B", "C"}
            for scope, result in content[mode][outcome].items():
                assert result["refused"] is None
                assert result["n"] > 0
                tasks = ["taskB", "taskC"] if scope == "pooled" else []
                levels = [f"retargeter{name}" for name in names[1:]]
                assert list(result["coefficients"]) == ["(Intercept)", *levels, *tasks, "t"]
                assert list(result["emm"]) == names
                assert list(result["dunnett"]) == names[1:]
                assert len(result["pairs"]) == 6
                means, pair = result["emm"], result["pairs"]["geort-sbr"]
                expected = means["geort"]["estimate"] - means["sbr"]["estimate"]
                assert pair["difference"] == pytest.approx(expected)
                against = result["dunnett"]["sbr"]
                assert against["difference"] == pytest.approx(
                    -result["pairs"]["dexpilot-sbr"]["difference"]
                )
                outside = against["lower"] > 0 or against["upper"] < 0
                assert outside == (against["p_dunnett"] < 0.05)
    assert content["learning"]["pooled"]["trial_global"]["time"]["slope"] < 0
    assert "ame_prob_per_unit" in content["learning"]["A"]["trial_in_block"]["success"]
    assert analysis.data.questionnaires is not None
    questionnaires = len(analysis.data.questionnaires)
    assert content["learning"]["pooled"]["tlx_index"]["tlx"]["n"] == questionnaires
    assert content["spearman"]["quality~raw_tlx"]["rho"] > 0
    assert "constant" in content["spearman"]["constant~success"]["refused"]
    assert set(content["tlx_items"]["pooled"]) == set(ITEMS)
    assert content["study"]["baseline"] == "dexpilot"
    assert content["operator_variance"]["success"]["A"]["sbr"]["operators"] == 6


def test_modes_differ_where_they_should(analysis):
    small, paper = (analysis.results[mode] for mode in MODES)
    for outcome in OUTCOMES:
        for scope in analysis.scopes:
            a, b = small[outcome][scope], paper[outcome][scope]
            for name, mean in a.emm.items():
                # The nested model weighs blocks, the published one trials.
                same = mean.estimate == b.emm[name].estimate
                assert (
                    same if outcome == "success" else abs(mean.estimate - b.emm[name].estimate) < 2
                )
                assert math.isfinite(mean.df)
                assert math.isinf(b.emm[name].df)
                assert mean.upper - mean.lower > b.emm[name].upper - b.emm[name].lower
    assert small["success"]["A"].emm["sbr"].df == small["success"]["A"].operators - 1


def test_the_baseline_can_be_another(case, tmp_path):
    data = load(tmp_path, [row for row in case.trials if row["task"] == "A"])
    found = analyze_study(data, "sbr").results["small-sample"]["time"]["pooled"]
    assert list(found.dunnett) == ["dexpilot", "geort", "hybrid"]
    assert next(iter(found.pairs)) == "sbr-dexpilot"
    with pytest.raises(UnknownNameError, match="Did you mean 'dexpilot'"):
        analyze_study(data, "dexpilo")


def test_one_operator_or_retargeter_is_refused(case, tmp_path):
    alone = [row for row in case.trials if row["operator"] == "P00"]
    with pytest.raises(StudyError, match="one operator, P00"):
        analyze_study(load(tmp_path, alone))
    only = [row for row in case.trials if row["retargeter"] == "dexpilot"]
    with pytest.raises(StudyError, match="one retargeter, dexpilot"):
        analyze_study(load(tmp_path, only))


def test_a_task_of_one_operator_is_refused_alone(case, tmp_path):
    trials = [row for row in case.trials if row["task"] != "B" or row["operator"] == "P00"]
    found = analyze_study(load(tmp_path, trials)).results["small-sample"]
    for outcome in ("success", "time"):
        refused = found[outcome]["B"]
        assert "one operator (P00)" in (refused.refused or "")
        assert not refused.emm
        assert refused.observed["sbr"]["n"] > 0
        assert found[outcome]["A"].refused is None
    assert "no questionnaires" in (found["tlx"]["pooled"].refused or "")


def test_a_retargeter_that_never_succeeds_leaves_the_others(case, tmp_path):
    """It is one more in the family; the others' differences are nearly as if it was not there."""
    found = analyze_study(load(tmp_path, failed(case.trials, retargeter="geort")))
    others = analyze_study(load(tmp_path, without(case.trials, retargeter="geort"))).results
    for mode in MODES:
        for scope in ("pooled", "A"):
            result, other = (x[mode]["success"][scope] for x in (found.results, others))
            assert result.refused is None
            assert result.observed["geort"]["mean"] == 0
            assert 0 < result.emm["geort"].estimate < 0.03
            assert (len(result.pairs), len(other.pairs)) == (6, 3)
            for name, pair in other.pairs.items():
                assert result.pairs[name].difference == pytest.approx(pair.difference, abs=0.02)
                assert result.pairs[name].se == pytest.approx(pair.se, rel=0.15)
            assert any("geort succeeded in none of" in text for text in result.warnings)
            assert result.dunnett["geort"].p_dunnett < 0.01
        time = found.results[mode]["time"]["pooled"]
        assert "geort" not in time.emm
        assert any("no rows of geort: it is excluded" in text for text in time.warnings)
    slope = found.learning["pooled"]["trial_global"]["success"]
    assert slope["without"] == ["geort"]
    assert "refused" not in slope
    content = json.loads(json.dumps(found.to_json(), allow_nan=False))
    geort = content["small-sample"]["success"]["pooled"]["separated"]["geort"]
    assert geort["bound"] == pytest.approx(1 - 0.05 ** (1 / 6))
    assert geort["bound_if_independent"] < 0.04


def test_two_retargeters_of_which_one_never_succeeds_are_compared(case, tmp_path):
    two = [row for row in case.trials if row["retargeter"] in ("dexpilot", "sbr")]
    found = analyze_study(load(tmp_path, failed(two, retargeter="dexpilot"))).results
    result = found["small-sample"]["success"]["pooled"]
    assert result.refused is None
    assert list(result.emm) == ["dexpilot", "sbr"]
    assert list(result.separated) == ["dexpilot"]
    assert result.dunnett["sbr"].p_dunnett < 0.001
    # And where neither has both outcomes, the comparison stands, too.
    both = altered(failed(two, retargeter="dexpilot"), {"retargeter": "sbr"}, score=1, time_s="9")
    result = analyze_study(load(tmp_path, both)).results["small-sample"]["success"]["A"]
    assert result.separated["sbr"].rate == 1
    assert result.separated["sbr"].bound > 0.6
    assert 0.9 < result.dunnett["sbr"].difference < result.dunnett["sbr"].upper <= 1
    assert result.dunnett["sbr"].p_dunnett < 0.001


def test_means_of_success_stay_within_0_and_100_percent(tmp_path):
    """Near the edge, where an interval around the mean would go beyond it."""
    rows = simulate(2, operators=range(6), effect=0.1).trials
    for row in rows:
        if row["retargeter"] == "sbr" and row["trial_global"] != 3:
            row |= {"score": 1, "time_s": "9"}
    found = analyze_study(load(tmp_path, rows)).results
    beyond = 0
    for mode in MODES:
        for result in found[mode]["success"].values():
            for mean in result.emm.values():
                assert 0 < mean.lower < mean.estimate < mean.upper < 1
                beyond += mean.estimate + 1.96 * mean.se > 1
            for test in result.dunnett.values():
                assert -1 <= test.lower < test.upper <= 1
    assert beyond > 2


def test_separation_in_one_task_is_left_out_there_and_flagged_pooled(case, tmp_path):
    trials = failed(case.trials, retargeter="geort", task="B")
    found = analyze_study(load(tmp_path, trials)).results["small-sample"]["success"]
    assert list(found["B"].separated) == ["geort"]
    assert found["pooled"].refused is None
    assert not found["pooled"].separated
    assert any("geort in task B has 0 successes" in text for text in found["pooled"].warnings)


def test_separation_by_the_trial_is_found(case, tmp_path):
    """Every level has both outcomes, but the index of the trial tells them apart."""
    trials: list[Row] = []
    for row in case.trials:
        late = int(str(row["trial_global"])) > 9
        score, time = (1, "12.0") if late else (0, "")
        trials.append(row | {"score": score, "time_s": time})
    found = analyze_study(load(tmp_path, trials)).results["paper"]["success"]["A"]
    assert "separation: a combination of" in (found.refused or "")


def test_constant_outcomes_are_refused(case, tmp_path):
    trials = [row | {"score": 1, "time_s": "20"} for row in case.trials]
    tlx = [row | dict.fromkeys(ITEMS, 50) for row in case.tlx]
    found = analyze_study(load(tmp_path, trials, tlx)).results
    for mode in MODES:
        for outcome in OUTCOMES:
            assert "no difference to test" in (found[mode][outcome]["pooled"].refused or "")
            assert not found[mode][outcome]["pooled"].coefficients


def test_a_baseline_without_rows_leaves_the_pairs(case, tmp_path):
    trials = without(case.trials, retargeter="dexpilot", task="B")
    found = analyze_study(load(tmp_path, trials)).results["small-sample"]["success"]["B"]
    assert found.refused is None
    assert not found.dunnett
    assert list(found.pairs) == ["geort-hybrid", "geort-sbr", "hybrid-sbr"]
    assert any("nothing is compared with it" in text for text in found.warnings)


def test_missing_times_and_answers_are_flagged(case, tmp_path):
    won = [row for row in case.trials if row["score"] and row["task"] == "A"][:3]
    trials = [row | {"time_s": "nan"} if row in won else row for row in case.trials]
    tlx = [dict(row) for row in case.tlx]
    tlx[0]["effort"] = ""
    found = analyze_study(load(tmp_path, trials, tlx)).results["small-sample"]
    times = sum(bool(row["score"]) for row in case.trials)
    assert found["time"]["pooled"].n == times - 3
    assert "3 successful trial(s) without a time are excluded" in found["time"]["A"].warnings
    assert found["tlx"]["pooled"].n == len(case.tlx) - 1
    assert any("missing answer" in text for text in found["tlx"]["pooled"].warnings)


def test_tasks_that_tell_the_retargeter_are_refused(case, tmp_path):
    trials = [row for row in case.trials if (row["task"] == "B") == (row["retargeter"] == "sbr")]
    trials = [row for row in trials if row["task"] in "AB"]
    found = analyze_study(load(tmp_path, trials)).results["small-sample"]["success"]
    assert "taskB: not independent of the other terms" in (found["pooled"].refused or "")


def test_singular_fits_and_few_operators_are_flagged(tmp_path):
    case = simulate(5, alternate=True, spread=0.0, effect=0.0, operators=range(6))
    found = analyze_study(load(tmp_path, case.trials, case.tlx)).results["small-sample"]
    singular = [r for scopes in found.values() for r in scopes.values() if r.model.get("singular")]
    assert singular
    assert all(any("singular fit" in text for text in r.warnings) for r in singular)
    assert any("only 6 operators" in text for text in found["tlx"]["pooled"].warnings)


def test_as_many_coefficients_as_operators_is_flagged(case, tmp_path):
    few = [
        row
        for row in case.trials
        if row["operator"] in ("P00", "P01", "P02") and row["task"] == "A"
    ]
    found = analyze_study(load(tmp_path, few)).results
    for mode in MODES:
        result = found[mode]["success"]["A"]
        flagged = any("sandwich covariance is singular" in text for text in result.warnings)
        assert result.refused or flagged


@pytest.mark.parametrize(
    "seed", [2, *(pytest.param(seed, marks=pytest.mark.weekly) for seed in (1, 5))]
)
def test_damaged_studies_never_give_a_silent_number(seed, tmp_path):
    """Rows, cells and operators go at random: every figure is finite, or refused with a reason."""
    draw = random.Random(seed)
    case = simulate(seed, operators=range(draw.choice([2, 3, 5])), effect=draw.choice([0.0, 1.5]))
    trials = [row for row in case.trials if draw.random() < draw.choice([0.3, 0.9])]
    trials = without(trials, retargeter=draw.choice(["geort", "sbr"]), task=draw.choice("AB"))
    tlx = [row for row in case.tlx if draw.random() < 0.5]
    for mode, outcomes in analyze_study(load(tmp_path, trials, tlx)).results.items():
        for outcome, scopes in outcomes.items():
            for scope, result in scopes.items():
                where = f"{mode} {outcome} {scope}"
                if result.refused:
                    assert (result.emm, result.pairs, result.coefficients) == ({}, {}, {}), where
                    assert result.warnings, where
                    continue
                for family in (result.emm, result.dunnett, result.pairs, result.coefficients):
                    for entry in family.values():
                        for name, value in vars(entry).items():
                            if isinstance(value, float) and name != "df":
                                assert math.isfinite(value), f"{where} {name}"
                        assert entry.se > 0, where
                        assert entry.df > 0, where


def test_the_methods_paragraph_has_the_numbers_and_every_citation(analysis):
    text = methods_paragraph(analysis)
    assert "6 operators took part" in text
    assert "All 6 pairs" in text
    assert f"{len(analysis.data.trials)} trials" in text
    missing = {c.key for c in CITATIONS} - {c.key for c in cited(text)}
    assert {"Firth1993", "Heinze2002", "Morel2003"} < missing  # no retargeter is separated
    assert len(missing) <= 7
    assert "exact" not in text  # contrasts have degrees of freedom of their own


def test_the_methods_paragraph_claims_nothing_that_was_refused(tmp_path):
    won = [
        {**row, "score": 1, "time_s": 20 + 7919 * k % 13}
        for k, row in enumerate(simulate(3, operators=range(4), retargeters=FOUR[:2]).trials)
    ]
    text = methods_paragraph(analyze_study(load(tmp_path, won)))
    assert "Success could not be analysed (all tasks): all " in text
    assert "there is no difference to test" in text
    assert "Completion time of successful trials was analysed" in text
    for claim in ("Liang1986", "Mancl2001", "Cohen's h", "NASA-TLX", "workload"):
        assert claim not in text

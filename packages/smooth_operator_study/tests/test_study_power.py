"""Simulated power: the truth is what was asked for, verdicts are those of the analysis."""

import json
from dataclasses import replace

import numpy as np
import pytest

from smooth_operator.cli import main
from smooth_operator.errors import StudyError
from smooth_operator.simulation.tasks.task import PAPER_TASKS
from smooth_operator_study.analysis.analyze import analyze_study
from smooth_operator_study.analysis.readings import equivalences
from smooth_operator_study.analysis.results import MODES
from smooth_operator_study.design.plan import Plan, make_plan
from smooth_operator_study.design.protocol import Condition, Protocol, Task
from smooth_operator_study.power import power_run
from smooth_operator_study.power.power_run import (
    LOG,
    PowerSettings,
    Verdict,
    count,
    power_json,
    rate,
    run_power,
    verdicts,
    write_power,
)
from smooth_operator_study.power.simulated_study import (
    Simulator,
    Spread,
    assumptions_for,
    planned_data,
)

METHODS = ("sbr", "dexpilot", "geort", "hybrid")
CONDITIONS = tuple(Condition(name) for name in METHODS)
PAPER = Protocol("paper", CONDITIONS, PAPER_TASKS, "dexpilot", 18)
SMALL = Protocol("small", CONDITIONS[:3], (Task("A", trials=6), Task("B", trials=6)), "dexpilot", 8)


@pytest.fixture(scope="module")
def paper() -> Plan:
    return make_plan(PAPER)


def test_the_papers_design_has_its_numbers_of_trials(paper):
    """12 operators x 4 x 10, 8 x 4 x 10, 6 x 4 x 20, and three questionnaires a block."""
    data = planned_data(paper)
    assert (len(data.trials), data.trials.trial_global.max()) == (480 + 320 + 480, 80)
    assert (len(data.questionnaires), data.questionnaires["index"].max()) == (26 * 4 * 3, 12)


def test_simulated_studies_have_the_means_that_were_assumed(paper):
    truth = replace(assumptions_for(METHODS), practice=Spread(0.0, 0.0, 0.0))
    simulator = Simulator(paper, truth)
    draws = [simulator.draw(np.random.default_rng([9, k])) for k in range(300)]

    def mean(table: str, column: str, name: str) -> float:
        """Tasks weigh alike in the assumptions, so they do here."""
        rows = getattr(draws[0], table)
        values = np.mean([getattr(getattr(draw, table), column) for draw in draws], axis=0)
        own = rows.retargeter == name
        return float(np.mean([values[own & (rows.task == task)].mean() for task in "ABC"]))

    for name in METHODS:
        assert mean("trials", "success", name) == pytest.approx(truth.success[name], abs=0.012)
        assert mean("trials", "time", name) == pytest.approx(truth.time_s[name], abs=0.6)
        points = mean("questionnaires", "workload", name)
        assert points == pytest.approx(truth.workload[name], abs=1.0)
    assert min(draw.trials.time.min() for draw in draws) >= 2.0


def test_operators_differ_as_was_assumed(paper):
    simulator = Simulator(paper, assumptions_for(METHODS, operators=Spread(0.0, 0.0, 20.0)))
    spread = []
    for k in range(60):
        asked = simulator.draw(np.random.default_rng(k)).questionnaires
        own = (asked.task == "A") & (asked.retargeter == "dexpilot")
        codes = np.unique(asked.operator[own])
        means = [asked.workload[own & (asked.operator == code)].mean() for code in codes]
        spread.append(np.std(means, ddof=1))
    assert np.mean(spread) == pytest.approx(20.0, rel=0.15)


@pytest.mark.parametrize(("seed", "never"), [(1, None), (2, "sbr")])
def test_verdicts_are_those_of_the_analysis(seed, never):
    """Of every outcome, scope, mode and test: significant there exactly where it is here."""
    truth = assumptions_for(SMALL.condition_names, operators=Spread(0.3, 4.0, 10.0))
    study = Simulator(make_plan(SMALL), truth).draw(np.random.default_rng(seed))
    if never is not None:
        trials = study.trials.copy()
        trials.loc[trials.retargeter == never, ["score", "success"]] = 0.0, False
        study = replace(study, trials=trials)
    analysis = analyze_study(study, "dexpilot")
    compared = 0
    for verdict in verdicts(study, "dexpilot", ("pooled", "A", "B")):
        result = analysis.results[verdict.mode][verdict.outcome][verdict.scope]
        assert (verdict.refused is None) == (result.refused is None), (verdict, result.refused)
        for name, test in result.dunnett.items():
            sign = np.sign(test.difference) if test.p_dunnett <= 0.05 else 0
            assert verdict.against[name] == sign, (verdict, test)
            compared += 1
        for pair in result.pairs.values():
            sign = np.sign(pair.difference) if pair.p_holm <= 0.05 else 0
            assert verdict.pairs[pair.a, pair.b] == sign, (verdict, pair)
            compared += 1
    # Three outcomes (without times of whoever never succeeds), scopes, two modes, two families.
    assert compared == 3 * 2 * (3 * (2 + 3) - (0 if never is None else 3))
    found = [v for v in verdicts(study, "dexpilot") if any(v.against.values())]
    assert found, "nothing is significant in this study: it compares nothing"


def test_small_studies_are_refused_not_guessed():
    """Whoever always fails leaves no odds to estimate: counted as nothing found."""
    names = SMALL.condition_names
    truth = assumptions_for(names, success=dict.fromkeys(names, 0.01))
    plan = make_plan(replace(SMALL, operators=3))
    study = Simulator(plan, truth).draw(np.random.default_rng(0))
    refused = {v.outcome: v.refused for v in verdicts(study, "dexpilot")}
    assert refused["success"] is not None
    assert count(Verdict("success", "pooled", "paper", {}, {}, "none"), truth, "dexpilot") == {
        "refused": 1
    }


def test_what_a_verdict_gets_right_and_wrong():
    truth = assumptions_for(("sbr", "dexpilot", "geort"), success={"geort": 0.44, "sbr": 0.54})
    against = {"sbr": 1, "geort": -1}  # the first is true, the second is not
    pairs = {("dexpilot", "geort"): 0, ("dexpilot", "sbr"): -1, ("geort", "sbr"): 1}
    counts = count(Verdict("success", "pooled", "paper", against, pairs), truth, "dexpilot")
    assert counts == {
        "dunnett:sbr": 1,
        "dunnett:all": 1,
        "family:dunnett": 1,
        "holm:dexpilot-sbr": 1,
        "family:holm": 1,
    }
    null = truth.null("dexpilot")
    assert set(null.success.values()) == {0.44}
    assert count(Verdict("success", "pooled", "paper", against, {}), null, "dexpilot") == {
        "family:dunnett": 1
    }


def test_equivalence_is_what_two_one_sided_tests_say():
    """Counted where the 90 % interval lies within the margin, as the reading of a study has it."""
    truth = assumptions_for(SMALL.condition_names)
    study = Simulator(make_plan(SMALL), truth).draw(np.random.default_rng(3))
    analysis = analyze_study(study, "dexpilot")
    for verdict in verdicts(study, "dexpilot"):
        result = analysis.results[verdict.mode][verdict.outcome]["pooled"]
        for name, smallest in verdict.smallest_margin.items():
            one = equivalences(result, "dexpilot", None)[f"{name}-dexpilot"]
            assert smallest == pytest.approx(one.smallest_margin, rel=1e-6)
    wide = count(verdict, truth, "dexpilot", {"tlx": 1.01 * smallest})
    narrow = count(verdict, truth, "dexpilot", {"tlx": 0.99 * smallest})
    assert f"equivalent:{name}" in wide
    assert f"equivalent:{name}" not in narrow


def test_monte_carlo_errors():
    half = rate(500, 1000)
    assert half.se == pytest.approx(0.0158, abs=1e-4)
    assert (half.lower, half.upper) == pytest.approx((0.469, 0.531), abs=1e-3)
    assert rate(0, 1000).lower == 0.0
    assert rate(0, 1000).upper == pytest.approx(0.0038, abs=1e-4)  # not zero


def test_any_number_of_workers_and_any_interruption_give_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(power_run, "_CHUNK", 2)
    truth = assumptions_for(SMALL.condition_names)
    settings = PowerSettings(SMALL, truth, (4,), studies=4)
    folders = [tmp_path / name for name in ("alone", "many", "broken")]
    for folder in folders:
        folder.mkdir()
    alone = run_power(settings, folders[0], workers=0)
    many = run_power(settings, folders[1], workers=1)
    assert power_json(settings, alone) == power_json(settings, many)
    # A run that was killed in the middle of a line, after one chunk of four.
    lines = (folders[0] / LOG).read_text().splitlines(keepends=True)
    assert len(lines) == 4
    (folders[2] / LOG).write_text(lines[0] + lines[1][:40])
    told: list[tuple[int, int]] = []
    resumed = run_power(settings, folders[2], workers=0, report=lambda *n: told.append(n))
    assert told[0] == (2, 8)
    assert told[-1] == (8, 8)
    assert power_json(settings, resumed) == power_json(settings, alone)
    # More studies only add to what is there.
    told.clear()
    more = replace(settings, studies=5)
    run_power(more, folders[2], workers=0, report=lambda *n: told.append(n))
    assert told[0] == (8, 10)
    # Another truth shares nothing.
    told.clear()
    other = replace(settings, truth=replace(truth, scales=4.0), studies=2)
    run_power(other, folders[2], workers=0, report=lambda *n: told.append(n))
    assert told[0] == (0, 4)
    files = write_power(settings, alone, tmp_path)
    assert files[1].read_bytes().startswith(b"\x89PNG")
    cells = json.loads(files[0].read_text())["cells"]
    assert len(cells) == 2 * 3 * len(MODES)
    assert {cell["studies"] for cell in cells} == {4}


@pytest.mark.weekly
def test_honest_tests_err_less_and_find_less(tmp_path):
    """Of 30 studies of the paper's design each: the gap that many more show is seen already."""
    settings = PowerSettings(PAPER, assumptions_for(METHODS), (18,), studies=30, seed=4)
    tallies = run_power(settings, tmp_path)
    cells = {
        (c["truth"], c["outcome"], c["mode"]): c for c in power_json(settings, tallies)["cells"]
    }
    power = {
        mode: cells["effects", "success", mode]["power"]["dunnett"]["sbr"]["rate"] for mode in MODES
    }
    error = {mode: cells["null", "success", mode]["family_error"]["dunnett"] for mode in MODES}
    assert 0.25 < power["small-sample"] < power["paper"] < 0.90
    assert error["small-sample"]["lower"] < 0.06
    assert error["small-sample"]["rate"] <= error["paper"]["rate"]
    # People have preferences by default, which mode paper takes for differences of workload.
    workload = [cells["null", "tlx", mode] for mode in MODES]
    assert [cell["errs"] for cell in workload] == [False, True]
    assert workload[1]["family_error"]["dunnett"]["rate"] > 0.15
    assert cells["effects", "tlx", "small-sample"]["power"]["dunnett"]["geort"]["rate"] == 1.0
    assert cells["null", "tlx", "small-sample"]["power"]["dunnett"] == {}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--operators", "2"], "of at least 3"),
        (["--success", "sbr=1.5"], "probability from 0.005 to 0.995"),
        (["--success", "ako=0.5"], "set for 'ako'"),
        (["--time", "sbr"], "NAME=NUMBER"),
        (["--studies", "0"], "one simulated study"),
        (["--operators", "6", "6"], "occurs twice"),
    ],
)
def test_study_power_refuses(tmp_path, arguments, says, capsys):
    assert main(["study", "power", "--output", str(tmp_path / "out"), *arguments]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_study_power_of_a_plan(tmp_path, capsys):
    folder = str(tmp_path / "mine")
    design = "--conditions dexpilot mine --tasks T:6 --operators 6"
    assert main(["study", "new", folder, *design.split()]) == 0
    arguments = ["study", "power", folder, "--studies", "2", "--operators", "6", "--workers", "0"]
    assert main(arguments) == 2
    assert "the expected success of mine is missing" in capsys.readouterr().err
    assumed = ["--success", "mine=0.8", "--time", "mine=20", "--workload", "mine=30"]
    assert main([*arguments, *assumed]) == 0
    printed = capsys.readouterr().out
    assert "family-wise" in printed
    assert "equivalent to" not in printed  # no margins
    plan = tmp_path / "mine" / "study.toml"
    plan.write_text(plan.read_text(encoding="utf-8") + "\n[margins]\ntlx = 60\n", encoding="utf-8")
    assert main([*arguments, *assumed]) == 0
    assert "100 / 100" in capsys.readouterr().out
    assert (tmp_path / "mine/power/power.json").is_file()


def test_assumptions_that_can_not_be():
    with pytest.raises(StudyError, match="can't be negative"):
        assumptions_for(METHODS, operators=Spread(-1.0, 0.0, 0.0))

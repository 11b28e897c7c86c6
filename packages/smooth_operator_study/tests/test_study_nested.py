"""Nested random intercepts of time and workload, against R and against whole matrices."""

import csv
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_cases import ITEMS, POINTS, Row, holes, simulate

from smooth_operator_study.analysis.frame import Frame, make_frame
from smooth_operator_study.analysis.gee import mancl_derouen
from smooth_operator_study.analysis.learning import linear_slope
from smooth_operator_study.analysis.mixed import fit_mixed
from smooth_operator_study.analysis.outcomes import analyze

SCRIPT = Path(__file__).with_name("study_nested.R")
REFERENCE = Path(__file__).with_name("study_nested.json")


def nested_rows() -> dict[str, list[Row]]:
    """``CASE OUTCOME SCOPE`` -> rows with y, retargeter, task, operator and index."""
    cases = {
        "own": simulate(21, own=0.5),
        "own holes": simulate(22, own=0.4, keep=holes),
        "singular": simulate(5, alternate=True, spread=0.0, effect=0.0),
        "few": simulate(24, own=0.3, operators=range(5), retargeters=("dexpilot", "sbr")),
    }
    found = {}
    for name, case in cases.items():
        for scope in ("pooled", "A"):
            time = [_row(row, row["time_s"], row["trial_global"]) for row in case.trials]
            tlx = [
                _row(row, sum(float(str(row[item])) for item in ITEMS) / 6, _asked(row))
                for row in case.tlx
            ]
            for outcome, rows in (("time", time), ("tlx", tlx)):
                found[f"{name} {outcome} {scope}"] = [
                    row for row in rows if row["y"] != "" and scope in ("pooled", row["task"])
                ]
    return found


def _asked(row: Row) -> int:
    return 3 * (int(str(row["block"])) - 1) + POINTS.index(str(row["point"])) + 1


def _row(row: Row, y: object, index: object) -> Row:
    return {"y": y, "index": index} | {k: row[k] for k in ("retargeter", "task", "operator")}


def ask_r(rows: dict[str, list[Row]], folder: Path) -> dict[str, Any]:
    """What R says, by the same names.

    Raises:
        subprocess.CalledProcessError: R can't do it; its words are in ``stderr``.
    """
    names = {}
    for number, (name, table) in enumerate(rows.items()):
        path = folder / f"{number}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(table[0]))
            writer.writeheader()
            writer.writerows(table)
        names[str(path)] = name
    done = subprocess.run(
        ["Rscript", str(SCRIPT), *names], capture_output=True, text=True, check=True
    )
    return {names[path]: values for path, values in json.loads(done.stdout).items()}


def frame_of(rows: list[Row]) -> Frame:
    """The rows as the analysis has them."""
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return make_frame(
        columns["y"].astype(float),
        columns["retargeter"],
        columns["task"],
        columns["operator"],
        columns["index"].astype(float),
        "dexpilot",
    )


CASES = nested_rows()
EXPECTED = json.loads(REFERENCE.read_text(encoding="utf-8"))


def check(rows: list[Row], expected: dict[str, Any]) -> None:
    found = analyze("time", frame_of(rows), limits=False, modes=("small-sample",))["small-sample"]
    assert list(found.coefficients) == expected["names"]
    of, means, pairs = (list(x.values()) for x in (found.coefficients, found.emm, found.pairs))
    for name, values, rel in (
        ("estimate", [c.estimate for c in of], 1e-6),
        ("se", [c.se for c in of], 1e-6),
        ("df", [c.df for c in of], 1e-5),
        ("emm", [m.estimate for m in means], 1e-6),
        ("emm_se", [m.se for m in means], 1e-6),
        ("emm_df", [m.df for m in means], 1e-5),
        ("pair", [p.difference for p in pairs], 1e-6),
        ("pair_se", [p.se for p in pairs], 1e-6),
        ("pair_df", [p.df for p in pairs], 1e-5),
    ):
        wanted = np.atleast_1d(expected[name])
        np.testing.assert_allclose(values, wanted, rtol=rel, atol=1e-9, err_msg=name)
    assert found.model["log_likelihood"] == pytest.approx(expected["log_likelihood"], abs=1e-8)
    names = {"operator:retargeter:task": "block", "Residual": "residual"}
    variances = {names.get(k, k): v for k, v in expected["variances"].items()}
    assert found.model["variances"] == pytest.approx(variances, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("name", list(EXPECTED))
def test_nested_intercepts_are_as_r_has_them(name):
    check(CASES[name], EXPECTED[name])


def test_r_itself_says_so(tmp_path):
    if shutil.which("Rscript") is None:
        pytest.skip("R is not installed")
    cases = {name: CASES[name] for name in ("own time pooled", "singular time pooled")}
    try:
        found = ask_r(cases, tmp_path)
    except subprocess.CalledProcessError as error:
        if "there is no package called" in error.stderr:
            pytest.skip(f"R lacks a package: {error.stderr.splitlines()[0]}")
        raise
    for name, expected in found.items():
        check(cases[name], expected)


def test_some_of_the_cases_are_singular():
    """Or the tests above would say nothing on boundaries."""
    zero = [
        level
        for case in EXPECTED.values()
        for level, variance in case["variances"].items()
        if variance < 1e-9
    ]
    assert {"operator", "operator:retargeter", "operator:retargeter:task"} <= set(zero)


def test_levels_that_can_not_be_told_apart_are_left_out():
    """One task for each operator: a block is an operator with one retargeter."""
    frame = frame_of(CASES["own time A"])
    levels = {**frame.levels, "block": frame.levels["operator:retargeter"]}
    fit = fit_mixed(frame.design()[0], frame.outcome, levels)
    assert fit.levels == ("operator", "operator:retargeter")
    # One row for each: what is left over is the residual.
    alone = {**frame.levels, "rows": np.arange(len(frame))}
    assert fit_mixed(frame.design()[0], frame.outcome, alone).levels == fit.levels


def test_operators_that_differ_hugely_change_nothing_within_them():
    frame = frame_of(CASES["own time A"])
    design = frame.design()[0]
    near = fit_mixed(design, frame.outcome, frame.levels)
    far = fit_mixed(design, frame.outcome + 1e4 * frame.group, frame.levels)
    again = fit_mixed(design, frame.outcome + 2e4 * frame.group, frame.levels)
    assert far.variances["operator"] > 1e8
    np.testing.assert_allclose(far.beta[1:4], again.beta[1:4], rtol=1e-5)
    contrast = np.eye(design.shape[1])[1]
    assert far.satterthwaite(contrast) == pytest.approx(again.satterthwaite(contrast), rel=1e-5)
    # Operators who differ little tell something of the difference, too: 32.91 and 32.71.
    assert far.satterthwaite(contrast) == pytest.approx(near.satterthwaite(contrast), rel=0.01)


def test_what_suits_operators_is_said_with_its_size():
    found = analyze("time", frame_of(CASES["own time pooled"]), limits=False)
    text = "operators differ in the retargeter that suits them: SD 2.4 s of operator by retargeter"
    assert any(said.startswith(text) for said in found["small-sample"].warnings)
    assert "trials of one block as independent" in found["paper"].warnings[-1]
    assert (
        found["small-sample"]
        .model["formula"]
        .endswith("+ (1 | operator) + (1 | operator:retargeter) + (1 | operator:retargeter:task)")
    )
    assert found["paper"].model["formula"].endswith("+ t + (1 | operator)")
    # The error that a difference is given is that of operators who differ in it.
    small, paper = (found[mode].dunnett["sbr"] for mode in ("small-sample", "paper"))
    assert small.se > 1.3 * paper.se
    calm = analyze("tlx", frame_of(CASES["singular tlx A"]), limits=False)
    assert not any("suits them" in said for said in calm["small-sample"].warnings)


def test_the_robust_covariance_is_what_whole_matrices_say():
    frame = frame_of(CASES["own time pooled"])
    design = frame.design()[0]
    fit = fit_mixed(design, frame.outcome, {"operator": frame.group})
    left = frame.outcome - design @ fit.beta
    found = mancl_derouen(design, left, frame.group, fit.ratios[0])
    bread, parts = np.zeros((design.shape[1],) * 2), []
    for k in range(len(frame.operators)):
        rows = frame.group == k
        weight = np.linalg.inv(np.eye(rows.sum()) + fit.ratios[0])
        parts.append((design[rows], weight, left[rows]))
        bread += design[rows].T @ weight @ design[rows]
    inverse = np.linalg.inv(bread)
    expected = np.zeros_like(bread)
    for x, w, r in parts:
        score = x.T @ w @ np.linalg.solve(np.eye(len(r)) - x @ inverse @ x.T @ w, r)
        expected += np.outer(inverse @ score, inverse @ score)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-12)
    alone = np.column_stack([np.ones(len(left)), frame.group == 0]).astype(float)
    assert mancl_derouen(alone, left, frame.group, 0.1) is None


def test_operators_who_learn_at_different_rates_make_no_slope_of_all():
    """One gets quicker, the next slower: a model without random slopes finds one all the same."""
    found = []
    for seed in range(40):
        draw = np.random.default_rng(seed)
        index = np.tile(np.arange(1.0, 25.0), 8)
        operator = np.repeat(np.arange(8), 24)
        name = np.where((index.astype(int) + operator) % 2, "dexpilot", "sbr")
        slopes = 0.3 * draw.normal(size=8)
        y = 20 + slopes[operator] * (index - 12.5) + 2 * draw.normal(size=len(index))
        code = np.array([f"P{k}" for k in operator])
        frame = make_frame(y, name, np.full(len(y), "A"), code, index, "dexpilot")
        slope = linear_slope(frame)
        found.append((slope["p_satterthwaite"] < 0.05, slope["p_t"] < 0.05))
        assert slope["df"] == 7.0
    assert sum(one for one, _ in found) > 15
    assert sum(one for _, one in found) < 6

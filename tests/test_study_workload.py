"""Raw and weighted NASA-TLX, from the operator's choices to the analysis."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_cases import simulate, write_rows
from study_writers import small_plan
from test_study_store import walk

from smooth_operator.cli import main
from smooth_operator.errors import StudyError
from smooth_operator.study.data import ITEMS, read_study
from smooth_operator.study.data.checked_tables import WEIGHT_COLUMNS
from smooth_operator.study.data.reading import with_workload
from smooth_operator.study.store.export import export_study
from smooth_operator.study.store.study_store import open_study

RATINGS = dict(zip(ITEMS, (80, 10, 60, 30, 70, 20), strict=True))
WEIGHTS = dict(zip(WEIGHT_COLUMNS, (5, 0, 4, 1, 3, 2), strict=True))
WEIGHTED = (5 * 80 + 0 * 10 + 4 * 60 + 1 * 30 + 3 * 70 + 2 * 20) / 15  # by hand: 61.33
RAW = (80 + 10 + 60 + 30 + 70 + 20) / 6  # 45


def written(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    trials = simulate(1, operators=range(3)).trials
    return [write_rows(folder / "trials.csv", trials), write_rows(folder / "tlx.csv", rows)]


def rows(**changes: Any) -> list[dict[str, Any]]:
    found = [dict(row) for row in simulate(1, operators=range(3)).tlx]
    return [{**row, **RATINGS, **WEIGHTS, **changes} for row in found]


def test_a_weighted_mean_is_what_one_works_out_by_hand(tmp_path: Path) -> None:
    data = read_study(written(tmp_path, rows()))
    assert data.questionnaires is not None
    np.testing.assert_allclose(data.questionnaires.workload, RAW)
    weighted = with_workload(data, "weighted").questionnaires
    assert weighted is not None
    np.testing.assert_allclose(weighted.workload, WEIGHTED)
    assert with_workload(data, "raw").questionnaires is not None
    one_left_out = rows()
    one_left_out[0]["physical"] = ""  # it would count nothing, but was not answered
    weighted = with_workload(read_study(written(tmp_path, one_left_out)), "weighted").questionnaires
    assert weighted is not None
    assert list(np.isnan(weighted.workload[:2])) == [True, False]


def test_without_the_pairs_there_is_no_weighted_workload(tmp_path: Path) -> None:
    some = rows()
    for row in some[:3]:
        row.update(dict.fromkeys(WEIGHT_COLUMNS, ""))
    data = read_study(written(tmp_path, some))
    first = some[0]
    where = f"operator {first['operator']}, task {first['task']}, block {first['block']}"
    with pytest.raises(StudyError, match=f"missing in 1: {where}. Analyse the raw workload"):
        with_workload(data, "weighted")
    assert with_workload(data, "raw").questionnaires is not None
    plain = simulate(1, operators=range(3))
    with pytest.raises(StudyError, match=r"missing in 2\d: .*; and \d+ more"):
        with_workload(read_study(plain.write(tmp_path / "plain")), "weighted")
    trials_only = read_study([tmp_path / "plain" / "trials.csv"])
    with pytest.raises(StudyError, match="needs questionnaires"):
        with_workload(trials_only, "weighted")
    assert with_workload(trials_only, "raw") is trials_only


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"weight_effort": 6}, "column weight_effort: expected 0 to 5, whole, or nothing"),
        ({"weight_effort": 2.5}, "column weight_effort: expected 0 to 5, whole, or nothing"),
        (
            {"weight_effort": 2},
            "expected weights that are 15 together, as of 15 pairs; they are 14",
        ),
        ({"weight_effort": ""}, "column weight_effort: the other weights are there"),
    ],
)
def test_weights_are_checked_by_row_and_column(
    tmp_path: Path, changes: dict[str, Any], expected: str
) -> None:
    table = rows()
    table[2].update(changes)
    with pytest.raises(StudyError) as caught:
        read_study(written(tmp_path, table))
    assert "row 4" in str(caught.value)
    assert expected in str(caught.value)


def test_half_of_the_columns_is_refused(tmp_path: Path) -> None:
    table = [{k: v for k, v in row.items() if k != "weight_mental"} for row in rows()]
    with pytest.raises(StudyError, match="or none; missing: weight_mental"):
        read_study(written(tmp_path, table))


def test_choices_come_from_the_store_to_the_analysis(tmp_path: Path) -> None:
    plan = small_plan(2)
    with open_study(tmp_path / "study", plan) as store:
        for operator in plan.codes:
            walk(store, operator, seed=int(operator[1:]))
        export_study(store, tmp_path / "out")
        progress = store.progress("P01")
    asked = progress.questionnaires[0]
    winners = progress.winners[asked.block.task.name, asked.block.number]
    by_hand = sum(asked.ratings[winner] for winner in winners) / 15
    with (tmp_path / "out" / "tlx.csv").open(encoding="utf-8") as file:
        row = next(csv.DictReader(file))
    assert row["operator"] == "P01"
    assert float(row["weighted_workload"]) == pytest.approx(by_hand)
    assert sum(int(row[column]) for column in WEIGHT_COLUMNS) == 15
    for path in (tmp_path / "out", tmp_path / "out" / "study.json"):
        found = with_workload(read_study([path]), "weighted").questionnaires
        assert found is not None
        assert found.workload[0] == pytest.approx(by_hand)
    everything = json.loads((tmp_path / "out" / "study.json").read_text(encoding="utf-8"))
    told = [entry["weighted_workload"] for entry in everything["questionnaires"]]
    np.testing.assert_allclose(found.workload, told)


def test_a_study_without_pairs_has_no_such_columns(tmp_path: Path) -> None:
    plan = small_plan(1, weights=False)
    with open_study(tmp_path / "study", plan) as store:
        walk(store, "P01")
        export_study(store, tmp_path / "out")
    header = (tmp_path / "out" / "tlx.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.endswith("effort,frustration")
    entry = json.loads((tmp_path / "out/study.json").read_text(encoding="utf-8"))["questionnaires"]
    assert entry[0]["weight_mental"] is None
    data = read_study([tmp_path / "out" / "study.json"])
    with pytest.raises(StudyError, match="missing in"):
        with_workload(data, "weighted")


def test_the_command_analyses_the_one_that_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = simulate(3, operators=range(6))
    for i, row in enumerate(case.tlx):  # those whose effort counts most, and those of frustration
        counts = (0, 1, 2, 3, 5, 4) if i % 2 else (4, 1, 2, 3, 0, 5)
        row.update(zip(WEIGHT_COLUMNS, counts, strict=True))
    files = [str(path) for path in case.write(tmp_path)]
    means = {}
    for kind in ("raw", "weighted"):
        out = tmp_path / kind
        words = ["--workload", kind] if kind == "weighted" else []
        main(["study", "analyze", *files, "--output", str(out), "--no-report", *words])
        content = json.loads((out / "results.json").read_text(encoding="utf-8"))
        assert content["study"]["workload"] == kind
        means[kind] = content["small-sample"]["tlx"]["pooled"]["emm"]["sbr"]["estimate"]
        assert f"{kind} TLX, pooled" in capsys.readouterr().out
        text = (out / "methods.txt").read_text(encoding="utf-8")
        assert ("unweighted mean" in text) == (kind == "raw")
    assert abs(means["raw"] - means["weighted"]) > 1e-3
    for row in case.tlx[:3]:
        row.update(dict.fromkeys(WEIGHT_COLUMNS, ""))
    case.write(tmp_path)
    words = ["--output", str(tmp_path / "no"), "--workload", "weighted"]
    assert main(["study", "analyze", *files, *words]) == 2
    assert "missing in 1: operator" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()

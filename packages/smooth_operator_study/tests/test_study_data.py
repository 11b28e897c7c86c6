"""Tables of a study: read whatever is well-formed, and say by row and column what is not."""

import json
from typing import Any

import numpy as np
import pytest
from study_cases import Case, simulate, write_rows

from smooth_operator.errors import StudyError
from smooth_operator_study.data import read_study
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES


@pytest.fixture(scope="module")
def case() -> Case:
    return simulate(1, operators=range(3))


def changed(case: Case, row: int, **values: Any) -> list[dict[str, object]]:
    rows = [dict(entry) for entry in case.trials]
    rows[row - 2] |= values  # row 1 is the header
    return rows


def test_tables_are_told_by_their_columns(case, tmp_path):
    trials, tlx = case.write(tmp_path)
    trials = trials.rename(tmp_path / "a.csv")
    tlx = tlx.rename(tmp_path / "b.csv")
    data = read_study([tlx, trials])
    assert len(data.trials) == len(case.trials)
    assert len(data.questionnaires) == len(case.tlx)
    assert data.notes == ()
    assert data.questionnaires["index"].max() == 12
    first = data.questionnaires.loc[0, [*SCALE_NAMES]]
    assert data.questionnaires.workload[0] == pytest.approx(first.mean())


def test_a_folder_and_json_hold_the_same(case, tmp_path):
    case.write(tmp_path)
    write_rows(
        tmp_path / "sim_metrics.csv",
        [
            {"operator": f"P{i:02d}", "retargeter": name, "jitter": i + len(name)}
            for i in range(3)
            for name in ("dexpilot", "sbr")
        ],
    )
    folder = read_study([tmp_path])
    assert folder.metrics is not None
    assert [*folder.metrics] == ["operator", "retargeter", "jitter"]
    content = {
        "trials": [
            {**row, "time_s": float(str(row["time_s"])) if row["time_s"] else None}
            for row in case.trials
        ],
        "questionnaires": case.tlx,
    }
    file = tmp_path / "study.json"
    file.write_text(json.dumps(content), encoding="utf-8")
    same = read_study([file])
    np.testing.assert_array_equal(same.trials.time, folder.trials.time)
    np.testing.assert_array_equal(same.trials.score, folder.trials.score)
    assert same.sources == ("study.json",)


def test_semicolons_and_a_byte_order_mark_are_read(case, tmp_path):
    trials, _ = case.write(tmp_path)
    text = trials.read_text(encoding="utf-8").replace(",", ";")
    trials.write_text("\ufeff" + text, encoding="utf-8")
    assert len(read_study([trials]).trials) == len(case.trials)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"score": 0.7}, "row 5, column score: expected 0, 0.5 or 1, not '0.7'"),
        ({"score": ""}, "row 5, column score: expected 0, 0.5 or 1; the field is empty"),
        ({"score": "nan"}, "row 5, column score"),
        ({"time_s": -3}, "row 5, column time_s: expected a time in seconds above 0"),
        ({"time_s": "inf"}, "row 5, column time_s"),
        ({"time_s": "12,5"}, "row 5, column time_s"),
        ({"block": 1.5}, "row 5, column block: expected a whole number of at least 1, not '1.5'"),
        ({"trial_global": 0}, "row 5, column trial_global"),
        ({"operator": " "}, "row 5, column operator: expected a name; the field is empty"),
        (
            {"trial_in_block": 1},
            "the same operator P00, task A, block 1, trial_in_block 1 as row 2",
        ),
    ],
)
def test_a_bad_value_is_named_by_row_and_column(case, tmp_path, values, expected):
    file = write_rows(tmp_path / "trials.csv", changed(case, 5, **values))
    with pytest.raises(StudyError, match=r"trials\.csv can't be used") as caught:
        read_study([file])
    assert expected in str(caught.value)


def test_all_bad_values_are_told_at_once(case, tmp_path):
    rows = changed(case, 5, score=2, block="x")
    for row in rows[10:40]:
        row["score"] = 9
    with pytest.raises(StudyError) as caught:
        read_study([write_rows(tmp_path / "trials.csv", rows)])
    assert "and 24 more" in str(caught.value)  # of 32, eight are shown


def test_names_that_differ_in_case_are_no_two_retargeters(case, tmp_path):
    rows = changed(case, 7, retargeter=str(case.trials[5]["retargeter"]).upper())
    with pytest.raises(StudyError, match="differ only in case"):
        read_study([write_rows(tmp_path / "trials.csv", rows)])


def test_missing_columns_rows_and_files_are_named(case, tmp_path):
    rows = [{k: v for k, v in row.items() if k != "score"} for row in case.trials]
    file = write_rows(tmp_path / "t.csv", rows)
    with pytest.raises(StudyError, match="no column 'score'"):
        read_study([file])
    lines = case.write(tmp_path / "cut")[0]
    lines.write_text(lines.read_text("utf-8") + "P09,A\n", encoding="utf-8")
    with pytest.raises(StudyError, match="expected 8 fields as in the header, not 2"):
        read_study([lines])
    header = write_rows(tmp_path / "x.csv", [{"a": 1, "b": 2}])
    with pytest.raises(StudyError, match="is not a table of a study"):
        read_study([header])
    with pytest.raises(StudyError, match="no such file"):
        read_study([tmp_path / "nowhere.csv"])
    with pytest.raises(StudyError, match="contains no study"):
        read_study([tmp_path])
    _, tlx = case.write(tmp_path / "only")
    with pytest.raises(StudyError, match=r"no trials in tlx\.csv"):
        read_study([tlx])
    trials, _ = case.write(tmp_path / "both")
    with pytest.raises(StudyError, match="both contain trials"):
        read_study([trials, trials])
    bad = tmp_path / "bad.json"
    bad.write_text('{"trials": [}', encoding="utf-8")
    with pytest.raises(StudyError, match=r"not readable as JSON: .* line 1"):
        read_study([bad])
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(StudyError, match="not text in UTF-8"):
        read_study([tmp_path / "picture.csv"])


def test_questionnaires_are_checked_too(case, tmp_path):
    trials, _ = case.write(tmp_path)
    for values, expected in (
        ({"effort": 101}, "column effort: expected 0 to 100"),
        ({"point": "end"}, "column point: expected initial, midpoint, final, not 'end'"),
        ({"point": case.tlx[1]["point"]}, "the same operator"),
    ):
        rows = [dict(row) for row in case.tlx]
        rows[0] |= values
        with pytest.raises(StudyError) as caught:
            read_study([trials, write_rows(tmp_path / "tlx.csv", rows)])
        assert expected in str(caught.value)


def test_what_is_odd_but_usable_is_noted(case, tmp_path):
    rows = [dict(row) for row in case.trials]
    won = [i for i, row in enumerate(rows) if row["score"] != 0]
    rows[won[0]]["time_s"] = "NaN"
    rows[won[1]]["time_s"] = ""
    tlx = [dict(row) for row in case.tlx]
    tlx[4]["effort"] = ""
    tlx[5]["operator"] = "P77"
    data = read_study(
        [write_rows(tmp_path / "trials.csv", rows), write_rows(tmp_path / "tlx.csv", tlx)]
    )
    notes = "\n".join(data.notes)
    assert "2 successful trials have no time_s" in notes
    assert f"row {won[0] + 2}, {won[1] + 2}" in notes
    assert "1 of" in notes
    assert "P77 not in trials.csv" in notes
    assert np.isnan(data.trials.time[won[0]])

"""CSV that a spreadsheet shows and never runs, and that reads back as it was."""

import csv
import io
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import smooth_hand_datasets
import smooth_operator
import smooth_operator_benchmark
import smooth_operator_devices
import smooth_operator_study
from smooth_operator.formats.csv_table import csv_text, plain_cell

FORMULAS = (
    '=HYPERLINK("http://elsewhere.example","click")',
    "-1+cmd|' /C calc'!A0",
    "+1+1",
    "@SUM(A1)",
    "＝1+1",
    "'=1+1",
)
SAFE = re.compile(r"[^=+\-@\t\r\n＝＋－＠]|[+-]?[\d.]+(e[+-]?\d+)?$|$")


def cells(text: str) -> list[list[str]]:
    return list(csv.reader(io.StringIO(text, newline="")))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.one_of(st.text(), st.sampled_from(FORMULAS)), min_size=1, max_size=3))
def test_any_text_reads_back_and_none_is_a_formula(values):
    columns = [f"c{k}" for k in range(len(values))] + ["last"]
    text = csv_text(columns, [dict(zip(columns, [*values, "end"], strict=True))])
    header, row = cells(text)
    assert header == columns
    assert [plain_cell(cell) for cell in row] == [*values, "end"]
    assert all(SAFE.match(cell) for cell in row)


def test_numbers_stay_numbers():
    values = {"a": -1.5, "b": 3, "c": "-2.5e-07", "d": None, "e": float("-inf")}
    assert cells(csv_text(list(values), [values]))[1] == ["-1.5", "3", "-2.5e-07", "", "-inf"]


def test_headers_are_cells_too():
    assert cells(csv_text(["=1+1"], []))[0] == ["'=1+1"]


@pytest.mark.parametrize(
    "package",
    [
        smooth_operator,
        smooth_hand_datasets,
        smooth_operator_benchmark,
        smooth_operator_study,
        smooth_operator_devices,
    ],
)
def test_there_is_one_writer(package):
    root = Path(package.__file__).parent
    writing = re.compile(r"csv\.(writer|DictWriter)|from csv import|to_csv|savetxt")
    files = [file.name for file in root.rglob("*.py") if writing.search(file.read_text("utf-8"))]
    assert files == []


@pytest.mark.parametrize("text", ["'quoted'", "it's", "", "'", "plain"])
def test_other_apostrophes_stay(text):
    assert plain_cell(text) == text

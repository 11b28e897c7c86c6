"""Tables of an analysis, in a spreadsheet."""

from study_cases import simulate
from test_csv_table import FORMULAS, SAFE, cells

from smooth_operator.cli import main
from smooth_operator.formats.csv_table import csv_text, plain_cell
from smooth_operator_study.data import read_study


def test_no_table_of_an_analysis_holds_a_formula(tmp_path):
    case = simulate(3, operators=range(6))
    codes = {f"P{k:02d}": name for k, name in enumerate(FORMULAS)}
    for rows, name in ((case.trials, "trials.csv"), (case.tlx, "tlx.csv")):
        renamed = [row | {"operator": codes[str(row["operator"])]} for row in rows]
        (tmp_path / name).write_text(csv_text(list(rows[0]), renamed), encoding="utf-8")
    data = read_study([tmp_path])
    assert set(data.trials.operator) == set(FORMULAS)
    out = tmp_path / "out"
    arguments = ["study", "analyze", str(tmp_path), "--output", str(out), "--no-report"]
    assert main([*arguments, "--quiet"]) == 0
    tables = {file.name: cells(file.read_text(encoding="utf-8")) for file in out.glob("*.csv")}
    assert {"operators.csv", "emm.csv", "learning.csv"} <= set(tables)
    for name, rows in tables.items():
        assert all(SAFE.match(cell) for row in rows for cell in row), name
    header, *rows = tables["operators.csv"]
    assert {plain_cell(row[header.index("operator")]) for row in rows} == set(FORMULAS)

"""``benchmarks/tables.py``: several figures in the cells of one table."""

import contextlib
import io
import json
import runpy
import sys
from pathlib import Path

import pytest

from smooth_operator.lab.benchmark.results import KEY

TABLES = Path(__file__).resolve().parents[1] / "benchmarks" / "tables.py"
SUMMARY = """\
measure,hand,side,condition,method,figure,unit,value,low,high,count
reachable,a,right,clean,smooth,error,mm,0.2,0.1,0.3,3
reachable,a,right,clean,sbr,error,mm,3,2,4,3
reachable,a,right,clean,smooth,p95,mm,0.5,0.4,0.6,3
reachable,a,right,clean,sbr,p95,mm,7,6,8,3
reachable,a,right,noisy,smooth,error,mm,0.9,0.8,1,3
reachable,a,right,noisy,hybrid,error,mm,0.8,0.7,0.9,3
"""
FIGURES = [
    {"name": name, "meaning": name, "unit": "mm", "goal": "down", "share": False}
    for name in ("error", "p95")
]


def printed(folder: Path, *words: str) -> list[str]:
    (folder / "summary.csv").write_text(SUMMARY, encoding="utf-8")
    content = {"measures": [{"name": "reachable", "figures": FIGURES}]}
    (folder / "results.json").write_text(json.dumps(content), encoding="utf-8")
    return output_of("physics", folder, "reachable", *words)


def output_of(*words: str | Path) -> list[str]:
    """Lines that the program prints, without blank ones."""
    path, printed = str(TABLES), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.setattr(sys, "argv", [path, *map(str, words)])
        runpy.run_path(path, run_name="__main__")
    return [line for line in printed.getvalue().splitlines() if line]


def test_figures_and_conditions_share_a_cell(tmp_path):
    found = printed(tmp_path, "error/p95/error@noisy", "--methods", "smooth", "sbr")
    assert found == [
        "error [mm], clean / p95 [mm], clean / error [mm], noisy:",
        "| hand | `smooth` | `sbr` |",
        "|---|---:|---:|",
        "| `a` | **0.2 ± 0.1 / 0.5 / 0.9** | 3 ± 1 / 7 / – |",
    ]


def test_a_table_for_each_condition(tmp_path):
    found = printed(tmp_path, "error")
    assert [line for line in found if line.startswith("error")] == [
        "error [mm], clean:",
        "error [mm], noisy:",
    ]
    assert found[-1] == "| `a` | 0.9 ± 0.1 | **0.8 ± 0.1** |"


def test_recordings_share_a_cell(tmp_path):
    def row(recording: str, method: str, motion: float | None) -> dict[str, object]:
        metrics = None if motion is None else {"motion_preservation": motion, "lag_ms": 12.4}
        return dict.fromkeys(KEY, "x") | {
            "recording": recording, "method": method, "preset": "paper", "metrics": metrics,
        }  # fmt: skip

    rows = [
        row("b", "sbr", 0.9), row("b", "ako", 0.7), row("a", "sbr", 0.8), row("a", "ako", None),
    ]  # fmt: skip
    (tmp_path / "results.json").write_text(json.dumps(rows), encoding="utf-8")
    assert output_of("bench", tmp_path, "--columns", "motion", "lag [ms]") == [
        "b, frames None / a, frames None",
        "| method | motion | lag [ms] |",
        "|---|---:|---:|",
        "| `sbr:paper` | 0.900 / 0.800 | 12 / 12 |",
        "| `ako:paper` | 0.700 / – | 12 / – |",
    ]

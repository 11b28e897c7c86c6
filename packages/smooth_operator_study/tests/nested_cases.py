"""Rows of simulated studies whose mixed models are compared with R's, and how R is asked."""

import csv
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from study_cases import ITEMS, POINTS, Row, holes, simulate

from smooth_operator_study.analysis.frame import Frame, make_frame

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


def ask_r(rows: dict[str, list[Row]], folder: Path, script: Path = SCRIPT) -> dict[str, Any]:
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
        ["Rscript", str(script), *names], capture_output=True, text=True, check=True
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

"""``analysis.R`` and the rows that it reads: the same analysis again, in R."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.atomic_files import atomic_write
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.study.analysis.analyze import Analysis

SCRIPT: Final = "analysis.R"
TRIALS: Final = "rows_trials.csv"
TLX: Final = "rows_tlx.csv"


def write_r_script(analysis: Analysis, folder: Path) -> list[str]:
    """Writes script and rows.

    Args:
        analysis: of the study.
        folder: exists, with the tables of the analysis.

    Returns:
        Names of the files. A table of questionnaires that is not there is not written, and an older
        one removed.

    Raises:
        OutputError: a file can't be written.
    """
    template = files("smooth_operator.study.analysis").joinpath(SCRIPT).read_text("utf-8")
    script = template.replace("@BASELINE@", json.dumps(analysis.baseline))
    texts = {SCRIPT: script, TRIALS: _csv(_trials(analysis))}
    if analysis.data.questionnaires is None:
        (folder / TLX).unlink(missing_ok=True)
    else:
        texts[TLX] = _csv(_questionnaires(analysis))
    for name, text in texts.items():
        with atomic_write(folder / name) as file:
            file.write(text.encode("utf-8"))
    return list(texts)


def _trials(analysis: Analysis) -> dict[str, np.ndarray]:
    rows = analysis.data.trials
    return {
        "operator": rows.operator,
        "task": rows.task,
        "retargeter": rows.retargeter,
        "block": rows.block,
        "trial_in_block": rows.trial_in_block,
        "trial_global": rows.trial_global,
        "score": rows.score,
        "success": rows.success.astype(int),
        "time_s": rows.time,
    }


def _questionnaires(analysis: Analysis) -> dict[str, np.ndarray]:
    rows = analysis.data.questionnaires
    assert rows is not None
    return {
        "operator": rows.operator,
        "task": rows.task,
        "retargeter": rows.retargeter,
        "block": rows.block,
        "point": rows.point,
        "index": rows.index,
        "workload": rows.workload,
    }


def _csv(columns: dict[str, np.ndarray]) -> str:
    values = [column.tolist() for column in columns.values()]
    rows: list[dict[str, Any]] = [
        {name: None if cell != cell else cell for name, cell in zip(columns, row, strict=True)}
        for row in zip(*values, strict=True)
    ]
    return csv_text(list(columns), rows)

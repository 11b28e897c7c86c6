"""The folder of an analysis: ``results.json``, CSV tables, ``methods.txt``, the report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from smooth_operator.atomic_files import atomic_write
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.citations import cited
from smooth_operator.study.analysis.csv_files import write_tables
from smooth_operator.study.analysis.methods_text import methods_paragraph
from smooth_operator.study.analysis.r_script import write_r_script

RESULTS: Final = "results.json"
METHODS: Final = "methods.txt"


def write_analysis(analysis: Analysis, folder: Path, *, report: bool = True) -> list[str]:
    """Writes everything.

    Args:
        analysis: of the study.
        folder: exists.
        report: whether to draw figures and write the page, which takes longest.

    Returns:
        Names of the files, the results first.

    Raises:
        OutputError: a file can't be written.
    """
    with atomic_write(folder / RESULTS) as file:
        text = json.dumps(analysis.to_json(), indent=1, allow_nan=False, ensure_ascii=False)
        file.write(text.encode() + b"\n")
    text = methods_paragraph(analysis)
    works = "\n".join(f"[{c.key}] {c.reference}" for c in cited(text))
    with atomic_write(folder / METHODS) as file:
        file.write(f"{text}\n\n{works}\n".encode())
    written = [RESULTS, *write_tables(analysis, folder), METHODS]
    written += write_r_script(analysis, folder)
    if report:
        from smooth_operator.study.analysis.report import write_report

        written.append(write_report(analysis, folder).name)
    return written

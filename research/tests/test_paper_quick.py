"""``paper --quick``: the whole set as a user runs it; one of it again computes nothing anew."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from smooth_operator_research.paper import docs_tables

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS = {"compute", "fk", "hessian", "noise", "rate", "solver", "table", "velocity"}


def quickly(folder: Path, *words: str) -> tuple[str, str]:
    """Standard output and standard error of the command."""
    command = [sys.executable, "-m", "smooth_operator", *words, "--quick", "--output", str(folder)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
    assert run.returncode == 0, run.stderr[-3000:]
    return run.stdout, run.stderr


def _check_tables_of_the_page(folder: Path) -> None:
    """Every table of research/docs/paper.md has the columns and rows that its program makes."""
    page = (ROOT / "research" / "docs" / "paper.md").read_text(encoding="utf-8")
    blocks = {found[1]: found[2] for found in docs_tables.BLOCK.finditer(page)}
    assert len(blocks) >= 12
    loose = docs_tables.BLOCK.sub("", page).partition("## Departures from the paper")[0]
    assert not re.search(r"^\|", loose, re.MULTILINE)  # none with figures is written by hand
    results = docs_tables.read_results(folder)
    assert set(results) == EXPERIMENTS
    for name, text in blocks.items():
        if name == "coverage":
            continue  # tests/test_ablations.py
        made = docs_tables.block(name, docs_tables.TABLES[name](results, results))
        ours, theirs = ([line for line in t.splitlines() if line[:1] == "|"] for t in (made, text))
        if name == "fk":  # libraries that are not installed here have no column
            assert set(ours[0].split(" | ")) <= set(theirs[0].split(" | "))
            continue
        assert _unnumbered(ours[0]) == _unnumbered(theirs[0]), name
        rows = [{_unnumbered(line.split(" | ")[0]) for line in t[2:]} for t in (ours, theirs)]
        # the page lacks a sampler that only some runs tune, and methods that changed since its run
        assert rows[1] <= rows[0], name
        extra = {row.removeprefix("| ") for row in rows[0] - rows[1] if "tuned" not in row}
        assert extra <= {"ako", "keyvector"}, name
    written = docs_tables.replaced(page, "solver", "new")
    assert docs_tables.replaced(page, "none", "new") == page
    assert "new" in written
    assert blocks["velocity"] in written


def _unnumbered(text: str) -> str:
    """Without its figures, which are the study's size."""
    return re.sub(r"[\d.,]+", "#", text)


@pytest.mark.weekly
def test_the_whole_set_runs_and_is_not_computed_twice(tmp_path):
    folder = tmp_path / "quick"
    told, progress = quickly(folder, "paper")
    assert "do not use it to judge a claim" in told.splitlines()[-1]
    assert "verdict" not in told
    assert "held" not in told + progress
    assert "[m²]" in told  # brackets are units, not markup
    assert f"{len(EXPERIMENTS)} of {len(EXPERIMENTS)} experiments done" in progress
    assert "grid N × L: 1 of " in progress
    for name in EXPERIMENTS:
        results = json.loads((folder / name / "results.json").read_text(encoding="utf-8"))
        assert results["experiment"] == name
        assert results["claim"]
        assert list((folder / name).glob("*.png")), name
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "do not use it to judge a claim" in page
    assert "Verdict:" not in page
    for name in EXPERIMENTS:
        assert f'id="{name}"' in page, name
    _check_tables_of_the_page(folder)
    kept = {path: path.stat().st_mtime_ns for path in sorted((folder / "cells").rglob("*.*"))}
    assert kept
    quickly(folder, "ablate", "solver")
    again = {path: path.stat().st_mtime_ns for path in sorted((folder / "cells").rglob("*.*"))}
    assert again == kept

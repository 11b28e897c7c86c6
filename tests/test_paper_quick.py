"""``paper --quick``: the whole set as a user runs it; one of it again computes nothing anew."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

EXPERIMENTS = {"compute", "fk", "hessian", "noise", "rate", "solver", "table", "velocity"}


def quickly(folder: Path, *words: str) -> tuple[str, str]:
    """Standard output and standard error of the command."""
    command = [sys.executable, "-m", "smooth_operator", *words, "--quick", "--output", str(folder)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
    assert run.returncode == 0, run.stderr[-3000:]
    return run.stdout, run.stderr


def test_the_whole_set_runs_and_is_not_computed_twice(tmp_path: Path) -> None:
    folder = tmp_path / "quick"
    told, progress = quickly(folder, "paper")
    assert "its verdicts say little" in told.splitlines()[-1]  # below the ticks and crosses
    assert f"{len(EXPERIMENTS)} of {len(EXPERIMENTS)} experiments done" in progress
    assert "grid N × L: 1 of " in progress
    for name in EXPERIMENTS:
        results = json.loads((folder / name / "results.json").read_text(encoding="utf-8"))
        assert results["experiment"] == name
        assert results["claim"]
        assert list((folder / name).glob("*.png")), name
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "its verdicts say little" in page
    for name in EXPERIMENTS:
        assert f'id="{name}"' in page, name
    kept = {path: path.stat().st_mtime_ns for path in sorted((folder / "cells").rglob("*.*"))}
    assert kept
    quickly(folder, "ablate", "solver")
    again = {path: path.stat().st_mtime_ns for path in sorted((folder / "cells").rglob("*.*"))}
    assert again == kept

"""Time without selection, against R: cumulative incidence and restricted means (survival, cmprsk).

``study_survival.json`` has R's figures (survival 3.5-3, cmprsk 2.2-11) for the rows that are made
here: ``python tests/test_study_survival.py FOLDER`` writes them, ``Rscript tests/study_survival.R
FOLDER/*.csv`` reads them.
"""

from __future__ import annotations

import json
import random
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from study_cases import Row, write_rows

from smooth_operator.study.analysis.time_to_success import (
    CENSORED,
    COMPETING,
    SUCCESS,
    TimeToSuccess,
    incidence,
    time_to_success,
)
from smooth_operator.study.data import read_study

SCRIPT = Path(__file__).with_name("study_survival.R")
EXPECTED = json.loads(SCRIPT.with_suffix(".json").read_text("utf-8"))
LIMIT = 60.0


def made(name: str) -> list[Row]:
    """Rows of a case: ties, events at the limit, censoring before, between and after events."""
    draw = random.Random(name)
    shares = {"ties": (0.2, 0.5, 0.3), "few": (0.3, 0.4, 0.3), "no-censoring": (0.0, 0.6, 0.4)}
    count = {"ties": 60, "few": 9, "no-censoring": 40}[name]
    rows: list[Row] = []
    for _ in range(count):
        time = min(LIMIT, 0.5 * round(2 * draw.expovariate(1 / 25)) + 0.5)
        event = draw.choices((CENSORED, SUCCESS, COMPETING), shares[name])[0]
        rows.append({"time": time, "event": event, "limit": LIMIT})
    return rows


@pytest.mark.parametrize("name", list(EXPECTED))
def test_incidence_and_restricted_mean_are_as_r_has_them(name: str) -> None:
    rows, expected = made(name), EXPECTED[name]
    times = np.array([row["time"] for row in rows], float)
    events = np.array([row["event"] for row in rows], int)
    found = incidence(times, events, np.ones((1, len(rows))))
    shares = [found.at(time)[0] for time in expected["at"]]
    np.testing.assert_allclose(shares, expected["incidence"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(shares, expected["incidence_cmprsk"], rtol=0, atol=1e-12)
    assert found.restricted_mean(LIMIT)[0] == pytest.approx(expected["restricted_mean"], rel=1e-12)
    alone = incidence(
        times, np.where(events == SUCCESS, SUCCESS, CENSORED), np.ones((1, len(rows)))
    )
    shares = [alone.at(time)[0] for time in expected["at"]]
    np.testing.assert_allclose(shares, expected["kaplan_meier"], rtol=0, atol=1e-12)
    mean = alone.restricted_mean(LIMIT)[0]
    assert mean == pytest.approx(expected["restricted_mean_alone"], rel=1e-12)


def test_a_study_is_read_so(tmp_path: Path) -> None:
    """A success is one, a drop competes, what was given up is censored or competes."""
    trials: list[Row] = []
    for block, name in enumerate(EXPECTED, 1):
        for k, row in enumerate(made(name)):
            won, line = (
                row["event"] == SUCCESS,
                ("not-done", "done", "dropped")[int(str(row["event"]))],
            )
            trials.append(
                {"operator": f"P{k % 3}", "task": "A", "retargeter": name, "block": block,
                 "trial_in_block": k + 1, "trial_global": 100 * block + k, "score": int(won),
                 "time_s": row["time"] if won else "", "duration_s": row["time"], "line": line}
            )  # fmt: skip
    write_rows(tmp_path / "trials.csv", trials)
    data = read_study([tmp_path])
    found = time_to_success(data.trials, ("A",), tuple(EXPECTED), limits={"A": LIMIT})
    assert isinstance(found, TimeToSuccess)
    for name, expected in EXPECTED.items():
        gone_on = found.if_gone_on[name].estimate
        assert gone_on == pytest.approx(expected["restricted_mean"], rel=1e-12)
    without = EXPECTED["no-censoring"]  # nothing was given up there: both readings are one
    assert found.restricted_mean["no-censoring"].estimate == pytest.approx(
        without["restricted_mean"], rel=1e-12
    )
    assert found.by_limit["no-censoring"].estimate == pytest.approx(without["incidence"][-1])


def test_r_itself_says_so(tmp_path: Path) -> None:
    if shutil.which("Rscript") is None:
        pytest.skip("R is not installed")
    names = "c('survival', 'cmprsk', 'jsonlite')"
    asked = f"for (n in {names}) if (!nzchar(system.file(package = n))) cat(n, '')"
    lacks = subprocess.run(
        ["Rscript", "-e", asked], capture_output=True, text=True, check=True, timeout=300
    ).stdout
    if lacks:
        pytest.skip(f"R has no package {lacks}")
    paths = write_cases(tmp_path)
    done = subprocess.run(
        ["Rscript", str(SCRIPT), *map(str, paths)], capture_output=True, text=True, timeout=300,
        check=True,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found.keys() == EXPECTED.keys()
    for name, expected in EXPECTED.items():
        for what, figures in expected.items():
            np.testing.assert_allclose(found[name][what], figures, rtol=1e-12, err_msg=what)


def write_cases(folder: Path) -> list[Path]:
    """The rows of all cases, for R."""
    names = ("ties", "few", "no-censoring")
    return [write_rows(folder / f"{name}.csv", made(name)) for name in names]


if __name__ == "__main__":
    print(*write_cases(Path(sys.argv[1])))

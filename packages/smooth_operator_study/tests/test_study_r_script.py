"""``analysis.R`` in the folder of results gives the report's figures in R, to its own precision."""

import csv
import math
import random
import shutil
import subprocess
from pathlib import Path

import pytest
from study_cases import simulate, write_rows

from smooth_operator_study.analysis import analyze_study
from smooth_operator_study.analysis.output import write_analysis
from smooth_operator_study.data import read_study

PACKAGES = ("lme4", "lmerTest", "geepack", "emmeans", "mvtnorm")
KEYS = ("mode", "outcome", "scope", "retargeter", "pair", "name")
ABSOLUTE = {"p": 1e-6, "p_raw": 1e-6, "p_holm": 1e-6, "p_dunnett": 1e-5}
"""Probabilities; all else is compared relative to its size, limits to the standard error."""
RELATIVE = {"df": 1e-4, "lower": 1e-4, "upper": 1e-4}
MORE = {"learning": ("scope", "index", "outcome"), "readings": ("reading", "where", "term")}
"""Further tables of the script, and what names their rows."""
READ = {"full_success": 3, "log_time": 3, "equivalence": 1, "interaction": 1}
"""Readings that R has, and how many sorts of rows each has at least."""


def needs_r() -> None:
    if shutil.which("Rscript") is None:
        pytest.skip("R is not installed")
    wanted = ", ".join(f"'{name}'" for name in PACKAGES)
    asked = f"for (n in c({wanted})) if (!nzchar(system.file(package = n))) cat(n, '')"
    done = subprocess.run(
        ["Rscript", "-e", asked], capture_output=True, text=True, check=True, timeout=300
    )
    if done.stdout.strip():
        pytest.skip(f"R has no package {done.stdout.strip()}")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a small study: a baseline that is not the first by name, one retargeter fails."""
    made = tmp_path_factory.mktemp("r")
    names = ("ako", "hybrid", "sbr")
    case = simulate(
        5, operators=range(7), retargeters=names, spread=0.9, keep=lambda i, t, r, n: t != "C"
    )
    never = [
        {
            **row,
            "retargeter": "=never",
            "block": 4,
            "score": 0,
            "time_s": "",
            "trial_global": int(str(row["trial_global"])) + 100,
        }
        for row in case.trials
        if row["retargeter"] == "sbr"
    ]
    draw = random.Random(2)
    trials = [
        {
            **row,
            "duration_s": row["time_s"] or draw.randrange(20, 600) / 10,
            "line": "done" if row["score"] else draw.choice(("dropped", "not-done")),
        }
        for row in (*case.trials, *never)
    ]
    write_rows(made / "trials.csv", trials)
    write_rows(made / "tlx.csv", case.tlx)
    out = made / "out"
    out.mkdir()
    study = read_study([made])
    write_analysis(analyze_study(study, "sbr"), out, report=False)
    return out


def rows(path: Path, keys: tuple[str, ...] = KEYS) -> dict[tuple[str, ...], dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    # What a spreadsheet would read as a formula has an apostrophe in front.
    return {tuple(row.get(key, "").removeprefix("'") for key in keys): row for row in found}


def test_the_script_and_its_rows_are_written(folder):
    script = (folder / "analysis.R").read_text(encoding="utf-8")
    assert 'baseline <- "sbr"' in script
    assert "@" not in script.split("suppressMessages")[0]
    with (folder / "rows_trials.csv").open(encoding="utf-8") as file:
        trials = list(csv.DictReader(file))
    assert {row["success"] for row in trials} == {"0", "1"}
    assert all((row["time_s"] == "") == (row["success"] == "0") for row in trials)
    assert {row["retargeter"] for row in trials} == {"ako", "hybrid", "sbr", "'=never"}


@pytest.fixture(scope="module")
def by_r(folder: Path) -> Path:
    """The folder after R read it."""
    needs_r()
    done = subprocess.run(
        ["Rscript", str(folder / "analysis.R"), str(folder)],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_r_reads_the_rest_the_same(by_r):
    for name, keys in MORE.items():
        ours, theirs = rows(by_r / f"{name}.csv", keys), rows(by_r / f"R_{name}.csv", keys)
        assert theirs.keys() <= ours.keys()
        if name != "readings":
            assert {key for key, row in ours.items() if not row.get("refused")} == theirs.keys()
        for key, found in theirs.items():
            compared = 0
            for column in (found.keys() & ours[key].keys()) - set(keys):
                mine, other = ours[key][column], found[column]
                if not mine or not other:  # a column of other rows, or permutations
                    continue
                compared += 1
                apart = abs(float(mine) - float(other))
                if column not in ABSOLUTE and not column.startswith("p_"):
                    apart /= max(abs(float(mine)), 1e-3)
                assert apart < 1e-4 if column in RELATIVE else apart < 1e-5, (name, key, column)
            assert compared, (name, key)
    sorts: dict[str, set[tuple[str, str]]] = {name: set() for name in READ}
    for reading, where, term in rows(by_r / "R_readings.csv", MORE["readings"]):
        sorts[reading].add((where.rpartition("/")[2], term if "/" not in where else ""))
    assert {name: len(kinds) >= READ[name] for name, kinds in sorts.items()} == dict.fromkeys(
        READ, True
    )


def test_r_finds_the_same(by_r):
    folder = by_r
    for name in ("emm", "dunnett", "pairs", "coefficients"):
        ours, theirs = rows(folder / f"{name}.csv"), rows(folder / f"R_{name}.csv")
        assert ours.keys() == theirs.keys()
        scopes = {key[:3] for key in ours}
        assert {(m, o) for m, o, _ in scopes} == {
            (mode, outcome)
            for mode in ("small-sample", "paper")
            for outcome in ("success", "time", "tlx")
        }
        for key, found in theirs.items():
            for column in set(found) - set(KEYS):
                mine, other = ours[key][column], found[column]
                if column == "df" and key[0] == "paper":
                    assert (mine, other) == ("", "Inf")
                    continue
                apart = abs(float(mine) - float(other))
                if column not in ABSOLUTE:
                    edge = column in ("lower", "upper")
                    apart /= float(ours[key]["se"]) if edge else max(abs(float(mine)), 1e-9)
                limit = ABSOLUTE.get(column, RELATIVE.get(column, 1e-5))
                assert not math.isnan(apart)
                assert apart < limit, (name, key, column, mine, other)

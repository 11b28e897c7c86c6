"""The contributors' guide holds: paths exist, commands run, workflows parse."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

PROJECT = Path(__file__).resolve().parents[1]


def read(name: str) -> str:
    return (PROJECT / name).read_text(encoding="utf-8")


def parsed(name: str) -> Any:
    return yaml.safe_load(read(name))


def table(text: str, first: str) -> list[dict[str, str]]:
    """Rows of the Markdown table whose first heading is ``first``, by heading."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(f"| {first} |"))
    rows = []
    for line in lines[start:]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]


def to_add() -> dict[str, dict[str, str]]:
    return {row["to add a"]: row for row in table(read("CONTRIBUTING.md"), "to add a")}


def test_every_kind_of_part_has_a_row_of_paths_that_exist():
    rows = to_add()
    assert {"method", "hand", "source", "sink", "real hand", "reader", "metric"} < rows.keys()
    for part, row in rows.items():
        assert "tests/test_" in row["test in"], part
        cells = " ".join(row[name] for name in ("write", "register in", "test in", "document in"))
        paths = [path.removesuffix("*") for path in re.findall(r"`([^`]+)`", cells)]
        assert [path for path in paths if not (PROJECT / path).exists()] == [], part


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
def test_make_targets_that_are_named_exist_and_do_what_ci_does():
    targets = re.findall(r"^([a-z]+):", read("Makefile"), re.MULTILINE)
    texts = (read("CONTRIBUTING.md"), read(".github/PULL_REQUEST_TEMPLATE.md"))
    named = {target for text in texts for target in re.findall(r"\bmake ([a-z]+)", text)}
    assert {"check", "test", "docs", "bench"} <= named <= {*targets, "install"}
    command = ["make", "-n", *targets]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "bash .ci/run" in done.stdout.splitlines()
    assert "-m mkdocs build --strict" in done.stdout
    (arguments,) = re.findall(r"-m (pytest -n .*)", read("Makefile"))
    assert f"-m {arguments} || exit" in read(".ci/run")


def test_entry_point_groups_are_those_of_the_registries():

    kinds = {
        kind
        for path in (PROJECT / "src").rglob("*.py")
        for kind in re.findall(r'= Registry\(\s*"(\w+)"', path.read_text(encoding="utf-8"))
    }
    assert kinds
    # distributions of the repository have the only ones; plugins add none
    kinds -= {"scorecard", "retargeting"}
    groups = {row["entry point group"].strip("`") for row in to_add().values()} - {"none", ""}
    assert {f"smooth_operator.{kind}s" for kind in kinds} <= groups
    # and the example plugin has a part of every kind that plugins add
    plugin = tomllib.loads(read("examples/plugin/pyproject.toml"))["project"]
    assert set(plugin["entry-points"]) == groups
    for parts in plugin["entry-points"].values():
        for target in parts.values():
            module = target.partition(":")[0].replace(".", "/")
            folder = PROJECT / "examples" / "plugin" / module
            assert folder.with_suffix(".py").is_file() or (folder / "__init__.py").is_file()


@pytest.mark.parametrize("name", ["ci", "release"])
def test_a_workflow_is_whole(name):
    """Jobs have an end, name jobs that exist, and run scripts that exist."""
    workflow = parsed(f".github/workflows/{name}.yml")
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        assert job["timeout-minutes"] <= 180
        assert job.get("needs", name) in {name, *workflow["jobs"]}
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step)
            for script in re.findall(r"\.ci/\w+", step.get("run", "")):
                assert (PROJECT / script).is_file(), script
    if name == "ci":
        run = [step.get("run") for job in workflow["jobs"].values() for step in job["steps"]]
        assert {"bash .ci/run", "make docs PYTHON=python"} <= set(run)


def test_only_what_was_tried_is_published():
    """The job that publishes has the identity, no secret, and files that were used before."""
    jobs = parsed(".github/workflows/release.yml")["jobs"]
    assert jobs["smoke"]["needs"] == "build"
    assert jobs["publish"]["needs"] == "smoke"
    assert "tag" in jobs["publish"]["if"]
    assert [name for name in jobs if "permissions" in jobs[name]] == ["publish"]
    assert jobs["publish"]["permissions"] == {"id-token": "write"}
    assert "secrets." not in read(".github/workflows/release.yml")


@pytest.mark.skipif(os.name == "nt", reason="needs bash")
def test_a_tag_that_is_not_the_version_of_all_distributions_is_refused(tmp_path):
    steps = parsed(".github/workflows/release.yml")["jobs"]["build"]["steps"]
    (check,) = [step["run"] for step in steps if "TAG" in step.get("env", {})]
    files = [path.relative_to(PROJECT) for path in PROJECT.glob("packages/*/pyproject.toml")]
    files.append(Path("pyproject.toml"))
    version = tomllib.loads(read("pyproject.toml"))["project"]["version"]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])

    def run(tag: str = f"v{version}") -> str:
        done = subprocess.run(
            ["bash", "-e", "-c", check],
            cwd=tmp_path,
            env={**os.environ, "PATH": path, "TAG": tag},
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode == 0) == (done.stderr == "")
        return done.stderr

    urls = 'Source = "https://a.example"\nIssues = "https://a.example/issues"\n'
    for file in files:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        text = read(str(file))
        text += "" if "[project.urls]\n" in text else "\n[project.urls]\n"
        (tmp_path / file).write_text(text.replace("[project.urls]\n", f"[project.urls]\n{urls}"))
    citation = read("CITATION.cff")
    (tmp_path / "CITATION.cff").write_text(citation)
    assert "CITATION.cff lacks date-released" in run()
    citation += "date-released: 2026-12-01\nrepository-code: https://a.example\n"
    (tmp_path / "CITATION.cff").write_text(citation)
    assert "CHANGELOG.md has no date" in run()
    (tmp_path / "CHANGELOG.md").write_text(f"## [{version}] - 2026-12-01\n")
    assert run() == ""
    (tmp_path / "CITATION.cff").write_text("version: 8.8.8\n")
    assert "CITATION.cff has another version" in run()
    assert "but pyproject.toml has" in run("v9.9.9")
    (tmp_path / files[0]).write_text(read(str(files[0])).replace(f'"{version}"', '"9.9.9"'))
    assert f"but {files[0]} has 9.9.9" in run()


def seconds_of(node: ast.AST) -> Iterator[float]:
    """Numbers that a test waits for at most."""
    if isinstance(node, ast.Call):
        bounds = [k.value for k in node.keywords if k.arg in ("timeout", "open_timeout")]
        if getattr(node.func, "attr", "") in ("join", "wait", "result"):
            bounds += node.args
        for bound in bounds:
            if isinstance(bound, ast.Constant) and isinstance(bound.value, int | float):
                yield bound.value


def test_tests_do_not_judge_the_speed_of_the_machine():
    """Twenty programs for each core: what takes a second may take a minute, or ten."""
    found = {
        f"{path.name}:{node.lineno}: {seconds:g} s"
        for folder in (
            PROJECT / "tests",
            PROJECT / "research/tests",
            *PROJECT.glob("packages/*/tests"),
        )
        for path in folder.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for seconds in seconds_of(node)
        if 1.0 <= seconds < 60.0
    }
    assert sorted(found) == [], "wait with live_time.PATIENCE_S, or on a clock of the test's own"

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
from test_lint import COMMANDS

PROJECT = Path(__file__).resolve().parents[1]
PARTS = (
    "method",
    "term",
    "hand",
    "source",
    "sink",
    "output of feedback",
    "tracker of a maker",
    "real hand",
    "reader",
    "data set layout",
    "data set format",
    "metric",
    "command",
    "research data set",
    "experiment",
    "physics measure",
    "demonstration",
    "doc page",
)
YAML_FILES = sorted({*PROJECT.glob(".github/**/*.yml"), PROJECT / ".pre-commit-config.yaml"})


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


def missing_paths(cells: list[str]) -> list[str]:
    """Paths in backticks that do not exist; ``folder/*`` asks for the folder."""
    paths = [path for cell in cells for path in re.findall(r"`([^`]+)`", cell)]
    return [path for path in paths if not (PROJECT / path.removesuffix("*")).exists()]


def test_every_kind_of_part_has_a_row():
    assert tuple(to_add()) == PARTS


@pytest.mark.parametrize("part", PARTS)
def test_the_paths_of_a_row_exist(part):
    row = to_add()[part]
    assert "`" in row["write"]
    assert "tests/test_" in row["test in"]
    assert missing_paths([row[c] for c in ("write", "register in", "test in", "document in")]) == []


def test_entry_point_groups_are_those_of_the_registries():
    """A registry of the package has its group in the table."""
    kinds = {
        kind
        for path in (PROJECT / "src").rglob("*.py")
        for kind in re.findall(r'= Registry\(\s*"(\w+)"', path.read_text(encoding="utf-8"))
    }
    assert kinds
    kinds -= {"scorecard"}  # the research distribution has the only one; plugins add none
    groups = {row["entry point group"].strip("`") for row in to_add().values()} - {"none"}
    assert {f"smooth_operator.{kind}s" for kind in kinds} <= groups


def test_the_example_plugin_has_a_part_of_every_kind_that_plugins_add():
    groups = {row["entry point group"].strip("`") for row in to_add().values()} - {"none", ""}
    plugin = tomllib.loads(read("examples/plugin/pyproject.toml"))["project"]
    assert set(plugin["entry-points"]) == groups
    for parts in plugin["entry-points"].values():
        for target in parts.values():
            module = target.partition(":")[0].replace(".", "/")
            folder = PROJECT / "examples" / "plugin" / module
            assert folder.with_suffix(".py").is_file() or (folder / "__init__.py").is_file()


def targets() -> set[str]:
    return set(re.findall(r"^([a-z]+):", read("Makefile"), re.MULTILINE))


def test_the_make_targets_that_are_named_exist():
    named = {
        target
        for name in ("CONTRIBUTING.md", ".github/PULL_REQUEST_TEMPLATE.md")
        for target in re.findall(r"\bmake ([a-z]+)", read(name))
    } - {"install"}
    assert {"check", "test", "docs", "bench"} <= named <= targets()


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
def test_make_check_is_what_ci_runs():
    done = subprocess.run(
        ["make", "-n", *sorted(targets())], cwd=PROJECT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "bash .ci/run" in done.stdout.splitlines()


def test_files_that_make_runs_exist():
    files = re.findall(r"(?:bash|PYTHON\)|pytest) ([\w./]+\.py|\.ci/\w+)", read("Makefile"))
    assert len(files) >= 2
    assert "-m mkdocs build --strict" in read("Makefile")
    assert [name for name in files if not (PROJECT / name).is_file()] == []


def test_the_test_command_of_make_is_that_of_ci():
    (arguments,) = re.findall(r"-m (pytest -n .*)", read("Makefile"))
    assert f"-m {arguments} || exit" in read(".ci/run")


@pytest.mark.parametrize("path", YAML_FILES, ids=lambda path: path.name)
def test_yaml_parses(path):
    assert isinstance(yaml.safe_load(path.read_text(encoding="utf-8")), dict)


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
            assert re.fullmatch(r"[\w-]+/[\w-]+@[\w./]+", step.get("uses", "a/b@v1"))
            for script in re.findall(r"\.ci/\w+", step.get("run", "")):
                assert (PROJECT / script).is_file(), script


def test_ci_runs_the_one_script():
    steps = parsed(".github/workflows/ci.yml")["jobs"]["test"]["steps"]
    assert "bash .ci/run" in [step.get("run") for step in steps]


def test_ci_builds_the_site():
    steps = parsed(".github/workflows/ci.yml")["jobs"]["docs"]["steps"]
    assert "make docs PYTHON=python" in [step.get("run") for step in steps]
    (path,) = [step["with"]["path"] for step in steps if "upload" in step.get("uses", "")]
    assert path.rstrip("/") == parsed_site()["site_dir"]


def parsed_site() -> dict[str, Any]:
    """``mkdocs.yml`` without the tags of its own that name Python objects."""
    text = re.sub(r"!!python/\S+", "", read("mkdocs.yml"))
    return yaml.safe_load(text)


def test_only_what_was_tried_is_published():
    """The job that publishes has the identity, no secret, and files that were used before."""
    jobs = parsed(".github/workflows/release.yml")["jobs"]
    assert jobs["smoke"]["needs"] == "build"
    assert jobs["publish"]["needs"] == "smoke"
    assert "tag" in jobs["publish"]["if"]
    assert [name for name in jobs if "permissions" in jobs[name]] == ["publish"]
    assert jobs["publish"]["permissions"] == {"id-token": "write"}
    assert {"ubuntu-latest", "macos-latest", "windows-latest"} == set(
        jobs["smoke"]["strategy"]["matrix"]["os"]
    )
    names = {
        step["with"]["name"]
        for job in jobs.values()
        for step in job["steps"]
        if "artifact" in step.get("uses", "")
    }
    assert names == {"dist"}
    assert jobs["publish"]["steps"][-1] == {
        "uses": "pypa/gh-action-pypi-publish@release/v1",
        "with": {"packages-dir": "upload/"},
    }
    assert "secrets." not in read(".github/workflows/release.yml")


@pytest.mark.skipif(os.name == "nt", reason="needs bash")
def test_a_tag_that_is_not_the_version_of_all_distributions_is_refused(tmp_path):
    steps = parsed(".github/workflows/release.yml")["jobs"]["build"]["steps"]
    (check,) = [step["run"] for step in steps if "TAG" in step.get("env", {})]
    files = [path.relative_to(PROJECT) for path in PROJECT.glob("packages/*/pyproject.toml")]
    files.append(Path("pyproject.toml"))
    version = tomllib.loads(read("pyproject.toml"))["project"]["version"]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])

    def run(tag: str) -> str:
        environment = {**os.environ, "PATH": path, "TAG": tag}
        command = ["bash", "-e", "-c", check]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert (done.returncode == 0) == (done.stderr == "")
        return done.stderr

    for file in files:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(read(str(file)))
    citation = tmp_path / "CITATION.cff"
    citation.write_text(read("CITATION.cff"))
    assert "CITATION.cff lacks date-released" in run(f"v{version}")
    citation.write_text(read("CITATION.cff") + "date-released: 2026-12-01\n")
    assert "CITATION.cff lacks repository-code" in run(f"v{version}")
    with citation.open("a") as file:
        file.write("repository-code: https://a.example\n")
    assert "CHANGELOG.md has no date" in run(f"v{version}")
    (tmp_path / "CHANGELOG.md").write_text(f"## [{version}] - 2026-12-01\n")
    assert "project.urls of pyproject.toml lacks Source" in run(f"v{version}")
    urls = 'Source = "https://a.example"\nIssues = "https://a.example/issues"\n'
    for file in files:
        text = read(str(file))
        text += "" if "[project.urls]\n" in text else "\n[project.urls]\n"
        text = text.replace("[project.urls]\n", f"[project.urls]\n{urls}")
        (tmp_path / file).write_text(text)
    assert run(f"v{version}") == ""
    (tmp_path / "CITATION.cff").write_text("version: 8.8.8\n")
    assert "CITATION.cff has another version" in run(f"v{version}")
    assert "but pyproject.toml has" in run("v9.9.9")
    for file in files:
        (tmp_path / file).write_text(read(str(file)).replace(f'"{version}"', '"9.9.9"'))
        assert f"but {file} has 9.9.9" in run(f"v{version}")
        (tmp_path / file).write_text(read(str(file)))


def test_each_distribution_is_published_by_a_publisher_of_its_own():
    files = [PROJECT / "pyproject.toml", *sorted(PROJECT.glob("packages/*/pyproject.toml"))]
    projects = [tomllib.loads(file.read_text(encoding="utf-8"))["project"] for file in files]
    publish = parsed(".github/workflows/release.yml")["jobs"]["publish"]
    entries = publish["strategy"]["matrix"]["include"]
    assert [entry["distribution"] for entry in entries] == [project["name"] for project in projects]
    assert len({entry["environment"] for entry in entries}) == len(entries)
    for entry in entries:
        assert entry["files"] == entry["distribution"].replace("-", "_")
    assert publish["strategy"]["max-parallel"] == 1
    for project in projects:
        assert f"version: {project['version']}\n" in read("CITATION.cff")
        groups = [project["dependencies"], *project.get("optional-dependencies", {}).values()]
        for need in (need for group in groups for need in group):
            if need.startswith("smooth-retargeting") and project is not projects[0]:
                assert "~=0.1" in need, need  # never an older, unknown one


def test_hooks_are_the_tools_of_ci():
    """Local hooks: the versions are those of the environment, as in CI."""
    (repository,) = parsed(".pre-commit-config.yaml")["repos"]
    assert repository["repo"] == "local"
    entries = [hook["entry"].split() for hook in repository["hooks"]]
    assert {entry[2] for entry in entries} == {"ruff", "mypy"}
    checked = [[word for word in line.split() if word[0] != "-"] for line in COMMANDS]
    for entry in entries:
        command = [word for word in entry[2:] if not word.startswith("-")]
        assert command in checked, entry


def test_issue_forms_ask_for_what_a_report_needs():
    for name in ("bug", "feature"):
        form = parsed(f".github/ISSUE_TEMPLATE/{name}.yml")
        assert {"name", "description", "body"} <= form.keys()
        ids = [field["id"] for field in form["body"]]
        assert len(set(ids)) == len(ids)
        assert all(field["attributes"]["label"] for field in form["body"])


def test_links_of_the_pages_for_contributors_exist():
    for name in ("CONTRIBUTING.md", "SECURITY.md"):
        links = re.findall(r"\]\(([^)\s#]+)[^)]*\)", read(name))
        paths = [link for link in links if not link.startswith("https:")]
        assert paths
        assert [path for path in paths if not (PROJECT / path).exists()] == [], name


def seconds_of(node: ast.AST) -> Iterator[float]:
    """Numbers that a test waits for, or that a time on the machine's clock may be at most."""

    def is_clock(call: ast.AST) -> bool:
        clocks = ("time.monotonic()", "time.perf_counter()", "time.time()")
        return isinstance(call, ast.Call) and ast.unparse(call) in clocks

    bounds: list[ast.expr] = []
    match node:
        case ast.Compare(left=ast.BinOp(op=ast.Sub(), left=one, right=other), ops=[ast.Lt()]):
            bounds = node.comparators if is_clock(one) or is_clock(other) else []
        case ast.BinOp(op=ast.Add(), left=clock, right=bound) if is_clock(clock):
            bounds = [bound]
        case ast.Call(func=ast.Attribute(attr="join" | "wait" | "result"), args=[bound]):
            bounds = [bound]
        case ast.Call():
            bounds = [k.value for k in node.keywords if k.arg in ("timeout", "open_timeout")]
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

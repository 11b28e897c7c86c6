"""Extras: what the base does without, and the one line that names what is missing."""

import ast
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from email.message import Message
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from processes import python

from smooth_operator import extras
from smooth_operator.extras import install_command

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "smooth_operator"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BASE = {"flatbuffers", "jax", "jaxtyping", "mujoco", "numpy", "rich", "scipy", "tyro"}
"""Distributions that everyone gets; their modules have the same names."""
KNOWN = sys.stdlib_module_names | BASE | {"smooth_operator"}

EXTRAS = """teleop training all arm avp cluster hdf5 lerobot menagerie serial webcam webxr zmq
docs test"""
"""Names that stand in scripts."""
AT_THE_TOP = ("teleop/arm/", "teleop/pages/", "teleop/recording/messages.py")
"""Where they may be imported with the module: its package says first what is missing."""


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[\[<>=;]", text)[0] for text in requirements}


def test_the_base_needs_nine_distributions():
    assert names(PROJECT["dependencies"]) == BASE


def test_the_lock_is_resolved_from_all_extras():
    lines = (ROOT / "requirements.in").read_text(encoding="utf-8").splitlines()
    requests = [line.removeprefix("-e ") for line in lines if line.startswith("-e ")]
    named = {
        ROOT / folder: {extra for extra in inner.strip("]").split(",") if extra}
        for folder, _, inner in (request.partition("[") for request in requests)
    }
    for folder, given in named.items():
        text = (folder / "pyproject.toml").read_text(encoding="utf-8")
        offered = tomllib.loads(text)["project"].get("optional-dependencies", {})
        assert given == set(offered), folder


def test_every_extra_has_the_wing_that_it_is_part_of():
    extras = PROJECT["optional-dependencies"]
    assert sorted(extras) == sorted(EXTRAS.split())
    for extra in extras.keys() - {"teleop", "training", "cluster", "docs"}:
        included = re.findall(r"smooth-retargeting\[(.*?)\]", " ".join(extras[extra]))
        assert "teleop" in ",".join(included).split(","), extra


def imported_by(node: ast.AST) -> list[str]:
    """Top-level modules that a statement imports."""
    if isinstance(node, ast.Import):
        return [alias.name.split(".")[0] for alias in node.names]
    if isinstance(node, ast.ImportFrom) and not node.level:
        return [(node.module or "").split(".")[0]]
    return []


def imported_with_the_module(path: Path) -> Iterator[tuple[int, str]]:
    """(line, top-level module) of the imports outside functions and ``TYPE_CHECKING``."""
    todo: list[Any] = [ast.parse(path.read_text(encoding="utf-8"))]
    while todo:
        node = todo.pop()
        yield from ((node.lineno, name) for name in imported_by(node))
        typed = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if not typed and not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            todo += ast.iter_child_nodes(node)


def test_only_the_base_is_imported_with_a_module():
    wrong = [
        f"{path.relative_to(SOURCE).as_posix()}:{line}: import {name} inside the function"
        for path in SOURCE.rglob("*.py")
        if not path.relative_to(SOURCE).as_posix().startswith(AT_THE_TOP)
        for line, name in imported_with_the_module(path)
        if name not in KNOWN
    ]
    assert wrong == []


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Makes the package look as if it was installed in some way."""

    def pretend(record: object = None, *, there: bool = True) -> None:
        def distribution(name: str) -> Any:
            assert name in ("smooth-retargeting", extras.DEVICES, extras.DATA_SETS)
            if not there:
                raise metadata.PackageNotFoundError(name)
            text = record if isinstance(record, str | None) else json.dumps(record)
            return SimpleNamespace(read_text={"direct_url.json": text}.__getitem__)

        monkeypatch.setattr(metadata, "distribution", distribution)
        forget()

    def forget() -> None:
        extras._installed_from.cache_clear()
        extras._owner.cache_clear()

    yield pretend
    monkeypatch.undo()
    forget()


def test_an_extra_is_added_to_what_is_installed(installed, monkeypatch, tmp_path):
    by_name = 'python -m pip install "smooth-retargeting[zmq]"'
    wheel = {"url": (tmp_path / "a.whl").as_uri(), "archive_info": {}}
    damaged = ["{", "[]", "{}", '{"url": 3, "dir_info": {}}', '{"dir_info": {}}']
    for record in (None, wheel, *damaged):
        installed(record)
        assert install_command("zmq") == by_name, record

    folder = {"url": ROOT.as_uri(), "dir_info": {}}
    monkeypatch.chdir(ROOT)
    installed(folder)
    assert install_command("zmq") == 'python -m pip install ".[zmq]"'
    installed(folder | {"dir_info": {"editable": True}})
    assert install_command("zmq") == 'python -m pip install -e ".[zmq]"'
    installed(there=False)
    assert install_command("zmq") == 'python -m pip install ".[zmq]"'

    monkeypatch.chdir(tmp_path)
    assert install_command("zmq") == f'python -m pip install "{ROOT}[zmq]"'
    installed({"url": (tmp_path / "removed").as_uri(), "dir_info": {}})
    assert install_command("zmq") == by_name

    about = {extras.DEVICES: Message(), extras.DATA_SETS: Message()}
    about[extras.DEVICES]["Provides-Extra"] = "orca"  # an extra of another distribution
    about[extras.DATA_SETS]["Provides-Extra"] = "objects"
    monkeypatch.setattr(metadata, "metadata", about.__getitem__)
    devices = ROOT / "packages" / "smooth_operator_devices"
    installed({"url": devices.as_uri(), "dir_info": {"editable": True}})
    assert install_command("orca") == f'python -m pip install -e "{devices}[orca]"'
    monkeypatch.chdir(ROOT)
    assert install_command("orca") == f'python -m pip install -e "./packages/{devices.name}[orca]"'
    installed(None)
    assert install_command("orca") == 'python -m pip install "smooth-operator-devices[orca]"'
    assert install_command("objects") == 'python -m pip install "smooth-hand-datasets[objects]"'
    assert install_command("zmq") == by_name


# Runs in a fresh interpreter that has the base alone: what each command and import comes to.
PROBE = """
import contextlib, importlib, io, json, sys
commands, modules, libraries = json.loads(sys.argv[1])
sys.modules.update(dict.fromkeys(libraries))
from smooth_operator.cli import main
from smooth_operator.errors import MissingExtraError
found = {}
for command in commands:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(command.split())
    found[command] = [status, err.getvalue()]
for module in modules:
    try:
        importlib.import_module(module)
    except MissingExtraError as error:
        found[module] = [None, str(error)]
print(json.dumps(found))
"""

WORK = [
    "--help",
    "hands list",
    "hands show leap_hand --no-view",
    "sample in.npz --duration 0.5 --quiet",
    "retarget in.npz --method joint_angle --output out.npz --quiet",
    "convert in.npz --output copy.npz --quiet",
    "teleop --no-view --method joint_angle --duration 0.3 --quiet",
]
LACK = {
    "demo": "teleop",
    "dataset in.npz --cluster auto --output data": "cluster",
    "teleop": "teleop",
    "teleop --arm panda": "arm",
    "teleop --no-view --sink record:x.mcap": "teleop",
    "teleop --no-view --source webcam": "webcam",
    "teleop --no-view --source webxr": "webxr",
    "view out.npz in.npz": "teleop",
    "latency x.mcap": "teleop",
    "sample x.mcap": "teleop",
    "hands show leap_hand": "teleop",
    "hands render leap_hand": "teleop",
    "convert in.npz --output x.h5": "hdf5",
    "calibrate in.npz --output operator.json": "teleop",
    "train geort in.npz --output trained": "training",
}
MODULES = {
    "smooth_operator.baselines.geort.training": "training",
    "smooth_operator.teleop.pages.player": "teleop",
    "smooth_operator.teleop.pages.live.live_page": "teleop",
    "smooth_operator.teleop.recording.log": "teleop",
    "smooth_operator.teleop.recording.log_reader": "teleop",
    "smooth_operator.teleop.sinks.record": "teleop",
    "smooth_operator.reporting.drawing": "teleop",
}


def test_without_extras_a_command_works_or_names_what_it_lacks(tmp_path):
    nodes = (
        node for path in SOURCE.rglob("*.py") for node in ast.walk(ast.parse(path.read_bytes()))
    )
    # tyro looks for msgspec among the loaded modules
    libraries = {name for node in nodes for name in imported_by(node)} - KNOWN - {"msgspec"}
    assert {"mcap", "viser", "cv2"} < libraries
    asked = json.dumps([[*WORK, *LACK], list(MODULES), sorted(libraries)])
    done = python("-c", PROBE, asked, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    for command in WORK:
        assert found[command][0] == 0, (command, found[command])
    for what, extra in (LACK | MODULES).items():
        status, text = found.get(what, (None, "it was imported"))
        assert status in (2, None), (what, text)
        words = " and the extra ".join(f"'{one}'" for one in extra.split(","))
        assert re.search(rf"needs the extra {words}: python -m pip install .*\[{extra}\]", text)
        assert text.strip().count("\n") == 0, (what, text)
    assert {path.name for path in tmp_path.iterdir()} == {
        "in.npz",
        "out.npz",
        "out.json",
        "copy.npz",
    }

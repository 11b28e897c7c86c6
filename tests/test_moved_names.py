"""Old names of packages: importing one says what it is called now."""

from __future__ import annotations

import importlib
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

import smooth_operator
from smooth_operator.moved_names import FORMER, MOVED, MovedNames, install

SOURCE = Path(smooth_operator.__file__).parent

OLD_IMPORTS = (
    ("from smooth_operator.recording import read_recording", "formats"),
    ("from smooth_operator.recording import read_log", "teleop.recording"),
    ("from smooth_operator.recording.readers import read_recording", "formats"),
    ("from smooth_operator.retargeters.sbr import SbrConfig", "methods"),
    ("from smooth_operator.retargeters.operated import operated_by", "methods"),
    ("from smooth_operator.sources.synthetic import SyntheticOperator", "synthetic"),
    ("from smooth_operator.sources.live import Mailbox", "teleop"),
    ("from smooth_operator.sinks.runner import SinkRunner", "teleop"),
    ("from smooth_operator.sinks.zmq_sink import ZmqSink", "teleop.sinks"),
    ("from smooth_operator.runtime.remote_client import RemoteTeleop", "teleop"),
    ("from smooth_operator.live.orders import Orders", "teleop.control"),
    ("from smooth_operator.ui import serve", "teleop.pages"),
    ("from smooth_operator.offline import execute", "lab.offline"),
    ("from smooth_operator import tuning", "lab.tuning"),
    ("import smooth_operator.checkup", "lab.validation"),
    ("import smooth_operator.benchmark.results", "lab.benchmark"),
    ("import smooth_operator.ablations", "lab.paper"),
    ("import smooth_operator.training", "lab.training"),
    ("from smooth_operator.hands.discovery import discover", "lab.discovery"),
    ("from smooth_operator.human.calibration.estimate import calibrate", "calibration"),
    ("from smooth_operator.study.tasks.demonstration import play", "simulation.tasks"),
    ("from smooth_operator.metrics.plots import save_plots", "reporting.metric_plots"),
    ("from smooth_operator.documents import parse_json", "io.documents"),
    ("from smooth_operator.io.results import config_path", "formats.commands"),
    ("from smooth_operator.io import registry", "formats.registry"),
    ("from smooth_operator.io.arrays import open_arrays", "formats.arrays"),
    ("from smooth_operator.methods.geort_model import read_geort_model", "baselines.geort_model"),
    ("from smooth_operator.solvers.slsqp import SlsqpConfig", "baselines.slsqp"),
    ("from smooth_operator.human.joint_map import joint_map", "baselines.joint_map"),
    ("from smooth_operator.hands.menagerie import drawn_on", "hand_files.menagerie"),
    ("from smooth_operator.hands.catalogue import load_hand", "hands.registry"),
    ("from smooth_operator.human.anatomy import draw_anatomy", "synthetic.hand_anatomy"),
)
"""What the documentation of 0.1.0 and scripts of that time import -> what the error names."""


def exists(module: str) -> bool:
    path = SOURCE.joinpath(*module.split("."))
    return path.with_suffix(".py").is_file() or any(path.glob("*.py"))


@pytest.mark.parametrize(("statement", "home"), OLD_IMPORTS)
def test_an_old_import_says_the_new_name(statement: str, home: str) -> None:
    with pytest.raises(ModuleNotFoundError) as raised:
        exec(statement, {})
    old, *new = re.split(r" is now | and |; .*", str(raised.value))
    assert (
        f"{statement} ".replace(" import ", ".")
        .removeprefix("from ")
        .startswith((old, f"import {old}"))
    )
    assert f"smooth_operator.{home}" in new


def test_the_error_lists_the_public_names() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"smooth_operator\.formats has .*read_recording"):
        importlib.import_module("smooth_operator.recording")


@pytest.mark.parametrize("old", MOVED)
def test_a_row_is_true(old: str) -> None:
    """The old module is gone, its parent is there, and so are the new modules."""
    assert not exists(old)
    assert "." not in old or exists(old.rpartition(".")[0])
    assert [home for home in MOVED[old] if not exists(home)] == []


@pytest.mark.parametrize("old", FORMER)
def test_a_former_name_of_a_package_is_that_of_its_new_home(old: str) -> None:
    package, _, name = old.rpartition(".")
    home = importlib.import_module(f"smooth_operator.{FORMER[old]}")
    now = re.escape(f"smooth_operator.{old} is now {home.__name__}.{name}")
    with pytest.warns(DeprecationWarning, match=now):
        found = getattr(importlib.import_module(f"smooth_operator.{package}".rstrip(".")), name)
    assert found is getattr(home, name)


def test_other_names_fail_as_before() -> None:
    for name in ("smooth_operator.gadget", "smooth_operator.methods.gadget", "recording_of_nobody"):
        with pytest.raises(ModuleNotFoundError, match=rf"^No module named '{name}'$"):
            importlib.import_module(name)
        assert importlib.util.find_spec(name) is None
    assert MovedNames().find_spec("retargeters") is None


def test_the_finder_is_the_last_and_only_one() -> None:
    install()
    found = [isinstance(finder, MovedNames) for finder in sys.meta_path]
    assert sum(found) == 1
    code = "import sys, smooth_operator; print(type(sys.meta_path[-1]).__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "MovedNames"

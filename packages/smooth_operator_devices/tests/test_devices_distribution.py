"""The distribution of devices: its entry points, extras and libraries."""

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest

from smooth_operator.cli.options import COMMANDS
from smooth_operator.errors import ConfigError, MissingExtraError
from smooth_operator.teleop.components import SINKS, SOURCES, build_source
from smooth_operator_devices import HardwareSink

HOME = Path(__file__).resolve().parents[1]
SOURCE = HOME / "smooth_operator_devices"
PROJECT, CORE = (
    tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for folder in (HOME, HOME.parents[1])
)
MODULES = {
    "bc_revo3_sdk": "bc-revo3-sdk",
    "bc_stark_sdk": "bc-stark-sdk",
    "can": "python-can",
    "dynamixel_sdk": "dynamixel-sdk",
    "google": "protobuf",
    "orca_core": "orca-core",
    "rerun": "rerun-sdk",
    "serial": "pyserial",
    "wuji_sdk": "wuji-sdk",
    "xr": "pyopenxr",
    "zmq": "pyzmq",
}
"""Module -> the distribution that has it, where their names differ."""
REGISTRIES = pytest.mark.parametrize("registry", [SINKS, SOURCES, COMMANDS], ids=lambda r: r.kind)


@REGISTRIES
def test_every_part_is_an_entry_point_that_the_core_knows(registry):
    points = PROJECT["entry-points"][registry.group]
    assert {name: registry.plugins[name].target for name in points} == points
    assert points.keys() <= registry.elsewhere.keys()
    assert registry.kind == "command" or points.keys() == registry.summaries.keys()
    assert not points.keys() & registry.built_in.keys()


@pytest.mark.parametrize("registry", [SINKS, SOURCES], ids=lambda registry: registry.kind)
def test_the_core_names_the_extra_of_each_part(registry):
    for name, advice in registry.elsewhere.items():
        extras = re.findall(r"smooth_operator_devices\[(\w+)\]", advice)
        assert set(extras) <= PROJECT["optional-dependencies"].keys()
        assert bool(extras) == registry.summaries[name].endswith(" extra)")


def test_drivers_move_real_hands_and_other_sinks_do_not():
    real = {name for name, kind in SINKS.loadable().items() if kind.moves_real_hand}
    drivers = {path.stem for path in (SOURCE / "hands" / "drivers").glob("*.py")}
    assert real - {"leap"} <= drivers  # leap is in the module of dynamixel
    others = {"rerun", "ros2"}
    assert real == PROJECT["entry-points"][SINKS.group].keys() - others
    assert all(issubclass(SINKS.load(name), HardwareSink) for name in real)


def test_libraries_of_every_module_are_declared():
    brought = [
        *CORE["dependencies"],
        *CORE["optional-dependencies"]["teleop"],
        *(need for extra in PROJECT["optional-dependencies"].values() for need in extra),
    ]
    needs = {re.split(r"[\[<>=~;]", need)[0] for need in brought}
    known = sys.stdlib_module_names | needs | {"smooth_operator", "smooth_operator_devices"}
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert not node.level, path
                names = [node.module or ""]
            tops = {name.split(".")[0] for name in names}
            assert {MODULES.get(top, top) for top in tops} <= known, path


@pytest.mark.parametrize(
    ("name", "module"), [("rokoko", "lz4.frame"), ("openxr", "xr"), ("isaac", "isaacteleop")]
)
def test_a_source_without_its_library_names_the_extra(monkeypatch, name, module):
    for loaded in [each for each in sys.modules if each.startswith(f"{module}.")]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=f"'{name}' needs the extra '{name}'"):
        build_source(name).connect()


@pytest.mark.parametrize("name", ["openxr", "isaac"])
def test_the_rate_of_a_source_that_asks_a_library_is_checked(name):
    with pytest.raises(ConfigError, match="rate must be 1 to 1000 Hz, not 0"):
        build_source(f"{name}:rate=0")

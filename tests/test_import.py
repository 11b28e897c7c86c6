"""``import smooth_operator``: quick, without side effects, and with a fixed list of names."""

import importlib
import importlib.metadata
import os
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import processes
import pytest

from smooth_operator.extras import install_command

PROJECT = Path(__file__).resolve().parents[1]
IMPORT_BUDGET_S = 2.0
HEAVY = ("matplotlib", "viser", "mcap", "tyro", "rich")
"""What only some commands need: no part of it may come with the library."""

LIBRARIES = (*HEAVY, "jax", "mujoco", "numpy", "scipy", "trimesh")
"""What no package may import before one of its names is asked for."""

MOST_NAMES = 50
PUBLIC_NAMES = Path(__file__).with_name("public_names.txt")
PUBLIC_PACKAGES = (
    "calibration",
    "formats",
    "hand_discovery",
    "hands",
    "metrics",
    "retargeting",
    "teleop",
)

PUBLIC_MODULES = ("errors", "landmarks")
"""Modules whose public names are in their ``__all__``."""
APART = (*PUBLIC_MODULES, "calibration", "formats")
"""Counted apart: errors, index maps, and readers and writers, which are one for each case."""


def python(*arguments: str, **environment: str) -> str:
    """Standard output of a fresh interpreter."""
    return processes.python(*arguments, env=os.environ | environment, check=True).stdout


def test_import_is_quick_and_leaves_the_heavy_libraries_alone():
    code = "import sys, time; start = time.process_time(); import smooth_operator; "
    code += "print(time.process_time() - start, *sys.modules)"
    # Of the processor. Best of three: the first may compile byte code.
    runs = [python("-c", code).split() for _ in range(3)]
    seconds = min(float(run[0]) for run in runs)
    assert seconds < IMPORT_BUDGET_S, "find out why with: python -X importtime"
    assert not {name.split(".")[0] for name in runs[0]} & set(HEAVY), "import them lazily"


def test_import_initialises_no_jax_backend():
    # With a platform that does not exist, whatever touches a backend raises.
    nowhere = {"JAX_PLATFORMS": "no_such_platform"}
    python("-c", "import smooth_operator", **nowhere)
    with pytest.raises(AssertionError, match="no_such_platform"):
        python("-c", "import jax.numpy as jnp; jnp.zeros(3)", **nowhere)


def packages() -> dict[str, ModuleType]:
    own = (f"smooth_operator.{name}" for name in PUBLIC_PACKAGES)
    others = (f"smooth_operator_{name}" for name in ("benchmark", "study", "devices"))
    names = ("smooth_operator", *own, "smooth_hand_datasets.pipeline", *others)
    return {name: importlib.import_module(name) for name in names}


def public_names() -> list[str]:
    names = {f"{name}.{x}" for name, package in packages().items() for x in package.__all__}
    for name in (f"smooth_operator.{module}" for module in PUBLIC_MODULES):
        module = importlib.import_module(name)
        assert [x for x in module.__all__ if not hasattr(module, x)] == []
        names |= {f"{name}.{x}" for x in module.__all__}
    return sorted(names)


def test_the_public_names_are_few():
    """A name that stands in two packages counts once; those of APART, of other distributions and
    the version do not."""
    apart = {name.rpartition(".")[2] for name in public_names() if name.split(".")[1] in APART}
    own = [name for name in public_names() if name.startswith("smooth_operator.")]
    names = {name.rpartition(".")[2] for name in own} - apart - {"__version__"}
    assert len(names) <= MOST_NAMES


def test_public_names_are_the_recorded_ones():
    names = public_names()
    recorded = PUBLIC_NAMES.read_text(encoding="utf-8").split()
    assert names == recorded, (
        f"added: {sorted(set(names) - set(recorded))}, gone: {sorted(set(recorded) - set(names))}. "
        "If that is meant, note it in CHANGELOG.md and run: python tests/test_import.py"
    )


def test_a_public_name_is_one_object_and_no_module():
    """Importing ``package.name`` would put a module of that name in the place of the object."""
    homes: dict[str, Any] = {}
    for name, package in packages().items():
        folder = Path(package.__file__ or "").parent
        assert len(set(package.__all__)) == len(package.__all__)
        assert not {path.stem for path in folder.iterdir()} & set(package.__all__), name
        assert set(package.__all__) <= set(dir(package))
        for public in package.__all__:
            found = getattr(package, public)
            assert homes.setdefault(public, found) is found, public
        with pytest.raises(AttributeError, match=rf"module '{name}' has no attribute 'Gadget'"):
            _ = package.Gadget


def test_subpackages_are_attributes_of_the_package():
    names = "; ".join(f"smooth_operator.{name}.__all__" for name in PUBLIC_PACKAGES)
    loaded = python("-c", f"import sys, smooth_operator; {names}; print(*sys.modules)").split()
    assert not {name.split(".")[0] for name in loaded} & set(LIBRARIES)
    assert {f"smooth_operator.{name}" for name in PUBLIC_PACKAGES} <= set(loaded)


@pytest.mark.parametrize(
    ("statement", "libraries"),
    [
        ("import smooth_operator.cli.options", {"numpy", "jax", "scipy", "mujoco"}),  # for --help
        ("from smooth_operator.metrics import evaluate", {"matplotlib"}),
    ],
)
def test_an_import_leaves_the_libraries_alone_that_it_does_not_need(statement, libraries):
    loaded = python("-c", f"{statement}; import sys; print(*sys.modules)").split()
    assert not libraries & set(loaded)


def test_version_is_that_of_the_project_or_unknown(monkeypatch):
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    module = importlib.import_module("smooth_operator.version")
    assert importlib.import_module("smooth_operator").__version__ == project["version"]

    def absent(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(module, "version", absent)
    assert module.package_version() == "0+unknown"


def test_a_wing_without_its_libraries_names_its_extra(tmp_path):
    """One line with the command that installs it; the same for a name of the package."""
    (tmp_path / "jax.py").write_text("raise ModuleNotFoundError('No module', name='jax')\n")
    code = (
        "import smooth_operator as s\n"
        "try:\n    s.teleop.TeleopLoop\n"
        "except ImportError as error:\n    print(type(error).__name__, error)\n"
        "try:\n    s.Hand\n"
        "except ImportError as error:\n    print(type(error).__name__, error)\n"
    )
    wing, core = python("-c", code, PYTHONPATH=str(tmp_path)).splitlines()
    assert wing.startswith("MissingExtraError smooth_operator.teleop.TeleopLoop needs the extra")
    assert wing.endswith(install_command("teleop"))
    assert core.startswith("ModuleNotFoundError")


if __name__ == "__main__":
    PUBLIC_NAMES.write_text("\n".join(public_names()) + "\n", encoding="utf-8")

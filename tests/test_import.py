"""``import smooth_operator``: quick, without side effects, and with a fixed list of names."""

import importlib
import importlib.metadata
import json
import os
import re
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

# Runs in a fresh interpreter, with the statements to judge, one by one, as its arguments. JAX is
# imported first: what it does to the process is not ours to answer for.
PROBE = """
import json, locale, logging, os, random, signal, sys, threading, warnings
import jax, numpy as np

def signals():
    return {s.name: str(signal.getsignal(s)) for s in signal.valid_signals() if hasattr(s, "name")}

def loggers():
    named = {n: x for n, x in logging.root.manager.loggerDict.items() if hasattr(x, "handlers")}
    return {
        name: (logger.level, logger.disabled, [str(h) for h in logger.handlers])
        for name, logger in {"root": logging.root, **named}.items()
        if logger.handlers or logger.level or logger.disabled
    }

def picture():
    return {
        "jax config": {k: repr(v) for k, v in jax.config.values.items()},
        "environment": dict(os.environ),
        "warning filters": [str(f) for f in warnings.filters],
        "log handlers": loggers(),
        "numpy error state": np.geterr(),
        "numpy print options": {k: repr(v) for k, v in np.get_printoptions().items()},
        "numpy random state": repr(np.random.get_state()),
        "python random state": hash(random.getstate()),
        "module search path": list(sys.path),
        "hooks": [repr(sys.excepthook), repr(sys.displayhook), repr(threading.excepthook)],
        "signal handlers": signals(),
        "locale": locale.setlocale(locale.LC_ALL),
        "threads": sorted(t.name for t in threading.enumerate()),
        "working directory": os.getcwd(),
        "recursion limit": sys.getrecursionlimit(),
    }

changed = []
for statement in sys.argv[1:]:
    before = picture()
    exec(statement)
    after = picture()
    changed.append({k: [before[k], after[k]] for k in before if before[k] != after[k]})
print(json.dumps({"changed": changed, "modules": sorted(sys.modules)}))
"""

TIMER = """
import time
start = time.process_time()
import smooth_operator
print(time.process_time() - start)
"""


def python(*arguments: str, **environment: str) -> str:
    """Standard output of a fresh interpreter."""
    return processes.python(*arguments, env=os.environ | environment, check=True).stdout


def probe(*statements: str) -> dict[str, Any]:
    """What each statement changed, and the modules that are loaded after the last."""
    return json.loads(python("-c", PROBE, *statements))


@pytest.fixture(scope="module")
def imported() -> dict[str, Any]:
    return probe("import smooth_operator")


def test_import_takes_less_than_two_seconds():
    # Of the processor. Best of three: the first may compile byte code.
    best = min(float(python("-c", TIMER)) for _ in range(3))
    assert best < IMPORT_BUDGET_S, (
        f"import smooth_operator took {best:.2f} s, more than {IMPORT_BUDGET_S} s; "
        "find out why with: python -X importtime -c 'import smooth_operator'"
    )


def test_import_changes_no_global_state(imported):
    assert imported["changed"] == [{}]


def test_import_leaves_the_heavy_libraries_alone(imported):
    loaded = {name.split(".")[0] for name in imported["modules"]} & set(HEAVY)
    assert not loaded, f"import smooth_operator also imports {sorted(loaded)}; import them lazily"


def test_import_initialises_no_jax_backend():
    # With a platform that does not exist, whatever touches a backend raises.
    nowhere = {"JAX_PLATFORMS": "no_such_platform"}
    python("-c", "import smooth_operator", **nowhere)
    with pytest.raises(AssertionError, match="no_such_platform"):
        python("-c", "import jax.numpy as jnp; jnp.zeros(3)", **nowhere)


def packages() -> dict[str, ModuleType]:
    own = (f"smooth_operator.{name}" for name in PUBLIC_PACKAGES)
    names = ("smooth_operator", *own, "smooth_operator_study", "smooth_operator_devices")
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


def test_public_names_exist_once():
    for package in packages().values():
        assert len(set(package.__all__)) == len(package.__all__)
        assert [name for name in package.__all__ if not hasattr(package, name)] == []
        assert set(package.__all__) <= set(dir(package))


def test_a_public_name_is_one_object_wherever_it_is():
    homes: dict[str, list[Any]] = {}
    for package in packages().values():
        for name in package.__all__:
            homes.setdefault(name, []).append(getattr(package, name))
    assert [name for name, found in homes.items() if any(x is not found[0] for x in found)] == []


def test_no_public_name_is_also_a_module():
    """Importing ``package.name`` would put the module in the place of the object."""
    for name, package in packages().items():
        folder = Path(package.__file__ or "").parent
        modules = {path.stem for path in folder.glob("*.py")} | {p.name for p in folder.iterdir()}
        assert not modules & set(package.__all__), name


def test_subpackages_are_attributes_of_the_package():
    names = "; ".join(f"smooth_operator.{name}.__all__" for name in PUBLIC_PACKAGES)
    loaded = python("-c", f"import sys, smooth_operator; {names}; print(*sys.modules)").split()
    assert not {name.split(".")[0] for name in loaded} & set(LIBRARIES)
    assert {f"smooth_operator.{name}" for name in PUBLIC_PACKAGES} <= set(loaded)


def test_an_unknown_name_is_an_attribute_error():
    for name, package in packages().items():
        with pytest.raises(AttributeError, match=rf"module '{name}' has no attribute 'Gadget'"):
            _ = package.Gadget


def test_version_is_that_of_the_project():
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert importlib.import_module("smooth_operator").__version__ == project["version"]


def test_version_without_an_installed_distribution(monkeypatch):
    def absent(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    module = importlib.import_module("smooth_operator.version")
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


def test_pip_is_asked_for_our_distribution_only():
    """The package index has another program of the command's name."""
    files = [*PROJECT.glob("src/**/*.py"), *PROJECT.glob("docs/**/*.md"), *PROJECT.glob("*.md")]
    wrong = re.compile(r"(install|upgrade) +['\"]?smooth-operator\b")
    assert [path.name for path in files if wrong.search(path.read_text(encoding="utf-8"))] == []


if __name__ == "__main__":
    PUBLIC_NAMES.write_text("\n".join(public_names()) + "\n", encoding="utf-8")

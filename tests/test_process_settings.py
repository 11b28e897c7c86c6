"""A call of the library changes no setting of the process, and uses no private part of others."""

import ast
import json
import os
from collections.abc import Iterator
from pathlib import Path

from processes import python

SETTINGS = """
import json, logging, os, signal, sys, threading, warnings

def settings():
    import jax
    root = logging.getLogger()
    return {
        "environment": dict(os.environ),
        "filters of warnings": list(map(repr, warnings.filters)),
        "shown by": repr(warnings.showwarning),
        "signals": {str(n): repr(signal.getsignal(n)) for n in signal.valid_signals()},
        "logging": [root.level, list(map(repr, root.handlers)), logging.root.manager.disable,
                    repr(logging.lastResort)],
        "path": sys.path[:],
        "modules": {name: None for name, module in sys.modules.items() if module is None},
        "hooks": [repr(getattr(sys, name)) for name in
                  ("excepthook", "unraisablehook", "displayhook", "stdout", "stderr")]
                 + [repr(threading.excepthook), sys.getswitchinterval(), sys.getrecursionlimit()],
        "cores": sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [],
        "folder": os.getcwd(),
        "jax": {name: repr(value) for name, value in jax.config.values.items()},
    }
"""

CALLS = """
from pathlib import Path
import smooth_operator as so
from smooth_operator import Retargeter, SyntheticOperator
from smooth_operator.errors import SourceError
from smooth_operator.hands.registry import load_hand
from smooth_operator.retargeting.batching import BatchRetargeter
from smooth_operator.teleop.pages.hand_page import HandPage
from smooth_operator.teleop.sources.webcam import camera, webcam_source

def frame():
    retargeter = Retargeter(method="joint_angle")
    for frame in SyntheticOperator().record(0.05):
        retargeter(frame)

def batch():
    recordings = [SyntheticOperator(seed=seed).record(0.1) for seed in (1, 2)]
    BatchRetargeter(method="joint_angle").batch(recordings)

def page():
    with HandPage(load_hand("mimic_p050"), port=0) as page:
        assert page.url.startswith("http://")

def webcam():
    for look in (lambda: camera.open_camera(97, 640, 480, 30.0),
                 lambda: camera.VideoFile(Path(camera.__file__))):
        try:
            look()
        except SourceError:
            continue
        raise AssertionError("there is no such camera, and no video in that file")

changes = {}
for call in (frame, batch, page, webcam):
    before = settings()
    call()
    after = settings()
    changes[call.__name__] = {k: [v, after[k]] for k, v in before.items() if v != after[k]}
print(json.dumps(changes))
"""


def test_a_call_changes_no_setting_of_the_process(tmp_path):
    """The libraries are imported before, since what their imports set is not this package's."""
    libraries = "import jax, mujoco, numpy\nfor name in ('viser', 'cv2', 'mediapipe', 'rich'):\n"
    libraries += "    try: __import__(name)\n    except ImportError: pass\n"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_COMPILATION")}
    environment |= {"SMOOTH_OPERATOR_CACHE": str(tmp_path), "JAX_PLATFORMS": "cpu"}
    done = python("-c", SETTINGS + libraries + CALLS, env=environment)
    assert done.returncode == 0, done.stderr
    changes = json.loads(done.stdout.splitlines()[-1])
    assert changes == {"frame": {}, "batch": {}, "page": {}, "webcam": {}}


HOME = Path(__file__).resolve().parent.parent
SOURCES = sorted(
    path
    for folder in ("src", "research/src", "research/benchmarks", "packages")
    for path in (HOME / folder).rglob("*.py")
    if "tests" not in path.parts and ".venv" not in path.parts
)
DOCUMENTED = {"_exit", "_replace", "_fields", "_asdict", "_thread"}
"""Names that Python documents: of os, of named tuples, and a module."""


def names_of(nodes: list[ast.AST]) -> Iterator[str]:
    """Underscore names that a module defines: functions, classes, variables, fields."""
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value  # as in setattr


def private_uses(nodes: list[ast.AST], own: set[str]) -> Iterator[str]:
    """Underscore names that a module takes, and that this repository does not define."""
    for node in nodes:
        if isinstance(node, ast.Attribute):
            names = [node.attr]
        elif isinstance(node, ast.ImportFrom):
            own_module = (node.module or "").split(".")[0].startswith(("smooth_", "lerobot_"))
            names = [] if own_module else [*(node.module or "").split("."), *_names(node)]
        elif isinstance(node, ast.Import):
            names = [part for name in _names(node) for part in name.split(".")]
        else:
            continue
        known = DOCUMENTED | own if isinstance(node, ast.Attribute) else DOCUMENTED
        for name in names:
            if name.startswith("_") and not name.endswith("__") and name not in known:
                yield f"{name} (line {node.lineno})"


def _names(node: ast.Import | ast.ImportFrom) -> list[str]:
    return [each.name for each in node.names]


def test_private_parts_of_other_packages_are_found():
    code = "import a._b\nfrom c import _d\nfrom e._f import g\nh._i()\nself._own = 1\nx._own\n"
    nodes = list(ast.walk(ast.parse(code)))
    assert [use.split()[0] for use in private_uses(nodes, set(names_of(nodes)))] == [
        "_b",
        "_d",
        "_f",
        "_i",
    ]


def test_no_private_part_of_another_package_is_used():
    kinds = (ast.stmt, ast.Attribute, ast.Name, ast.Constant)
    trees = {
        path: [
            node
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, kinds)
        ]
        for path in SOURCES
    }
    assert len(trees) > 300
    own = {name for nodes in trees.values() for name in names_of(nodes) if name.startswith("_")}
    found = {
        str(path.relative_to(HOME)): uses
        for path, nodes in trees.items()
        if (uses := sorted(private_uses(nodes, own)))
    }
    assert found == {}

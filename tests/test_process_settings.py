"""A call of the library changes no setting of the process, and uses no private part of others."""

import ast
import json
import os
from collections.abc import Iterator
from pathlib import Path

from processes import python

SETTINGS = """
import json, locale, logging, os, random, signal, sys, threading, warnings

def settings():
    import jax, numpy
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
        "numpy": [numpy.geterr(), repr(numpy.get_printoptions()), repr(numpy.random.get_state())],
        "random numbers": hash(random.getstate()),
        "locale": locale.setlocale(locale.LC_ALL),
        "jax": {name: repr(value) for name, value in jax.config.values.items()},
    }
"""

CALLS = """
from pathlib import Path
before = settings()
import smooth_operator
after = settings()
changes = {"import": {k: [v, after[k]] for k, v in before.items() if v != after[k]}}
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

for call in (frame, batch, page, webcam):
    before = settings()
    call()
    after = settings()
    changes[call.__name__] = {k: [v, after[k]] for k, v in before.items() if v != after[k]}
print(json.dumps(changes))
"""


def test_an_import_or_a_call_changes_no_setting_of_the_process(tmp_path):
    """The libraries are imported before, since what their imports set is not this package's."""
    libraries = "import jax, mujoco, numpy\nfor name in ('viser', 'cv2', 'mediapipe', 'rich'):\n"
    libraries += "    try: __import__(name)\n    except ImportError: pass\n"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_COMPILATION")}
    environment |= {"SMOOTH_OPERATOR_CACHE": str(tmp_path), "JAX_PLATFORMS": "cpu"}
    done = python("-c", SETTINGS + libraries + CALLS, env=environment)
    assert done.returncode == 0, done.stderr
    changes = json.loads(done.stdout.splitlines()[-1])
    assert changes.pop("page").keys() <= {"random numbers"}  # websockets draws some
    assert changes == {"import": {}, "frame": {}, "batch": {}, "webcam": {}}


HOME = Path(__file__).resolve().parent.parent
SOURCES = sorted(
    path
    for folder in ("src", "research/src", "research/benchmarks", "packages")
    for path in (HOME / folder).rglob("*.py")
    if "tests" not in path.parts and ".venv" not in path.parts
)
DOCUMENTED = {"_exit", "_replace", "_fields", "_asdict", "_thread"}
"""Names that Python documents: of os, of named tuples, and a module."""


def defined_in(tree: ast.AST) -> Iterator[str]:
    """Names that a module defines: functions, classes, variables, fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value  # as in setattr


def taken_in(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """(line, name) of the attributes that a module reads, and of what it imports from others."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            yield node.lineno, node.attr
        elif isinstance(node, ast.ImportFrom | ast.Import):
            module = getattr(node, "module", None) or ""
            if not module.startswith(("smooth_", "lerobot_")):
                names = ".".join([module, *(alias.name for alias in node.names)])
                yield from ((node.lineno, name) for name in names.split("."))


def test_no_private_part_of_another_package_is_used():
    """A name with an underscore that this repository does not define belongs to someone else."""
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}
    assert len(trees) > 300
    known = DOCUMENTED.union(*map(defined_in, trees.values()))
    found = [
        f"{path.relative_to(HOME)}:{line}: {name}"
        for path, tree in trees.items()
        for line, name in taken_in(tree)
        if name.startswith("_") and not name.endswith("__") and name not in known
    ]
    assert found == []
    tree = ast.parse("import a._b\nfrom c import _d\nfrom e._f import g\nh._i()")
    assert {"_b", "_d", "_f", "_i"} <= {name for _, name in taken_in(tree)}

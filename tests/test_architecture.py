"""Imports of the package follow the levels of ``docs/explanation/architecture.md``."""

import ast
import functools
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = "smooth_operator"
SOURCE = Path(__file__).resolve().parents[1] / "src" / PACKAGE
RESEARCH = SOURCE.parents[1] / "research" / "src" / "smooth_operator_research"
"""Experiments outside the wheel: they may import all of the package, which imports none of them."""
DATA_SETS = SOURCE.parents[1] / "packages" / "smooth_hand_datasets" / "smooth_hand_datasets"
"""The pipeline of data sets and research data sets, outside the wheel in the same way."""
BENCHMARK = (
    SOURCE.parents[1] / "packages" / "smooth_operator_benchmark" / "smooth_operator_benchmark"
)
"""The benchmark, outside the wheel in the same way."""
STUDY = SOURCE.parents[1] / "packages" / "smooth_operator_study" / "smooth_operator_study"
"""The user study, outside the wheel in the same way."""
DEVICES = SOURCE.parents[1] / "packages" / "smooth_operator_devices" / "smooth_operator_devices"
"""Real hands, trackers and ROS 2, outside the wheel in the same way."""
OTHERS = [RESEARCH, DATA_SETS, BENCHMARK, STUDY, DEVICES]
ALL = pytest.mark.parametrize("source", [SOURCE, *OTHERS], ids=lambda path: path.name)

ROOT = "__init__"
"""The package itself: the public names, re-exported from the levels up to its own."""

CORE = {
    "errors": 0,
    "extras": 0,
    "lazy_names": 0,
    "version": 1,
    "landmarks": 0,
    "geometry": 0,
    "terminal": 0,
    "user_folders": 0,
    "settings": 1,
    "own_files": 1,
    "source_digest": 1,
    "plugins": 1,
    "types": 1,
    "io": 2,
    "hands": 3,
    "retargeting": 4,
    "metrics": 5,
}
"""Core: module -> level. It imports nothing of what follows."""

SHARED = {
    "console": 1,
    "reporter": 0,
    "signals": 0,
    "atomic_files": 3,
    "formats": 3,
    "parallel": 3,
    "poses": 3,
    "web": 3,
    "episode_files": 4,
    "hand_files": 4,
    "result_cache": 4,
    "headsets": 5,
    "simulation": 5,
    "calibration": 5,
    "synthetic": 5,
    "wrist_following": 6,
    ROOT: 7,
    "baselines": 7,
    "execution": 7,
    "planning": 7,
    "request": 7,
    "reporting": 7,
}
"""What several wings use: module -> level. It imports no wing."""

WINGS = {"teleop": 8, "hand_discovery": 8}
"""Wings: each imports the core, what is shared, and itself."""

LEVELS = CORE | SHARED | WINGS | {"cli": 9, "__main__": 9}
"""Top-level module -> level, as ``docs/explanation/architecture.md`` lists them."""

KNOWN_UPWARD = {
    "formats/registry.py": {"episode_files", "headsets.recordings", "teleop.recording"},
}
"""File -> what it imports from above by a text such as ``Entry("smooth_operator...")``. Such an
import hides an arrow that runs up, so the list only shrinks: a new one fails, and so does one that
is gone and still listed."""

START = "retargeting.retargeter"
"""Module of ``Retargeter``, where the closure begins."""

CLOSURE_LINES = 10_193
"""Most lines of the modules that ``Retargeter`` can import: the core grows only on purpose."""

MAX_LINES = 700
UNPICKLERS = {"pickle", "_pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
TARGET = re.compile(rf"{PACKAGE}(\.\w+)+(:[\w.]+)?")
RESTRICTED = {"smooth_hand_datasets/unpickle.py"}
"""Reads pickles as data, with an ``Unpickler`` that refuses every name but a few."""
DRAWERS = {"util", "utils", "helpers", "misc"}


def modules(source: Path) -> list[Path]:
    """Source files, and the stubs from which packages load their public names."""
    return sorted([*source.rglob("*.py"), *source.rglob("*.pyi")])


def place(source: Path, path: Path) -> str:
    """A file as messages name it, from the name of its package on."""
    return path.relative_to(source.parent).as_posix()


def top_level(source: Path, path: Path) -> str:
    """Name of the top-level module that a file belongs to, as in ``LEVELS``."""
    return path.relative_to(source).with_suffix("").parts[0]


@functools.cache
def nodes_of(path: Path) -> list[ast.AST]:
    """All nodes of a file's syntax tree, parsed once for all tests."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def imported_modules(source: Path, path: Path) -> Iterator[tuple[int, str]]:
    """(line, dotted absolute name) of every import in a file, however deep in a function it hides.

    Relative imports are resolved, and so are constant names given to ``import_module``.
    """
    package = (PACKAGE, *path.relative_to(source).parent.parts)
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            prefix = package[: len(package) - node.level + 1] if node.level else ()
            base = ".".join((*prefix, *filter(None, [node.module])))
            # `from package import name` may name a module: only the files can tell.
            yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Call) and node.args:
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            argument = node.args[0]
            if name in {"import_module", "__import__"} and isinstance(argument, ast.Constant):
                yield node.lineno, str(argument.value).lstrip(".")


def imported_by_text(path: Path) -> Iterator[str]:
    """Dotted names in the texts of a file that may be modules: of ``Entry``, ``files``, tables."""
    for node in nodes_of(path):
        text = node.value if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and TARGET.fullmatch(text):
            yield text.replace(":", ".")


def module_of(source: Path, name: str) -> str:
    """File or folder that a dotted name of the package begins with, without the package's name."""
    parts = name.split(".")[1:]
    while parts and not (
        source.joinpath(*parts).is_dir() or source.joinpath(*parts).with_suffix(".py").is_file()
    ):
        parts = parts[:-1]
    return ".".join(parts)


def upward_by_text(source: Path) -> dict[str, set[str]]:
    """File -> modules above its level, or in another wing, that it names in a text."""
    upward: dict[str, set[str]] = {}
    for path in modules(source):
        module = top_level(source, path)
        for name in filter(None, (module_of(source, n) for n in imported_by_text(path))):
            target = name.split(".")[0]
            other_wing = target != module and {module, target} <= WINGS.keys()
            if other_wing or LEVELS.get(target, 0) > LEVELS.get(module, 0):
                upward.setdefault(path.relative_to(source).as_posix(), set()).add(name)
    return upward


def closure(source: Path, start: str) -> dict[str, int]:
    """Module -> lines of all that a module can import: statements anywhere, and texts.

    A public name of a package leads to the module that has it, as its stub says.
    """
    homes = {
        ".".join((PACKAGE, *stub.relative_to(source).parent.parts, name.rpartition(".")[2])): name
        for stub in source.rglob("__init__.pyi")
        for _, name in imported_modules(source, stub)
    }
    lines: dict[str, int] = {}
    waiting = [start]
    while waiting:
        module = waiting.pop()
        path = source.joinpath(*module.split("."))
        path = path / f"{ROOT}.py" if path.is_dir() else path.with_suffix(".py")
        if module in lines or not path.is_file():
            continue
        lines[module] = len(path.read_text(encoding="utf-8").splitlines())
        names = [name for _, name in imported_modules(source, path)] + [*imported_by_text(path)]
        own = (homes.get(name, name) for name in names if name.startswith(f"{PACKAGE}."))
        waiting += filter(None, (module_of(source, name) for name in own))
    return lines


def level_violations(source: Path) -> list[str]:
    found = []
    for path in modules(source):
        module, where = top_level(source, path), place(source, path)
        if module not in LEVELS:
            found.append(
                f"{where}: no level for the new top-level module {module!r}; "
                "give it one in LEVELS here and in docs/explanation/architecture.md"
            )
            continue
        for line, name in imported_modules(source, path):
            if name.split(".")[0] != PACKAGE:
                continue
            target = module_of(source, name).split(".")[0] or ROOT
            if target != module and {module, target} <= WINGS.keys():
                found.append(
                    f"{where}:{line}: {module} may not import {target}, another wing; "
                    "move what both need into the core or a shared package"
                )
            elif path == source / "__init__.pyi" and name == f"{PACKAGE}.{target}":
                continue  # the package names its subpackages, which it loads when asked for
            elif target != module and LEVELS.get(target, 0) > LEVELS[module]:
                found.append(
                    f"{where}:{line}: {module} may import up to level {LEVELS[module]}, "
                    f"but {target} is at level {LEVELS[target]}; "
                    "import from below, or move what both need down"
                )
    return found


def cycle(source: Path) -> list[str]:
    """Modules that import each other in a circle, the first one again at the end; else none.

    Imports inside functions and below ``TYPE_CHECKING`` count: a reader has to follow them too.
    The packages around an imported module do not: their ``__init__`` only re-exports.
    """
    files = {}
    for path in modules(source):
        parts = path.relative_to(source.parent).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == ROOT else parts)] = path
    graph: dict[str, set[str]] = {module: set() for module in files}
    for module, path in files.items():
        for _, name in imported_modules(source, path):
            while name and name not in files:
                name = name.rpartition(".")[0]  # a name in a module, or of another distribution
            graph[module] |= {name} - {"", module}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])[::-1]
    return []


def unpickling(source: Path) -> list[str]:
    found = []
    for path in modules(source):
        where = place(source, path)
        found += [
            f"{where}:{line}: imports {name}: data files hold no code, nothing unpickles"
            for line, name in imported_modules(source, path)
            if name.split(".")[0] in UNPICKLERS and where not in RESTRICTED
        ]
        found += [
            f"{where}:{node.value.lineno}: allow_pickle must be False"
            for node in nodes_of(path)
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle"
            if not (isinstance(node.value, ast.Constant) and node.value.value is False)
        ]
    return found


def from_other_distributions(source: Path) -> list[tuple[str, str]]:
    """(file:line, package) of the imports from the other distributions of the repository."""
    others = {other.name for other in OTHERS} - {source.name}
    return [
        (f"{place(source, path)}:{line}", name.split(".")[0])
        for path in modules(source)
        for line, name in imported_modules(source, path)
        if name.split(".")[0] in others
    ]


def home_of(source: Path, call: ast.Call) -> Path:
    """Folder to which the paths of a call of ``code_digest`` are relative."""
    own = source.name == PACKAGE or any(keyword.arg == "home" for keyword in call.keywords)
    return source if own else SOURCE


def missing_code(source: Path) -> list[str]:
    """Paths given to ``code_digest`` that do not exist (any more).

    Without a folder of their own (``home``) they are paths of this package.
    """
    return [
        f"{place(source, path)}:{node.lineno}: {given.value!r} is not in the package: results "
        "would be used again though their code has changed; if it has moved, name its new place"
        for path in modules(source)
        for node in nodes_of(path)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "code_digest"
        for given in ast.walk(node)
        if isinstance(given, ast.Constant) and isinstance(given.value, str)
        if not (home_of(source, node) / given.value).exists()
    ]


def misshapen(source: Path) -> list[str]:
    found = []
    for path in modules(source):
        where, count = place(source, path), len(path.read_text(encoding="utf-8").splitlines())
        if count > MAX_LINES:
            found.append(f"{where}: {count} lines, more than {MAX_LINES}: split it by concept")
        if DRAWERS & {part.strip("_") for part in path.relative_to(source).with_suffix("").parts}:
            found.append(f"{where}: name a module after what it holds, not 'utils'")
    return found


def test_modules_import_only_from_their_own_level_or_below():
    assert not level_violations(SOURCE), "\n".join(level_violations(SOURCE))


def test_distributions_import_only_those_below_them():
    imported = {
        source.name: {name for _, name in from_other_distributions(source)}
        for source in (SOURCE, *OTHERS)
    }
    below = {RESEARCH.name: {BENCHMARK.name, STUDY.name}}
    assert imported == {source.name: below.get(source.name, set()) for source in (SOURCE, *OTHERS)}
    named = re.compile(
        rf"({DATA_SETS.name}|{BENCHMARK.name}|{STUDY.name}|{DEVICES.name})\.\w"
    )  # in a text
    assert [p.name for p in modules(SOURCE) if named.search(p.read_text(encoding="utf-8"))] == []


@ALL
def test_no_modules_import_each_other_in_a_circle(source):
    assert not cycle(source), " imports ".join(cycle(source))


def test_no_packages_import_each_other():
    graph: dict[str, set[str]] = {}
    for path in modules(SOURCE):
        package = top_level(SOURCE, path)
        names = {name.split(".")[1] for _, name in imported_modules(SOURCE, path) if "." in name}
        graph.setdefault(package, set()).update(names & LEVELS.keys() - {package, ROOT})
    mutual = {(a, b) for a in graph for b in graph[a] if a < b and a in graph.get(b, ())}
    assert not mutual


def test_texts_that_import_from_above_are_listed():
    assert upward_by_text(SOURCE) == KNOWN_UPWARD


def test_what_a_retargeter_imports_is_small():
    lines = closure(SOURCE, START)
    total = sum(lines.values())
    listing = "\n".join(f"{count:6} {name}" for name, count in sorted(lines.items()))
    assert total <= CLOSURE_LINES, f"{total} lines in {len(lines)} modules:\n{listing}"


@ALL
@pytest.mark.parametrize("check", [unpickling, missing_code, misshapen], ids=lambda f: f.__name__)
def test_code_follows_the_rules(source, check):
    assert not check(source), "\n".join(check(source))


def package(root: Path, files: dict[str, str]) -> Path:
    source = root / PACKAGE
    for name, text in {"__init__.py": "", **files}.items():
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return source


def test_each_way_to_break_a_rule_is_found(tmp_path):
    files = {
        "types.py": "def f():\n    from . import hands",
        "landmarks.py": "from smooth_operator.hands import Hand",
        "__init__.pyi": "from smooth_operator.teleop import loop as loop",
        "gadget.py": "",
        "hands/spec.py": "from ..types import Side\nimport numpy as np",  # a lower level
        "hands/utils.py": "from pickle import load\n" + "\n" * 701,
        "teleop/loop.py": "from smooth_operator import hand_discovery\nload(allow_pickle=trusted)",
        "hand_discovery/__init__.py": 'code_digest("types.py", "moved.py")',
        "retargeting/smooth.py": 'Entry("smooth_operator.teleop.loop:Loop"), "see smooth_operator"',
    }
    source = package(tmp_path, files)
    broken = [line.split(":")[0].partition("/")[2] for line in level_violations(source)]
    assert broken == ["__init__.pyi", "gadget.py", "landmarks.py", "teleop/loop.py", "types.py"]
    assert upward_by_text(source) == {"retargeting/smooth.py": {"teleop.loop"}}
    found = [
        line.split(":")[0].rpartition("/")[2]
        for check in (unpickling, missing_code, misshapen)
        for line in check(source)
    ]
    assert found == ["utils.py", "loop.py", "__init__.py", "utils.py", "utils.py"]


def test_a_circle_of_imports_and_what_a_module_leads_to_are_found(tmp_path):
    files = {
        "hands/__init__.pyi": "from smooth_operator.hands.spec import Spec as Spec",
        "hands/spec.py": "from smooth_operator.hands import limits",
        "hands/limits.py": "def f():\n    from smooth_operator.hands.load import Loaded",
        "hands/load.py": "A = 'smooth_operator.landmarks:b'",
        "landmarks.py": "",
        "retargeting/retargeter.py": "from ..hands import Spec",
    }
    source = package(tmp_path / "line", files)
    assert cycle(source) == []
    reached = {"hands.spec", "hands.limits", "hands.load", "landmarks", START}
    assert closure(source, START).keys() == reached
    files["hands/load.py"] = "if TYPE_CHECKING:\n    from .spec import HandSpec"
    found = cycle(package(tmp_path / "circle", files))
    assert found[0] == found[-1]
    assert sorted(found[1:]) == [f"{PACKAGE}.hands.{name}" for name in ("limits", "load", "spec")]

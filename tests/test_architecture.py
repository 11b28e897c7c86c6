"""Imports of the package follow the levels of ``docs/explanation/architecture.md``."""

import ast
import functools
import re
from collections.abc import Callable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import TypeAlias

import pytest

PACKAGE = "smooth_operator"
_Line: TypeAlias = tuple[int, str]
SOURCE = Path(__file__).resolve().parents[1] / "src" / PACKAGE
RESEARCH = SOURCE.parents[1] / "research" / "src" / "smooth_operator_research"
"""Experiments outside the wheel: they may import all of the package, which imports none of them."""
DATA_SETS = SOURCE.parents[1] / "packages" / "smooth_hand_datasets" / "smooth_hand_datasets"
"""Research data sets, outside the wheel in the same way."""
STUDY = SOURCE.parents[1] / "packages" / "smooth_operator_study" / "smooth_operator_study"
"""The user study, outside the wheel in the same way."""
DEVICES = SOURCE.parents[1] / "packages" / "smooth_operator_devices" / "smooth_operator_devices"
"""Real hands, trackers and ROS 2, outside the wheel in the same way."""
OTHERS = [RESEARCH, DATA_SETS, STUDY, DEVICES]
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

WINGS = {"teleop": 8, "hand_discovery": 8, "datasets": 8, "benchmark": 8}
"""Wings: each imports the core, what is shared, and itself."""

LEVELS = CORE | SHARED | WINGS | {"cli": 9, "__main__": 9}
"""Top-level module -> level, as ``docs/explanation/architecture.md`` lists them."""

KNOWN_UPWARD = {
    "formats/registry.py": {
        "episode_files",
        "episode_files.egodex",
        "episode_files.hdf5",
        "episode_files.landmark_pairs",
        "episode_files.packed",
        "headsets.recordings",
        "teleop.recording",
        "teleop.recording.log_reader",
    },
}
"""File -> what it imports from above by a string such as ``Entry("smooth_operator...")``. Such an
import hides an arrow that runs up, so the list only shrinks: a new one fails, and so does one that
is gone and still listed."""

START = "retargeting.retargeter"
"""Module of ``Retargeter``, where the closure begins."""

CLOSURE_LINES = 10_189
"""Most lines of the modules that ``Retargeter`` can import: the core grows only on purpose."""

MAX_LINES = 700
UNPICKLERS = {"pickle", "_pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
TARGET = re.compile(rf"{PACKAGE}\.[\w. ]+(:[\w. ]+)?")
RESTRICTED = {"smooth_hand_datasets/unpickle.py"}
"""Reads pickles as data, with an ``Unpickler`` that refuses every name but a few."""
DRAWERS = {"util", "utils", "helpers", "misc"}


def modules(source: Path) -> list[Path]:
    """Source files, and the stubs from which packages load their public names."""
    return sorted([*source.rglob("*.py"), *source.rglob("*.pyi")])


def top_level(source: Path, path: Path) -> str:
    """Name of the top-level module that a file belongs to, as in ``LEVELS``."""
    return path.relative_to(source).with_suffix("").parts[0]


def imported_modules(source: Path, path: Path) -> Iterator[tuple[int, str]]:
    """(line, dotted absolute name) of every import in a file, however deep in a function it hides.

    Relative imports are resolved, and so are constant names given to ``import_module``.
    """
    package = (PACKAGE, *path.relative_to(source).parent.parts)
    yield from imports_in(path.read_text(encoding="utf-8"), package)


@functools.cache
def nodes_of(text: str) -> list[ast.AST]:
    """All nodes of a module's syntax tree, parsed once for all tests."""
    return list(ast.walk(ast.parse(text)))


def each_once(function: Callable[..., Iterator[_Line]]) -> Callable[..., list[_Line]]:
    """Keeps the results of a generator, which several tests want."""
    return functools.cache(lambda *arguments: list(function(*arguments)))


@each_once
def imports_in(text: str, package: tuple[str, ...]) -> Iterator[tuple[int, str]]:
    """(line, name) of the imports in a module of a package, as ``imported_modules``."""
    for node in nodes_of(text):
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


def own_imports(source: Path, path: Path) -> Iterator[tuple[int, str, str]]:
    """(line, top-level module, dotted name) of every import of this package in a file."""
    for line, name in imported_modules(source, path):
        parts = name.split(".")
        if parts[0] != PACKAGE:
            continue
        child = parts[1] if len(parts) > 1 else ROOT
        is_module = (source / child).is_dir() or (source / f"{child}.py").is_file()
        yield line, child if is_module else ROOT, name


def constants(nodes: list[ast.AST]) -> dict[str, str]:
    """Name -> text of every assignment of a literal text in a file."""
    texts = {}
    for node in nodes:
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(node.value, ast.Constant):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [target.id for target in targets if isinstance(target, ast.Name)]
            if isinstance(node.value.value, str):
                texts |= dict.fromkeys(names, node.value.value)
    return texts


def literal(node: ast.AST, texts: Mapping[str, str]) -> str | None:
    """Text of a string or f-string; names in ``texts`` are filled in, others become spaces."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if not isinstance(node, ast.JoinedStr):
        return None
    parts = []
    for part in node.values:
        inner = part.value if isinstance(part, ast.FormattedValue) else part
        text = texts.get(inner.id) if isinstance(inner, ast.Name) else literal(inner, texts)
        parts.append(" " if text is None else text)
    return "".join(parts)


def imported_by_text(source: Path, path: Path) -> Iterator[tuple[int, str]]:
    """(line, dotted name) of every text that is the name of a module: ``Entry``, ``files``, tables.

    Text after a part that is known only at run time is left out: ``f"{HERE}.{name}"`` stands for
    the package ``HERE``. An attribute after ``:`` follows the module as in a dotted name.
    """
    package = ".".join((PACKAGE, *path.relative_to(source).parent.parts))
    for line, text in targets_in(path.read_text(encoding="utf-8"), package):
        name = text.partition(" ")[0].rstrip(".:").replace(":", ".")
        child = source.joinpath(*name.split(".")[1:2])
        if child != source and (child.is_dir() or child.with_suffix(".py").is_file()):
            yield line, name


@each_once
def targets_in(module: str, package: str) -> Iterator[tuple[int, str]]:
    """(line, text) of the texts in a module that look like the name of a module."""
    if PACKAGE not in module and "__package__" not in module:
        return
    nodes = nodes_of(module)
    texts = constants(nodes) | {"__package__": package}
    for node in nodes:
        text = literal(node, texts)
        if text is not None and TARGET.fullmatch(text):
            yield node.lineno, text


def upward_by_text(source: Path) -> dict[str, set[str]]:
    """File -> modules above its level, or in another wing, that it names in a text."""
    upward: dict[str, set[str]] = {}
    for path in modules(source):
        module = top_level(source, path)
        for _, name in imported_by_text(source, path):
            target = name.split(".")[1]
            other_wing = target != module and {module, target} <= WINGS.keys()
            if other_wing or LEVELS.get(target, 0) > LEVELS.get(module, 0):
                where = path.relative_to(source).as_posix()
                upward.setdefault(where, set()).add(module_of(source, name))
    return upward


def module_of(source: Path, name: str) -> str:
    """File or folder that a dotted name begins with, without the name of the package."""
    parts = name.split(".")[1:]
    while parts and not (
        source.joinpath(*parts).is_dir() or source.joinpath(*parts).with_suffix(".py").is_file()
    ):
        parts = parts[:-1]
    return ".".join(parts)


def stub_homes(source: Path) -> dict[str, str]:
    """Public name of a package -> module that has it, as the stubs say."""
    homes = {}
    for stub in source.rglob("__init__.pyi"):
        package = ".".join((PACKAGE, *stub.relative_to(source).parent.parts))
        for _, name in imported_modules(source, stub):
            homes[f"{package}.{name.rpartition('.')[2]}"] = name
    return homes


def closure(source: Path, start: str) -> dict[str, int]:
    """Module -> lines of all that a module can import: statements anywhere, and texts.

    A public name of a package leads to the module that has it, a package to its ``__init__``.
    Imports for type checkers count, since a reader has to follow them too.
    """
    homes = stub_homes(source)
    lines: dict[str, int] = {}
    waiting = [start]
    while waiting:
        module = waiting.pop()
        if module in lines:
            continue
        place = source.joinpath(*module.split("."))
        path = place / f"{ROOT}.py" if place.is_dir() else place.with_suffix(".py")
        if not path.is_file():
            continue
        lines[module] = len(path.read_text(encoding="utf-8").splitlines())
        for _, name in [*imported_modules(source, path), *imported_by_text(source, path)]:
            if name.startswith(f"{PACKAGE}."):
                waiting.append(module_of(source, homes.get(name, name)))
    return lines


def level_violations(source: Path) -> list[str]:
    found = []
    for path in modules(source):
        module = top_level(source, path)
        where = path.relative_to(source.parent).as_posix()
        if module not in LEVELS:
            found.append(
                f"{where}: no level for the new top-level module {module!r}; "
                "give it one in LEVELS here and in docs/explanation/architecture.md"
            )
            continue
        limit = LEVELS[module]
        for line, target, name in own_imports(source, path):
            if target != module and {module, target} <= WINGS.keys():
                found.append(
                    f"{where}:{line}: {module} may not import {target}, another wing; "
                    "move what both need into the core or a shared package"
                )
            elif path == source / "__init__.pyi" and name == f"{PACKAGE}.{target}":
                continue  # the package names its subpackages, which it loads when asked for
            elif target != module and LEVELS.get(target, 0) > limit:
                found.append(
                    f"{where}:{line}: {module} may import up to level {limit}, "
                    f"but {target} is at level {LEVELS[target]}; "
                    "import from below, or move what both need down"
                )
    return found


def module_graph(source: Path) -> dict[str, set[str]]:
    """Module -> the modules of the package that it names in an import, wherever that stands.

    Imports inside functions and below ``TYPE_CHECKING`` count: a reader has to follow them too.
    The packages around an imported module do not: their ``__init__`` only re-exports.
    """
    graph: dict[str, set[str]] = {}
    files = {}
    for path in modules(source):
        parts = path.relative_to(source.parent).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == ROOT else parts)] = path
    for module, path in files.items():
        graph[module] = set()
        for _, name in imported_modules(source, path):
            while name and name not in files:
                name = name.rpartition(".")[0]  # a name in a module, or of another distribution
            graph[module] |= {name} - {"", module}
    return graph


def cycle(source: Path) -> list[str]:
    """Modules that import each other in a circle, the first one again at the end; else none."""
    try:
        TopologicalSorter(module_graph(source)).prepare()
    except CycleError as error:
        return list(error.args[1])[::-1]
    return []


def unpickling(source: Path) -> list[str]:
    found = []
    for path in modules(source):
        where = path.relative_to(source.parent).as_posix()
        found += [
            f"{where}:{line}: imports {name}: data files hold no code, nothing unpickles"
            for line, name in imported_modules(source, path)
            if name.split(".")[0] in UNPICKLERS and where not in RESTRICTED
        ]
        text = path.read_text(encoding="utf-8")
        for node in nodes_of(text) if "allow_pickle" in text else ():
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                off = isinstance(node.value, ast.Constant) and node.value.value is False
                if not off:
                    found.append(f"{where}:{node.value.lineno}: allow_pickle must be False")
    return found


def from_other_distributions(source: Path) -> list[tuple[str, str]]:
    """(file:line, package) of the imports from the other distributions of the repository."""
    others = {other.name for other in OTHERS} - {source.name}
    return [
        (f"{path.relative_to(source.parent).as_posix()}:{line}", name.split(".")[0])
        for path in modules(source)
        for line, name in imported_modules(source, path)
        if name.split(".")[0] in others
    ]


def missing_code(source: Path) -> list[str]:
    """Paths given to ``code_digest`` that do not exist (any more)."""
    found = []
    for path in modules(source):
        where = path.relative_to(source.parent).as_posix()
        text = path.read_text(encoding="utf-8")
        if "code_digest" not in text and "imported_modules" not in text:
            continue
        for node in nodes_of(text):
            name = isinstance(node, ast.Call) and getattr(node.func, "id", "")
            if name != "code_digest":
                continue
            given = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]
            found += [
                f"{where}:{node.lineno}: {place!r} is not in the package: results would be used "
                "again though their code has changed; if it has moved, name its new place"
                for place in given
                if isinstance(place, str) and not (source / place).exists()
            ]
    return found


def misshapen(source: Path) -> list[str]:
    found = []
    for path in modules(source):
        where = path.relative_to(source.parent).as_posix()
        count = len(path.read_text(encoding="utf-8").splitlines())
        if count > MAX_LINES:
            found.append(f"{where}: {count} lines, more than {MAX_LINES}: split it by concept")
        if DRAWERS & {part.strip("_") for part in path.relative_to(source).with_suffix("").parts}:
            found.append(f"{where}: name a module after what it holds, not 'utils'")
    return found


def test_source_is_where_the_tests_look():
    assert {"types", "landmarks", "errors"} <= {top_level(SOURCE, p) for p in modules(SOURCE)}


def test_modules_import_only_from_their_own_level_or_below():
    assert not level_violations(SOURCE), "\n".join(level_violations(SOURCE))


def test_the_package_imports_no_other_distribution_of_the_repository():
    assert from_other_distributions(SOURCE) == []


def test_no_text_of_the_package_names_a_module_of_another_distribution():
    named = re.compile(rf"({STUDY.name}|{DEVICES.name})\.\w")
    assert [p.name for p in modules(SOURCE) if named.search(p.read_text(encoding="utf-8"))] == []


def test_only_research_imports_the_study():
    assert from_other_distributions(DATA_SETS) == []
    assert from_other_distributions(STUDY) == []
    assert from_other_distributions(DEVICES) == []
    assert {name for _, name in from_other_distributions(RESEARCH)} == {STUDY.name}


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
def test_nothing_unpickles(source):
    assert not unpickling(source), "\n".join(unpickling(source))


@pytest.mark.parametrize("source", [SOURCE, STUDY], ids=lambda path: path.name)
def test_digests_of_code_name_files_that_exist(source):
    assert not missing_code(source), "\n".join(missing_code(source))


@ALL
def test_modules_are_small_and_named_after_what_they_hold(source):
    assert not misshapen(source), "\n".join(misshapen(source))


# The checks themselves, on a package that breaks each rule.


def package(root: Path, files: dict[str, str]) -> Path:
    source = root / PACKAGE
    for name, text in {"__init__.py": "", **files}.items():
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return source


@pytest.mark.parametrize(
    ("importer", "statement"),
    [
        ("types.py", "from smooth_operator.hands import HandSpec"),
        ("types.py", "def f():\n    from . import hands"),
        ("types.py", "import importlib\nimportlib.import_module('smooth_operator.hands.spec')"),
        ("retargeting/sampling.py", "from ..cli import main"),
        ("__init__.pyi", "from smooth_operator.teleop.pages import live as live"),
        ("teleop/loop.py", "from smooth_operator import datasets"),
    ],
)
def test_an_upward_import_is_found(tmp_path, importer, statement):
    files = {"hands/spec.py": "", "cli.py": "", "teleop/runtime.py": "", "datasets/__init__.py": ""}
    source = package(tmp_path, files | {importer: statement})
    found = level_violations(source)
    assert len(found) == 1, found
    assert found[0].startswith(f"{PACKAGE}/{importer}:")


def test_a_text_that_imports_from_above_is_found(tmp_path):
    files = {
        "retargeting/sampling.py": 'X = "smooth_operator.teleop"\nE = Entry(f"{X}.runtime:Loop")',
        "retargeting/newton.py": '"smooth_operator.retargeting.x", "see smooth_operator.teleop"',
        "teleop/__init__.py": "",
        "teleop/runtime.py": "",
    }
    upward = upward_by_text(package(tmp_path, files))
    assert upward.keys() == {"retargeting/sampling.py"}
    assert upward["retargeting/sampling.py"] <= {"teleop", "teleop.runtime"}


def test_the_closure_follows_statements_texts_and_public_names(tmp_path):
    files = {
        "retargeting/retargeter.py": "from ..hands import Spec\nA = 'smooth_operator.a:b'",
        "hands/__init__.py": "",
        "hands/__init__.pyi": "from smooth_operator.hands.spec import Spec as Spec",
        "hands/spec.py": "def f():\n    import smooth_operator.c",
        "hands/other.py": "",
        "a.py": "",
        "c.py": "x = 1\ny = 2",
    }
    lines = closure(package(tmp_path, files), START)
    assert lines == {START: 2, "hands.spec": 2, "a": 0, "c": 2}


@pytest.mark.parametrize(
    ("importer", "statement"),
    [
        ("hands/mjcf/load.py", "from ..limits import Limits\nfrom ...types import Side"),
        ("cli.py", "from smooth_operator import __version__\nfrom smooth_operator import teleop"),
        ("__init__.pyi", "from smooth_operator import teleop as teleop"),
        ("types.py", "import numpy as np\nfrom hands import spec"),
    ],
)
def test_a_downward_import_passes(tmp_path, importer, statement):
    files = {
        "types.py": "",
        "retargeting/filters.py": "",
        "retargeting/sbr/method.py": "",
        "hands/spec.py": "",
    }
    files |= {"hands/__init__.py": "", "hands/limits.py": "", "teleop/runtime.py": ""}
    assert level_violations(package(tmp_path, files | {importer: statement})) == []


def test_a_circle_of_imports_is_found(tmp_path):
    files = {
        "hands/spec.py": "from smooth_operator.hands import limits",
        "hands/limits.py": "def f():\n    from smooth_operator.hands.load import Loaded",
        "hands/load.py": "if TYPE_CHECKING:\n    from .spec import HandSpec",
    }
    found = cycle(package(tmp_path, files))
    assert found[0] == found[-1]
    assert sorted(found[1:]) == [f"{PACKAGE}.hands.{name}" for name in ("limits", "load", "spec")]


def test_a_package_that_re_exports_its_modules_is_no_circle(tmp_path):
    files = {
        "hands/__init__.py": "from smooth_operator.hands.spec import HandSpec as HandSpec",
        "hands/spec.py": "from smooth_operator.hands import limits",
        "hands/limits.py": "",
    }
    assert cycle(package(tmp_path, files)) == []
    files["hands/limits.py"] = "from smooth_operator.hands import HandSpec"
    assert len(cycle(package(tmp_path / "face", files))) == 4


def test_a_module_without_a_level_is_named(tmp_path):
    (found,) = level_violations(package(tmp_path, {"gadget.py": ""}))
    assert "'gadget'" in found
    assert "LEVELS" in found


def test_what_unpickles_has_moved_or_is_misshapen_is_found(tmp_path):
    loading = "def f():\n    from pickle import load\nnp.load(path, allow_pickle=trusted)"
    files = {
        "recording.py": loading,
        "types.py": "np.load(path, allow_pickle=False)  # never import pickle" + "\n" * 700,
        "hands/utils.py": 'code_digest("types.py", "moved.py")' + "\n" * 701,
    }
    source = package(tmp_path, files)
    offenders = [
        [line.split(":")[0].rpartition("/")[2] for line in check(source)]
        for check in (unpickling, missing_code, misshapen)
    ]
    assert offenders == [["recording.py"] * 2, ["utils.py"], ["utils.py"] * 2]

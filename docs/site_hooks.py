"""Hook of mkdocs: lists the public names and the modules of a package on its API page.

A page of ``docs/reference/api`` has the line ``{{ public smooth_operator.hands }}`` or
``{{ modules smooth_operator.hands }}``. The first becomes one mkdocstrings block for each public
name of the package, the second a table of its modules with the first line of their docstrings.
Both are read from the source files: nothing is imported.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_PROJECT = Path(__file__).resolve().parents[1]
SOURCES = (_PROJECT / "src", _PROJECT / "packages" / "smooth_operator_study")
"""Folders that the packages are in."""
ROOT = "smooth_operator"
# A title counts a thousand times as much as text, and each name of the API is a title.
_BOOST = {"tutorials": 4.0, "how-to": 4.0, "robots": 3.0, "explanation": 2.0}
_LINE = re.compile(r"^\{\{ (public|modules) ([\w.]+) \}\}$", re.MULTILINE)


def _folder(package: str) -> Path:
    """The folder of a package, or the path of a module without its suffix."""
    top = package.split(".")[0]
    source = next((each for each in SOURCES if (each / top).is_dir()), SOURCES[0])
    return source.joinpath(*package.split("."))


def public_names(package: str) -> dict[str, str]:
    """Name -> the module that defines it: what a package imports as ``X as X``.

    An import of a whole module (``from package import module as module``) is left out.
    """
    stub = _folder(package) / "__init__.pyi"
    source = stub if stub.is_file() else stub.with_suffix(".py")
    tree = ast.parse(source.read_text(encoding="utf-8"))
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                is_module = _folder(f"{node.module}.{alias.name}")
                if is_module.is_dir() or is_module.with_suffix(".py").is_file():
                    continue
                if alias.asname == alias.name:
                    found[alias.name] = _home(node.module, alias.name)
    return found


def _home(module: str, name: str) -> str:
    """The module that defines a name which ``module`` may only pass on."""
    folder = _folder(module)
    if folder.is_dir():
        return public_names(module).get(name, module)
    return module


def _modules(package: str) -> Iterator[tuple[str, str]]:
    """(dotted name, first line of the docstring) of every module in a package."""
    folder = _folder(package)
    for path in sorted(folder.rglob("*.py")):
        doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
        parts = path.relative_to(folder).with_suffix("").parts
        if parts[-1] == "__init__":
            parts = parts[:-1]
        name = ".".join((package, *parts))
        if doc and name != package:
            yield name, doc.split("\n\n")[0].replace("\n", " ").replace("|", "\\|")


def _expanded(match: re.Match[str]) -> str:
    kind, package = match.groups()
    if kind == "public":
        names = public_names(package)
        elsewhere = set() if package == ROOT else names.keys() & public_names(ROOT).keys()
        links = (f"[`{name}`][{names[name]}.{name}]" for name in sorted(elsewhere))
        blocks = [f"::: {names[name]}.{name}" for name in sorted(names.keys() - elsewhere)]
        if elsewhere:
            blocks.insert(0, f"Also in `{ROOT}`, and described there: {', '.join(links)}.")
        return "\n\n".join(blocks)
    rows = [f"| `{name}` | {doc} |" for name, doc in _modules(package)]
    return "\n".join(["| module | content |", "|---|---|", *rows])


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Called by mkdocs for each page: lists names; guides rank before the API in the search."""
    path = page.file.src_uri
    boost = _BOOST.get(path.split("/")[0], 1.0)
    page.meta["search"] = {"boost": 0.0005 if path.startswith("reference/api/") else boost}
    return _LINE.sub(_expanded, markdown)

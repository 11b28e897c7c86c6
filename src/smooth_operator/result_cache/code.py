"""Digests of the code that a result depends on."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Final

HOME: Final = Path(__file__).resolve().parents[1]
"""Folder of this package."""


@cache
def code_digest(*names: str, home: Path = HOME) -> str:
    """SHA-256 of names and contents of some files and folders of this package.

    Args:
        names: paths relative to ``home``; a folder stands for all files below it, data included.
        home: folder of the package.

    Returns:
        the digest, hexadecimal.

    Raises:
        FileNotFoundError: a path does not exist; perhaps the code has moved.
    """
    total = hashlib.sha256()
    for name in names:
        path = home / name
        if not path.exists():
            raise FileNotFoundError(
                f"{name!r} is not in the package {home.name!r}; name the place that it moved to"
            )
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file() and file.suffix != ".pyc":
                total.update(file.relative_to(home).as_posix().encode() + b"\0" + file.read_bytes())
    return total.hexdigest()


@cache
def imported_modules(
    *start: str, leave_out: tuple[str, ...] = (), home: Path = HOME
) -> tuple[str, ...]:
    """Files of the modules of this package that some modules import, directly or indirectly.

    Args:
        start: files relative to ``home``; they are included.
        leave_out: files that are neither included nor followed.
        home: folder of the package.

    Returns:
        sorted paths relative to ``home``, for ``code_digest``.

    Raises:
        FileNotFoundError: a file of ``start`` or ``leave_out`` does not exist.
    """
    for name in (*start, *leave_out):
        if not (home / name).is_file():
            raise FileNotFoundError(
                f"{name!r} is no file of the package {home.name!r}; name the place that it moved to"
            )
    left_out = {home / name for name in leave_out}
    modules: set[Path] = set()
    waiting = [home / name for name in start]
    while waiting:
        path = waiting.pop()
        if path not in modules and path not in left_out:
            modules.add(path)
            waiting += _imports(path, home)
    return tuple(sorted(path.relative_to(home).as_posix() for path in modules))


@cache
def _imports(path: Path, home: Path) -> tuple[Path, ...]:
    """Modules of this package that a module imports, also in functions."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    return tuple(_files(names, home))


def _files(names: Iterable[str], home: Path) -> Iterable[Path]:
    for name in names:
        package, *parts = name.split(".")
        if package == home.name and parts:
            module = home.joinpath(*parts)
            yield from (
                path
                for path in (module.with_suffix(".py"), module / "__init__.py")
                if path.is_file()
            )

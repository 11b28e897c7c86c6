"""Imports the public names of a package on first use.

The stub ``__init__.pyi`` of a package is its list of public names: type checkers and editors read
it, and so does ``public_names``. Importing a package therefore reads only a small file and imports
no library.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module

TYPE_CHECKING = False  # as typing's, which takes longer to import than all of this package
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any, Final

_NO_WORD: Final = str.maketrans("(),", "   ")
_WITH_EXTRA: Final = "teleop"
"""Package whose libraries belong to an extra of the same name."""


def public_names(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Makes ``__getattr__``, ``__dir__`` and ``__all__`` of a package from the names in its stub
    file.

    Args:
        package: its ``__name__``.
        file: its ``__file__``.

    Returns:
        ``__getattr__``, ``__dir__`` and ``__all__``. Submodules that the stub names are
        attributes, but not in ``__all__``: a star import of ``io`` would hide Python's own.
    """
    homes = stub_imports(os.path.splitext(file)[0] + ".pyi")
    public = sorted(name for name, home in homes.items() if home != package)

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if homes[name] == package:
            return import_module(f"{package}.{name}")  # the import system keeps it as an attribute
        try:
            value = getattr(import_module(homes[name]), name)
        except ModuleNotFoundError as error:
            _name_the_extra(f"{package}.{name}", error)
            raise
        setattr(sys.modules[package], name, value)  # found directly from now on
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes})

    return load, names, public


def stub_imports(path: str) -> dict[str, str]:
    """Maps each name in a stub to its module, from lines of the form ``from module import name as
    name``."""
    with open(path, encoding="utf-8") as stream:
        lines = [line.partition("#")[0].translate(_NO_WORD) for line in stream]
    homes: dict[str, str] = {}
    module = ""
    words = iter(" ".join(lines).split())
    for word in words:
        if word == "from":
            module = next(words)
        elif word == "as":
            homes[next(words)] = module
    return homes


def _name_the_extra(name: str, error: ModuleNotFoundError) -> None:
    """Raises MissingExtraError if a library of an extra is not installed."""
    from smooth_operator.errors import MissingExtraError

    if name.split(".")[1] == _WITH_EXTRA and (error.name or "").split(".")[0] != __package__:
        raise MissingExtraError(name, _WITH_EXTRA) from error

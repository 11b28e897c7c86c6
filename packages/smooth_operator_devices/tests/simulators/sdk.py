"""Helpers of the stand-ins for makers' Python packages."""

from __future__ import annotations

import ast
import importlib.util
import types
from pathlib import Path


def module(name: str, **members: object) -> types.ModuleType:
    """A module with the given members."""
    made = types.ModuleType(name)
    vars(made).update(members)
    return made


def stub_methods(package: str, file: str) -> dict[str, dict[str, list[str]]] | None:
    """The parameters of each method of each class in a package's stub, or None without it.

    The package is found and not imported. A class that appears twice has the methods of both; of a
    property the parameters are ["self"].
    """
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        return None
    path = Path(next(iter(spec.submodule_search_locations))) / file
    if not path.is_file():
        return None
    classes: dict[str, dict[str, list[str]]] = {}
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef):
            methods = classes.setdefault(node.name, {})
            for item in node.body:
                if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
                    names = [*item.args.posonlyargs, *item.args.args, *item.args.kwonlyargs]
                    methods[item.name] = [argument.arg for argument in names]
    return classes

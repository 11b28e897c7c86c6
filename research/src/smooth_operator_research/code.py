"""Digests of the code that a stored result depends on, in this distribution and in the library."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import Final

from smooth_operator.source_digest import code_digest

HOME: Final = Path(__file__).resolve().parent
"""Folder of this package."""


@cache
def research_digest(*names: str) -> str:
    """Digest of files and folders of this package and of ``smooth_operator``.

    Comments, docstrings and line breaks of Python files don't count, so that stored results outlast
    better words.

    Args:
        names: paths relative to this package, or, if it has no such file, to ``smooth_operator``.

    Returns:
        The digest, hexadecimal.
    """
    own = [name for name in names if (HOME / name).exists()]
    others = [name for name in names if name not in own]
    return code_digest(*own, home=HOME, content=statements) + code_digest(
        *others, content=statements
    )


def statements(path: Path) -> bytes:
    """Content of a file; of a Python file its code without comments and docstrings."""
    content = path.read_bytes()
    if path.suffix != ".py":
        return content
    tree = ast.parse(content)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [one for one in node.body if not _is_docstring(one)]
    return ast.unparse(tree).encode()


def _is_docstring(statement: ast.stmt) -> bool:
    """True for a docstring, also one of an attribute."""
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)

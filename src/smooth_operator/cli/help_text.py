"""Help texts, wrapped to the width of the terminal."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import functools
import inspect
import io
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Any, get_args, get_type_hints

from tyro.conf import Suppress, arg

_NARROWEST = 40
_BOXED = re.compile(r"\s*(\x1b\[[0-9;]*m)*[╭│╰|+]")


def unwrapped(text: str) -> str:
    """A text whose paragraphs are a line each; indented lines stay as they are.

    tyro joins a line that begins with a letter to the one before, an indented one too; an empty
    line after an indented block keeps them apart.
    """
    joined = re.sub(r"(?m)^(\S.*)\n(?=\S)", r"\1 ", text)
    return re.sub(r"(?m)^( .*)\n(?=\S)", r"\1\n\n", joined)


def document(kind: type) -> None:
    """Gives tyro the help of each option of a dataclass, of its parts and of its subcommands.

    tyro finds the docstrings below the fields itself, but keeps the line breaks of the source,
    since continued lines are indented there.
    """
    for each in reversed(kind.__mro__):
        if dataclasses.is_dataclass(each):
            _document(each)
    for hint in get_type_hints(kind, include_extras=True).values():
        for part in _dataclasses_in(hint):
            document(part)


def without_rare(kind: type) -> type:
    """A copy of a command's class whose help leaves out the rare options."""
    rare: frozenset[str] = getattr(kind, "rare", frozenset())
    if not rare:
        return kind
    hints = get_type_hints(kind, include_extras=True)
    namespace: dict[str, Any] = {
        field.name: dataclasses.field(default=field.default, default_factory=field.default_factory)
        for field in dataclasses.fields(kind)
        if field.name in rare
    }
    suppress: Any = Suppress
    namespace["__annotations__"] = {name: suppress[hints[name]] for name in namespace}
    namespace["__doc__"] = kind.__doc__
    copy = type(kind.__name__, (kind,), namespace)
    return dataclasses.dataclass(frozen=True, kw_only=True)(copy)


@functools.cache
def _document(kind: type) -> None:
    docs, hints = _field_docs(kind), get_type_hints(kind, include_extras=True)
    for name in docs.keys() & kind.__annotations__.keys():
        kind.__annotations__[name] = Annotated[hints[name], arg(help=docs[name])]


def _field_docs(kind: type) -> dict[str, str]:
    try:
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    except (OSError, SyntaxError, ValueError):
        return {}
    assert isinstance(body, ast.ClassDef)
    return {
        field.target.id: " ".join(doc.value.value.split())
        for field, doc in pairwise(body.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(doc, ast.Expr) and isinstance(doc.value, ast.Constant)
        if isinstance(doc.value.value, str)
    }


def _dataclasses_in(hint: Any) -> Iterator[type]:
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        yield hint
    for part in get_args(hint):
        yield from _dataclasses_in(part)


@contextlib.contextmanager
def wrapped_output() -> Iterator[None]:
    """Wraps the text printed in the block at the width of the terminal, except boxes.

    tyro fits its boxes to that width, and leaves what stands above them as it is.
    """
    before, held = sys.stdout, _Held(sys.stdout)
    sys.stdout = held
    try:
        yield
    finally:
        sys.stdout = before
        width = max(shutil.get_terminal_size().columns, _NARROWEST)
        for line in held.getvalue().splitlines():
            print(_fitted(line, width), file=before)


def _fitted(line: str, width: int) -> str:
    if _BOXED.match(line) or len(line) <= width:
        return line
    if "usage:" in line:  # all subcommands, which a box lists as well
        line = re.sub(r"\{\S+,\S+\}", "COMMAND", line)
    indent = " " * (len(line) - len(line.lstrip()))
    table = re.match(r"\s+\S+(, \S+)*\s{2,}|\s+", line)  # a name and what it is, in columns
    after = " " * len(table[0]) if table else indent
    return textwrap.fill(
        line, width, subsequent_indent=after, break_on_hyphens=False, break_long_words=False
    )


class _Held(io.StringIO):
    """Collects text, with the encoding and width of another stream."""

    def __init__(self, stream: Any) -> None:
        super().__init__()
        self._stream = stream

    def isatty(self) -> bool:
        return bool(self._stream.isatty())

    def fileno(self) -> int:
        return int(self._stream.fileno())

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return str(self._stream.encoding)

"""Plain technical English: words of the old dialect that may not come back.

Say instead: for "is told" receives, reads, is passed; for "anew" again; for "beside" next to, with;
for "at once" together, immediately; for "of which" a separate sentence; for "lets go of" releases,
closes; for "what became of each" the result of each.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
SOURCE = PROJECT / "src" / "smooth_operator"
PAGES = [*sorted((PROJECT / "docs").glob("**/*.md")), PROJECT / "README.md"]
FORBIDDEN = re.compile(
    r"\b(told|anew|beside|at\s+once|of\s+which|hasty|gulp|doomed|lets?\s+go\s+of|what\s+became\s+of)"
    r"\b(?!: [a-z])",
    re.IGNORECASE | re.MULTILINE,
)
"""Not the name of an argument in the section ``Args``, with a colon after it."""

PARTS = sorted(path for path in SOURCE.iterdir() if path.suffix == ".py" or path.is_dir())


def in_page(text: str) -> list[str]:
    """Forbidden words of a Markdown page, with their lines; code in backticks is quoted."""
    prose = re.sub(r"`[^`\n]+`", "", text)
    return found(prose)


def found(text: str, first_line: int = 1) -> list[str]:
    return [
        f"line {first_line + text.count(chr(10), 0, match.start())}: {match[0]!r}"
        for match in FORBIDDEN.finditer(text)
    ]


def prose_of(code: str) -> Iterator[tuple[int, str]]:
    """(line, text) of every comment and every string of a Python file."""
    for token in tokenize.generate_tokens(io.StringIO(code).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(PROJECT).as_posix())
def test_pages(page: Path) -> None:
    assert in_page(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_source(part: Path) -> None:
    """Docstrings, comments, help and error texts of a package or module."""
    files = sorted(part.rglob("*.py")) if part.is_dir() else [part]
    wrong = [
        f"{file.relative_to(SOURCE).as_posix()}: {words}"
        for file in files
        for line, text in prose_of(file.read_text(encoding="utf-8"))
        for words in found(text, line)
    ]
    assert wrong == []


def test_the_words_are_found() -> None:
    assert in_page("it is told\nall at\nonce, `told`\n") == [
        "line 1: 'told'",
        "line 2: 'at\\nonce'",
    ]
    code = 'x = 1  # anew\ndef f():\n    """Beside."""\n    raise E(f"of which {x}")\n'
    words = [word for line, text in prose_of(code) for word in found(text, line)]
    assert words == ["line 1: 'anew'", "line 3: 'Beside'", "line 4: 'of which'"]

"""Writer of CSV tables whose text a spreadsheet does not evaluate."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

_FORMULA: Final = re.compile(r"'*[=+\-@\t\r\n＝＋－＠]")
"""Beginnings that a spreadsheet takes for a formula, whatever quotes stand around the cell."""
_QUOTED: Final = re.compile(r'[",\r\n]')
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|-?inf")


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """A table, with a header.

    Text that a spreadsheet would calculate (``=HYPERLINK(...)``, ``-1+cmd|...``) gets an apostrophe
    before it, which ``plain_cell`` takes away again. Numbers stay as they are.

    Args:
        rows: values by column; other keys are left out, and missing ones empty.
    """
    lines = [columns, *([row.get(name) for name in columns] for row in rows)]
    return "".join(f"{','.join(map(_cell, line))}\n" for line in lines)


def plain_cell(text: str) -> str:
    """A cell that was read, as it was before ``csv_text`` wrote it."""
    return text[1:] if text.startswith("'") and _runs(text[1:]) else text


def _cell(value: Any) -> str:
    text = "" if value is None else str(value)
    if isinstance(value, str) and _runs(text):
        text = f"'{text}"
    # Python's own writer leaves a carriage return bare, which ends the row for a reader.
    return '"{}"'.format(text.replace('"', '""')) if _QUOTED.search(text) else text


def _runs(text: str) -> bool:
    return _FORMULA.match(text) is not None and _NUMBER.fullmatch(text) is None

"""Writer of CSV tables whose text a spreadsheet does not evaluate."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

_FORMULA: Final = re.compile(r"'*[=+\-@\t\r\n＝＋－＠]")
"""Characters at the beginning of a cell that a spreadsheet treats as a formula, even in a quoted
cell."""
_QUOTED: Final = re.compile(r'[",\r\n]')
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|-?inf")


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Formats a table with a header as CSV.

    Text that a spreadsheet would evaluate (``=HYPERLINK(...)``, ``-1+cmd|...``) gets a leading
    apostrophe, which ``plain_cell`` removes again. Numbers are unchanged.

    Args:
        rows: values by column; other keys are ignored, and missing values are empty.
    """
    lines = [columns, *([row.get(name) for name in columns] for row in rows)]
    return "".join(f"{','.join(map(_cell, line))}\n" for line in lines)


def plain_cell(text: str) -> str:
    """Returns the original text of a cell that ``csv_text`` wrote."""
    return text[1:] if text.startswith("'") and _runs(text[1:]) else text


def _cell(value: Any) -> str:
    text = "" if value is None else str(value)
    if isinstance(value, str) and _runs(text):
        text = f"'{text}"
    # Python's own writer leaves a carriage return bare, which ends the row for a reader.
    return '"{}"'.format(text.replace('"', '""')) if _QUOTED.search(text) else text


def _runs(text: str) -> bool:
    return _FORMULA.match(text) is not None and _NUMBER.fullmatch(text) is None

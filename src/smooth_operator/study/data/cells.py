"""One value of a table: text to a number or a name, or an error that says where and what."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from smooth_operator.errors import StudyError, brief, listed

_MISSING = frozenset({"", "na", "n/a", "nan", "none", "null"})
_SHOWN = 8
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_MOST_COUNT = 10**9
"""Of a block or trial; whole numbers of a table fit into 64 bits."""


@dataclass
class Checked:
    """Rows of one table, and what is wrong with them, gathered so that one look shows all.

    Attributes:
        name: of the file.
        rows: (number of its line or entry, values by column).
        unit: what the number counts: "row" of a file with a header in row 1, or "entry".
        problems: found so far.
    """

    name: str
    rows: Sequence[tuple[int, Mapping[str, Any]]]
    unit: str = "row"
    problems: list[str] = field(default_factory=list)

    def complain(self, number: int, column: str, text: str) -> None:
        """Notes a problem with one value."""
        self.problems.append(f"{self.unit} {number}, column {column}: {text}")

    def raise_if_any(self) -> None:
        """Refuses the table if anything was wrong.

        Raises:
            StudyError: with the first problems by row and column.
        """
        if not self.problems:
            return
        shown = "\n  ".join(self.problems[:_SHOWN])
        more = len(self.problems) - _SHOWN
        rest = f"\n  and {more} more" if more > 0 else ""
        raise StudyError(f"{self.name} can't be used:\n  {shown}{rest}")

    def words(self, column: str) -> list[str]:
        """Names; none may be empty, and two must differ by more than case."""
        found: list[str] = []
        first: dict[str, tuple[int, str]] = {}
        for number, row in self.rows:
            text = str(row[column]).strip() if row[column] is not None else ""
            if not text:
                self.complain(number, column, "expected a name; the field is empty")
            at, known = first.setdefault(text.casefold(), (number, text))
            if known != text:
                self.complain(
                    number,
                    column,
                    f"{brief(text)} and {brief(known)} of {self.unit} {at} differ only in case; "
                    "write both the same way",
                )
            found.append(text)
        return found

    def counts(self, column: str) -> list[int]:
        """Whole numbers from 1."""
        found = []
        for number, row in self.rows:
            value = _number(row[column])
            if value is None or not 1 <= value <= _MOST_COUNT or value != int(value):
                self.complain(
                    number, column, f"expected a whole number from 1 on, came {brief(row[column])}"
                )
                value = 1.0
            found.append(int(value))
        return found

    def numbers(
        self, column: str, expected: str, allowed: Any, *, optional: bool = True
    ) -> list[float]:
        """Numbers; NaN where the field is empty, if that is allowed.

        Args:
            column: which.
            expected: what to say that was expected.
            allowed: takes a number, returns whether it is.
            optional: whether the field may be empty.
        """
        found = []
        for number, row in self.rows:
            if is_missing(row[column]):
                if not optional:
                    self.complain(number, column, f"expected {expected}; the field is empty")
                found.append(math.nan)
                continue
            value = _number(row[column])
            if value is None or not allowed(value):
                self.complain(number, column, f"expected {expected}, came {brief(row[column])}")
                value = math.nan
            found.append(value)
        return found

    def unique(self, columns: Sequence[str]) -> None:
        """Notes rows that are there twice."""
        seen: dict[tuple[str, ...], int] = {}
        for number, row in self.rows:
            key = tuple(str(row[column]).strip() for column in columns)
            if key in seen:
                what = listed(f"{c} {k}" for c, k in zip(columns, key, strict=True))
                self.problems.append(
                    f"{self.unit} {number}: the same {what} as {self.unit} {seen[key]}; every "
                    "trial and questionnaire may be there once"
                )
            seen.setdefault(key, number)


def is_missing(value: Any) -> bool:
    """Whether a field says that there is no value."""
    return (
        value is None
        or (isinstance(value, str) and value.strip().lower() in _MISSING)
        or (isinstance(value, float) and math.isnan(value))
    )


def _number(value: Any) -> float | None:
    """A finite number, or None."""
    if isinstance(value, bool) or is_missing(value):
        return None
    if isinstance(value, str) and not _NUMBER.fullmatch(value.strip()):
        return None  # Python would take 1_0 for 10
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None

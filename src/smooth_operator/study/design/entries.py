"""Checked look-ups in a table of a TOML file: each error names the file, the entry, what is due."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from smooth_operator.errors import StudyError


@dataclass(frozen=True)
class Entries:
    """A table.

    Attributes:
        file: as messages call it.
        values: what it holds.
        where: dotted name of the table in the file; empty for the file itself.
    """

    file: str
    values: Mapping[str, Any]
    where: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Its entries, in the order of the file."""
        return tuple(self.values)

    def only(self, *known: str) -> None:
        """Refuses entries that nobody reads."""
        for name in self.values:
            if name not in known:
                close = get_close_matches(name, known, n=1)
                hint = f" Did you mean {close[0]!r}?" if close else ""
                raise self.error(name, f"no such entry.{hint} Known here: {', '.join(known)}")

    def text(self, name: str, default: str | None = None) -> str:
        """A text."""
        value = self._get(name, default, "a text")
        if not isinstance(value, str) or not value.isprintable():
            raise self.error(name, f"expected a text on one line, not {value!r}")
        return value

    def texts(self, name: str, default: Sequence[str] | None = None) -> list[str]:
        """A list of texts."""
        value = self._get(name, default, "a list of texts")
        if not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value):
            raise self.error(name, f"expected a list of texts, not {value!r}")
        return list(value)

    def whole(self, name: str, default: int | None = None) -> int:
        """A whole number; true is none, though Python says so."""
        value = self._get(name, default, "a whole number")
        if isinstance(value, bool) or not isinstance(value, int) or abs(value) > 2**63:
            raise self.error(name, f"expected a whole number, not {value!r}")
        return value

    def number(self, name: str, default: float | None = None) -> float:
        """A finite number."""
        value = self._get(name, default, "a number")
        right = isinstance(value, int | float) and not isinstance(value, bool)
        if not right or abs(value) > 1e300 or not math.isfinite(value):
            raise self.error(name, f"expected a finite number, not {value!r}")
        return float(value)

    def flag(self, name: str, default: bool) -> bool:
        """True or false."""
        value = self._get(name, default, "true or false")
        if not isinstance(value, bool):
            raise self.error(name, f"expected true or false, not {value!r}")
        return value

    def table(self, name: str) -> Entries:
        """A table in this one."""
        value = self._get(name, None, "a table")
        if not isinstance(value, dict):
            raise self.error(name, f"expected a table, not {value!r}")
        return Entries(self.file, value, self._full(name))

    def tables(self, name: str) -> list[Entries]:
        """A list of tables."""
        value = self._get(name, None, "a list of tables")
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            raise self.error(name, f"expected a list of tables, not {value!r}")
        return [Entries(self.file, v, f"{self._full(name)}[{k}]") for k, v in enumerate(value, 1)]

    def error(self, name: str, text: str) -> StudyError:
        """What is wrong with an entry."""
        full = self._full(name)
        full, text = (  # a damaged file may hold names and values of any length
            word if len(word) <= most else f"{word[: most - 3]}..."
            for word, most in ((full, 100), (text, 400))
        )
        return StudyError(f"{self.file}: {full}: {text}")

    def _get(self, name: str, default: Any, kind: str) -> Any:
        if name in self.values:
            return self.values[name]
        if default is None:
            raise self.error(name, f"is missing; expected {kind}")
        return default

    def _full(self, name: str) -> str:
        return f"{self.where}.{name}" if self.where else name

"""Checks and looks up entries of a settings file (TOML or JSON), and reads TOML.

Each error names the file, the entry and the expected value, and corrects a misspelt name.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

from smooth_operator.errors import (
    ConfigError,
    DocumentError,
    SmoothOperatorError,
    brief,
    did_you_mean,
)
from smooth_operator.io.plain_files import MOST_DIGITS, MOST_LEVELS, read_text, too_deep

_T = TypeVar("_T", bound=str)


@dataclass(frozen=True)
class Entries:
    """A table of a settings file. A look-up raises ``refuse`` if the entry has another type, or if
    it is missing and has no default.

    Attributes:
        file: name of the file in messages.
        values: content of the table.
        refuse: class of the errors.
        where: dotted name of the table in the file; empty for the file itself.
    """

    file: str
    values: Mapping[str, Any]
    refuse: type[SmoothOperatorError] = ConfigError
    where: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries, in the order of the file."""
        return tuple(self.values)

    def only(self, *names: str) -> None:
        """Refuses entries other than the known ones."""
        for name in self.values:
            if name not in names:
                hint = did_you_mean(name, names)
                raise self.error(name, f"no such entry.{hint} Known entries: {', '.join(names)}")

    def check_format(self, version: int) -> None:
        """Refuses a file whose entry ``format`` names another version of the file format."""
        number = self.whole("format")
        if number != version:
            newer = "; this file is from a newer version: update yours" if number > version else ""
            raise self.error("format", f"expected {version}, not {number}{newer}")

    def text(
        self, name: str, default: str | None = None, *, empty: bool = True, lines: bool = False
    ) -> str:
        """Returns a string; with ``lines``, it may have several lines and control characters."""
        value = self._get(name, default, "a string")
        if not isinstance(value, str):
            raise self.error(name, f"expected a string, not {brief(value)}")
        if not lines and not value.isprintable():
            raise self.error(name, f"expected a string on one line, not {brief(value)}")
        if not empty and not value:
            raise self.error(name, "expected a string that is not empty")
        return value

    def choice(self, name: str, options: Sequence[_T], default: _T | None = None) -> _T:
        """Returns one of the allowed words."""
        value = self._get(name, default, "a string")
        for option in options:
            if value == option:
                return option
        raise self.error(name, f"expected {' or '.join(map(repr, options))}, not {brief(value)}")

    def texts(self, name: str, *, what: str = "a list of strings") -> list[str]:
        """Returns a list of strings; ``what`` is its name in messages."""
        value = self._get(name, None, what)
        if not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value):
            raise self.error(name, f"expected {what}, not {brief(value)}")
        return list(value)

    def whole(self, name: str, default: int | None = None) -> int:
        """Returns a whole number. Unlike in Python, true does not count as a number."""
        value = self._get(name, default, "a whole number")
        if isinstance(value, bool) or not isinstance(value, int) or abs(value) > 2**63:
            raise self.error(name, f"expected a whole number, not {brief(value)}")
        return value

    def number(self, name: str, default: float | None = None) -> float:
        """Returns a finite number."""
        return self._finite(name, self._get(name, default, "a number"))

    def numbers(
        self, name: str, count: int, default: Sequence[float] | None = None, *, what: str = ""
    ) -> Any:
        """Returns a tuple of ``count`` finite numbers; ``what`` is its name in messages."""
        what = what or f"{count} numbers"
        value = self._get(name, default, what)
        if not isinstance(value, list | tuple) or len(value) != count:
            raise self.error(name, f"expected {what}, not {brief(value)}")
        return tuple(self._finite(name, each) for each in value)

    def flag(self, name: str, default: bool) -> bool:
        """Returns true or false."""
        value = self._get(name, default, "true or false")
        if not isinstance(value, bool):
            raise self.error(name, f"expected true or false, not {brief(value)}")
        return value

    def table(self, name: str, default: Mapping[str, Any] | None = None) -> Entries:
        """Returns a nested table."""
        value = self._get(name, default, "a table")
        if not isinstance(value, Mapping):
            raise self.error(name, f"expected a table, not {brief(value)}")
        return replace(self, values=value, where=self._full(name))

    def tables(self, name: str) -> list[Entries]:
        """Returns a list of tables."""
        value = self._get(name, None, "a list of tables")
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            raise self.error(name, f"expected a list of tables, not {brief(value)}")
        full = self._full(name)
        return [replace(self, values=v, where=f"{full}[{k}]") for k, v in enumerate(value, 1)]

    def error(self, name: str, text: str) -> SmoothOperatorError:
        """Creates an error about an entry."""
        # A damaged file may hold names of any length.
        return self.refuse(f"{self.file}: {_cut(self._full(name), 80)}: {_cut(text, 400)}")

    @contextmanager
    def name_file(self) -> Iterator[None]:
        """Converts this package's errors in the block to ``refuse``, with the file's name added."""
        try:
            yield
        except SmoothOperatorError as error:
            if str(error).startswith(self.file):
                raise
            raise self.refuse(f"{self.file}: {_cut(str(error), 400)}") from error

    def _get(self, name: str, default: Any, kind: str) -> Any:
        if name in self.values:
            return self.values[name]
        if default is None:
            raise self.error(name, f"is missing; expected {kind}")
        return default

    def _finite(self, name: str, value: Any) -> float:
        right = isinstance(value, int | float) and not isinstance(value, bool)
        if not right or abs(value) > 1e300 or not math.isfinite(value):
            raise self.error(name, f"expected a finite number, not {brief(value)}")
        return float(value)

    def _full(self, name: str) -> str:
        return f"{self.where}.{name}" if self.where else name


def read_entries(
    path: Path,
    what: str,
    refuse: type[SmoothOperatorError] = ConfigError,
    *,
    most_bytes: int,
    hint: str = "",
) -> Entries:
    """Reads the table of a TOML file, which may have at most ``most_bytes``.

    Args:
        path: path of the file.
        what: kind of file, for messages.
        refuse: class of the errors, also of the look-ups.
        hint: where such files come from, for the message about a missing file.

    Raises:
        SmoothOperatorError: of the class ``refuse``: the file can't be read, or is not TOML.
    """
    try:
        return Entries(str(path), read_toml(path, most_bytes=most_bytes), refuse)
    except FileNotFoundError:
        raise refuse(f"no {what} at {path}{hint}") from None
    except OSError as error:
        raise refuse(f"can't read the {what} {path}: {error.strerror}") from error
    except DocumentError as error:
        raise refuse(f"{path} is not well-formed TOML: {error}") from error


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."


_MOST_DOTS: Final = 1000  # in one line of TOML; the parser's time grows with their square


def parse_toml(text: str) -> dict[str, Any]:
    """Parses a TOML text to a table. Raises DocumentError if the text is not TOML, or exceeds one
    of the limits of ``parse_json``."""
    if any(line.count(".") > _MOST_DOTS for line in text.split("\n")):
        raise DocumentError(f"a line has more than {_MOST_DOTS} dots")
    try:
        table = tomllib.loads(text)
    except RecursionError as error:
        raise too_deep() from error
    except ValueError as error:  # TOMLDecodeError; and a number of thousands of digits
        raise DocumentError(str(error) if len(str(error)) < 200 else "damaged text") from error
    for level, value in _values(table):
        if level > MOST_LEVELS:
            raise too_deep()
        if isinstance(value, int) and abs(value) >= 10**MOST_DIGITS:
            raise DocumentError(f"a whole number has more than {MOST_DIGITS} digits")
    return table


def read_toml(path: Path, *, most_bytes: int) -> dict[str, Any]:
    """Reads the table of a TOML file.

    Raises:
        OSError: there is no such file, or it can't be read.
        DocumentError: as in ``read_text`` and ``parse_toml``.
    """
    return parse_toml(read_text(path, most_bytes=most_bytes))


def _values(table: dict[str, Any]) -> Iterator[tuple[int, Any]]:
    """Yields (level, value) of all in a table; without recursion, which could exhaust the stack."""
    left: list[tuple[int, Any]] = [(1, table)]
    while left:
        level, value = left.pop()
        yield level, value
        if level > MOST_LEVELS:
            continue
        if isinstance(value, dict):
            left += [(level + 1, child) for child in value.values()]
        elif isinstance(value, list):
            left += [(level + 1, child) for child in value]

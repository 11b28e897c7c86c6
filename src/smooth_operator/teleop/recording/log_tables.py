"""The messages of one topic as columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.errors import brief

_FLOAT64: Final = np.dtype("<f8")


@dataclass
class Table:
    """The messages of a topic: one row each, one column for each field.

    Numbers that stand in a list are bytes of float64, and empty where a message has none.

    Attributes:
        fields: names of the columns.
        numbers: sequence numbers of the messages.
        rows: their values, in the order of the fields.
    """

    fields: tuple[str, ...]
    numbers: list[int] = field(default_factory=list)
    rows: list[tuple[Any, ...]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.rows)

    def column(self, name: str) -> list[Any]:
        """The values of a field."""
        place = self.fields.index(name)
        return [row[place] for row in self.rows]

    def floats(self, name: str) -> Float[np.ndarray, " T"]:
        """The values of a field that is a number; what is not finite is NaN."""
        return _finite(np.array(self.column(name), np.float64))

    def stamps(self) -> Float[np.ndarray, " T"]:
        """The stamps.

        Raises:
            ValueError: one is not finite.
        """
        found = np.array(self.column("stamp"), np.float64)
        if not np.isfinite(found).all():
            raise ValueError("a stamp is not finite")
        return found

    def matrix(self, name: str, *shape: int) -> Float[np.ndarray, "T ..."]:
        """The values of a field that is a list of numbers; what is not finite is NaN.

        Args:
            name: of the field.
            shape: of each; rows of messages that have none are NaN.

        Raises:
            ValueError: one has another number of numbers.
        """
        parts, count = self.column(name), int(np.prod(shape))
        size = count * _FLOAT64.itemsize
        if any(len(part) != size for part in parts):
            for part in parts:
                if len(part) not in (0, size):
                    has = len(part) / _FLOAT64.itemsize
                    raise ValueError(f"{name} has {has:g} numbers, not {count}")
            none = np.full(count, np.nan, _FLOAT64).tobytes()
            parts = [part or none for part in parts]
        flat = np.frombuffer(b"".join(parts), _FLOAT64).astype(np.float64)  # which can be written
        return _finite(flat).reshape(len(parts), *shape)

    def optional(self, name: str, *shape: int) -> Float[np.ndarray, "T ..."] | None:
        """The same; None where no message has any."""
        return self.matrix(name, *shape) if any(self.column(name)) else None

    def same(self, name: str, what: str) -> Any:
        """The value of a field that all messages have alike.

        Args:
            name: of the field.
            what: of it, for the error.

        Raises:
            ValueError: it changes.
        """
        values = self.column(name)
        other = next((value for value in values if value != values[0]), None)
        if other is not None:
            raise ValueError(f"{what} changes: {brief(values[0])}, {brief(other)}")
        return values[0]

    def places(self, commands: Sequence[int]) -> Int[np.ndarray, " C"]:
        """The row that belongs to each command: the last one of its number, -1 for none."""
        rows = {number: row for row, number in enumerate(self.numbers)}
        return np.array([rows.get(number, -1) for number in commands], np.int64)


def spread(values: np.ndarray, places: Int[np.ndarray, " C"], absent: Any) -> np.ndarray:
    """Rows of a table for each command.

    Args:
        values: of the rows.
        places: the row of each command; see ``Table.places``.
        absent: for a command that has none.
    """
    found = np.full((len(places), *values.shape[1:]), absent, values.dtype)
    there = places >= 0
    found[there] = values[places[there]]
    return found


def _finite(values: np.ndarray) -> np.ndarray:
    values[np.isinf(values)] = np.nan
    return values

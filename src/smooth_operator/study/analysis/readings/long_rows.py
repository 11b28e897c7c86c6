"""All readings as rows of one long table, for other programs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from smooth_operator.study.analysis.readings.all_readings import Readings
from smooth_operator.study.analysis.results import plain

Row = dict[str, Any]


def reading_rows(readings: Readings) -> list[Row]:
    """One row for each table entry: ``reading``, ``where`` it belongs, ``term``, and its figures.

    ``where`` is the outcome, scope or field, joined by slashes; ``refused`` has the reason in rows
    without figures.
    """
    return [row for name, content in vars(readings).items() for row in _rows(name, content)]


def _rows(reading: str, content: Any) -> Iterator[Row]:
    if content is None:
        return
    yield from _descend(reading, (), plain(content))


def _descend(reading: str, path: tuple[str, ...], content: Any) -> Iterator[Row]:
    """Mappings whose values are numbers are rows; others are walked."""
    if not isinstance(content, Mapping):
        return
    numbers = {
        key: value for key, value in content.items() if not isinstance(value, (Mapping, list))
    }
    if numbers:
        yield {
            "reading": reading,
            "where": "/".join(path[:-1]),
            "term": "".join(path[-1:]),
        } | numbers
    for key, value in content.items():
        if key not in _NOT_IN_ROWS:
            yield from _descend(reading, (*path, str(key)), value)


_NOT_IN_ROWS = frozenset({"model", "diagnostics", "observed", "coefficients"})
"""Parts of a model's result that other tables describe."""

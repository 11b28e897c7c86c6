"""Lists of what to read: a path a line, or a table with tasks, sides and layouts."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import ConfigError, DocumentError, RecordingError, brief, reason
from smooth_operator.io.documents import check_plain_file, parse_json, read_text
from smooth_operator.types import Side, as_side

_MOST_BYTES: Final = 2_000_000_000
_COLUMNS: Final = ("path", "task", "side", "layout", "rate")
_FIRST: Final = 65_536


@dataclass(frozen=True)
class Row:
    """A line of a list.

    Attributes:
        path: of a file or folder, relative to the list; or an address.
        task: what is done, in words.
        side: which hand.
        layout: name of the reader.
        rate: frames a second [Hz].
        frames: range of frames ``A:B`` of the file; empty for all.
    """

    path: str
    task: str | None = None
    side: Side | None = None
    layout: str | None = None
    rate: float | None = None
    frames: str = ""


def is_manifest(path: Path) -> bool:
    """Whether a file is a list: ``.txt``; ``.csv``; ``.jsonl`` whose first line has a ``path``."""
    suffix = path.suffix.lower()
    if suffix in (".txt", ".csv"):
        return True
    if suffix != ".jsonl":
        return False
    try:
        check_plain_file(path)
        with path.open("rb") as file:
            line = next(
                (line for line in iter(lambda: file.readline(_FIRST), b"") if line.strip()), b""
            )
        first = parse_json(line)
    except (OSError, DocumentError):
        return False
    return isinstance(first, dict) and isinstance(first.get("path"), str)


def read_manifest(path: Path) -> Iterator[Row]:
    """The lines of a list.

    Raises:
        RecordingError: it can't be read, or a line is not one; says which.
    """
    try:
        text = read_text(path, most_bytes=_MOST_BYTES)
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: the list can't be read: {error}") from error
    suffix = path.suffix.lower()
    if suffix == ".csv":
        yield from _of_csv(text, path)
        return
    for number, line in enumerate(text.split("\n"), 1):
        line = line.strip()
        if not line or (suffix == ".txt" and line.startswith("#")):
            continue
        if suffix == ".txt":
            yield Row(line)
            continue
        where = f"{path}, line {number}"
        try:
            values = parse_json(line)
        except DocumentError as error:
            raise RecordingError(f"{where}: {error}; expected a JSON object a line") from error
        yield _row(values, where)


def _of_csv(text: str, path: Path) -> Iterator[Row]:
    table = csv.DictReader(io.StringIO(text))
    if "path" not in (table.fieldnames or ()):
        raise RecordingError(
            f"{path}: a list needs the column 'path' in its first line, and may have "
            f"{', '.join(_COLUMNS[1:])}; found {brief(', '.join(table.fieldnames or ()))}"
        )
    try:
        for values in table:
            filled = {name: value for name, value in values.items() if name and value}
            if filled:
                yield _row(filled, f"{path}, line {table.line_num}")
    except csv.Error as error:
        raise RecordingError(
            f"{path}, line {table.line_num}: {reason(error)}; expected a table"
        ) from error


def _row(values: Any, where: str) -> Row:
    if not isinstance(values, Mapping) or not isinstance(values.get("path"), str):
        raise RecordingError(f"{where}: expected an object with the text 'path'")
    for name in ("task", "layout"):
        if not isinstance(values.get(name, ""), str | None):
            raise RecordingError(f"{where}: {name} must be a text, not {brief(values[name])}")
    rate, side = values.get("rate"), values.get("side")
    try:
        return Row(
            values["path"],
            values.get("task") or None,
            None if side is None else as_side(side),
            values.get("layout") or None,
            None if rate is None else float(rate),
        )
    except (ConfigError, TypeError, ValueError) as error:
        raise RecordingError(f"{where}: {reason(error)}") from error

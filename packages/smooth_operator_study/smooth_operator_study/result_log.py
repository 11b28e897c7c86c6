"""Store of the results of simulated studies as lines of a file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import DocumentError
from smooth_operator.io.documents import parse_json
from smooth_operator.io.jsonable import to_json
from smooth_operator.result_cache import Note, ResultStore, key_digest, no_note


class ResultLog(ResultStore):
    """Store of results as lines of a file, for one writing process at a time.

    A line has the fields of the result, and ``key`` and ``code`` as in a ``ResultCache``. Lines
    with another key or other code are kept but not used. The incomplete line of a killed process is
    removed.

    Args:
        path: the file; created with the first result.
        note: shows messages about lines that could not be used.

    Raises:
        OutputError: the file can't be read.
    """

    def __init__(self, path: Path, note: Note = no_note) -> None:
        super().__init__(path, note)
        self.path = path
        self._results: dict[tuple[str, str], dict[str, Any]] = {}
        self._keys: set[str] = set()
        try:
            content = path.read_bytes() if path.exists() else b""
            whole = content[: content.rfind(b"\n") + 1]
            if len(whole) < len(content):
                os.truncate(path, len(whole))
        except OSError as error:
            raise output_error(path, error) from error
        damaged = sum(not self._take(line) for line in whole.splitlines())
        if damaged:
            lines = (
                "1 line that is not a result"
                if damaged == 1
                else f"{damaged} lines that are not results"
            )
            note(f"{path} holds {lines} and will not be used")

    def find(self, name: str, key: object, code: str) -> dict[str, Any] | None:
        """Returns the stored result of this key and this code, or None. The name is ignored."""
        digest = key_digest(key)
        value = self._results.get((digest, code))
        self._outdated += value is None and digest in self._keys
        return value

    def keep(self, name: str, key: object, code: str, value: Mapping[str, Any]) -> None:
        """Appends a result, and flushes it to the disk; OutputError if the file can't be
        written."""
        record = {"key": key_digest(key), "code": code}
        try:
            with self.path.open("ab") as file:
                file.write(to_json({**record, **value}).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise output_error(self.path, error) from error
        self._results[record["key"], code] = dict(value)

    def _take(self, line: bytes) -> bool:
        """Reads a line; returns False if it is not a result."""
        try:
            content = parse_json(line)
            key, code = str(content.pop("key")), str(content.pop("code"))
        except (DocumentError, AttributeError, KeyError, TypeError):
            return False
        self._keys.add(key)
        self._results[key, code] = content
        return True

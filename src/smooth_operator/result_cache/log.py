"""A result cache in one file: a line of JSON for each small result."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import DocumentError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.io.documents import parse_json
from smooth_operator.result_cache.cache import Note, key_digest, no_note, outdated


class ResultLog:
    """Results as lines of a file; one process writes at a time.

    A line has the fields of the result, and ``key`` and ``code`` as a ``ResultCache`` has. Lines of
    other keys or other code stay and are not used. Half a line, which a killed process leaves, is
    cut off.

    Args:
        path: the file; made with the first result.
        note: called with what could not be used.

    Raises:
        OutputError: the file can't be read.
    """

    def __init__(self, path: Path, note: Note = no_note) -> None:
        self.path, self.note = path, note
        self._known: dict[tuple[str, str], dict[str, Any]] = {}
        self.damaged = 0
        """Lines that are no result."""
        self._keys: set[str] = set()
        self._earlier = self._outdated = 0
        try:
            content = path.read_bytes() if path.exists() else b""
            whole = content[: content.rfind(b"\n") + 1]
            if len(whole) < len(content):
                os.truncate(path, len(whole))
        except OSError as error:
            raise output_error(path, error) from error
        for line in whole.splitlines():
            self._take(line)
        for count, what in ((self.damaged, "no results"), (self._earlier, "of an earlier version")):
            if count:
                lines = "1 line that is" if count == 1 else f"{count} lines that are"
                note(f"{path} holds {lines} {what}: not used")

    def find(self, name: str, key: object, code: str) -> dict[str, Any] | None:
        """A result that was kept before; None if there is none of this key and this code.

        Args:
            name: not used; results of a ``ResultCache`` have one.
            key: what it depends on, but for code; anything with a JSON form.
            code: digest of the code that computes it.
        """
        digest = key_digest(key)
        found = self._known.get((digest, code))
        self._outdated += found is None and digest in self._keys
        return found

    def keep(self, name: str, key: object, code: str, value: Mapping[str, Any]) -> None:
        """Appends a result; it is on the disk when this returns.

        Raises:
            OutputError: it can't be written.
        """
        record = {"key": key_digest(key), "code": code}
        try:
            with self.path.open("ab") as file:
                file.write(to_json({**record, **value}).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise output_error(self.path, error) from error
        self._known[record["key"], code] = dict(value)

    def values(self, code: str) -> list[dict[str, Any]]:
        """All results of some code, in the order of the file."""
        return [value for (_, known), value in self._known.items() if known == code]

    def note_outdated(self) -> None:
        """Says how many results since the last call were of other code."""
        if self._outdated:
            self.note(outdated(self._outdated, self.path))
        self._outdated = 0

    def _take(self, line: bytes) -> None:
        try:
            content = parse_json(line)
            if not isinstance(content, dict):
                raise DocumentError("it is no object")
        except DocumentError:
            self.damaged += 1
            return
        if not {"key", "code"} <= content.keys():
            self._earlier += 1
            return
        key, code = str(content.pop("key")), str(content.pop("code"))
        self._keys.add(key)
        self._known[key, code] = content

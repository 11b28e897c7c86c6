"""A folder of results: one file each, whole or not there."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Final, TypeAlias

import numpy as np

from smooth_operator.atomic_files import atomic_write, output_error, write_json
from smooth_operator.errors import DocumentError, SmoothOperatorError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.io.documents import check_plain_file, read_json

Note: TypeAlias = Callable[[str], None]
"""Called with a sentence for a person: which results could not be used, and why."""

MOST_BYTES: Final = 100_000_000
"""Largest JSON file that is read."""


def key_digest(key: object) -> str:
    """SHA-256 of anything that has a JSON form, hexadecimal: what two equal keys share."""
    return hashlib.sha256(to_json(key).encode()).hexdigest()


def content_name(prefix: str, key: object) -> str:
    """Name of a result that only its key identifies."""
    return f"{prefix}-{key_digest(key)[:20]}"


def outdated(count: int, place: Path) -> str:
    """A sentence about results of other code."""
    results = "1 result" if count == 1 else f"{count} results"
    return f"{results} in {place} came from another version of the code: computed again"


def no_note(text: str) -> None:
    """For a caller that shows no notes."""


class ResultCache:
    """Results as JSON files in a folder.

    A result is found if its key and the digest of the code are those that it was kept with. A
    file that is damaged, or from other code, counts as missing, and the next result of that name
    replaces it. Files are replaced as a whole, so that several processes may share a folder: the
    last one to keep a result of a name wins.

    Args:
        folder: made when needed.
        note: called with what could not be used.
        other_code: use results of other code too; ``found_by_other_code`` names them.

    Raises:
        OutputError: the folder can't be made.
    """

    suffix: ClassVar[str] = ".json"

    def __init__(self, folder: Path, note: Note = no_note, *, other_code: bool = False) -> None:
        self.folder, self.note, self._other_code = folder, note, other_code
        self.found_by_other_code: set[str] = set()
        self._outdated = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(folder, error) from error

    def path(self, name: str) -> Path:
        """File of a result."""
        return self.folder / f"{name}{self.suffix}"

    def find(self, name: str, key: object, code: str) -> Any | None:
        """A result that was kept before.

        Args:
            name: of its file, without the suffix.
            key: what it depends on, but for code; anything with a JSON form.
            code: digest of the code that computes it.

        Returns:
            The value, or None if there is none that is whole, of this key and of this code.
        """
        path = self.path(name)
        try:
            record, value = self._read(path)
            known_key, known_code = record["key"], record["code"]
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, EOFError, SmoothOperatorError,
                zipfile.BadZipFile) as error:  # fmt: skip
            self.note(f"{path} is damaged or of an earlier version ({error}): computed again")
            return None
        if known_key != key_digest(key):
            return None
        if known_code != code:
            if not self._other_code:
                self._outdated += 1
                return None
            self.found_by_other_code.add(name)
        return value

    def keep(self, name: str, key: object, code: str, value: Any) -> None:
        """Writes a result; it is on the disk when this returns.

        Args:
            name: of its file, without the suffix.
            key: as in ``find``.
            code: as in ``find``.
            value: what this kind of cache holds.

        Raises:
            OutputError: it can't be written.
            ConfigError: key or value have no JSON form.
        """
        self.found_by_other_code.discard(name)
        self._write(self.path(name), {"key": key_digest(key), "code": code}, value)

    def note_outdated(self) -> None:
        """Says how many results since the last call were of other code."""
        if self._outdated:
            self.note(outdated(self._outdated, self.folder))
        self._outdated = 0

    def _read(self, path: Path) -> tuple[Mapping[str, Any], Any]:
        """Key and code of a file, and its value."""
        content = read_json(path, most_bytes=MOST_BYTES)
        return content, content["value"]

    def _write(self, path: Path, record: Mapping[str, str], value: Any) -> None:
        write_json(path, {**record, "value": value})


class ArrayCache(ResultCache):
    """Results as ``.npz`` files: each a mapping from names to arrays."""

    suffix: ClassVar[str] = ".npz"

    def _read(self, path: Path) -> tuple[Mapping[str, Any], dict[str, np.ndarray]]:
        check_plain_file(path)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        if "key" not in arrays:
            raise DocumentError("it has no key")
        key = arrays.pop("key")
        return {"key": str(key), "code": str(arrays.pop("code", ""))}, arrays

    def _write(
        self, path: Path, record: Mapping[str, str], value: Mapping[str, np.ndarray]
    ) -> None:
        content: dict[str, Any] = {**value, **{k: np.array(v) for k, v in record.items()}}
        with atomic_write(path) as file:
            np.savez(file, **content)

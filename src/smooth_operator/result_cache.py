"""Stores the results of long computations in a folder, and reuses them while they are valid.

A result has a key, which is any JSON, and the digest of the code that computed it. The key holds
the settings and the digest of the input, so a result is used again only if input, settings and code
are the same. ``key_digest``, ``content_digest`` and ``code_digest`` are also the keys of the packs
of data sets, in the distribution ``smooth-hand-datasets``.
"""

from __future__ import annotations

import hashlib
import sys
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, TypeAlias, TypeVar

from smooth_operator.atomic_files import output_error, write_json
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.io.documents import read_json
from smooth_operator.io.jsonable import to_json
from smooth_operator.parallel import TaskResult
from smooth_operator.source_digest import HOME
from smooth_operator.source_digest import code_digest as code_digest

T = TypeVar("T")

Note: TypeAlias = Callable[[str], None]
"""Function that shows a message: results that could not be used, and the reason."""

MOST_BYTES: Final = 100_000_000
"""Largest accepted JSON file."""


def key_digest(key: object) -> str:
    """SHA-256 digest of a value that can be written as JSON, in hexadecimal."""
    return hashlib.sha256(to_json(key).encode()).hexdigest()


def content_digest(content: bytes | Path) -> str:
    """SHA-256 digest of some bytes or of a file, in hexadecimal."""
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest()
    with content.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def outside_code(*parts: Any) -> list[str]:
    """Digests of the packages from other distributions, such as plugins, that provide parts of
    registries.

    Args:
        parts: objects with a module, or names of modules; these are not imported.

    Returns:
        one digest for each package other than this one, in hexadecimal, sorted.
    """
    modules = {part if isinstance(part, str) else getattr(part, "__module__", "") for part in parts}
    packages = {module.partition(".")[0] for module in modules}
    return sorted(digest for package in packages if (digest := _package_digest(package)))


@cache
def _package_digest(package: str) -> str:
    """Digest of a package or module of another distribution; empty for this package, or if the
    module has no file.
    """
    path = _file_of(package)
    if path is None or path.parent == HOME:
        return ""
    files = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()


def _file_of(package: str) -> Path | None:
    file = getattr(sys.modules.get(package), "__file__", None)
    if file is None:
        with suppress(ImportError, ValueError):  # no such module, or one without a description
            spec = find_spec(package)
            file = None if spec is None or not spec.has_location else spec.origin
    return None if file is None else Path(file).resolve()


def no_note(text: str) -> None:
    """``Note`` function that shows nothing."""


class ResultStore(ABC):
    """Base class of result stores; it counts the stored results that another version of the code
    computed."""

    def __init__(self, place: Path, note: Note) -> None:
        self._place, self.note = place, note
        self._outdated = 0

    @abstractmethod
    def find(self, name: str, key: object, code: str) -> Any | None:
        """Returns the result stored for a key and a code digest, or None."""

    @abstractmethod
    def keep(self, name: str, key: object, code: str, value: Any) -> None:
        """Stores a result under a name; OutputError if it can't be written."""

    def note_outdated(self) -> None:
        """Reports how many of the results used since the last call were computed by another
        version of the code."""
        if self._outdated:
            results = "1 result" if self._outdated == 1 else f"{self._outdated} results"
            self.note(
                f"{results} in {self._place} came from another version of the code and will be "
                "computed again"
            )
        self._outdated = 0


class ResultCache(ResultStore):
    """Stores results as JSON files in a folder.

    A stored result is valid for its key and its digest of the code. A file that is damaged, or from
    other code, counts as missing, and the next result of that name replaces it. Files are replaced
    atomically, so several processes may share a folder: the last result of a name wins.

    Args:
        folder: the folder; created if necessary.
        note: shows messages about results that could not be used.

    Raises:
        OutputError: the folder can't be created.
    """

    suffix: ClassVar[str] = ".json"

    def __init__(self, folder: Path, note: Note = no_note) -> None:
        super().__init__(folder, note)
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(folder, error) from error

    def path(self, name: str) -> Path:
        """File in which a result is stored."""
        return self.folder / f"{name}{self.suffix}"

    def find(self, name: str, key: object, code: str) -> Any | None:
        """Returns the result stored for a key and a code digest, or None if it is missing or
        damaged.

        The key is everything except code that the result depends on, and has a JSON form."""
        path = self.path(name)
        try:
            record, value = self._read(path)
            own_key, own_code = record["key"], record["code"]
        except FileNotFoundError:
            return None
        except (
            OSError,
            ValueError,
            KeyError,
            TypeError,
            EOFError,
            SmoothOperatorError,
            zipfile.BadZipFile,
        ) as error:
            self.note(
                f"{path} is damaged or from an earlier version ({error}) and will be computed again"
            )
            return None
        if own_key != key_digest(key):
            return None
        if own_code != code:
            self._outdated += 1
            return None
        return value

    def keep(self, name: str, key: object, code: str, value: Any) -> None:
        """Stores a result under a name (a file name without suffix), and flushes it to disk.

        Key and code are as in ``find``.

        Raises:
            OutputError: the file can't be written.
            ConfigError: key or value have no JSON form.
        """
        self._write(self.path(name), {"key": key_digest(key), "code": code}, value)

    def _read(self, path: Path) -> tuple[Mapping[str, Any], Any]:
        """Reads the key, the code and the value of a file."""
        content = read_json(path, most_bytes=MOST_BYTES)
        return content, content["value"]

    def _write(self, path: Path, record: Mapping[str, str], value: Any) -> None:
        write_json(path, {**record, "value": value})


Execute: TypeAlias = Callable[[Sequence[T]], Iterable[TaskResult[Any]]]
"""Function that computes tasks in any order, such as ``PersistentPool.run``."""


@dataclass(frozen=True, eq=False)
class Job(Generic[T]):
    """A computation whose result may be in a store.

    Attributes:
        name: name of its file, unique in the store.
        key: everything except code that the result depends on; any value with a JSON form.
        code: digest of the code that computes it.
        task: argument of the computation.
        label: human-readable name.
        effort: relative duration.
    """

    name: str
    key: object
    code: str
    task: T
    label: str = ""
    effort: float = 0.0


@dataclass(frozen=True, eq=False)
class JobResult(Generic[T]):
    """The result of a job.

    Attributes:
        job: the job.
        value: its result; None after a failure.
        error: reason of the failure; None without one.
        seconds: time of the computation [s]; 0 for a stored result.
    """

    job: Job[T]
    value: Any | None
    error: str | None = None
    seconds: float = 0.0


def find_results(
    jobs: Sequence[Job[T]], cache: ResultStore
) -> tuple[list[JobResult[T]], list[Job[T]]]:
    """Returns the stored results of jobs, and the jobs that have no stored result."""
    finished, missing = [], []
    for job in jobs:
        value = cache.find(job.name, job.key, job.code)
        if value is None:
            missing.append(job)
        else:
            finished.append(JobResult(job, value))
    cache.note_outdated()
    return finished, missing


def compute_results(
    jobs: Sequence[Job[T]],
    cache: ResultStore,
    execute: Execute[T],
    value: Callable[[Job[T], TaskResult[Any]], Any] = lambda _, result: result.value,
) -> Iterator[JobResult[T]]:
    """Runs jobs, and stores each result as soon as it is available.

    Args:
        jobs: computations in the order of their starts.
        value: converts the result of a task to the value to store; None stores nothing.

    Raises:
        OutputError: a result can't be written.
    """
    if not jobs:
        return
    results = execute([job.task for job in jobs])
    try:
        for result in results:
            job = jobs[result.index]
            stored = value(job, result)
            if stored is not None:
                cache.keep(job.name, job.key, job.code, stored)
            yield JobResult(job, stored, result.error, result.seconds)
    finally:
        close = getattr(results, "close", None)
        if close is not None:
            close()  # end the workers now rather than at garbage collection

"""The groups and arrays of an HDF5 file, read by a separate process."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from smooth_operator.episode_files import hdf5_process
from smooth_operator.errors import DocumentError, MissingExtraError, RecordingError, listed
from smooth_operator.formats.arrays import damaged
from smooth_operator.formats.bounds import Allowance
from smooth_operator.io.documents import check_plain_file, parse_json

_SECONDS: Final = 3
"""Seconds of processor time that reading may take, and"""
_BYTES_PER_SECOND: Final = 20_000_000
"""a second more for so many bytes of the file; a laptop reads five times as many."""
_WAIT_S: Final = 30.0
"""How long it may take by the clock, at least: the only limit on Windows."""
_MOST_TEXT: Final = 8_000_000


@dataclass(frozen=True, eq=False)
class Hdf5Array:
    """An array of a file.

    Attributes:
        name: with its groups.
        shape: its shape.
        kind: what its elements are, as NumPy has it: ``f``, ``i``, ``u``, ``b``, or another.
        type: the same for a person.
        attributes: texts, numbers and lists of them.
        data: its numbers, None where it holds something else.
        texts: its texts, in one row; None where it holds something else.
    """

    name: str
    shape: tuple[int, ...]
    kind: str
    type: str
    attributes: dict[str, Any]
    data: np.ndarray | None
    texts: list[str | None] | None


@dataclass(frozen=True, eq=False)
class Hdf5Group:
    """A group of a file.

    Attributes:
        name: with those that it is in.
        names: of what it holds, the first hundred.
        attributes: texts, numbers and lists of them.
        arrays: those that this package reads.
    """

    name: str
    names: list[str]
    attributes: dict[str, Any]
    arrays: dict[str, Hdf5Array]

    def describe(self) -> str:
        """What it holds, for messages."""
        return listed(self.names) or "nothing"


def read_tree(path: Path, *, head: bool = False) -> dict[str, Hdf5Group]:
    """The groups that this package reads, by name; the file itself is ``/``.

    Args:
        path: the file.
        head: only the attributes of the file.

    Raises:
        MissingExtraError: h5py is not installed.
        RecordingError: the file is damaged, links to others, or takes more memory than a file of
            its size may, or longer.
    """
    h5py_of()
    try:
        size = check_plain_file(path)
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: can't be read: {error}") from error
    most = Allowance.of(path, size).most
    seconds = _SECONDS + size // _BYTES_PER_SECOND
    if not sys.executable or getattr(sys, "frozen", False):  # nothing to start a process with
        return _in_process(path, most, head)
    with _LOCK:
        global _reader
        try:
            if _reader is None or not _reader.serves():
                _reader = _Reader()
            return _reader.read(path, most, seconds, head)
        except RecordingError:
            raise
        except BaseException:  # Ctrl-C: its answer is not read
            if _reader is not None:
                _reader.end()
            _reader = None
            raise


class _Reader:
    """The process, kept for the next file: to start it takes as long as to read many."""

    def __init__(self) -> None:
        # -P: the modules of this package are not those of the standard library.
        self._process = subprocess.Popen(
            [sys.executable, "-P", hdf5_process.__file__],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )  # fmt: skip
        self._owner = os.getpid()
        atexit.register(self.end)

    def serves(self) -> bool:
        """Whether it can be asked: it has not ended, and is no copy in a forked process."""
        return self._owner == os.getpid() and self._process.poll() is None

    def end(self) -> None:
        if self._owner != os.getpid():
            return
        atexit.unregister(self.end)
        self._process.kill()
        self._process.communicate()

    def read(self, path: Path, most: int, seconds: int, head: bool) -> dict[str, Hdf5Group]:
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        late = threading.Event()

        def end() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(_WAIT_S + 2 * seconds, end)
        timer.daemon = True
        timer.start()
        try:
            process.stdin.write(json.dumps([str(path), most, seconds, head]).encode() + b"\n")
            process.stdin.flush()
            return _answer(process.stdout, path, most)
        except (EOFError, BrokenPipeError):
            code = process.wait()
            self.end()
            if code == 0:  # it ended in the very moment that it was asked, having been idle
                return _Reader().read(path, most, seconds, head)
            if late.is_set() or code == -_SIGXCPU:
                raise damaged(path, f"HDF5: not read within {seconds} s") from None
            raise damaged(path, f"HDF5: reading it ended with {code}") from None
        except RecordingError:  # an answer
            raise
        except (ValueError, KeyError, TypeError, MemoryError) as error:
            self.end()  # the file has damaged its memory, too
            raise damaged(path, f"HDF5: {error}") from error
        finally:
            timer.cancel()


_LOCK: Final = threading.Lock()
_reader: _Reader | None = None
_SIGXCPU: Final = 24  # a limit of the processor's time was reached; signal lacks it on Windows


def _answer(stream: IO[bytes], path: Path, most: int) -> dict[str, Hdf5Group]:
    length = int.from_bytes(_exactly(stream, 8), "little")
    if length > _MOST_TEXT:
        raise ValueError("too long a description")
    answer = parse_json(bytes(_exactly(stream, length)), most_bytes=_MOST_TEXT)
    _raise_if_refused(path, answer)
    entries = [
        entry for group in answer["tree"].values() for entry in group["arrays"].values()
        if "index" in entry
    ]  # fmt: skip
    arrays: dict[int, np.ndarray] = {}
    for entry in sorted(entries, key=lambda entry: int(entry["index"])):
        kind, shape = np.dtype(entry["stored"]), tuple(entry["shape"])
        count = int(np.prod(shape, dtype=object)) * kind.itemsize
        if count > most:
            raise ValueError(f"an array of {count} bytes")
        content = _exactly(stream, count)
        arrays[entry["index"]] = np.frombuffer(content, kind).reshape(shape)
    return _tree(answer["tree"], arrays)


def _in_process(path: Path, most: int, head: bool) -> dict[str, Hdf5Group]:
    try:
        tree, arrays = hdf5_process.read(str(path), most, head=head)
    except hdf5_process.RefusedError as error:
        raise RecordingError(f"{path}: {error}") from error
    except Exception as error:  # h5py promises no list of what damaged bytes raise
        raise damaged(path, f"HDF5: {error}") from error
    return _tree(tree, dict(enumerate(arrays)))


def _raise_if_refused(path: Path, answer: dict[str, Any]) -> None:
    if "refused" in answer:
        raise RecordingError(
            f"{path}: {answer['refused']}; save it again with its data within it, or as .npz"
        )
    if "damaged" in answer:
        raise damaged(path, f"HDF5: {answer['damaged']}")


def _tree(tree: dict[str, Any], arrays: dict[int, np.ndarray]) -> dict[str, Hdf5Group]:
    return {
        key: Hdf5Group(
            group["name"],
            group["names"],
            group["attributes"],
            {
                name: Hdf5Array(
                    f"{group['name'].rstrip('/')}/{name}",
                    tuple(entry["shape"]),
                    entry["kind"],
                    entry["type"],
                    entry["attributes"],
                    arrays[entry["index"]] if "index" in entry else None,
                    entry.get("texts"),
                )
                for name, entry in group["arrays"].items()
            },
        )
        for key, group in tree.items()
    }


def _exactly(stream: IO[bytes], count: int) -> bytearray:
    buffer = bytearray(count)
    view, at = memoryview(buffer), 0
    while at < count:
        got = stream.readinto(view[at:])  # type: ignore[attr-defined]
        if not got:
            raise EOFError
        at += got
    return buffer


def h5py_of() -> Any:
    """The module ``h5py``.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("an HDF5 file", "hdf5") from error
    return h5py

"""Writes data sets as shards: files with many clips, each with an index that is written once the
shard is complete.

::

    OUT/meta/dataset.json                      format and options with which the folder was begun
    OUT/meta/shards/part-00000-000012.json     the clips of a shard; a shard without it is ignored
    OUT/meta/configurations/DIGEST.json        configurations that made the commands

A shard is written under a hidden name and renamed when it is full. A killed process therefore
leaves complete shards; the next process removes files without an index and continues there.

A WebDataset consists of tar files with samples: ``KEY.json`` and ``KEY.npz`` for each clip, with
the arrays of ``pipeline.writers.arrays``. The headers contain no time, owner or process, so that
the same clips give the same bytes.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import tarfile
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.arrays import (
    clip_arrays,
    clip_document,
    clip_key,
    resampled,
    unique_slug,
)
from smooth_hand_datasets.pipeline.writers.registry import DatasetFormat, WritingOptions
from smooth_operator.atomic_files import atomic_write, output_error, write_json
from smooth_operator.errors import ConfigError, DocumentError, OutputError, RecordingError
from smooth_operator.io.documents import parse_json, read_json
from smooth_operator.io.jsonable import to_json

PROGRAM: Final = "smooth-operator"
MARK: Final = "meta/dataset.json"
INDEX: Final = "meta/shards"
CONFIGURATIONS: Final = "meta/configurations"
MB: Final = 1_000_000


class ShardedWriter(ABC):
    """Base class of writers of sharded data sets; a subclass defines the format of a shard.

    A writer that is not closed, or whose process is killed, leaves complete shards and loses the
    clips of the last one. A new writer with the same options continues after them.

    Args:
        output: the folder.
        options: options of the format.
        name: name of the format in ``WRITERS``.
        shard_mb: default size of its shards [MB].
        fixed: settings that all clips of a folder must share.

    Attributes:
        frames: number of frames that were written for the clips passed to ``write``.
    """

    most_clips = 10_000
    """Largest number of clips in a shard; its index stays in memory until the shard is full."""

    def __init__(
        self,
        output: Path,
        options: WritingOptions,
        name: str,
        shard_mb: float,
        fixed: Mapping[str, Any],
    ) -> None:
        self.output = output
        self.options = options
        self._limit = int((options.shard_mb or shard_mb) * MB)
        self._written: set[str] = set()
        self._pending: list[dict[str, Any]] = []
        self._pending_keys: set[str] = set()
        self._configurations: dict[int, tuple[Mapping[str, Any], str]] = {}
        self._facts: dict[str, tuple[int, tuple[str, ...]]] = {}
        self._taken: set[str] = set()
        self._notes: list[str] = []
        self._counts: dict[str, int] = {}
        self.frames = 0
        self._open = False
        self._number = 0
        if output.exists() and not output.is_dir():
            raise OutputError(
                f"can't write {str(output)!r}: it is a file; give the name of a folder"
            )
        with _about(output):
            for folder in (INDEX, CONFIGURATIONS):
                (output / folder).mkdir(parents=True, exist_ok=True)
        self._begin_folder({"format": name, **fixed})
        self._recover()

    # Methods of a format.

    @abstractmethod
    def _path(self, number: int) -> Path:
        """Path of a shard."""

    @abstractmethod
    def _start(self) -> None:
        """Prepares the shard in ``_file``, which is empty."""

    @abstractmethod
    def _add(self, clip: RobotClip, entry: dict[str, Any]) -> None:
        """Adds a clip to the shard, and facts about it to its entry in the index. RecordingError if
        the clip does not fit the format; no part of it was written."""

    @abstractmethod
    def _complete(self) -> dict[str, Any]:
        """Writes the rest of the shard to ``_file``; returns further content of its index."""

    def _discard(self) -> None:  # noqa: B027 - most need nothing
        """Releases what ``_start`` opened for a shard that is removed."""

    def _resume(self, index: Mapping[str, Any]) -> None:  # noqa: B027 - most need nothing
        """Counts a complete shard of this part; called for each such shard in turn."""

    def _describe(self) -> None:  # noqa: B027
        """Writes the description of all shards; called after each shard."""

    # Common methods.

    def _begin(self, number: int) -> None:
        """Starts a shard under a hidden name."""
        path = self._path(number)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: IO[bytes] = hidden(path).open("wb")
        self._start()

    def _size(self) -> int:
        """Current size of the shard [bytes]."""
        return self._file.tell()

    def _end(self, number: int) -> dict[str, Any]:
        """Completes the shard; returns further content of its index."""
        path = self._path(number)
        extra = self._complete()
        self._file.close()
        publish(path)
        return {"shard": path.relative_to(self.output).as_posix(), **extra}

    def _drop(self) -> None:
        """Removes the incomplete shard."""
        self._discard()
        with contextlib.suppress(OSError):  # its last bytes may not fit on the disk
            self._file.close()
        remove(hidden(self._path(self._number)))

    def _clean(self, number: int) -> None:
        """Removes leftovers of a killed process: hidden files, and this shard without an index."""
        remove(self._path(number))

    @property
    def written(self) -> Collection[str]:
        """Keys of the clips in the complete shards, of all parts of the data set."""
        return self._written

    @property
    def notes(self) -> list[str]:
        """Notes about the clips, each with the number of clips it applies to."""
        return [
            f"{count} clip{'s' * (count != 1)}: {text}"
            for text, count in sorted(self._counts.items())
        ]

    def note(self, text: str) -> None:
        """Adds a note about the current clip."""
        self._notes.append(text)

    def _take(self, key: str) -> None:
        """Counts the frames and notes of a clip that this run or an earlier one wrote."""
        if key in self._taken:
            return
        self._taken.add(key)
        frames, notes = self._facts.get(key, (0, ()))
        self.frames += frames
        for text in notes:
            self._counts[text] = self._counts.get(text, 0) + 1

    def write(self, clip: RobotClip) -> None:
        """Adds a clip, unless a clip with the same key was written before.

        Raises:
            RecordingError: the format can't store this clip (no frames, no wrist, no object). The
                writer can be used for the next one.
            OutputError: there is no space or no permission. The writer can't be used any more.
        """
        key = clip.key or clip_key(clip)
        if key in self._written or key in self._pending_keys:
            self._take(key)
            return
        if not len(clip.clip):
            raise RecordingError(f"{clip.clip.name}: this clip contains no frames; leave it out")
        entry = {
            "key": key,
            "name": clip.clip.name,
            "frames": len(clip.clip),
            "task": clip.clip.task,
        }
        with self._writing():
            if not self._open:
                self._begin(self._number)
                self._open = True
            self._notes = []
            self._add(clip, entry)
            if self._notes:
                entry["notes"] = self._notes
            self._pending.append(entry)
            self._pending_keys.add(key)
            self._facts[key] = _facts(entry)
            self._take(key)
            if self._size() >= self._limit or len(self._pending) >= self.most_clips:
                self._finish()

    def close(self) -> None:
        """Completes the last shard and writes the description of all shards."""
        with self._writing():
            if self._open and self._pending:
                self._finish()
            self._abandon()
            self._describe()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Removes the incomplete shard if it can't be written."""
        with _about(self.output):
            try:
                yield
            except (OSError, MemoryError):
                self._abandon()
                raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            self._abandon()

    def configuration(self, clip: RobotClip) -> str:
        """Returns the digest of the clip's configuration, whose file is written only once."""
        configuration = self._configurations.get(id(clip.config))
        if configuration is not None and configuration[0] is clip.config:
            return configuration[1]
        text = to_json(clip.config)
        digest = hashlib.sha256(text.encode()).hexdigest()[:16]
        path = self.output / CONFIGURATIONS / f"{digest}.json"
        if not path.exists():
            with atomic_write(path) as file:
                file.write(text.encode() + b"\n")
        # A mapping's identity is its own only while it lives: it is kept, the last few of them.
        if len(self._configurations) >= _KEPT:
            self._configurations.clear()
        self._configurations[id(clip.config)] = (clip.config, digest)
        return digest

    def shard_name(self, number: int) -> str:
        """``part-00000-000012``."""
        return f"part-{self.options.part:05d}-{number:06d}"

    def _finish(self) -> None:
        extra = self._end(self._number)
        self._open = False
        index = {"clips": self._pending, **extra}
        write_json(self.output / INDEX / f"{self.shard_name(self._number)}.json", index)
        self._written |= self._pending_keys
        self._pending, self._pending_keys = [], set()
        self._number += 1
        self._resume(index)
        self._describe()

    def _abandon(self) -> None:
        if self._open:
            with contextlib.suppress(OSError):
                self._drop()
        self._open = False
        self._pending, self._pending_keys = [], set()

    def _begin_folder(self, fixed: dict[str, Any]) -> None:
        path = self.output / MARK
        expected = parse_json(to_json({"program": PROGRAM, "version": 1, **fixed}))
        try:
            stored = read_json(path)
        except FileNotFoundError:
            write_json(path, expected)
            return
        except (OSError, DocumentError) as error:
            raise OutputError(
                f"{path}: can't be read ({error}); choose a new folder or remove this one"
            ) from error
        for name in sorted({*expected, *(stored if isinstance(stored, dict) else {})}):
            new, old = expected.get(name), stored.get(name) if isinstance(stored, dict) else None
            if new != old:
                raise ConfigError(
                    f"{self.output} was started with {name} = {to_json(old)}, not {to_json(new)}; "
                    "continue with the same value, or write to another folder"
                )

    def _recover(self) -> None:
        mine = f"part-{self.options.part:05d}-"
        with _about(self.output):
            looked = f"{mine}*.json" if self.options.apart else "part-*.json"
            for path in sorted((self.output / INDEX).glob(looked)):
                try:
                    index = read_json(path, most_bytes=_MOST_INDEX)
                    facts = {str(clip["key"]): _facts(clip) for clip in index["clips"]}
                except (DocumentError, KeyError, TypeError) as error:
                    raise OutputError(
                        f"{path}: can't be read as the index of a shard ({error}); remove it, "
                        "so that its clips are written again"
                    ) from error
                self._written |= facts.keys()
                self._facts |= facts
                if path.name.startswith(mine):
                    if path.stem != self.shard_name(self._number):
                        raise OutputError(
                            f"{path}: the preceding index {self.shard_name(self._number)} is "
                            "missing; write to a new folder"
                        )
                    self._number += 1
                    self._resume(index)
            self._clean(self._number)


def _facts(entry: Mapping[str, Any]) -> tuple[int, tuple[str, ...]]:
    """Frames and notes of a clip, from its entry in an index."""
    return int(entry["frames"]), tuple(map(str, entry.get("notes", ())))


_KEPT: Final = 64
_MOST_INDEX: Final = 1 << 28


@contextlib.contextmanager
def _about(path: Path) -> Iterator[None]:
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise output_error(path, error) from error


def hidden(path: Path) -> Path:
    """Hidden name that a file has until the file is complete."""
    return path.with_name(f".{path.name}.tmp")


def publish(path: Path) -> None:
    """Renames a complete file from its hidden name to its final name, after a flush to disk."""
    temporary = hidden(path)
    with temporary.open("rb+") as file:
        os.fsync(file.fileno())  # or a power cut could leave the name on an empty file
    os.replace(temporary, path)


def remove(path: Path) -> None:
    """Removes a file and its hidden version, if they exist."""
    for each in (path, hidden(path)):
        with contextlib.suppress(FileNotFoundError):
            each.unlink()


def drop_parquet(writer: Any) -> None:
    """Abandons an incomplete Parquet file."""
    if writer is not None:
        with contextlib.suppress(OSError):
            writer.close()
        writer.is_open = False  # or it would try again when it is collected


class TarShards(ShardedWriter):
    """Shards in the form of tar files with deterministic headers."""

    folder = "shards"

    def _path(self, number: int) -> Path:
        return self.output / self.folder / f"{self.shard_name(number)}.tar"

    def _start(self) -> None:
        self._tar = tarfile.TarFile(fileobj=self._file, mode="w", format=tarfile.PAX_FORMAT)

    def add_file(self, name: str, content: bytes) -> None:
        """Adds a member to the open shard."""
        header = tarfile.TarInfo(name)
        header.size, header.mode = len(content), 0o644
        self._tar.addfile(header, io.BytesIO(content))

    def _complete(self) -> dict[str, Any]:
        self._tar.close()
        return {}


def npz_bytes(arrays: dict[str, np.ndarray]) -> bytes:
    """Encodes arrays as an uncompressed NumPy archive. Equal arrays give equal bytes."""
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    return content.getvalue()


class _Writer(TarShards):
    def __init__(self, output: Path, options: WritingOptions) -> None:
        super().__init__(output, options, "webdataset", 256.0, {"rate": options.rate})

    def _add(self, clip: RobotClip, entry: dict[str, Any]) -> None:
        if self.options.rate is not None:
            clip = resampled(clip, self.options.rate)
        key = unique_slug(clip.clip.name, entry["key"])
        document = clip_document(clip, entry["key"], self.configuration(clip))
        self.add_file(f"{key}.json", to_json(document).encode())
        self.add_file(f"{key}.npz", npz_bytes(clip_arrays(clip)))
        entry["sample"] = key
        entry["frames"] = len(clip.clip)


WEBDATASET: Final = DatasetFormat("WebDataset tar shards", _Writer, parallel=True)

"""What a data set is made from: folders, files, patterns, lists of files, object storage."""

from __future__ import annotations

import glob
import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, TypeAlias

from smooth_operator.errors import ConfigError, RecordingError, SmoothOperatorError
from smooth_operator.formats.frames import frame_slice
from smooth_operator.lab.datasets.manifest import Row, is_manifest, read_manifest
from smooth_operator.lab.datasets.registry import (
    DATASETS,
    RESEARCH_LAYOUTS,
    RESEARCH_PACKAGE,
    ClipRef,
    DatasetReader,
    readers,
)
from smooth_operator.lab.datasets.remote import is_address, list_remote, local_path
from smooth_operator.parallel.tasks import describe
from smooth_operator.result_cache import key_digest
from smooth_operator.types import Side

_WILD: Final = ("*", "?", "[")
_NO_DATA: Final = frozenset(
    (
        *(".md", ".txt", ".csv", ".pdf", ".py", ".yaml", ".yml", ".toml", ".html", ".log"),
        *(".mp4", ".mov", ".avi", ".mkv", ".webm", ".jpg", ".jpeg", ".png"),
        *(".obj", ".ply", ".stl"),
    )
)
"""Suffixes of files of object storage that are not fetched to look into them."""


@dataclass(frozen=True, slots=True)
class Item:
    """A piece of work: a clip, or a file of object storage with all that is in it.

    Attributes:
        name: unique among the items.
        ref: the clip; None for a file that has to be fetched first.
        address: of that file.
        mark: size and date of that file, as its storage has them.
        layout: name of the reader to use; None for the one that recognises the file.
        task: what is done, in words, as a list says; None for what the file says.
        side: which hand, as a list says.
        rate: frames a second, as a list says.
        frames: range of frames ``A:B`` of the clip; empty for all.
        root: the folder that the paths of its files are named relative to; None for none.
        size: bytes or frames; 0 if unknown.
    """

    name: str
    ref: ClipRef | None = None
    address: str = ""
    mark: tuple[int, str] = (0, "")
    layout: str | None = None
    task: str | None = None
    side: Side | None = None
    rate: float | None = None
    frames: str = ""
    root: Path | None = None
    size: int = field(default=0, compare=False)

    @property
    def asked(self) -> str:
        """Digest of what a list says of it, and of the part of the file that it is."""
        part = "" if self.ref is None else self.ref.key
        return key_digest([self.layout, part, self.task, self.side, self.rate, self.frames])[:16]


@dataclass(frozen=True)
class Refused:
    """Something that was named as a source and can't be used.

    Attributes:
        name: of it.
        reason: why.
    """

    name: str
    reason: str


@dataclass(frozen=True)
class Found:
    """What the sources hold.

    Attributes:
        items: the pieces of work, by name.
        refused: what can't be read.
        passed_over: files of folders that no reader knows, counted by suffix.
    """

    items: tuple[Item, ...]
    refused: tuple[Refused, ...]
    passed_over: dict[str, int]


_Each: TypeAlias = Item | Refused | str
"""Found in a source: work, what can't be used, or the suffix of a file of no known layout."""


def find_items(
    sources: Sequence[str], *, layout: str | None = None, leave_out: Path | None = None
) -> Found:
    """Looks through the sources; opens files, but reads no arrays.

    Args:
        sources: paths, patterns, lists, addresses.
        layout: name of the reader for all of them; None for the one that recognises each.
        leave_out: a folder that is not looked into: that of the results.

    Raises:
        UnknownNameError: there is no such reader.
        RecordingError: a source is not there.
        MissingExtraError: an address needs a library that is not installed.
    """
    items: list[Item] = []
    refused: list[Refused] = []
    passed_over: dict[str, int] = {}
    for each in each_item(sources, layout=layout, leave_out=leave_out):
        if isinstance(each, Item):
            items.append(each)
        elif isinstance(each, Refused):
            refused.append(each)
        else:
            passed_over[each] = passed_over.get(each, 0) + 1
    named = _unique(items)
    return Found(tuple(sorted(named, key=lambda item: item.name)), tuple(refused), passed_over)


def each_item(
    sources: Sequence[str], *, layout: str | None = None, leave_out: Path | None = None
) -> Iterator[Item | Refused | str]:
    """What the sources hold, one after the other, so that a list of any length fits in memory.

    The order is that of the sources and of names in them. Items of two sources may share a name.

    Args:
        sources: as in ``find_items``.
        layout: as there.
        leave_out: as there.

    Yields:
        items; what can't be used; and the suffixes of files of no known layout.

    Raises:
        UnknownNameError, RecordingError, MissingExtraError: as ``find_items``.
    """
    if layout is not None:
        DATASETS.load(layout)
    look = _Looking(layout, None if leave_out is None else leave_out.resolve())
    return (item for source in sources for item in look.through(source))


def in_shard(item: Item, shard: tuple[int, int] | None) -> bool:
    """Whether an item belongs to shard i of n, counted from 1; a matter of its name alone."""
    if shard is None:
        return True
    number = int.from_bytes(hashlib.sha256(item.name.encode()).digest()[:8])
    return number % shard[1] == shard[0] - 1


def find_reader(path: Path, layout: str | None) -> tuple[str, DatasetReader] | None:
    """Name and reader of a file or folder; None if no reader matches.

    Raises:
        UnknownNameError: there is no reader of the name ``layout``.
    """
    choice = readers() if layout is None else {layout: DATASETS.load(layout)}
    for name, reader in choice.items():
        try:
            if reader.matches(path):
                return name, reader
        except Exception:  # a file that makes a reader stumble is not of its layout
            continue
    return None


class _Looking:
    def __init__(self, layout: str | None, leave_out: Path | None) -> None:
        self._layout, self._leave_out = layout, leave_out
        self._seen: set[Path] = set()

    def through(self, source: str) -> Iterator[_Each]:
        """One source."""
        if is_address(source):
            local = local_path(source)
            if local is None:
                yield from self._remote(source, Row(source))
                return
            source = str(local)
        path, frames = Path(source).expanduser(), ""
        name, _, part = source.rpartition("@")
        if not path.exists() and Path(name).expanduser().is_file():
            frame_slice(part, 10**12)  # refuses what is no range
            path, frames = Path(name).expanduser(), part
        if not path.exists() and any(sign in source for sign in _WILD):
            paths = [Path(match) for match in sorted(glob.glob(str(path), recursive=True))]
            if not paths:
                raise RecordingError(f"{source}: nothing has a name of this pattern")
            root = _fixed_part(path)
            above = {folder for each in paths for folder in each.parents}
            for each in paths:
                if each not in above:  # a pattern with ** names folders and what is in them
                    yield from self._named(each, root, Row(str(each)))
            return
        if not path.exists():
            raise RecordingError(
                f"{source}: there is no such file or folder; expected a folder, a file, frames of "
                "a file like 'take.npz@:500', a pattern like 'data/*.hdf5', a list (.txt, .csv, "
                ".jsonl) or an address like s3://..."
            )
        if path.is_file() and is_manifest(path):
            for row in read_manifest(path):
                yield from self._listed(replace(row, frames=frames), path.parent)
            return
        row = Row(str(path), frames=frames)
        yield from self._named(path, path if path.is_dir() else path.parent, row)

    def _listed(self, row: Row, home: Path) -> Iterator[_Each]:
        if is_address(row.path) and local_path(row.path) is None:
            yield from self._remote(row.path, row)
            return
        path = home / (local_path(row.path) or Path(row.path).expanduser())
        if not path.exists():
            yield Refused(row.path, "there is no such file or folder")
            return
        root = home if path.is_relative_to(home) else path.parent
        yield from self._named(path, root, row)

    def _named(self, path: Path, root: Path, row: Row) -> Iterator[_Each]:
        """Something that was named, so that it must be of use."""
        layout = row.layout or self._layout
        reader = find_reader(path, layout)
        if reader is not None:
            yield from _clips(*reader, path, root, row)
        elif path.is_dir():
            yield from self._walk(path, root, row, layout)
        else:
            yield Refused(_name(path, root), _unknown(layout))

    def _walk(self, folder: Path, root: Path, row: Row, layout: str | None) -> Iterator[_Each]:
        real = folder.resolve()
        if real == self._leave_out or real in self._seen:
            return
        self._seen.add(real)
        try:
            entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        except OSError as error:
            yield Refused(_name(folder, root), f"can't be read: {error.strerror or error}")
            return
        for entry in entries:
            if entry.name.startswith("."):
                continue
            path = folder / entry.name
            reader = find_reader(path, layout)
            if reader is not None:
                yield from _clips(*reader, path, root, row)
            elif entry.is_dir():
                yield from self._walk(path, root, row, layout)
            else:
                yield path.suffix.lower() or path.name

    def _remote(self, address: str, row: Row) -> Iterator[_Each]:
        for file in list_remote(address):
            suffix = Path(file.name).suffix.lower()
            if suffix in _NO_DATA and file.address != address:
                yield suffix
                continue
            yield Item(
                file.name,
                None,
                file.address,
                (file.bytes, file.changed),
                row.layout or self._layout,
                row.task,
                row.side,
                row.rate,
                size=file.bytes,
            )


def _clips(
    name: str, reader: DatasetReader, path: Path, root: Path, row: Row
) -> Iterator[Item | Refused]:
    """The clips of a file or folder, with the folders above it in their names."""
    folder = path.parent if path != root and path.is_relative_to(root) else root
    above = folder.relative_to(root).as_posix() if folder.is_relative_to(root) else "."
    prefix = "" if above == "." else f"{above}/"
    try:
        for ref in reader.clips(path):
            ref = replace(ref, layout=ref.layout or name)
            yield Item(
                prefix + ref.name,
                ref,
                layout=name,
                task=row.task,
                side=row.side,
                rate=row.rate,
                frames=row.frames,
                root=root,
                size=ref.size,
            )
    except SmoothOperatorError as error:
        yield Refused(_name(path, root), str(error))
    except Exception as error:  # of a damaged file: anything; the others go on
        yield Refused(_name(path, root), describe(error))


def _unique(items: Iterable[Item]) -> Iterator[Item]:
    """Items with names of their own: the second of a name has ``~2`` after it."""
    counts: dict[str, int] = {}
    for item in items:
        count = counts[item.name] = counts.get(item.name, 0) + 1
        yield item if count == 1 else replace(item, name=f"{item.name}~{count}")


def _unknown(layout: str | None) -> str:
    if layout is not None:
        reader = DATASETS.load(layout)
        return f"it is not {reader.what}; expected {reader.expects}"
    missing = [name for name in RESEARCH_LAYOUTS if name not in DATASETS]
    more = f"; {', '.join(missing)}: {RESEARCH_PACKAGE}" if missing else ""
    return f"no reader recognises it; layouts that are read: {', '.join(DATASETS)}{more}"


def _name(path: Path, root: Path) -> str:
    return (
        path.relative_to(root).as_posix()
        if path.is_relative_to(root) and path != root
        else path.name
    )


def _fixed_part(pattern: Path) -> Path:
    """The folders of a pattern before the first one with a wildcard."""
    fixed = Path(pattern.anchor)
    for part in pattern.parts[len(fixed.parts) : -1]:
        if any(sign in part for sign in _WILD):
            break
        fixed /= part
    return fixed


def parse_shard(text: str) -> tuple[int, int]:
    """``i/n``, i from 1 to n.

    Raises:
        ConfigError: it is something else.
    """
    number, sign, count = text.partition("/")
    if not (sign and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise ConfigError(f"a shard must be i/n with i from 1 to n, such as 3/16, not {text!r}")
    return int(number), int(count)

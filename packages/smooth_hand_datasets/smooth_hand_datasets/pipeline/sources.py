"""Finds the clips in the sources of a data set: folders, files, patterns, lists, object storage."""

from __future__ import annotations

import contextlib
import csv
import glob
import hashlib
import io
import itertools
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final, TypeAlias
from urllib.parse import unquote, urlsplit

from smooth_operator.errors import (
    ConfigError,
    DocumentError,
    RecordingError,
    SmoothOperatorError,
    brief,
    reason,
)
from smooth_operator.formats.checks import frame_slice
from smooth_operator.formats.clip import ClipRef
from smooth_operator.formats.foreign import foreign_dataset, foreign_file, is_dataset
from smooth_operator.formats.registry import (
    ClipReader,
    clip_readers,
    file_kind,
    find_reader,
    recognise,
)
from smooth_operator.io.documents import parse_json
from smooth_operator.io.plain_files import check_plain_file, read_text
from smooth_operator.parallel.tasks import describe
from smooth_operator.result_cache import key_digest
from smooth_operator.types import Side, as_side

_DATES: Final = ("ETag", "etag", "md5Hash", "content_md5", "LastModified", "last_modified")
_MORE_DATES: Final = ("updated", "mtime", "created")
"""Names of fields that object storages use for the time at which a file changed."""


def is_address(text: str) -> bool:
    """True for an address such as ``s3://bucket/folder``, False for a path."""
    scheme, sign, _ = text.partition("://")
    return bool(sign) and scheme.replace("+", "").replace("-", "").isalnum()


def local_path(address: str) -> Path | None:
    """The path of a ``file://`` address; None for other addresses."""
    if not is_address(address) or urlsplit(address).scheme not in ("file", "local"):
        return None
    return Path(unquote(urlsplit(address).path))


def list_remote(address: str) -> Iterator[Item]:
    """Lists the files at an address: a folder with its subfolders, a pattern, or a single file.

    Returns:
        for each file its name, which is its path relative to the address; its address, its size,
        and a mark that changes with each write, empty if the storage does not have one.

    Raises:
        RecordingError: the address can't be listed, there are no files, or fsspec's library for
            this storage is not installed.
    """
    system, path = _system(address)
    root = path.rstrip("/")
    with _about(address):
        wild = any(sign in path for sign in "*?[")
        listing: dict[str, Any] = system.glob(path, detail=True) if wild else {}
        if wild:
            root = str(PurePosixPath(path.split("*")[0].split("?")[0].split("[")[0] + "x").parent)
        else:
            listing = system.find(path, detail=True)
        files = {name: info for name, info in listing.items() if info.get("type") == "file"}
    if not files:
        raise RecordingError(f"{address}: there are no files")
    for name, info in sorted(files.items()):
        below = name.removeprefix(root).strip("/") or PurePosixPath(name).name
        dates = [info[each] for each in (*_DATES, *_MORE_DATES) if info.get(each)]
        size = int(info.get("size") or 0)
        mark = (size, str(*dates[:1]))
        yield Item(below, address=system.unstrip_protocol(name), mark=mark, size=size)


@contextlib.contextmanager
def fetched(address: str) -> Iterator[Path]:
    """Copies a file to this machine for the duration of the block.

    Raises:
        RecordingError: as ``list_remote``.
    """
    system, path = _system(address)
    with tempfile.TemporaryDirectory(prefix="smooth-operator-") as folder:
        local = Path(folder) / PurePosixPath(path).name
        with _about(address):
            system.get_file(path, str(local))
        yield local


def _system(address: str) -> tuple[Any, str]:
    import fsspec

    scheme = urlsplit(address).scheme
    try:
        system, path = fsspec.core.url_to_fs(address)
    except ImportError as error:
        raise RecordingError(
            f"{address}: fsspec needs a library for {scheme}:// that is not installed ({error})"
        ) from error
    except ValueError as error:
        raise RecordingError(f"{address}: {error}") from error
    return system, path


@contextlib.contextmanager
def _about(address: str) -> Iterator[None]:
    """Converts errors of a storage to errors that name the address."""
    try:
        yield
    except RecordingError:
        raise
    except FileNotFoundError as error:
        raise RecordingError(f"{address}: there is no such file or folder") from error
    except Exception as error:  # of libraries of storages: anything
        reason = " ".join(str(error).split())
        raise RecordingError(
            f"{address}: can't be read: {type(error).__name__}: {reason}; check the address, the "
            "network and your credentials"
        ) from error


_MOST_BYTES: Final = 2_000_000_000
_COLUMNS: Final = ("path", "task", "side", "layout", "rate")
_FIRST: Final = 65_536


@dataclass(frozen=True, slots=True)
class Item:
    """A piece of work: one clip, or one file in object storage with all its clips.

    Attributes:
        name: its name, unique among the items.
        ref: the clip; None for a file that must be fetched first.
        address: address of that file.
        mark: size and change mark of that file.
        layout: name of the reader; None to detect it from the file.
        task: description of the task, if a list states it; None for the one in the file.
        side: side of the hand, if a list states it.
        rate: frame rate, if a list states it [Hz].
        frames: range of frames ``A:B`` of the clip; empty for all.
        root: folder to which the paths of its files are relative; None for absolute paths.
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
    def settings_key(self) -> str:
        """Digest of the settings that the item's list states, and of the part of the file that the
        item covers."""
        part = "" if self.ref is None else self.ref.key
        return key_digest([self.layout, part, self.task, self.side, self.rate, self.frames])[:16]


def is_manifest(path: Path) -> bool:
    """True if a file is a list of recordings: a ``.txt`` or ``.csv`` file, or a ``.jsonl`` file
    whose first line has ``path``."""
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


def read_manifest(path: Path) -> Iterator[Item]:
    """Yields the lines of a list as items, each named by its path or address. Raises RecordingError
    if the list can't be read or a line is not valid; the message has the number of the line."""
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
            yield Item(line)
            continue
        where = f"{path}, line {number}"
        try:
            values = parse_json(line)
        except DocumentError as error:
            raise RecordingError(f"{where}: {error}; expected one JSON object per line") from error
        yield _row(values, where)


def _of_csv(text: str, path: Path) -> Iterator[Item]:
    table = csv.DictReader(io.StringIO(text))
    if "path" not in (table.fieldnames or ()):
        if _is_of_numbers(text):
            raise RecordingError(
                f"{path}: this is {foreign_file(path)}; if it is meant as a list of recordings, it "
                "needs the column 'path'"
            )
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


def _is_of_numbers(text: str) -> bool:
    """True for a table whose first rows contain mostly numbers."""
    rows = list(itertools.islice(csv.reader(io.StringIO(text)), 1, 4))
    cells = [cell for row in rows for cell in row if cell.strip()]
    numbers = 0
    for cell in cells:
        with contextlib.suppress(ValueError):
            float(cell)
            numbers += 1
    return numbers >= 3 and numbers > len(cells) / 2


def _row(values: Any, where: str) -> Item:
    if not isinstance(values, Mapping) or not isinstance(values.get("path"), str):
        raise RecordingError(f"{where}: expected an object with the string 'path'")
    for name in ("task", "layout"):
        if not isinstance(values.get(name, ""), str | None):
            raise RecordingError(f"{where}: {name} must be a string, not {brief(values[name])}")
    rate, side = values.get("rate"), values.get("side")
    try:
        rate = None if rate is None else float(rate)
    except (TypeError, ValueError):
        raise RecordingError(
            f"{where}: rate must be a number of frames per second, not {brief(rate)}"
        ) from None
    try:
        return Item(
            values["path"],
            layout=values.get("layout") or None,
            task=values.get("task") or None,
            side=None if side is None else as_side(side),
            rate=rate,
        )
    except ConfigError as error:
        raise RecordingError(f"{where}: {reason(error)}") from error


_WILD: Final = ("*", "?", "[")
_NO_DATA: Final = frozenset(
    (
        *(".md", ".txt", ".csv", ".pdf", ".py", ".yaml", ".yml", ".toml", ".html", ".log"),
        *(".mp4", ".mov", ".avi", ".mkv", ".webm", ".jpg", ".jpeg", ".png"),
        *(".obj", ".ply", ".stl"),
    )
)
"""Suffixes of files in object storage that are skipped without fetching them."""


@dataclass(frozen=True)
class Refused:
    """A source that can't be used.

    Attributes:
        name: its name.
        reason: why it can't be used.
    """

    name: str
    reason: str


@dataclass(frozen=True)
class Survey:
    """Everything that a search of the sources found.

    Attributes:
        items: the pieces of work, sorted by name.
        refused: items that can't be read.
        passed_over: suffix -> number of files in folders that no reader recognised.
    """

    items: tuple[Item, ...]
    refused: tuple[Refused, ...]
    passed_over: dict[str, int]


_Each: TypeAlias = Item | Refused | str
"""Part of a source: an item, a source that can't be used, or the suffix of an unknown file."""


def find_items(
    sources: Sequence[str], *, layout: str | None = None, leave_out: Path | None = None
) -> Survey:
    """Lists the items in some sources. Opens files, but reads no arrays.

    Args:
        sources: paths, patterns, lists, addresses.
        layout: name of the reader for all sources; None to detect it for each file.
        leave_out: folder to skip, namely that of the results.

    Raises:
        UnknownNameError: there is no such reader.
        RecordingError: a source does not exist, or an address needs a library that is not
            installed.
    """
    items: list[Item] = []
    refused: list[Refused] = []
    passed_over: dict[str, int] = {}
    if layout is not None:
        find_reader(layout)
    look = _Looking(layout, None if leave_out is None else leave_out.resolve())
    for each in itertools.chain.from_iterable(map(look.through, sources)):
        if isinstance(each, Item):
            items.append(each)
        elif isinstance(each, Refused):
            refused.append(each)
        else:
            passed_over[each] = passed_over.get(each, 0) + 1
    named = _unique(items)
    return Survey(tuple(sorted(named, key=lambda item: item.name)), tuple(refused), passed_over)


def in_shard(item: Item, shard: tuple[int, int] | None) -> bool:
    """True if an item belongs to shard i of n, counted from 1. This depends only on the item's
    name."""
    if shard is None:
        return True
    number = int.from_bytes(hashlib.sha256(item.name.encode()).digest()[:8])
    return number % shard[1] == shard[0] - 1


class _Looking:
    def __init__(self, layout: str | None, leave_out: Path | None) -> None:
        self._layout, self._leave_out = layout, leave_out
        self._seen: set[Path] = set()

    def through(self, source: str) -> Iterator[_Each]:
        if is_address(source):
            local = local_path(source)
            if local is None:
                yield from self._remote(source, Item(source))
                return
            source = str(local)
        path, frames = Path(source).expanduser(), ""
        name, _, part = source.rpartition("@")
        if not path.exists() and Path(name).expanduser().is_file():
            frame_slice(part, None)  # refuses what is no range
            path, frames = Path(name).expanduser(), part
        if not path.exists() and any(sign in source for sign in _WILD):
            paths = [Path(match) for match in sorted(glob.glob(str(path), recursive=True))]
            if not paths:
                raise RecordingError(f"{source}: no file or folder matches this pattern")
            root = _fixed_part(path)
            above = {folder for each in paths for folder in each.parents}
            for each in paths:
                if each not in above:  # a pattern with ** names folders and what is in them
                    yield from self._named(each, root, Item(str(each)))
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
        row = Item(str(path), frames=frames)
        yield from self._named(path, path if path.is_dir() else path.parent, row)

    def _listed(self, row: Item, home: Path) -> Iterator[_Each]:
        if is_address(row.name) and local_path(row.name) is None:
            yield from self._remote(row.name, row)
            return
        path = home / (local_path(row.name) or Path(row.name).expanduser())
        if not path.exists():
            yield Refused(row.name, "there is no such file or folder")
            return
        root = home if path.is_relative_to(home) else path.parent
        yield from self._named(path, root, row)

    def _named(self, path: Path, root: Path, row: Item) -> Iterator[_Each]:
        """Yields the items of a path that the user named, so an unknown file is refused."""
        layout = row.layout or self._layout
        reader = recognise(path, layout)
        if reader is not None:
            yield from _clips(*reader, path, root, row)
        elif is_dataset(path):
            yield Refused(_name(path, root), _lerobot(path))
        elif path.is_dir():
            yield from self._walk(path, root, row, layout)
        else:
            yield Refused(_name(path, root), _unknown(path, layout))

    def _walk(self, folder: Path, root: Path, row: Item, layout: str | None) -> Iterator[_Each]:
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
            reader = recognise(path, layout)
            if reader is not None:
                yield from _clips(*reader, path, root, row)
            elif is_dataset(path):
                yield Refused(_name(path, root), _lerobot(path))
            elif entry.is_dir():
                yield from self._walk(path, root, row, layout)
            else:
                yield path.suffix.lower() or path.name

    def _remote(self, address: str, row: Item) -> Iterator[_Each]:
        for file in list_remote(address):
            suffix = Path(file.name).suffix.lower()
            if suffix in _NO_DATA and file.address != address:
                yield suffix
                continue
            layout = row.layout or self._layout
            yield replace(file, layout=layout, task=row.task, side=row.side, rate=row.rate)


def _clips(
    name: str, reader: ClipReader, path: Path, root: Path, row: Item
) -> Iterator[Item | Refused]:
    """Yields the clips of a file or folder; their names contain the folders above it."""
    folder = path.parent if path != root and path.is_relative_to(root) else root
    above = folder.relative_to(root).as_posix() if folder.is_relative_to(root) else "."
    prefix = "" if above == "." else f"{above}/"
    try:
        for ref in reader.clips(path):
            ref = replace(ref, layout=ref.layout or name)
            yield replace(
                row, name=prefix + ref.name, ref=ref, layout=name, root=root, size=ref.size
            )
    except SmoothOperatorError as error:
        yield Refused(_name(path, root), str(error))
    except Exception as error:  # of a damaged file: anything; the others go on
        yield Refused(_name(path, root), describe(error))


def _unique(items: Iterable[Item]) -> Iterator[Item]:
    """Makes the names of items unique: the second item with a name gets the suffix ``~2``."""
    counts: dict[str, int] = {}
    for item in items:
        count = counts[item.name] = counts.get(item.name, 0) + 1
        yield item if count == 1 else replace(item, name=f"{item.name}~{count}")


def _lerobot(path: Path) -> str:
    """Reason why a LeRobot data set can't be a source."""
    foreign = foreign_dataset(path)
    if foreign is not None:
        return f"this is {foreign}"
    return (
        "this is a LeRobot data set; convert its episodes first, and use their folder: "
        f"smooth-operator convert {path} --to npz --output episodes; or, to keep it as a LeRobot "
        "data set and replace its actions with those of another robot hand: smooth-operator "
        f"retarget --dataset {path}"
    )


def _unknown(path: Path, layout: str | None) -> str:
    if layout is not None:
        reader = find_reader(layout)
        return f"this is not {reader.what}; expected {reader.expects}"
    try:
        file_kind(path)  # names the kind, and the way from it
    except RecordingError as error:
        kind = str(error).removeprefix(f"{path}: ")
        if not kind.startswith("not a recording"):
            return kind
    return f"no reader recognises this file; known layouts: {', '.join(clip_readers())}"


def _name(path: Path, root: Path) -> str:
    return (
        path.relative_to(root).as_posix()
        if path.is_relative_to(root) and path != root
        else path.name
    )


def _fixed_part(pattern: Path) -> Path:
    """The folders of a pattern before its first wildcard."""
    fixed = Path(pattern.anchor)
    for part in pattern.parts[len(fixed.parts) : -1]:
        if any(sign in part for sign in _WILD):
            break
        fixed /= part
    return fixed


def parse_shard(text: str) -> tuple[int, int]:
    """Parses ``i/n``, with i from 1 to n; ConfigError if the text does not have this form."""
    number, sign, count = text.partition("/")
    if not (sign and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise ConfigError(f"a shard must be i/n with i from 1 to n, such as 3/16, not {text!r}")
    return int(number), int(count)

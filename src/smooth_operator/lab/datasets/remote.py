"""Files of object storage: listed, and fetched to be read."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from smooth_operator.errors import MissingExtraError, RecordingError, require

EXTRA: Final = "datasets"
_DATES: Final = ("ETag", "etag", "md5Hash", "content_md5", "LastModified", "last_modified")
_MORE_DATES: Final = ("updated", "mtime", "created")
"""What storages call the mark that changes with a file."""


@dataclass(frozen=True)
class RemoteFile:
    """A file of object storage.

    Attributes:
        name: its path below what was asked for.
        address: of it.
        bytes: its size.
        changed: what changes when it is written again; empty if the storage has nothing.
    """

    name: str
    address: str
    bytes: int
    changed: str


def is_address(text: str) -> bool:
    """Whether a text is an address, such as ``s3://bucket/folder``, and no path."""
    scheme, sign, _ = text.partition("://")
    return bool(sign) and scheme.replace("+", "").replace("-", "").isalnum()


def local_path(address: str) -> Path | None:
    """The path of a ``file://`` address; None for others."""
    if not is_address(address) or urlsplit(address).scheme not in ("file", "local"):
        return None
    return Path(unquote(urlsplit(address).path))


def list_remote(address: str) -> Iterator[RemoteFile]:
    """The files at an address: those of a folder and its folders, of a pattern, or the one.

    Raises:
        MissingExtraError: fsspec, or its library for this storage, is not installed.
        RecordingError: the address can't be listed, or nothing is there.
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
        raise RecordingError(f"{address}: no files are there")
    for name, info in sorted(files.items()):
        below = name.removeprefix(root).strip("/") or PurePosixPath(name).name
        dates = [info[each] for each in (*_DATES, *_MORE_DATES) if info.get(each)]
        yield RemoteFile(
            below, system.unstrip_protocol(name), int(info.get("size") or 0), str(*dates[:1])
        )


@contextlib.contextmanager
def fetched(address: str) -> Iterator[Path]:
    """A copy of a file on this machine, while the block lasts.

    Raises:
        MissingExtraError, RecordingError: as ``list_remote``.
    """
    system, path = _system(address)
    with tempfile.TemporaryDirectory(prefix="smooth-operator-") as folder:
        local = Path(folder) / PurePosixPath(path).name
        with _about(address):
            system.get_file(path, str(local))
        yield local


def _system(address: str) -> tuple[Any, str]:
    require(f"reading {address}", EXTRA, "fsspec")
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
    """What a storage raises, with the address."""
    try:
        yield
    except (RecordingError, MissingExtraError):
        raise
    except FileNotFoundError as error:
        raise RecordingError(f"{address}: nothing is there") from error
    except Exception as error:  # of libraries of storages: anything
        reason = " ".join(str(error).split())
        raise RecordingError(
            f"{address}: can't be read: {type(error).__name__}: {reason}; look at the address, the "
            "network and your credentials"
        ) from error

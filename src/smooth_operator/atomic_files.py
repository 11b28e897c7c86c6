"""Atomic writing of files."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, BinaryIO, Final

from smooth_operator.errors import OutputError
from smooth_operator.io.jsonable import to_json

_LOCKED_BYTE: Final = 1 << 30
"""Position of the byte that is locked on Windows [byte], beyond the end of any file that is locked.
"""

# Advice by errno; strerror alone names the problem but not the remedy.
_REMEDIES = {
    errno.ENOSPC: "no space is left on the device; free some space, or write to another disk",
    errno.EDQUOT: "your disk quota is used up; free some space, or write to another disk",
    errno.EFBIG: "the file would be larger than this disk allows; write to another disk",
    errno.EACCES: "permission denied; choose a folder that you may write to",
    errno.EPERM: "permission denied; choose a folder that you may write to",
    errno.EROFS: "the file system is read-only; choose another folder",
    errno.ENOTDIR: "part of the path is a file, not a folder; choose another path",
    errno.EISDIR: "it is a folder; give the name of a file",
    errno.EEXIST: "the file exists already; choose another name, or ask to overwrite it",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
}


def output_error(path: str | os.PathLike[str], cause: OSError) -> OutputError:
    """Turns an operating-system error about ``path`` into an ``OutputError`` that says what to do.

    Args:
        path: the file that was to be written.

    Returns:
        The error to raise (``from cause``); it carries the cause's ``errno``.
    """
    path = Path(path)
    occupied = [errno.EISDIR, errno.EEXIST]
    if os.name == "nt":  # which calls opening a folder a lack of permission
        occupied.append(errno.EACCES)
    if isinstance(cause, FileNotFoundError):
        if path.parent.is_dir():  # of /proc, or of a folder that was removed meanwhile
            remedy = "no file can be created there; choose another folder"
        else:
            remedy = f"the folder {str(path.parent)!r} does not exist; create it first"
    elif cause.errno in occupied and os.path.isdir(path):
        remedy = _REMEDIES[errno.EISDIR]
    else:
        remedy = _REMEDIES.get(cause.errno or 0, f"{cause.strerror or cause}; choose another path")
    error = OutputError(f"can't write {str(path)!r}: {remedy}")
    error.errno = cause.errno
    return error


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """Write a file atomically: a temporary file in its folder replaces it at the end of the block.

    If the block raises, or the process dies, an existing file at ``path`` is unchanged. A symbolic
    link is followed, so its target is replaced and not the link.

    Args:
        path: the file; its folder must exist.

    Yields:
        A binary file, open for writing (and seekable).

    Raises:
        OutputError: no such folder, no permission, no space, or ``path`` is not a regular file.

    Example:
        >>> with atomic_write("result.json") as file:  # doctest: +SKIP
        ...     file.write(b"{}")
    """
    target = Path(os.path.realpath(path))
    if os.path.exists(target) and not os.path.isfile(target):
        # os.replace would happily put a regular file in the place of /dev/null.
        kind = "a folder" if os.path.isdir(target) else "not a regular file"
        raise OutputError(f"can't write {str(path)!r}: it is {kind}; give the name of a file")
    temporary = temporary_beside(target)
    try:
        file = temporary.open("xb")
    except OSError as error:
        raise output_error(path, error) from error
    try:
        try:
            with file:
                yield file
                file.flush()
                os.fsync(file.fileno())  # or a power cut could leave the new name on an empty file
            os.replace(temporary, target)
        except OSError as error:
            if isinstance(error, OutputError) or error.filename not in (None, str(temporary)):
                raise  # about another file that the block handles
            raise output_error(path, error) from error
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


_MACHINE = hashlib.sha256(os.uname().nodename.encode() if os.name != "nt" else b"").hexdigest()[:8]
_TEMPORARY = re.compile(rf"\..{{1,32}}\.{_MACHINE}-(\d{{1,10}})\.[0-9a-f]{{8}}\.tmp", re.DOTALL)
_ANY_TEMPORARY = re.compile(r"\..{1,32}\.[0-9a-f]{8}-\d{1,10}\.[0-9a-f]{8}\.tmp", re.DOTALL)
_swept: set[Path] = set()


def temporary_beside(target: Path) -> Path:
    """Returns a new hidden path for a file or folder that later replaces ``target``.

    It is in the same folder, since only a rename within one file system is atomic. Its name
    contains the machine and the process. When a process writes to a folder for the first time, the
    leftovers of killed processes of this machine are deleted there.
    """
    folder = target.parent
    if os.name != "nt" and folder not in _swept:
        _swept.add(folder)
        with contextlib.suppress(OSError):
            for path in list(folder.iterdir()):
                match = _TEMPORARY.fullmatch(path.name)
                if match is not None and not _runs(int(match[1])):
                    if path.is_dir() and not path.is_symlink():
                        shutil.rmtree(path, ignore_errors=True)
                    else:
                        path.unlink()
    unique = f"{_MACHINE}-{os.getpid()}.{secrets.token_hex(4)}"
    return target.with_name(f".{target.name[:32]}.{unique}.tmp")


def remove_leftovers(folders: Iterable[Path]) -> int:
    """Deletes the unfinished files that killed runs, on any machine, have left in some folders.

    Returns:
        their number.
    """
    count = 0
    for folder in folders:
        with contextlib.suppress(OSError):
            for path in list(folder.iterdir()):
                if _ANY_TEMPORARY.fullmatch(path.name) and path.is_file():
                    path.unlink()
                    count += 1
    return count


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's, or no number of a process
        pass
    return True


def write_json(path: Path, content: object, indent: int | None = None) -> None:
    """Write a JSON file atomically.

    Args:
        path: the file; its folder must exist.
        content: any value for ``to_json``.
        indent: spaces per level; None for one line.

    Raises:
        OutputError: the file can't be written.
        ConfigError: the content has no JSON form.
    """
    text = to_json(content, indent=indent)
    with atomic_write(path) as file:
        file.write(text.encode() + b"\n")


def file_name(readable: str, words: Iterable[str]) -> str:
    """Makes a readable file name from words. It is valid on every system, and unique for these
    words."""
    unique = hashlib.sha256("\n".join(words).encode()).hexdigest()[:8]
    harmless = re.sub(r"[^A-Za-z0-9.]+", "-", readable).strip("-.")
    return f"{harmless[:100]}-{unique}"


@contextlib.contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Locks a folder against other runs, until the block or the process ends.

    If folders can't be locked (Windows, some network disks), a second run is not noticed; it would
    write the same bytes.

    Raises:
        OutputError: another run is working there, or the folder can't be opened.
    """
    if sys.platform == "win32":  # no folder can be opened
        yield
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise output_error(folder, error) from error
    try:
        if not _lock(handle):
            raise OutputError(
                f"can't write into {str(folder)!r}: another run is writing there"
                f"{_locked_by(handle)}; wait until it is done, or choose another folder"
            )
        yield
    finally:
        os.close(handle)


def open_locked(path: Path, overwrite: bool) -> BinaryIO:
    """Open an empty file for writing, and lock it against other runs until it is closed.

    If the disk can't lock (some network disks), another run is not noticed.

    Args:
        overwrite: True to replace an existing file, unless another run is writing it.

    Raises:
        OutputError: another run is writing the file, which is left as it is.
        OSError: the file can't be created, or exists already.
    """
    stream = open(path, "wb" if overwrite else "xb", opener=_opened_whole)  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        return stream
    if not _lock(stream.fileno()):
        holder = _locked_by(stream.fileno())
        stream.close()
        raise OutputError(
            f"can't write {str(path)!r}: another run is writing it{holder}; stop that run, or give "
            "another name"
        )
    stream.truncate(0)
    return stream


def _opened_whole(path: str, flags: int) -> int:
    """Opens a file without truncating it, because another run may have locked it."""
    return os.open(path, flags & ~os.O_TRUNC, 0o666)


def _lock(handle: int) -> bool:
    """Lock an open file or folder; return False if another process has locked it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(handle, _LOCKED_BYTE, os.SEEK_SET)  # others can't read a locked byte
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
            os.lseek(handle, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # this disk can't lock
        return True
    return True


def _locked_by(handle: int) -> str:
    """Number of the process that has locked an open file, for a message; empty if unknown."""
    inode = os.fstat(handle).st_ino
    with contextlib.suppress(OSError):  # Linux lists all locks
        for line in Path("/proc/locks").read_text(encoding="utf-8").splitlines():
            words = line.split()
            if words[1] == "FLOCK" and words[5].endswith(f":{inode}"):
                return f" (process {words[4]})"
    return ""

"""Writes a file or folder completely or not at all.

``atomic_write`` yields an open file. Libraries that open files themselves, and datasets of many
files, need a temporary place until everything is written.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from smooth_operator.atomic_files import output_error, temporary_beside
from smooth_operator.errors import OutputError, RecordingError, SmoothOperatorError


@contextlib.contextmanager
def staged_file(path: Path) -> Iterator[Path]:
    """Yields a temporary path for a file, which is moved to ``path`` when the block ends.

    If the block raises, or the process dies, an existing file at ``path`` is unchanged. A symbolic
    link is followed, so its target is replaced and not the link.

    Raises:
        OutputError: as for ``atomic_write``.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        kind = "a folder" if target.is_dir() else "not a regular file"
        raise OutputError(f"can't write {str(path)!r}: it is {kind}; give the name of a file")
    temporary = temporary_beside(target)
    try:
        with _about(path, temporary):
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())  # or a power cut could leave the name on an empty file
            os.replace(temporary, target)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


@contextlib.contextmanager
def staged_folder(path: Path) -> Iterator[Path]:
    """Yields a new folder to fill, which is moved to ``path`` when the block ends.

    An existing folder at ``path`` is moved aside and then removed; if the process dies between the
    two moves, it still exists under a hidden name in the same folder (``.NAME.….old``).

    Raises:
        OutputError: no permission, no space, or the path is a file.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_dir():
        raise OutputError(f"can't write {str(path)!r}: it is a file; give the name of a folder")
    temporary = temporary_beside(target)
    former = temporary.with_suffix(".old")
    try:
        with _about(path, temporary):
            temporary.mkdir()
            yield temporary
            for file in temporary.rglob("*"):
                if file.is_file() and os.access(file, os.W_OK):  # a linked video may be read-only
                    with file.open("rb+") as stream:
                        os.fsync(stream.fileno())
            if target.exists():
                target.rename(former)
            try:
                temporary.rename(target)
            except OSError:
                if former.exists():
                    former.rename(target)
                raise
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    shutil.rmtree(former, ignore_errors=True)


@contextlib.contextmanager
def _about(path: Path, temporary: Path) -> Iterator[None]:
    """Makes errors name the requested file instead of the temporary one."""
    try:
        yield
    except SmoothOperatorError as error:
        text = str(error)
        if isinstance(error, (OutputError, RecordingError)) and str(temporary) in text:
            renamed = type(error)(text.replace(str(temporary), str(path)))
            if isinstance(renamed, OutputError) and isinstance(error, OutputError):
                renamed.errno = error.errno
            raise renamed from error
        raise
    except OSError as error:
        if not temporary.is_dir() or isinstance(error, FileNotFoundError):
            raise output_error(path, error) from error
        # Asked of a name that nothing has, or the trouble would seem to be that a folder is there.
        renamed = output_error(path / temporary.name, error)
        text = str(renamed).replace(str(path / temporary.name), str(path))
        fresh = OutputError(text)
        fresh.errno = renamed.errno
        raise fresh from error

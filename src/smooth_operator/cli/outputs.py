"""Checks output paths before the long work starts."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import OutputError
from smooth_operator.formats.commands import config_path
from smooth_operator.planning import foreign_result, read_configuration


def check_commands_path(path: Path, recording: Path, overwrite: bool) -> None:
    """Checks that ``OUT.npz`` and its configuration may be written; writes nothing. Raises
    OutputError if the name does not end in ``.npz``, if there is an earlier result and
    ``overwrite`` is false, or if one of the two files exists and is not an earlier result."""
    if path.suffix != ".npz":
        raise OutputError(f"can't write {str(path)!r}: the name must end in .npz")
    for target in (path, config_path(path)):
        if target.exists() and recording.exists() and target.samefile(recording):
            raise OutputError(
                f"can't write {str(target)!r}: it is the recording itself; choose another name"
            )
    if reason := foreign_result(path):
        raise OutputError(reason)
    if path.exists() and not overwrite:
        raise OutputError(
            f"can't write {str(path)!r}: it exists; choose another name, or add --overwrite"
        )


CONFIG: Final = "config.json"
"""Name of the file with the settings in a folder of results."""


def check_folder(folder: Path, command: str, former: str) -> None:
    """Checks that results may be written into a folder. Does not write anything.

    Args:
        command: command whose earlier results may be in the folder.
        former: origin of those results, for the message.

    Raises:
        OutputError: it is a file, or the folder contains anything other than such results.
    """
    if not folder.exists():
        return
    if not folder.is_dir():
        raise OutputError(
            f"can't write into {str(folder)!r}: it is a file; give the name of a folder"
        )
    try:
        empty = not any(folder.iterdir())
    except OSError as error:
        raise output_error(folder, error) from error
    if not empty and (read_configuration(folder / CONFIG) or {}).get("command") != command:
        raise OutputError(
            f"can't write into {str(folder)!r}: it contains files that are not from "
            f"{former}; choose another folder with --output"
        )


@contextlib.contextmanager
def folder_for(folder: Path) -> Iterator[None]:
    """Creates a folder if necessary and checks that it is writable. If the block fails, a new
    folder is removed again. OutputError if the folder can't be created or is not writable."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            f"can't write into {str(folder)!r}: it is a file, but a folder is expected; "
            "choose another path"
        )
    missing = [at for at in (folder, *folder.parents) if not at.exists()]
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise output_error(folder, error) from error
        yield
    except BaseException:
        for at in missing:  # Start with the deepest folder; rmdir removes only empty folders.
            with contextlib.suppress(OSError):
                at.rmdir()
        raise


def stopped(output: Path) -> KeyboardInterrupt:
    """Returns the exception to raise when Ctrl-C ends a command whose results are kept; ``main``
    prints its text."""
    return KeyboardInterrupt(f"run the same command again to continue in {output}")


@contextlib.contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Yields a temporary folder for results; its files are moved to ``folder`` when the block ends.

    If the block fails or is stopped, ``folder`` is unchanged.

    Raises:
        OutputError: a file can't be moved to ``folder``.
    """
    try:
        holder = tempfile.TemporaryDirectory(prefix=".unfinished-", dir=folder)
    except OSError as error:
        raise output_error(folder, error) from error
    with holder as temporary:
        stage = Path(temporary)
        yield stage
        try:
            for source in sorted(path for path in stage.rglob("*") if path.is_file()):
                target = folder / source.relative_to(stage)
                target.parent.mkdir(parents=True, exist_ok=True)
                source.replace(target)
        except OSError as error:
            raise output_error(error.filename2 or error.filename or folder, error) from error

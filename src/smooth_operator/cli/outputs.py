"""Checks of output paths before the long work starts."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import OutputError, RecordingError
from smooth_operator.formats.commands import config_path, read_commands
from smooth_operator.planning import read_configuration


def check_commands_path(path: Path, recording: Path, overwrite: bool) -> None:
    """Checks that ``OUT.npz`` and its configuration may be written; writes nothing.

    Raises:
        OutputError: the name does not end in ``.npz``; there is an earlier result and ``overwrite``
            is false; or one of the two names is taken by something other than an earlier result.
    """
    if path.suffix != ".npz":
        raise OutputError(f"can't write {str(path)!r}: the name must end in .npz")
    beside = config_path(path)
    for target in (path, beside):
        if target.exists() and not target.is_file():
            raise OutputError(f"can't write {str(target)!r}: it is a folder; give a file's name")
        if target.exists() and recording.exists() and target.samefile(recording):
            raise OutputError(
                f"can't write {str(target)!r}: it is the recording itself; choose another name"
            )
    if path.exists():
        try:
            read_commands(path)
        except RecordingError:
            raise OutputError(
                f"can't write {str(path)!r}: it holds something other than commands; choose "
                "another name, or remove it first"
            ) from None
        if not overwrite:
            raise OutputError(
                f"can't write {str(path)!r}: it exists; choose another name, or add --overwrite"
            )
    if beside.exists() and read_configuration(beside) is None:
        raise OutputError(
            f"can't write {str(beside)!r}, the configuration of {path.name}: it holds "
            "something else; choose another name for the result, or remove it first"
        )


@contextlib.contextmanager
def folder_for(folder: Path) -> Iterator[None]:
    """Makes a folder if need be and tries to write in it; a new one goes again if the block fails.

    Raises:
        OutputError: it can't be made or written to.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            f"can't write into {str(folder)!r}: a file stands where a folder is expected; choose "
            "another path"
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
        for at in missing:  # the deepest first; rmdir takes none that holds something
            with contextlib.suppress(OSError):
                at.rmdir()
        raise


def stopped(output: Path) -> KeyboardInterrupt:
    """The end of a command by Ctrl-C whose results are kept; ``main`` prints its text."""
    return KeyboardInterrupt(f"run the same command to continue in {output}")


def check_demo_folder(folder: Path) -> None:
    """Looks whether the demo may write into a folder; writes nothing.

    Raises:
        OutputError: it is a file, or holds something other than an earlier demo.
    """
    if not folder.exists():
        return
    if not folder.is_dir():
        raise OutputError(f"can't write {str(folder)!r}: a file stands there; name a folder")
    former = read_configuration(folder / "config.json")
    if former is not None and former.get("command") == "demo":
        return
    try:
        empty = not any(folder.iterdir())
    except OSError as error:
        raise output_error(folder, error) from error
    if not empty:
        raise OutputError(
            f"can't write into {str(folder)!r}: it holds something other than an earlier demo; "
            "give another folder with --output"
        )


@contextlib.contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A folder to write results in, whose files take their places when the block ends.

    If the block fails or is stopped, what stood in ``folder`` is as it was.

    Raises:
        OutputError: a file can't be put in its place.
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

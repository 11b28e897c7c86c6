"""Names of recordings: a file that the user names, or the next number in a folder of takes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import ConfigError, OutputError
from smooth_operator.types import Side

SUFFIX = ".mcap"


def is_folder(path: Path) -> bool:
    """Whether a path means a folder of takes: it is one, or has no suffix.

    Raises:
        ConfigError: it has another suffix than a log's.
    """
    if path.is_dir() or not path.suffix:
        return True
    if path.suffix.lower() != SUFFIX:
        raise ConfigError(
            f"a recording is an MCAP log: expected NAME{SUFFIX} or a folder, not {str(path)!r}"
        )
    return False


def take_paths(path: Path, sides: Sequence[Side], *, overwrite: bool) -> dict[Side, Path]:
    """Which files a new recording is written to; a folder is made if there is none.

    Args:
        path: see ``is_folder``. In a folder a recording is ``take-001.mcap`` and so on.
        sides: hands that are recorded. Two have a file each, as in ``take-001.right.mcap``.
        overwrite: a named file may stand there already.

    Raises:
        OutputError: a named file stands there, or the folder can't be made.
    """
    if not is_folder(path):
        files = _files(path, sides)
        taken = [] if overwrite else [file for file in files.values() if file.exists()]
        if taken:
            raise OutputError(
                f"can't write {str(taken[0])!r}: a file stands there already; choose another name, "
                "give a folder for numbered takes, or ask to overwrite it (overwrite=true)"
            )
        return files
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(path, error) from error
    return _first_free(path / f"take-{{:03d}}{SUFFIX}", sides, 1)


def next_part(path: Path, sides: Sequence[Side]) -> dict[Side, Path]:
    """Where a recording goes on that broke off: the next take, or ``NAME.part2.mcap``."""
    if is_folder(path):
        return take_paths(path, sides, overwrite=False)
    return _first_free(path.with_name(f"{path.stem}.part{{}}{path.suffix}"), sides, 2)


def _first_free(pattern: Path, sides: Sequence[Side], start: int) -> dict[Side, Path]:
    number = start
    while True:
        named = pattern.with_name(pattern.name.format(number))
        files = _files(named, sides)
        # A take of one hand and one of both must not share a number either.
        kin = [named, *(named.with_suffix(f".{side}{SUFFIX}") for side in ("right", "left"))]
        if not any(file.exists() for file in (*files.values(), *kin)):
            return files
        number += 1


def _files(path: Path, sides: Sequence[Side]) -> dict[Side, Path]:
    if len(sides) < 2:
        return dict.fromkeys(sides, path)
    return {side: path.with_name(f"{path.stem}.{side}{path.suffix}") for side in sides}

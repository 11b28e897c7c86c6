"""The recordings in a folder, however deep, and what they would be called in another."""

from __future__ import annotations

import contextlib
import os
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from smooth_operator.errors import RecordingError
from smooth_operator.formats.arrays import StoredArrays, open_arrays
from smooth_operator.formats.registry import find_reader, recording_suffixes
from smooth_operator.formats.sniff import file_kind

_COMMANDS: Final = ("joint_positions", "joint_names")
_LANDMARKS: Final = ("landmarks", "joints", "data")
_BYTES_PER_FRAME: Final = 600
"""Of the formats whose frames can't be counted without reading them; for the order only."""


@dataclass(frozen=True)
class Found:
    """A file that is taken for a recording.

    Attributes:
        path: where it is.
        name: its path in the folder, with slashes.
        frames: number of frames; an estimate if ``exact`` is False.
        exact: True if ``frames`` was counted.
    """

    path: Path
    name: str
    frames: int
    exact: bool

    @property
    def output(self) -> str:
        """Path of its commands in the folder of results."""
        return Path(self.name).with_suffix(".npz").as_posix()


def find_recordings(folder: Path, *, leave_out: Path | None = None) -> tuple[list[Found], int]:
    """Looks through a folder; opens files, but reads no data.

    Hidden files and folders are passed over. Links to folders are followed, once.

    Args:
        folder: where to look.
        leave_out: a folder in it that is not looked into.

    Returns:
        the recordings, the longest first, and the number of files passed over because they hold
        commands and no hand. A file that can't be understood counts as a recording: that it is
        none must not go unsaid.

    Raises:
        RecordingError: the folder can't be read.
    """
    recordings, commands = [], 0
    for path in _files(folder, leave_out):
        frames, exact = _size(path) // _BYTES_PER_FRAME, False
        # What is wrong with a file is reported by its reader.
        with contextlib.suppress(RecordingError, OSError):
            kind = file_kind(path)
            if kind in ("npy", "npz"):
                arrays = open_arrays(path)
                if all(n in arrays for n in _COMMANDS) and not any(n in arrays for n in _LANDMARKS):
                    commands += 1
                    continue
                frames, exact = _frames_of_arrays(arrays), True
            else:
                counted = find_reader(kind).count_frames(path)
                frames, exact = (frames, False) if counted is None else (counted, True)
        recordings.append(Found(path, path.relative_to(folder).as_posix(), frames, exact))
    # By name among equals, so that the order is the same everywhere.
    return sorted(recordings, key=lambda item: (-item.frames, item.name)), commands


def clashes(recordings: list[Found]) -> dict[str, str]:
    """Names of files whose results would stand in the same place, each with the reason."""
    by_output: dict[str, list[str]] = defaultdict(list)
    for item in recordings:
        by_output[item.output].append(item.name)
    return {
        name: f"{' and '.join(sorted(names))} would both become {output}; rename one, or remove it"
        for output, names in by_output.items()
        if len(names) > 1
        for name in names
    }


def _files(folder: Path, leave_out: Path | None) -> Iterator[Path]:
    def refuse(error: OSError) -> None:
        raise RecordingError(f"{error.filename}: can't be read: {error.strerror}") from error

    skipped = None if leave_out is None else leave_out.resolve()
    visited: set[Path] = set()
    suffixes = recording_suffixes()  # other files of a folder are left alone
    for at, folders, files in os.walk(folder, onerror=refuse, followlinks=True):
        real = Path(at).resolve()
        if real in visited or real == skipped:
            folders.clear()
            continue
        visited.add(real)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in files:
            path = Path(at, name)
            if path.suffix.lower() in suffixes and not name.startswith("."):
                yield path


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # a link to nowhere
        return 0


def _frames_of_arrays(arrays: StoredArrays) -> int:
    shapes = [item.shape for item in arrays.values() if len(item.shape) == 3]
    return max((shape[0] for shape in shapes), default=1)

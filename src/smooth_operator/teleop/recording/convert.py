"""Reads episodes from files of any supported format, and writes them in any other."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, TypeAlias, get_args

from smooth_operator.episode_files.hdf5 import is_own_hdf5, read_hdf5_episode, write_hdf5_episode
from smooth_operator.episode_files.lerobot import (
    Dataset,
    is_own_dataset,
    open_dataset,
    read_dataset_episode,
)
from smooth_operator.episode_files.npz import is_own_npz, read_npz_episode, write_npz_episode
from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.formats.checks import reading_notes
from smooth_operator.formats.commands import config_path
from smooth_operator.formats.episode import Episode
from smooth_operator.formats.readers import read_recording
from smooth_operator.formats.registry import file_kind, files_below, is_dataset
from smooth_operator.types import Side, as_side

Format: TypeAlias = Literal["mcap", "npz", "hdf5", "lerobot"]
"""Formats of episodes."""

SUFFIXES: Final[dict[str, Format]] = {
    ".mcap": "mcap",
    ".npz": "npz",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
}
"""Suffix of an output's name -> format. An output without a suffix is a LeRobot dataset."""


@dataclass(frozen=True, eq=False)
class Source:
    """A file or dataset from which one episode is read.

    Attributes:
        path: the file, or the folder of a LeRobot dataset.
        relative: path within the input folder; for a single input file, its name.
        dataset: the dataset that contains the episode, if any.
        number: number of the episode in the dataset.
    """

    path: Path
    relative: Path
    dataset: Dataset | None = None
    number: int = 0

    def read(
        self, *, rate: float | None = None, side: Side | None = None, layout: str | None = None
    ) -> Episode:
        """Reads the episode; see ``read_episode``.

        Raises:
            RecordingError, ConfigError, MissingExtraError: as the reader of its format.
        """
        if self.dataset is not None:
            return read_dataset_episode(
                self.dataset, self.number, rate=rate, side=side, layout=layout
            )
        return read_episode(self.path, rate=rate, side=side, layout=layout)


def read_episode(
    path: str | os.PathLike[str],
    *,
    rate: float | None = None,
    side: Side | None = None,
    layout: str | None = None,
    episode: int = 0,
) -> Episode:
    """Reads an episode, that is, the hand and the commands in a file of any format.

    Args:
        path: a recording (see ``read_recording``), the ``OUT.npz`` of a retargeting, a log, an HDF5
            file or the folder of a LeRobot dataset, recognised by content.
        rate: frame rate [Hz], for a file without stamps.
        side: side of the hand, for a file that does not store it; by default right.
        layout: order of the landmarks in a plain array of 21, as in ``read_recording``, or in a
            LeRobot dataset of another tool.
        episode: number of the episode in a LeRobot dataset.

    Returns:
        the episode; its ``notes`` are messages for the user.

    Raises:
        RecordingError: as ``read_recording``.
        ConfigError: ``rate`` or ``side`` is not valid, or there is no such ``episode``.
        UnknownNameError: there is no such ``layout``.
        MissingExtraError: the format needs an extra that is not installed.
    """
    path = Path(path)
    side = None if side is None else as_side(side)
    if is_dataset(path):
        return read_dataset_episode(
            open_dataset(path), episode, rate=rate, side=side, layout=layout
        )
    kind = file_kind(path)
    if kind == "log":
        from smooth_operator.teleop.recording.log_episode import read_log_episode

        return read_log_episode(path, rate=rate, side=side)
    if kind == "hdf5":
        return read_hdf5_episode(path, rate=rate, side=side)
    if kind == "npz":
        result = read_npz_episode(path, rate=rate, side=side, layout=layout)
    else:
        recording = read_recording(path, rate=rate, side=side, layout=layout)
        result = Episode(recording, name=recording.name)
    if result.recording is None:
        return result
    return replace(result, notes=(*result.notes, *reading_notes(result.recording, str(path))))


def write_episode(path: str | os.PathLike[str], episode: Episode, to: Format | None = None) -> None:
    """Writes an episode to a file atomically.

    Args:
        path: the file; its folder must exist.
        to: format of the file; None for the format of the suffix. ``write_dataset`` writes LeRobot
            datasets.

    Raises:
        ConfigError: the suffix does not belong to any format.
        MissingExtraError: the format needs an extra that is not installed.
        OutputError: the file can't be written.
    """
    path = Path(path)
    kind = format_of(path, to)
    if kind == "lerobot":
        raise ConfigError(
            f"{path}: a LeRobot dataset is a folder of episodes, not a file; write it with "
            "smooth_operator.episode_files.lerobot.write_dataset"
        )
    if kind == "mcap":
        from smooth_operator.teleop.recording.log_episode import write_log_episode

        write_log_episode(path, episode)
    elif kind == "npz":
        write_npz_episode(path, episode)
    else:
        write_hdf5_episode(path, episode)


def losses(episode: Episode, to: Format) -> list[str]:
    """Lists, for messages, the parts of an episode that a format can't store."""
    if to != "mcap":
        return []
    from smooth_operator.teleop.recording.log_episode import log_losses

    return log_losses(episode)


def format_of(path: Path, to: Format | None) -> Format:
    """Determines the format of an output; ConfigError if the suffix does not belong to any format,
    or contradicts ``to``."""
    named = SUFFIXES.get(path.suffix.lower())
    if to is not None:
        if to not in get_args(Format):
            raise ConfigError(f"a format is one of {', '.join(get_args(Format))}, not {to!r}")
        if named not in (None, to):
            raise ConfigError(
                f"the name {path.name!r} has the suffix of {named}, but --to is {to}; remove "
                "--to or choose another name"
            )
        return to
    if named is None and path.suffix and not path.is_dir():
        raise ConfigError(
            f"the suffix of {path.name!r} does not belong to any format: use "
            f"{', '.join(SUFFIXES)}, or no suffix for the folder of a LeRobot dataset, or set the "
            "format with --to"
        )
    return named or "lerobot"


def find_sources(
    inputs: Sequence[Path], *, episode: int | None = None, leave: Sequence[Path] = ()
) -> tuple[list[Source], list[str]]:
    """Finds all episodes in the inputs.

    Args:
        inputs: files, datasets, and folders of these. Folders are searched recursively; hidden
            files are ignored.
        episode: number of the only episode of a dataset to use; None for all.
        leave: files and folders to ignore.

    Returns:
        the sources, in the order of the inputs and then of names; and notes on ignored files that
        are not recordings.

    Raises:
        RecordingError: an input does not exist, or a folder contains no recording.
        ConfigError: ``episode`` is given for an input that is not a dataset, or does not exist in
            it.
        MissingExtraError: an input needs an extra that is not installed.
    """
    sources: list[Source] = []
    skipped: list[Path] = []
    left = {path.resolve() for path in leave}
    for entry in inputs:
        if is_dataset(entry):
            dataset = open_dataset(entry)
            numbers = dataset.numbers
            if episode is not None:
                dataset.row(episode)
                numbers = [episode]
            sources += [Source(entry, Path(entry.name), dataset, number) for number in numbers]
            continue
        if episode is not None:
            raise ConfigError(f"{entry}: --episode applies only to LeRobot datasets")
        if not entry.is_dir():
            file_kind(entry)  # one that was named is not passed over in silence
            sources.append(Source(entry, Path(entry.name)))
            continue
        before = len(sources)
        for path in files_below(entry, left):
            relative = path.relative_to(entry)
            if path.is_dir():
                dataset = open_dataset(path)
                sources += [Source(path, relative, dataset, i) for i in dataset.numbers]
            elif _is_recording(path):
                sources.append(Source(path, relative))
            else:
                skipped.append(path)
        if len(sources) == before:
            raise RecordingError(f"{entry}: this folder and its subfolders contain no recordings")
    notes = []
    if skipped:
        names = ", ".join(path.name for path in skipped[:5]) + (", …" if len(skipped) > 5 else "")
        notes.append(f"skipped (unknown format): {names}")
    return sources, notes


def check_target(path: Path, to: Format, inputs: Sequence[Path], overwrite: bool) -> None:
    """Checks that an output can be written, without writing it. OutputError if the output exists
    and ``overwrite`` is False, was not written by this program, or is one of the inputs."""
    if not os.path.lexists(path):
        return
    if any(entry.exists() and entry.samefile(path) for entry in inputs if path.exists()):
        raise OutputError(f"can't write {str(path)!r}: it is an input; choose another name")
    if to == "lerobot":
        if path.is_dir() and not any(path.iterdir()):
            return
        own = path.is_dir() and is_own_dataset(path)
    elif path.is_dir():
        raise OutputError(f"can't write {str(path)!r}: it is a folder; give the name of a file")
    else:
        own = _is_own(path, to)
    if not own:
        raise OutputError(
            f"can't write {str(path)!r}: the existing file was not written by this program "
            f"as {to}; choose another name, or remove the file first"
        )
    if not overwrite:
        raise OutputError(
            f"can't write {str(path)!r}: it already exists; add --overwrite to replace it, or "
            "choose another name"
        )


def files_of(path: Path, to: Format) -> list[Path]:
    """The files that writing an output may replace: the output and its configuration."""
    return [path, config_path(path)] if to == "npz" else [path]


def _is_recording(path: Path) -> bool:
    try:
        file_kind(path)
    except RecordingError:
        return False
    return True


def _is_own(path: Path, to: Format) -> bool:
    try:
        kind = file_kind(path)
    except RecordingError:
        return False
    if to == "mcap":
        from smooth_operator.teleop.recording.log_episode import is_own_log

        return kind == "log" and is_own_log(path)
    if to == "npz":
        return kind == "npz" and is_own_npz(path)
    return kind == "hdf5" and is_own_hdf5(path)

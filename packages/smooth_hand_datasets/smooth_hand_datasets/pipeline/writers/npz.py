"""Writer of command files like those of ``retarget``: ``NAME.npz`` and ``NAME.json`` for each clip.

A clip with two hands has ``NAME_right.npz`` and ``NAME_left.npz``. Latencies are NaN because clips
are retargeted together. Configurations have no date, so that a resumed run gives the same bytes as
an uninterrupted one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.sources import Item
from smooth_hand_datasets.pipeline.writers.arrays import resampled
from smooth_hand_datasets.pipeline.writers.registry import DatasetFormat, WritingOptions
from smooth_operator.atomic_files import output_error
from smooth_operator.errors import RecordingError
from smooth_operator.formats.commands import config_path, encode_commands, write_encoded_commands
from smooth_operator.io.jsonable import to_json
from smooth_operator.planning import foreign_result
from smooth_operator.types import Side, Status


class CommandFiles:
    """Writes command files to a folder. Files that already have the same content are not written
    again."""

    def __init__(self, folder: Path, options: WritingOptions) -> None:
        self._folder, self._options = folder, options
        self._frames = self._held = 0

    def __enter__(self) -> CommandFiles:
        return self

    def __exit__(self, *_: object) -> None:
        """Does nothing, since every file is already complete."""

    @property
    def notes(self) -> list[str]:
        """Note on the number of frames without a usable human hand."""
        held = f"{self._held} of {self._frames} frames had no usable hand"
        return [held] if self._held else []

    def write(self, episode: RobotClip) -> None:
        """Writes the commands of a clip.

        Raises:
            RecordingError: there is a file at the path that this program did not write.
            OutputError: it can't be written.
        """
        if self._options.rate is not None:
            episode = resampled(episode, self._options.rate)
        for side, commands in episode.commands.items():
            name = episode.clip.name + (f"_{side}" if len(episode.commands) > 1 else "")
            path = self._folder / f"{name}.npz"
            if reason := taken(path, self._folder):
                raise RecordingError(reason)
            config = _configuration(episode, side)
            encoded = encode_commands(commands)
            self._frames += len(commands)
            self._held += config["held"]
            if not _stands(path, encoded, config):
                try:
                    path.parent.mkdir(parents=True, exist_ok=True)
                except OSError as error:
                    raise output_error(path, error) from error
                write_encoded_commands(path, encoded, config)


NPZ: Final = DatasetFormat("a folder of commands", CommandFiles, parallel=True, shortest=1)


def taken(path: Path, folder: Path) -> str | None:
    """Reason why a result can't be written to a path; None if it can.

    Args:
        path: ``OUT.npz``.
        folder: folder that contains all results.
    """
    if not path.resolve().is_relative_to(folder.resolve()):
        return f"can't write {str(path)!r}: the clip's name leads out of {folder}; rename it"
    above = next((parent for parent in path.parents if parent.exists()), folder)
    if not above.is_dir():
        return f"can't write {str(path)!r}: {above} is not a folder; remove it first"
    return foreign_result(path)


def refused(items: Iterable[Item], folder: Path, report: str) -> dict[str, str]:
    """Maps the names of items whose results can't be written at their paths to the reasons.

    Args:
        folder: folder of the results.
        report: name of the report in it.
    """
    named: dict[str, list[Item]] = {}
    for item in items:
        alone = item.ref is None or item.name.endswith(item.ref.name)
        named.setdefault(item.name if alone else item.name.rpartition("~")[0], []).append(item)
    reasons: dict[str, str | None] = {}
    for name, same in named.items():
        path = folder / f"{name}.npz"
        reason = taken(path, folder)
        if config_path(path) == folder / report:
            reason = (
                f"its configuration file would be called {report}, like the report of the run; "
                "rename the recording"
            )
        if len(same) > 1:
            files = " and ".join(sorted(each.ref.path.name for each in same if each.ref))
            reason = f"{files} would both become {name}.npz; rename or remove one of them"
        reasons |= {each.name: reason for each in same}
    return {name: reason for name, reason in reasons.items() if reason is not None}


def _configuration(episode: RobotClip, side: Side) -> dict[str, Any]:
    """The resolved configuration of one hand, with facts about its recording."""
    config, recording = episode.config, episode.clip.hands[side]
    meta: Mapping[str, Any] = episode.clip.meta
    status = np.asarray(episode.commands[side].status)
    return {
        **config,
        "command": "retarget",
        "hand": episode.hand_names[side],
        "side": side,
        "config": config["config"][side],
        "recording": {
            "name": episode.clip.name,
            "side": side,
            "frames": len(recording),
            "rate_hz": recording.rate_hz if len(recording) > 1 else None,
            "duration_s": recording.duration,
        },
        "source": meta.get("source"),
        "rate": meta.get("rate_hz"),
        "layout": meta.get("order"),
        "held": int((status != Status.OK).sum()),
        "figures": dict(episode.figures),
        "key": episode.key,
    }


def _stands(path: Path, encoded: bytes, config: Mapping[str, Any]) -> bool:
    try:
        text = to_json(dict(config), indent=2).encode() + b"\n"
        return path.read_bytes() == encoded and config_path(path).read_bytes() == text
    except OSError:
        return False

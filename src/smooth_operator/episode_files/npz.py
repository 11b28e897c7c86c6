"""Episodes as ``.npz`` files: plain arrays that NumPy can read without this program.

========================  ==================  ============================================
array                     shape               content
========================  ==================  ============================================
``landmarks``             (T, 21, 3) float64  positions [m], NaN where not finite
``timestamps``            (T,) float64        stamps of the frames [s]
``valid``                 (T, 21) bool        False where the tracker lost the landmark
``side``                  text                right or left
``metacarpals``           (T, 4, 3) float64   metacarpal bases [m], if tracked
``orientations``          (T, 21, 4) float64  quaternions wxyz, if tracked
``T_world_wrist``         (T, 7) float64      wrist, x y z [m] and wxyz, if tracked; in ``world``
``forearm``               (T, 3) float64      forearm in the wrist's frame, if tracked
``joint_positions``       (C, n) float64      [rad], if there are commands
``joint_names``           (n,) text
``latency_ms``            (C,) float64
``status``                (C,) int8           indices of ``status_names``
``wrist_poses``           (C, 7) float64      the robot's wrist, if commanded; in ``wrist_world``,
                                              with ``wrist_engaged``, ``wrist_valid`` (C,) bool
``stages_ms``             (C, k) float64      times of the stages in ``stage_names``
``configuration``         text                JSON
``episode``               text                JSON: name, task, metadata of the source
========================  ==================  ============================================

``read_commands`` can read a file of commands, ``read_recording`` a file of frames, and both can
read a file with both. If the commands' stamps differ from those of the frames, ``timestamps`` are
the commands' and ``landmark_timestamps`` the frames'.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.errors import RecordingError
from smooth_operator.formats.arrays import StoredArrays, open_arrays
from smooth_operator.formats.commands import (
    command_arrays,
    config_path,
    read_commands,
    written_result,
)
from smooth_operator.formats.episode import Episode, WristTrack
from smooth_operator.formats.readers import LANDMARK_STAMPS, read_recording
from smooth_operator.io.documents import json_object, read_json
from smooth_operator.io.jsonable import to_json
from smooth_operator.types import Side

_COMMANDS: Final = ("joint_positions", "joint_names", "latency_ms", "status")
_HANDS: Final = ("landmarks", "joints")


def read_npz_episode(
    path: Path, *, rate: float | None = None, side: Side | None = None, layout: str | None = None
) -> Episode:
    """Reads a recording, a file of commands, or a file with both.

    The configuration is the one in the file, or otherwise ``OUT.json`` in its folder.

    Raises:
        RecordingError: as for ``read_recording`` and ``read_commands``.
    """
    arrays = open_arrays(path)
    has_commands = all(name in arrays for name in _COMMANDS)
    commands = read_commands(path) if has_commands else None
    recording = None
    if not has_commands or any(name in arrays for name in _HANDS):
        recording = read_recording(path, rate=rate, side=side, layout=layout)
    stored = _json(arrays, "episode") or {}
    config = _json(arrays, "configuration")
    if config is None and commands is not None:
        config = _beside(path)
    name = str(stored.get("name") or path.stem)
    if recording is not None:
        meta = stored.get("meta")
        meta = {**(meta if isinstance(meta, dict) else {}), **recording.meta}
        recording = replace(recording, name=name, meta=meta)
    return Episode(
        recording,
        commands,
        config,
        _stages(arrays, 0 if commands is None else len(commands)),
        None if stored.get("task") is None else str(stored["task"]),
        name,
        wrist=_wrist(arrays),
    )


def write_npz_episode(path: Path, episode: Episode) -> None:
    """Writes an episode; if it has commands and a configuration, also writes ``OUT.json``.
    OutputError if a file can't be written."""
    arrays: dict[str, np.ndarray] = {}
    recording, commands = episode.recording, episode.commands
    if recording is not None:
        assert recording.valid is not None  # filled in by HandRecording
        arrays["landmarks"] = recording.landmarks
        arrays["timestamps"] = recording.stamps
        arrays["valid"] = recording.valid
        arrays["side"] = np.array(recording.side)
        for name in ("metacarpals", "orientations", "T_world_wrist", "world", "forearm"):
            if getattr(recording, name) is not None:
                arrays[name] = np.asarray(getattr(recording, name))
    if commands is not None:
        if recording is not None and not np.array_equal(recording.stamps, commands.stamps):
            arrays[LANDMARK_STAMPS] = recording.stamps
        arrays |= command_arrays(commands)
    if episode.wrist is not None:
        for name in ("poses", "engaged", "valid", "world"):
            arrays[f"wrist_{name}"] = np.asarray(getattr(episode.wrist, name))
    if episode.stages_ms:
        arrays["stage_names"] = np.asarray(list(episode.stages_ms), np.str_)
        arrays["stages_ms"] = np.stack(list(episode.stages_ms.values()), axis=1)
    if episode.config is not None:
        arrays["configuration"] = np.array(to_json(episode.config))
    origin = {"name": episode.name, "task": episode.task, "meta": episode.meta}
    arrays["episode"] = np.array(to_json(origin))

    config = None if commands is None else episode.config
    with written_result(path, config) as file:
        np.savez(file, allow_pickle=False, **arrays)


def is_own_npz(path: Path) -> bool:
    """True if this program wrote the file, as an episode or as the result of a retargeting."""
    try:
        arrays = open_arrays(path)
        if all(name in arrays for name in _COMMANDS):
            return True
        return _json(arrays, "episode") is not None
    except RecordingError:
        return False


def _json(arrays: StoredArrays, name: str) -> dict[str, Any] | None:
    """Reads a JSON object from the arrays; None if it is missing or something else."""
    item = arrays.get(name)
    if item is None or item.dtype.kind != "U" or item.shape != ():
        return None
    return json_object(item.text())


def _beside(path: Path) -> dict[str, Any] | None:
    try:
        value = read_json(config_path(path))
    except (OSError, ValueError):
        return None
    return value if isinstance(value, dict) else None


def _wrist(arrays: StoredArrays) -> WristTrack | None:
    if not {"wrist_poses", "wrist_engaged", "wrist_valid", "wrist_world"} <= arrays.keys():
        return None
    try:
        return WristTrack(
            arrays["wrist_poses"].numbers(),
            arrays["wrist_engaged"].load().astype(bool),
            arrays["wrist_valid"].load().astype(bool),
            arrays["wrist_world"].text(),
        )
    except RecordingError as error:
        raise RecordingError(f"{arrays.path}: {error}") from error


def _stages(arrays: StoredArrays, count: int) -> dict[str, np.ndarray]:
    if "stages_ms" not in arrays or "stage_names" not in arrays:
        return {}
    names, times = arrays["stage_names"].texts(), arrays["stages_ms"].numbers()
    if times.shape != (count, len(names)):
        raise RecordingError(
            f"{arrays.path}: stages_ms must have shape {(count, len(names))} to fit the commands "
            f"and stage_names, not {times.shape}"
        )
    return {name: times[:, i].copy() for i, name in enumerate(names)}

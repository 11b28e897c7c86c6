"""Episodes as HDF5 files: one episode per file, with a unit for every array.

::

    /                    attributes: format "smooth-operator", version 1, name, task (optional)
    /hand                attributes: side, landmark_names (21), meta (JSON)
        landmarks        (T, 21, 3) float64, units m; NaN where not finite
        stamps           (T,) float64, units s, strictly increasing
        valid            (T, 21) bool
        metacarpals      (T, 4, 3) float64, units m, index to pinky; if tracked
        orientations     (T, 21, 4) float64, units "quaternion wxyz"; if tracked
        T_world_wrist    (T, 7) float64, units "m, quaternion wxyz", attribute world; if tracked
        forearm          (T, 3) float64, direction in the wrist's frame; if tracked
    /commands
        joint_positions  (C, n) float64, units rad
        joint_names      (n,) text
        stamps           (C,) float64, units s: stamps of the frames of the commands
        latency_ms       (C,) float64, units ms
        status           (C,) int8; attribute status_names: the name of code i at index i
        wrist            (C, 7) float64, units "m, quaternion wxyz", attribute world; if
                         commanded, with wrist_engaged and wrist_valid (C,) bool
        arm              (C, a) float64, units "rad", attributes name and joint_names (with commas);
                         if there was one, with arm_measured (C, a) and arm_wrist (C, 7)
        stages_ms/NAME   (C,) float64, units ms; if the loop's stages were timed
    /state               measured states of the robot hand, if any
        joint_positions  (S, n) float64, units rad; NaN where unknown
        joint_names      (n,) text
        stamps           (S,) float64, units s: times of the measurements
        actuator_names   (a,) text; if the actuators have their own names
        currents         (S, a) float64, mA or the driver's unit of force; if measured
        touch            (S, k) float64, the driver's unit; if measured
        contact          (S, f) float64, of each finger, 0 to 1; if measured
        newtons          (S, f) float64, force on each finger; if measured
    /configuration       text, JSON; if there is a configuration

``/hand`` or ``/commands`` may be absent. A file of another program can also be read if it has the
groups and arrays above that are not marked as optional; attributes may be missing.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from smooth_operator.episode_files.egodex import read_egodex
from smooth_operator.episode_files.hdf5_tree import Hdf5Array, Hdf5Group, h5py_of, read_tree
from smooth_operator.episode_files.staging import staged_file
from smooth_operator.errors import DocumentError, RecordingError, brief
from smooth_operator.extras import UPGRADE
from smooth_operator.formats.checks import (
    check_rate,
    check_recording,
    check_side,
    check_stamps,
    side_note,
    stamps_from_rate,
)
from smooth_operator.formats.commands import STATUS_NAMES, translate_status
from smooth_operator.formats.episode import (
    BASE,
    ArmTrack,
    Episode,
    StateTrajectory,
    WristTrack,
    check_commands,
)
from smooth_operator.formats.hand_arrays import own_stamps
from smooth_operator.io.documents import parse_json
from smooth_operator.io.jsonable import to_json
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.types import CommandTrajectory, HandRecording, Side

FORMAT: Final = "smooth-operator"
VERSION: Final = 1

POSE_UNITS: Final = "m, quaternion wxyz"

Group: TypeAlias = Any
"""A group of h5py, which has no type annotations."""

_OPTIONAL: Final = {
    "metacarpals": (4, 3),
    "orientations": (21, 4),
    "T_world_wrist": (7,),
    "forearm": (3,),
}


def write_hdf5_episode(path: Path, episode: Episode) -> None:
    """Writes an episode to an HDF5 file.

    Raises:
        MissingExtraError: h5py is not installed.
        OutputError: the file can't be written.
    """
    h5py = h5py_of()
    with staged_file(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["version"] = VERSION
        file.attrs["name"] = episode.name
        if episode.task is not None:
            file.attrs["task"] = episode.task
        if episode.recording is not None:
            _write_hand(file.create_group("hand"), episode.recording, episode.meta)
        if episode.commands is not None:
            group = file.create_group("commands")
            _write_commands(group, episode.commands, episode.stages_ms)
            if episode.wrist is not None:
                _write_wrist(group, episode.wrist)
            if episode.arm is not None:
                _write_arm(group, episode.arm)
        if episode.states is not None:
            _write_states(file.create_group("state"), episode.states)
        if episode.config is not None:  # not an attribute, since these end at 64 KiB
            file.create_dataset("configuration", data=to_json(episode.config))


def read_hdf5_episode(
    path: Path, *, rate: float | None = None, side: Side | None = None
) -> Episode:
    """Reads an episode from an HDF5 file.

    Raises:
        MissingExtraError: h5py is not installed.
        RecordingError: the file is damaged, or has another layout or a newer version; arrays have
            the wrong shape or type; or the side or rate contradicts the file.
    """
    tree = read_tree(path)
    top = tree["/"]
    if top.attributes.get("format", FORMAT) == FORMAT:
        version = top.attributes.get("version", VERSION)
        if version != VERSION:
            raise RecordingError(
                f"{path}: the file has format version {brief(version)}, but this program reads "
                f"version {VERSION}; upgrade the program: {UPGRADE}"
            )
    hand, commands = tree.get("hand"), tree.get("commands")
    if hand is None and commands is None and "transforms" in tree:
        return Episode(read_egodex(tree, path, rate, side), name=path.stem)
    if hand is None and commands is None:
        raise RecordingError(
            f"{path}: an HDF5 file from another program: it has no group 'hand' or 'commands', "
            f"only {top.describe()}. Save its landmarks with numpy.savez, or in a group 'hand' as "
            "'landmarks' (T, 21, 3) [m] and 'stamps' (T,) [s]"
        )
    name = _text_of(top.attributes.get("name")) or path.stem
    recording: HandRecording | None = None
    notes: tuple[str, ...] = ()
    if hand is not None:
        recording = _read_hand(hand, path, name, rate, side)
        if recording.meta["side_assumed"]:
            notes = (side_note(str(path)),)
        if top.attributes.get("format") != FORMAT:  # ours are in metres, others say nothing
            check_recording(recording, str(path))
    trajectory: CommandTrajectory | None = None
    wrist: WristTrack | None = None
    arm: ArmTrack | None = None
    stages: dict[str, np.ndarray] = {}
    if commands is not None:
        trajectory, stages = _read_commands(commands, tree.get("commands/stages_ms"), path)
        wrist = _read_wrist(commands, len(trajectory), path)
        arm = _read_arm(commands, len(trajectory), path)
    config = None
    if "configuration" in top.arrays:
        texts = top.arrays["configuration"].texts
        config = _object(texts[0] if texts else None, f"{path}: 'configuration'")
    task = _text_of(top.attributes.get("task"))
    group = tree.get("state")
    states = None if group is None else _read_states(group, path)
    return Episode(recording, trajectory, config, stages, task, name, notes, states, wrist, arm)


def read_hdf5_recording(
    path: Path, rate: float | None, side: Side | None, layout: str | None = None
) -> HandRecording:
    """Reads the hand frames of an episode file, which states the order of its landmarks.

    Raises:
        RecordingError: as for ``read_hdf5_episode``, or there are no frames.
    """
    recording = read_hdf5_episode(path, rate=rate, side=side).recording
    if recording is None:
        raise RecordingError(f"{path}: the file contains commands, but no hand frames")
    return replace(recording, name=path.stem)


def is_own_hdf5(path: Path) -> bool:
    """True if this program wrote the HDF5 file."""
    try:
        return bool(read_tree(path, head=True)["/"].attributes.get("format") == FORMAT)
    except RecordingError:
        return False


def _write_hand(group: Group, recording: HandRecording, meta: dict[str, Any]) -> None:
    group.attrs["side"] = recording.side
    group.attrs["landmark_names"] = list(LANDMARKS)
    group.attrs["meta"] = to_json(meta)
    for name, units in (
        ("landmarks", "m"),
        ("stamps", "s"),
        ("valid", None),
        ("metacarpals", "m"),
        ("orientations", "quaternion wxyz"),
        ("T_world_wrist", POSE_UNITS),
        ("forearm", None),
    ):
        value = getattr(recording, name)
        if value is not None:
            _write_array(group, name, value, units)
    if recording.world is not None:
        group.attrs["world"] = recording.world


def _write_commands(group: Group, commands: CommandTrajectory, stages: Any) -> None:
    _write_array(group, "joint_positions", np.asarray(commands.joint_positions, np.float64), "rad")
    names = h5py_of().string_dtype()
    group.create_dataset("joint_names", data=list(commands.joint_names), dtype=names)
    _write_array(group, "stamps", np.asarray(commands.stamps, np.float64), "s")
    _write_array(group, "latency_ms", np.asarray(commands.latency_ms, np.float64), "ms")
    _write_array(group, "status", np.asarray(commands.status, np.int8), None)
    group["status"].attrs["status_names"] = list(STATUS_NAMES)
    for stage, times in stages.items():
        # The name as an attribute, since a slash in it would mean a group.
        timed = group.require_group("stages_ms")
        key = stage.replace("/", "_") or "_"
        while key in timed:
            key += "_"
        data = timed.create_dataset(key, data=np.asarray(times, np.float64))
        data.attrs["units"] = "ms"
        data.attrs["stage"] = stage


def _read_hand(
    group: Hdf5Group, path: Path, name: str, rate: float | None, side: Side | None
) -> HandRecording:
    landmarks = _numbers(group, "landmarks", (None, 21, 3), path)
    count = len(landmarks)
    if "stamps" in group.arrays:
        stamps = own_stamps(_numbers(group, "stamps", (count,), path), rate, str(path))
    else:
        stamps = stamps_from_rate(count, rate, str(path))
    check_stamps(stamps, str(path), landmarks)
    check_rate(stamps, rate, str(path))
    optional: dict[str, Any] = {
        key: _numbers(group, key, (count, *shape), path) if key in group.arrays else None
        for key, shape in _OPTIONAL.items()
    }
    optional["world"] = _text_of(group.attributes.get("world"))
    valid = _array_of(group, "valid", (count, 21), "b", path) if "valid" in group.arrays else None
    label = _text_of(group.attributes.get("side"))
    recorded_side, assumed = check_side([] if label is None else [label], side, str(path))
    meta = _object(_text_of(group.attributes.get("meta")) or "{}", f"{path}: meta of 'hand'")
    meta |= {"format": "hdf5", "side_assumed": assumed}
    return HandRecording(
        landmarks, stamps, recorded_side, valid=valid, name=name, meta=meta, **optional
    )


def _read_commands(
    group: Hdf5Group, timed: Hdf5Group | None, path: Path
) -> tuple[CommandTrajectory, dict[str, np.ndarray]]:
    positions = _numbers(group, "joint_positions", (None, None), path)
    count = len(positions)
    names = _data_of(group, "joint_names", path)
    if names.texts is None or None in names.texts:
        raise RecordingError(f"{path}: {names.name} must hold text, not {names.type[:80]}")
    status = _array_of(group, "status", (count,), "iu", path)
    labels = group.arrays["status"].attributes.get("status_names")
    labels = [str(label) for label in labels] if isinstance(labels, list) else None
    commands = CommandTrajectory(
        joint_positions=positions,
        joint_names=tuple(map(str, names.texts)),
        stamps=_numbers(group, "stamps", (count,), path),
        latency_ms=_numbers(group, "latency_ms", (count,), path),
        status=translate_status(status, labels, str(path)),
    )
    check_commands(commands, str(path))
    stages: dict[str, np.ndarray] = {}
    if timed is not None:
        for key, array in timed.arrays.items():
            stage = _text_of(array.attributes.get("stage")) or key
            stages[stage] = _numbers(timed, key, (count,), path)
    return commands, stages


def _object(text: str | None, what: str) -> dict[str, Any]:
    try:
        value = parse_json(text or "")
    except DocumentError as error:
        raise RecordingError(f"{what} is not JSON ({error})") from error
    if not isinstance(value, dict):
        raise RecordingError(f"{what} must be a JSON object, not {type(value).__name__}")
    return value


def _write_wrist(group: Group, wrist: WristTrack) -> None:
    _write_array(group, "wrist", wrist.poses, POSE_UNITS)
    group["wrist"].attrs["world"] = wrist.world
    _write_array(group, "wrist_engaged", np.asarray(wrist.engaged, bool), None)
    _write_array(group, "wrist_valid", np.asarray(wrist.valid, bool), None)


def _read_wrist(group: Hdf5Group, count: int, path: Path) -> WristTrack | None:
    if "wrist" not in group.arrays:
        return None
    poses = _numbers(group, "wrist", (count, 7), path)
    engaged = _array_of(group, "wrist_engaged", (count,), "b", path)
    valid = _array_of(group, "wrist_valid", (count,), "b", path)
    world = _text_of(group.arrays["wrist"].attributes.get("world"))
    return WristTrack(poses, engaged, valid, BASE if world is None else world)


def _write_arm(group: Group, arm: ArmTrack) -> None:
    _write_array(group, "arm", arm.positions, "rad")
    _write_array(group, "arm_measured", arm.measured, "rad")
    _write_array(group, "arm_wrist", arm.poses, POSE_UNITS)
    group["arm"].attrs["name"] = arm.name
    group["arm"].attrs["joint_names"] = ",".join(arm.joint_names)


def _read_arm(group: Hdf5Group, count: int, path: Path) -> ArmTrack | None:
    if "arm" not in group.arrays:
        return None
    attributes = group.arrays["arm"].attributes
    names = tuple((_text_of(attributes.get("joint_names")) or "").split(","))
    shape = (count, len(names))
    return ArmTrack(
        _text_of(attributes.get("name")) or "arm",
        names,
        _numbers(group, "arm", shape, path),
        _numbers(group, "arm_measured", shape, path),
        _numbers(group, "arm_wrist", (count, 7), path),
    )


_MEASURED = ("currents", "touch", "contact", "newtons")


def _write_states(group: Group, states: StateTrajectory) -> None:
    _write_array(group, "joint_positions", np.asarray(states.positions, np.float64), "rad")
    _write_array(group, "stamps", np.asarray(states.stamps, np.float64), "s")
    texts = h5py_of().string_dtype()
    group.create_dataset("joint_names", data=list(states.names), dtype=texts)
    if states.actuators:
        group.create_dataset("actuator_names", data=list(states.actuators), dtype=texts)
    for name in _MEASURED:
        values = getattr(states, name)
        if values is not None:
            _write_array(group, name, np.asarray(values, np.float64), None)


def _read_states(group: Hdf5Group, path: Path) -> StateTrajectory:
    positions = _numbers(group, "joint_positions", (None, None), path)
    count = len(positions)
    optional: dict[str, Any] = {
        name: _numbers(group, name, (count, None), path) if name in group.arrays else None
        for name in _MEASURED
    }
    names, actuators = (
        tuple(map(str, group.arrays[key].texts or ())) if key in group.arrays else ()
        for key in ("joint_names", "actuator_names")
    )
    stamps = _numbers(group, "stamps", (count,), path)
    try:
        return StateTrajectory(stamps, positions, names, actuators, **optional)
    except RecordingError as error:
        raise RecordingError(f"{path}: {group.name}: {error}") from error


def _write_array(group: Group, name: str, value: np.ndarray, units: str | None) -> None:
    # Shuffled bytes of neighbouring samples compress far better than the samples themselves.
    packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if value.size else {}
    data = group.create_dataset(name, data=value, **packed)
    if units is not None:
        data.attrs["units"] = units


def _numbers(group: Hdf5Group, name: str, shape: tuple[int | None, ...], path: Path) -> np.ndarray:
    """Returns an array of numbers as float64; see ``_array_of``."""
    return _array_of(group, name, shape, "fiu", path).astype(np.float64, copy=False)


def _array_of(
    group: Hdf5Group, name: str, shape: tuple[int | None, ...], kinds: str, path: Path
) -> np.ndarray:
    """Returns an array of numbers after a check of its shape and kind; RecordingError if the array
    is missing, or has another shape or kind."""
    array = _data_of(group, name, path)
    fits = len(array.shape) == len(shape) and all(
        expected in (None, size) for expected, size in zip(shape, array.shape, strict=True)
    )
    if not fits:
        expected = ", ".join("any" if size is None else str(size) for size in shape)
        raise RecordingError(
            f"{path}: {array.name} must have shape ({expected}), not {tuple(array.shape)}"
        )
    if array.kind not in kinds or array.data is None:
        what = "true or false" if kinds == "b" else "numbers"
        raise RecordingError(f"{path}: {array.name} must hold {what}, not {array.type[:80]}")
    return array.data


def _data_of(group: Hdf5Group, name: str, path: Path) -> Hdf5Array:
    if name not in group.arrays:
        raise RecordingError(
            f"{path}: it lacks the array {group.name}/{name}; the group holds {group.describe()}"
        )
    return group.arrays[name]


def _text_of(value: Any) -> str | None:
    return value if isinstance(value, str) else None

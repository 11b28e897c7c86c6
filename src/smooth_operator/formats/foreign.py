"""Recognises files and data sets of other programs, and advises how to convert them to a
recording."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import listed
from smooth_operator.io.documents import read_json

SAVE: Final = (
    "numpy.savez('recording.npz', landmarks=<array of shape (T, 21, 3), in metres>, "
    "timestamps=<array of shape (T,), in seconds>, side='right')"
)
"""Advice on how to save points as a recording."""

_HEAD_BYTES: Final = 4096
_SKELETON: Final = (
    "a skeleton animation; compute the positions of a hand's joints by forward kinematics, "
    "in metres (such files are often in centimetres or inches), and save 21 of them with "
    f"{SAVE}. The fingers move only if the hands were tracked during the recording"
)
_MARKERS: Final = (
    "it contains skin markers, not hand joints; use the program that recorded the markers to fit "
    f"the joints of a hand to them, and save 21 joints with {SAVE}"
)
_BAG: Final = (
    "play it (ros2 bag play FOLDER) and read the topic of the hand live: smooth-operator teleop "
    "--source ros2"
)
_ROBOT: Final = "it contains no human hand, so there is nothing to retarget"
_TABLE: Final = (
    "a table without the header of landmarks; name its columns timestamp [s], side, wrist_x, "
    "wrist_y, wrist_z, thumb_cmc_x ... pinky_tip_z [m], separated by commas, or read its points "
    f"into an array, and save them with {SAVE}"
)

_STARTS: Final[tuple[tuple[bytes, str], ...]] = (
    (b"\x1f\x8b", "gzip-compressed; unpack it first"),
    (b"BZh", "bzip2-compressed; unpack it first"),
    (b"\xfd7zXZ\x00", "xz-compressed; unpack it first"),
    (b"\x28\xb5\x2f\xfd", "zstd-compressed; unpack it first"),
    (b"MATLAB", f"a MATLAB file; save its landmarks with {SAVE}"),
    (b"#ROSBAG", f"a ROS 1 bag; convert it to ROS 2 (rosbags-convert), then {_BAG}"),
    (b"version https://git-lfs", "a Git LFS pointer, not the data; run 'git lfs pull'"),
    (b"Kaydara FBX", f"an FBX file, {_SKELETON}"),
    (b"; FBX", f"an FBX file, {_SKELETON}"),
    (b"NO_OF_FRAMES", f"a Qualisys motion-capture table: {_MARKERS}"),
    (b"PathFileType", f"a TRC motion-capture file: {_MARKERS}"),
    (b"SQLite format 3", f"an SQLite file, as ROS 2 bags are (.db3); {_BAG}"),
)
_SUFFIXES: Final = {
    ".fbx": f"an FBX file, {_SKELETON}",
    ".mvnx": f"an Xsens MVNX file, {_SKELETON}",
    ".c3d": f"a C3D motion-capture file: {_MARKERS}",
    ".trc": f"a TRC motion-capture file: {_MARKERS}",
    ".db3": f"a bag of ROS 2; {_BAG}",
    ".csv": _TABLE,
    ".tsv": _TABLE,
}
_PARQUET: Final = (
    "a Parquet file; pass the whole folder of its LeRobot dataset to 'smooth-operator convert'"
)
_JSON_ROBOT: Final = re.compile(rb'"(states|actions)"\s*:\s*\{')
_BODIES: Final = {72: "SMPL", 156: "SMPL-H", 165: "SMPL-X"}
_OWN_FEATURES: Final = frozenset(("right_landmarks", "left_landmarks", "joint_positions"))
_LEVELS: Final = 4  # from a file of a LeRobot data set up to its folder


def foreign_file(path: Path) -> str | None:
    """Says what kind of file another program wrote, with advice; None if the kind is unknown.

    Args:
        path: a regular file.

    Raises:
        OSError: it can't be read.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip(b" \t\r\n")
    for magic, what in _STARTS:
        if head.startswith(magic) or (magic.isascii() and start.startswith(magic)):
            return what
    suffix = path.suffix.lower()
    if head.startswith(b"PAR1"):
        folder = next((at for at in path.parents[:_LEVELS] if is_dataset(at)), None)
        whole = None if folder is None else foreign_dataset(folder)
        return _PARQUET if whole is None else f"a file of {whole}"
    if b"<mvnx" in head:
        return _SUFFIXES[".mvnx"]
    if suffix == ".c3d" and head[1:2] != b"\x50":
        return None
    if start[:1] in (b"{", b"["):
        if _JSON_ROBOT.search(head):
            return f"a JSON file with the states and actions of a robot: {_ROBOT}"
        return f"a JSON file from another program; save its landmarks with {SAVE}"
    return _SUFFIXES.get(suffix)


def foreign_suffix(suffix: str) -> str | None:
    """Names the kind of a file of another program, from its suffix in lower case."""
    return _SUFFIXES.get(suffix)


def is_dataset(path: Path) -> bool:
    """True for the folder of a LeRobot dataset, whatever its version and the program that wrote
    it."""
    return (path / "meta" / "info.json").is_file()


def foreign_dataset(path: Path) -> str | None:
    """Description of a LeRobot data set (of any version) without a human hand; None for others.

    Args:
        path: its folder; see ``is_dataset``.
    """
    try:
        info = read_json(path / "meta" / "info.json")
        features, version = info["features"], str(info["codebase_version"])[:20]
        if not isinstance(features, dict) or features.keys() & _OWN_FEATURES:
            return None
    except (OSError, ValueError, KeyError, TypeError):
        return None  # damaged: its reader says so
    robot = info.get("robot_type")
    who = f"the robot {robot[:40]!r}" if isinstance(robot, str) and robot else "a robot"
    columns = [
        f"{name[:40]}{_names_of(feature)}"
        for name, feature in features.items()
        if name.startswith(("action", "observation.state"))
    ]
    what = ", ".join(columns[:3]) or listed(features) or "no columns"
    return f"a LeRobot data set (version {version}) from {who}, with {what}: {_ROBOT}"


def _names_of(feature: Any) -> str:
    """Names of the first numbers of a feature, in brackets; empty if it has no names."""
    names = feature.get("names") if isinstance(feature, Mapping) else None
    if isinstance(names, Mapping):
        names = next(iter(names.values()), None)
    if not isinstance(names, list) or not names:
        return ""
    return f" ({listed(names[:2])}{', ...' if len(names) > 2 else ''})"


def body_parameters(shapes: Mapping[str, tuple[int, ...]]) -> str | None:
    """Describes arrays that contain whole-body parameters (such as SMPL-X); None for other arrays.

    Args:
        shapes: name -> shape of the arrays of a file.
    """
    shape = shapes.get("poses", ())
    if len(shape) != 2 or shape[1] not in _BODIES:
        return None
    body = _BODIES[shape[1]]
    return (
        f"whole-body parameters ({body}, {shape[1]} numbers per frame), not the joints of a hand; "
        "compute joints from the parameters with the library smplx, and save the 21 joints of a "
        f"hand with {SAVE}"
    )

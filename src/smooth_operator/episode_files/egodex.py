"""Reads hands from EgoDex files: one hand as a recording, or everything in a file as a clip.

A file has 4 x 4 transforms in ARKit's world: the group ``transforms`` with an array (T, 4, 4) for
each joint (``rightHand``, ``rightIndexFingerTip``, ...) and for the camera, and perhaps
``confidences`` with an array (T,) for each joint. A file contains both hands, but no times.
Source: the README and ``visualize_2d.py`` of apple/ml-egodex; the paper, arXiv 2505.11709.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.episode_files.hdf5_tree import EGODEX_JOINTS, Hdf5Group, read_tree
from smooth_operator.errors import MissingExtraError, RecordingError
from smooth_operator.formats.both_hands import checked_hands, first_video
from smooth_operator.formats.checks import check_recording, check_side, stamps_from_rate
from smooth_operator.formats.clip import SIDES, Clip, ClipRef, ReadingOptions
from smooth_operator.formats.hand_arrays import shares
from smooth_operator.landmarks import FROM_WEBXR_25, METACARPALS_WEBXR_25
from smooth_operator.poses import (
    WORLD_AXES,
    WRIST_AXES,
    forearm_in_world,
    from_matrices,
    is_rigid,
    points_to_ours,
    to_ours,
)
from smooth_operator.types import HandRecording, Side

WORLD: Final = "egodex"
RATE_HZ: Final = 30.0
"""Frame rate of the data set [Hz], which its files do not state."""

_AXES: Final = WORLD_AXES["openxr"]
_WRISTS: Final[Mapping[Side, Float[np.ndarray, "3 3"]]] = {
    "right": WRIST_AXES["arkit_right"],
    "left": WRIST_AXES["arkit_left"],
}


def read_egodex(
    tree: Mapping[str, Hdf5Group], path: Path, rate: float | None, side: Side | None
) -> HandRecording:
    """Reads one hand of a file, with its wrist and landmarks in a z-up world.

    Args:
        tree: the file's groups.
        path: the file, for messages.
        rate: frame rate [Hz]; that of the data set is 30.
        side: side of the hand; right by default.

    Raises:
        RecordingError: joints are missing or have another shape, or there is no rate.
    """
    label, assumed = check_side([], side, str(path))
    recording = egodex_hand(tree, path, rate, label)
    recording.meta["side_assumed"] = assumed
    check_recording(recording, str(path))
    return recording


def egodex_hand(
    tree: Mapping[str, Hdf5Group], path: Path, rate: float | None, side: Side
) -> HandRecording:
    """Reads one hand without checking units and timestamps.

    Joints that ARKit lost and matrices that are not poses become NaN.

    Raises:
        RecordingError: as ``read_egodex``.
    """
    names = EGODEX_JOINTS[side]
    joints = np.stack([egodex_transforms(tree, name, path) for name in names], axis=1)
    with np.errstate(all="ignore"):  # of numbers beyond any transform
        volume = np.linalg.det(joints[..., :3, :3])  # 1 of a rotation; mirrored ones have -1
    valid = np.isfinite(joints).all(axis=(2, 3)) & (volume > 0.5) & (volume < 2.0)
    sure = egodex_confidences(tree, side, len(joints))
    if sure is not None:
        valid &= ~(sure <= 0.0)  # NaN: the file does not say
    joints[~valid] = np.nan
    points = points_to_ours(joints[..., :3, 3], _AXES)
    wrist = to_ours(_poses(joints[:, 0]), _AXES, _WRISTS[side])
    elbow = None
    if f"{side}Forearm" in tree["transforms"].arrays:
        place = egodex_transforms(tree, f"{side}Forearm", path)[:, :3, 3]
        elbow = points_to_ours(place, _AXES)
    return HandRecording(
        points[:, FROM_WEBXR_25],
        stamps_from_rate(len(points), rate, str(path)),
        side,
        metacarpals=points[:, METACARPALS_WEBXR_25],
        name=path.stem,
        meta={"format": "egodex"},
        T_world_wrist=wrist,
        world=WORLD,
        forearm=None if elbow is None else forearm_in_world(wrist, elbow),
    )


def egodex_camera(tree: Mapping[str, Hdf5Group], path: Path) -> Float[np.ndarray, "T 7"] | None:
    """Reads the (T, 7) camera poses in the same world frame as the hands; camera axes: x right, y
    down, z into the picture.

    The file already uses these axes: the inverse of ``transforms/camera`` and the 3 x 3
    ``camera/intrinsic`` project joints to pixels. The result is None if the file has no camera.

    Raises:
        RecordingError: the array has another shape.
    """
    if "camera" not in tree["transforms"].arrays:
        return None
    return to_ours(_poses(egodex_transforms(tree, "camera", path)), _AXES, np.eye(3))


def egodex_confidences(
    tree: Mapping[str, Hdf5Group], side: Side, count: int
) -> Float[np.ndarray, "T 25"] | None:
    """Reads ARKit's confidence in each joint, 0 to 1. A joint without confidences is NaN; returns
    None if the file has no confidences."""
    group = tree.get("confidences")
    held = {} if group is None else group.arrays
    sure = np.full((count, len(EGODEX_JOINTS[side])), np.nan)
    for column, name in enumerate(EGODEX_JOINTS[side]):
        stored = held.get(name)
        if stored is not None and stored.data is not None and stored.shape == (count,):
            sure[:, column] = stored.data
    return None if np.isnan(sure).all() else sure


def egodex_transforms(
    tree: Mapping[str, Hdf5Group], name: str, path: Path
) -> Float[np.ndarray, "T 4 4"]:
    """Reads the transforms of a joint or of the camera unchanged. Raises RecordingError if the file
    has none, or if their number differs from that of the other joints."""
    group = tree["transforms"]
    first = next((n for pair in EGODEX_JOINTS.values() for n in pair if n in group.arrays), name)
    stored, example = group.arrays.get(name), group.arrays.get(first)
    count = example.shape[0] if example is not None and example.shape else 0
    if stored is None or stored.data is None or stored.shape != (count, 4, 4):
        what = "nothing" if stored is None else f"{stored.type[:80]} {stored.shape}"
        raise RecordingError(
            f"{path}: an EgoDex file has {group.name}/{name} with numbers of shape (frames, 4, 4); "
            f"this one has {what}"
        )
    return stored.data.astype(np.float64)


def _poses(matrices: Float[np.ndarray, "T 4 4"]) -> Float[np.ndarray, "T 7"]:
    """Converts matrices to poses; NaN if a matrix is not a rigid transform."""
    good = is_rigid(matrices)
    poses = np.full((len(matrices), 7), np.nan)
    poses[good] = from_matrices(matrices[good])
    return poses


_MAGIC: Final = b"\x89HDF\r\n\x1a\n"
_HEAD_BYTES: Final = 4096
_ABOUT: Final = ("task", "environment", "object", "session_name", "llm_verbs", "llm_objects")


class Egodex:
    """Reader of EgoDex files; a file is one clip at 30 frames per second."""

    what = "an HDF5 file of EgoDex"
    expects = (
        "an .hdf5 file with transforms/rightHand (frames, 4, 4), transforms/leftHand and the 24 "
        "other joints of each hand, and perhaps transforms/camera and confidences"
    )

    def matches(self, path: Path) -> bool:
        """True for an HDF5 file with the group ``transforms``."""
        if path.suffix.lower() not in (".hdf5", ".h5") or not path.is_file():
            return False
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
        if not head.startswith(_MAGIC):
            return False
        if b"transforms\0" in head:  # a name of the top group; HDF5 itself takes 70 times as long
            return True
        try:
            return "transforms" in read_tree(path, head=True)["/"].names
        except (RecordingError, MissingExtraError):
            return False  # the reader of plain recordings says what is wrong

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """Yields the file as one clip."""
        yield ClipRef(path.stem, path, layout="egodex", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Reads the hands, the camera and the task of a file. Frames in which ARKit did not see a
        hand are NaN and not valid.

        Raises:
            RecordingError: the file is damaged, or joints are missing or have another shape.
            MissingExtraError: h5py is not installed.
        """
        path = ref.path
        tree = read_tree(path)
        if "transforms" not in tree:
            raise RecordingError(
                f"{path}: not an EgoDex file: it has {tree['/'].describe()}; expected "
                f"{self.expects}"
            )
        rate = options.rate or RATE_HZ
        held = tree["transforms"].arrays
        hands = {
            side: egodex_hand(tree, path, rate, side)
            for side in SIDES
            if any(name in held for name in EGODEX_JOINTS[side])
        }
        checked = checked_hands(hands, str(path), self.expects)
        video = first_video(path.with_suffix(".mp4"))
        top = tree["/"].attributes
        return Clip(
            ref.name,
            checked,
            "egodex",
            (path,) if video is None else (path, video),
            task=_task(top),
            confidence={
                side: shares(np.nanmean(sure, axis=1), f"{path}, {side} hand")
                for side, hand in checked.items()
                if (sure := egodex_confidences(tree, side, len(hand))) is not None
            },
            T_world_camera=egodex_camera(tree, path),
            video=video,
            meta=_meta(tree, top),
        )


def _task(attributes: Mapping[str, Any]) -> str | None:
    """Description of the task.

    A task that can be done and undone (``llm_type`` is ``reversible``) has two descriptions, and
    ``which_llm_description`` says which of them is meant.
    """
    key = "llm_description"
    if attributes.get("llm_type") == "reversible":
        second = str(attributes.get("which_llm_description", "1")).strip() == "2"
        key = "llm_description2" if second else key
    for name in (key, "llm_description", "task"):
        text = attributes.get(name)
        if isinstance(text, str) and text.strip():
            return text.strip()
    return None


def _meta(tree: Mapping[str, Hdf5Group], attributes: Mapping[str, Any]) -> dict[str, Any]:
    meta: dict[str, Any] = {name: attributes[name] for name in _ABOUT if name in attributes}
    stored = tree["camera"].arrays.get("intrinsic") if "camera" in tree else None
    matrix = None if stored is None or stored.shape != (3, 3) else stored.data
    if matrix is not None and np.isfinite(matrix).all():
        meta["intrinsic"] = matrix.tolist()
    return meta


EGODEX: Final = Egodex()

"""Hands of the EgoDex data set: HDF5 files of 4 x 4 transforms in ARKit's world.

A file has the group ``transforms`` with an array (T, 4, 4) for each joint (``rightHand``,
``rightIndexFingerTip``, ...), and perhaps ``confidences`` with an array (T,) for each. Both hands
are in one file; times are not.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.episode_files.hdf5_process import EGODEX_JOINTS
from smooth_operator.episode_files.hdf5_tree import Hdf5Group
from smooth_operator.errors import RecordingError
from smooth_operator.formats.checks import check_recording, check_side, stamps_from_rate
from smooth_operator.landmarks import FROM_WEBXR_25, METACARPALS_WEBXR_25
from smooth_operator.poses import WORLD_AXES, WRIST_AXES, from_matrices, points_to_ours, to_ours
from smooth_operator.types import HandRecording, Side

WORLD: Final = "egodex"
_AXES: Final = WORLD_AXES["openxr"]
_WRISTS: Final[Mapping[Side, Float[np.ndarray, "3 3"]]] = {
    "right": WRIST_AXES["arkit_right"],
    "left": WRIST_AXES["arkit_left"],
}


def read_egodex(
    tree: Mapping[str, Hdf5Group], path: Path, rate: float | None, side: Side | None
) -> HandRecording:
    """One hand of a file, its wrist and landmarks in a z-up world.

    Args:
        tree: the file's groups.
        path: the file, for messages.
        rate: frames a second [Hz]; the data set has 30.
        side: which of the two hands; the right one if left out.

    Raises:
        RecordingError: joints are missing or have another shape; there is no rate.
    """
    found, assumed = check_side([], side, str(path))
    names = EGODEX_JOINTS[found]
    joints = np.stack([_array(tree["transforms"], name, path) for name in names], axis=1)
    joints[~_tracked(tree.get("confidences"), names, joints)] = np.nan
    points = points_to_ours(joints[..., :3, 3], _AXES)
    recording = HandRecording(
        points[:, FROM_WEBXR_25],
        stamps_from_rate(len(points), rate, str(path)),
        found,
        metacarpals=points[:, METACARPALS_WEBXR_25],
        name=path.stem,
        meta={"format": "egodex", "side_assumed": assumed},
        T_world_wrist=to_ours(from_matrices(joints[:, 0]), _AXES, _WRISTS[found]),
        world=WORLD,
    )
    check_recording(recording, str(path))
    return recording


def _array(group: Hdf5Group, name: str, path: Path) -> Float[np.ndarray, "T 4 4"]:
    stored = group.arrays.get(name)
    count = group.arrays[min(group.arrays)].shape[0] if group.arrays else 0
    if stored is None or stored.data is None or stored.shape != (count, 4, 4):
        what = "nothing" if stored is None else f"{stored.type[:80]} {stored.shape}"
        raise RecordingError(
            f"{path}: a file of EgoDex has {group.name}/{name} with numbers of shape "
            f"(frames, 4, 4); this one has {what}"
        )
    return stored.data.astype(np.float64)


def _tracked(
    group: Hdf5Group | None, names: tuple[str, ...], joints: Float[np.ndarray, "T 25 4 4"]
) -> Bool[np.ndarray, "T 25"]:
    """Which joints ARKit saw; all that are finite in a file that does not say."""
    seen = np.asarray(np.isfinite(joints).all(axis=(2, 3)))
    for column, name in enumerate(names):
        stored = None if group is None else group.arrays.get(name)
        if stored is not None and stored.data is not None and stored.shape == seen[:, 0].shape:
            seen[:, column] &= stored.data > 0
    return seen

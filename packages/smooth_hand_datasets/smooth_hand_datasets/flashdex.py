"""Clips in the form of FlashDexRetarget's ``import`` step, for its retargeting.

::

    human_demo/CLIP.npz
    objects/OBJECT/visual.obj

Unpack the tar shards in the folder itself, which already has the meshes.

==========================  =============  ========================================================
``fps``                     ()             frames per second, the same for all clips
``mano_SIDE_wrist_pos``     (T, 3)         wrist [m], z-up world
``mano_SIDE_wrist_rot``     (T, 3, 3)      axes x to the fingers, y to the thumb on a right hand
                                           and away from it on a left one, z out of the back
``mano_SIDE_joints``        (T, 20, 3)     joints and tips of the fingers [m]
``mano_SIDE_joint_names``   (20,)          their names, sorted: ``index_distal`` … ``thumb_tip``
``obj_SIDE_pose``           (T, 4, 4)      the object that the hand holds
``obj_SIDE_id``             ()             its folder under ``objects``
==========================  =============  ========================================================

The program needs an object with a mesh for each hand, and the same hands in all clips.
Source: https://github.com/Holiday-Robot/FlashDexRetarget, ``docs/guide/kinematic_retargeting.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_hand_datasets.keypoints import FileShards
from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.arrays import unique_slug
from smooth_hand_datasets.pipeline.writers.registry import DatasetFormat, WritingOptions
from smooth_hand_datasets.pipeline.writers.shards import npz_bytes
from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import SIDES
from smooth_operator.landmarks import FINGERS
from smooth_operator.types import Side

_RATE: Final = 60.0
_PARTS: Final = ("proximal", "intermediate", "distal", "tip")
_JOINTS: Final = dict(
    sorted(
        (f"{finger}_{part}", 1 + 4 * i + k)
        for i, finger in enumerate(FINGERS)
        for k, part in enumerate(_PARTS)
    )
)
"""Landmark of each joint, in the program's order."""


class _Writer(FileShards):
    """Writes human hands for FlashDexRetarget's own retargeting.

    The files contain no commands, robot joints, validity, confidence, camera, video or quality
    metrics, and one object per hand. Clips are resampled to 60 frames per second, and gaps of
    up to 20 % are filled.
    """

    def __init__(self, output: Path, options: WritingOptions) -> None:
        self._rate = options.rate or _RATE
        self._sides: tuple[Side, ...] = tuple(side for side in SIDES if side in options.joints)
        fixed = {"rate": self._rate, "loose": options.loose, "sides": list(self._sides)}
        super().__init__(output, options, "flashdex", 256.0, fixed)

    def _add(self, clip: RobotClip, entry: dict[str, Any]) -> None:
        scene = self.scene(clip, self._rate, "objects")
        name = clip.clip.name
        if not scene.objects:
            raise RecordingError(
                f"{name}: it has no object, and FlashDexRetarget needs one for each hand"
            )
        present: tuple[Side, ...] = tuple(side for side in SIDES if side in scene.points)
        sides = self._sides or present
        lacking = [side for side in sides if side not in present]
        if lacking:
            raise RecordingError(
                f"{name}: it has no {lacking[0]} hand; all clips for FlashDexRetarget need the "
                "same hands, so write those of one hand to another folder"
            )
        arrays: dict[str, np.ndarray] = {"fps": np.float32(self._rate)}  # type: ignore[dict-item]
        for side in sides:
            track, mesh = scene.objects[scene.holds[side]]
            if mesh is None:
                item = clip.clip.objects[scene.holds[side]].name
                raise RecordingError(
                    f"{name}: the mesh of its object {item!r} is unknown, but FlashDexRetarget "
                    "needs it; set the folder of the meshes"
                )
            wrist = scene.wrists[side]
            if len(wrist) < 2:
                raise RecordingError(f"{name}: it has one frame; FlashDexRetarget needs two")
            arrays |= {
                f"mano_{side}_wrist_pos": wrist[:, :3].astype(np.float32),
                f"mano_{side}_wrist_rot": poses.rotation_matrices(wrist[:, 3:]).astype(np.float32),
                f"mano_{side}_joints": scene.points[side][:, list(_JOINTS.values())].astype(
                    np.float32
                ),
                f"mano_{side}_joint_names": np.array(list(_JOINTS)),
                f"obj_{side}_pose": poses.matrices(track).astype(np.float32),
                f"obj_{side}_id": np.array(mesh),
            }
        self._sides = sides
        place = f"human_demo/{unique_slug(name, entry['key'])}.npz"
        self.add_file(place, npz_bytes(arrays))
        entry["path"] = place
        entry["frames"] = len(wrist)

    def _end(self, number: int) -> dict[str, Any]:
        return {**super()._end(number), "sides": list(self._sides)}

    def _resume(self, index: Mapping[str, Any]) -> None:
        self._sides = tuple(side for side in SIDES if side in index["sides"])


FLASHDEX: Final = DatasetFormat("clips for FlashDexRetarget", _Writer)

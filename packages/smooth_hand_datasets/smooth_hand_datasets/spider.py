"""Clips in the layout of SPIDER's keypoint stage, for its ``preprocess`` programs.

::

    processed/smooth_operator/mano/EMBODIMENT/TASK/task_info.json
    processed/smooth_operator/mano/EMBODIMENT/TASK/0/trajectory_keypoints.npz
    processed/smooth_operator/assets/objects/OBJECT/visual.obj

EMBODIMENT is ``bimanual``, ``right`` or ``left``; TASK is the clip. Unpack the tar
shards in the folder itself, which already has the meshes.

=====================  ==========  ================================================================
``qpos_wrist_SIDE``    (T, 7)      wrist, x y z [m] and quaternion wxyz: z to the base of the
                                   middle finger, y to the thumb on a right hand and away from it
                                   on a left one, x out of the palm
``qpos_finger_SIDE``   (T, 5, 7)   fingertips, thumb to pinky; their rotation is 1 0 0 0
``qpos_obj_SIDE``      (T, 7)      the object of that hand
=====================  ==========  ================================================================

A missing hand or object is at the origin with rotation 1 0 0 0. An object held by both hands counts
as that of the right hand. Source: https://github.com/facebookresearch/spider.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_hand_datasets.keypoints import FileShards, Scene
from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.arrays import unique_slug
from smooth_hand_datasets.pipeline.writers.registry import DatasetFormat, WritingOptions
from smooth_hand_datasets.pipeline.writers.shards import npz_bytes
from smooth_operator import poses
from smooth_operator.formats.clip import SIDES
from smooth_operator.io.jsonable import to_json

_ROOT: Final = "processed/smooth_operator"
_RATE: Final = 50.0  # ref_dt = 0.02, the default of SPIDER's programs
_TIPS: Final = [4, 8, 12, 16, 20]
_AXES: Final = np.array([0.0, 0.0, 0.0, *np.sqrt([0.5, 0.0, 0.5, 0.0])])
"""Pose of SPIDER's wrist axes in the project's: its x, y, z are -z, y, x."""


class _Writer(FileShards):
    """Writes human hands for SPIDER's own retargeting.

    The files contain the wrist and five fingertips of each hand and one object per hand, but no
    commands, joints, validity, confidence, camera, video or quality metrics. Clips are resampled
    to 50 frames per second, and gaps of up to 20 % are filled.
    """

    def __init__(self, output: Path, options: WritingOptions) -> None:
        self._rate = options.rate or _RATE
        fixed = {"rate": self._rate, "loose": options.loose}
        super().__init__(output, options, "spider", 256.0, fixed)

    def _add(self, clip: RobotClip, entry: dict[str, Any]) -> None:
        meshes = f"{_ROOT}/assets/objects"
        scene = self.scene(clip, self._rate, meshes)
        both = len(scene.points) == 2
        embodiment = "bimanual" if both else next(iter(scene.points))
        arrays, folders = _arrays(scene)
        task = unique_slug(clip.clip.name, entry["key"])
        info: dict[str, Any] = {
            "task": task,
            "dataset_name": "smooth_operator",
            "robot_type": "mano",
            "embodiment_type": embodiment,
            "data_id": 0,
            "ref_dt": 1.0 / self._rate,
        }
        for side in SIDES:
            folder = folders.get(side)
            place = None if folder is None else f"{meshes}/{folder}"
            info[f"{side}_object_mesh_dir"] = place
            info[f"{side}_object_convex_dir"] = None if place is None else f"{place}/convex"
        info["smooth_operator"] = {
            "key": entry["key"],
            "name": clip.clip.name,
            "task": clip.clip.task,
            "world": clip.clip.world,
            "filled": scene.filled,
        }
        place = f"{_ROOT}/mano/{embodiment}/{task}"
        self.add_file(f"{place}/task_info.json", to_json(info, indent=2).encode())
        self.add_file(f"{place}/0/trajectory_keypoints.npz", npz_bytes(arrays))
        entry["path"] = place
        entry["frames"] = len(arrays["qpos_wrist_right"])


def _arrays(scene: Scene) -> tuple[dict[str, np.ndarray], dict[str, str | None]]:
    """The arrays, and the folders of the objects' meshes by side."""
    count = len(next(iter(scene.wrists.values())))
    arrays: dict[str, np.ndarray] = {}
    folders: dict[str, str | None] = {}
    shared = len(set(scene.holds.values())) == 1 and len(scene.holds) == 2
    for side in SIDES:
        wrist = np.tile(poses.IDENTITY, (count, 1))
        finger = np.tile(poses.IDENTITY, (count, 5, 1))
        held = np.tile(poses.IDENTITY, (count, 1))
        if side in scene.wrists:
            wrist = poses.compose(scene.wrists[side], _AXES)
            finger[..., :3] = scene.points[side][:, _TIPS]
        if side in scene.holds and not (shared and side == "left"):
            held, folders[side] = scene.objects[scene.holds[side]]
        arrays[f"qpos_wrist_{side}"] = wrist.astype(np.float32)
        arrays[f"qpos_finger_{side}"] = finger.astype(np.float32)
        arrays[f"qpos_obj_{side}"] = held.astype(np.float32)
    return arrays, folders


SPIDER: Final = DatasetFormat("keypoints for SPIDER", _Writer)

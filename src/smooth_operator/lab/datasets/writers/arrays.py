"""A robot clip as named arrays and a document: what the general formats hold.

All arrays have a row a frame. Poses are x y z [m] and a unit quaternion w x y z in the clip's
world. NaN is a value that is not known. ``SIDE`` is ``right`` or ``left``.

========================  ==========================  =============================================
``stamps``                (T,) float64                times of the frames [s]
``SIDE_joints``           (T, n) float32              commanded joint positions [rad]
``SIDE_wrist``            (T, 7) float32              pose of the robot hand's wrist
``SIDE_valid``            (T,) bool                   whether the command answers a hand that was
                                                      seen
``SIDE_status``           (T,) int8                   ``Status`` of the command
``SIDE_confidence``       (T,) float32                of the tracker, 0 to 1, if it is known
``SIDE_human_wrist``      (T, 7) float32              pose of the human wrist, if it is known
``SIDE_landmarks``        (T, 21, 3) float32          the human hand [m], in the tracker's frame
``camera``                (T, 7) float32              pose of the camera, if it is known
``objects``               (T, k, 7) float32           poses of the objects, if there are any
========================  ==========================  =============================================
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from typing import Any, Final

import numpy as np

from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.datasets.clip import SIDES, RobotClip
from smooth_operator.types import Side, Status

LOST: Final = (
    "It does not hold metacarpal bases, orientations of landmarks, figures of single frames, the "
    "time that a command took, and landmarks that are marked invalid; numbers but the stamps are "
    "rounded to float32."
)
"""What of a clip ``clip_arrays`` has no place for."""


def clip_arrays(clip: RobotClip) -> dict[str, np.ndarray]:
    """The arrays of a clip, by name, in a fixed order; see the module."""
    human = clip.clip
    arrays: dict[str, np.ndarray] = {"stamps": np.asarray(human.stamps, np.float64)}
    for side in SIDES:
        commands = clip.commands.get(side)
        if commands is not None:
            arrays[f"{side}_joints"] = _single(commands.joint_positions)
            if side in clip.T_world_wrist:
                arrays[f"{side}_wrist"] = _single(clip.T_world_wrist[side])
            arrays[f"{side}_valid"] = clip_valid(clip, side)
            arrays[f"{side}_status"] = np.asarray(commands.status, np.int8)
        hand = human.hands.get(side)
        if hand is None:
            continue
        assert hand.valid is not None  # filled in by HandRecording
        if side in human.confidence:
            arrays[f"{side}_confidence"] = _single(human.confidence[side])
        if hand.T_world_wrist is not None:
            arrays[f"{side}_human_wrist"] = _single(hand.T_world_wrist)
        landmarks = np.where(hand.valid[..., None], hand.landmarks, np.nan)
        arrays[f"{side}_landmarks"] = _single(landmarks)
    if human.T_world_camera is not None:
        arrays["camera"] = _single(human.T_world_camera)
    if human.objects:
        arrays["objects"] = _single(np.stack([o.T_world_object for o in human.objects], axis=1))
    return arrays


def clip_valid(clip: RobotClip, side: Side) -> np.ndarray:
    """(T,) whether the commands of a side answer a hand that was seen."""
    if side in clip.valid:
        return np.asarray(clip.valid[side], bool)
    return np.asarray(np.equal(clip.commands[side].status, Status.OK))


def clip_document(clip: RobotClip, key: str, configuration: str) -> dict[str, Any]:
    """Other facts of a clip, as JSON has them."""
    human = clip.clip
    return {
        "key": key,
        "name": human.name,
        "layout": human.layout,
        "source": [path.as_posix() for path in human.source],
        "task": human.task,
        "frames": len(human),
        "rate_hz": clip_rate(clip),
        "world": human.world,
        "hands": {side: clip.hand_names.get(side) for side in SIDES if side in clip.commands},
        "joints": {s: list(clip.commands[s].joint_names) for s in SIDES if s in clip.commands},
        "objects": [
            {
                "name": item.name,
                "mesh": None if item.mesh is None else item.mesh.as_posix(),
                "scale": item.scale,
            }
            for item in human.objects
        ],
        "shape": {side: np.asarray(human.shape[side]).tolist() for side in human.shape},
        "video": None if human.video is None else human.video.as_posix(),
        "video_start_s": human.video_start_s,
        "figures": {name: float(clip.figures[name]) for name in sorted(clip.figures)},
        "configuration": configuration,
        "meta": dict(human.meta),
    }


def clip_rate(clip: RobotClip) -> float | None:
    """Frames a second, by the median step; None with fewer than two frames."""
    steps = np.diff(clip.clip.stamps)
    return float(1.0 / np.median(steps)) if len(steps) else None


def clip_key(clip: RobotClip) -> str:
    """Digest of a clip without a key: of its name, its document and its arrays."""
    digest = hashlib.sha256(to_json(clip_document(clip, "", "")).encode())
    for name, array in clip_arrays(clip).items():
        digest.update(f"{name}{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def slug(text: str, longest: int = 60) -> str:
    """A text as part of a file's name on every system: ASCII letters, digits, ``-`` and ``_``."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")[:longest].strip("_") or "clip"


def unique_slug(name: str, key: str) -> str:
    """A clip's name as part of a file's name, with so much of its key that no two are equal."""
    return f"{slug(name)}-{hashlib.sha256(key.encode()).hexdigest()[:16]}"


def _single(values: Any) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)

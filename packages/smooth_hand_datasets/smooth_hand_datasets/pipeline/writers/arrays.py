"""Converts a robot clip to named arrays and a JSON document, for the general formats.

All arrays have one row per frame. Poses are x y z [m] and a unit quaternion w x y z in the clip's
world. NaN stands for an unknown value. ``SIDE`` is ``right`` or ``left``.

========================  ==========================  =============================================
``stamps``                (T,) float64                times of the frames [s]
``SIDE_joints``           (T, n) float32              commanded joint positions [rad]
``SIDE_wrist``            (T, 7) float32              pose of the robot hand's wrist
``SIDE_valid``            (T,) bool                   whether the command was computed from a hand
                                                      that was seen
``SIDE_status``           (T,) int8                   ``Status`` of the command
``SIDE_confidence``       (T,) float32                of the tracker, 0 to 1, if it is known
``SIDE_human_wrist``      (T, 7) float32              pose of the human wrist, if it is known
``SIDE_landmarks``        (T, 21, 3) float32          the human hand [m], in the tracker's frame
``camera``                (T, 7) float32              pose of the camera, if it is known
``objects``               (T, k, 7) float32           poses of the objects, if there are any
========================  ==========================  =============================================

If the frame rate is changed, positions and joint positions are interpolated linearly and rotations
along the shortest path; status and confidence are those of the nearer frame. A value is known only
if it is known in both frames around it, and a command is valid only if both frames are valid and
the tracker did not pause between them.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_operator import poses
from smooth_operator.episode_files.lerobot.tables import PAUSE
from smooth_operator.formats.clip import SIDES
from smooth_operator.io.jsonable import to_json
from smooth_operator.types import CommandTrajectory, HandRecording, Side, Status


def drift(stamps: Float[np.ndarray, " T"], rate: float) -> float:
    """Largest deviation of timestamps from evenly spaced ones at a rate [frames]."""
    if len(stamps) < 2:
        return 0.0
    nominal = np.arange(len(stamps)) / rate
    return float(np.abs(stamps - stamps[0] - nominal).max() * rate)


def resampled(clip: RobotClip, rate: float) -> RobotClip:
    """Resamples a clip to frames every 1 / ``rate`` seconds, from its first frame to its last."""
    human = clip.clip
    grid = Grid.of(human.stamps, rate)
    hands: dict[Side, HandRecording] = {s: _hand(h, grid) for s, h in human.hands.items()}
    scene = replace(
        human,
        hands=hands,
        confidence={s: np.asarray(c)[grid.nearest] for s, c in human.confidence.items()},
        T_world_camera=None if human.T_world_camera is None else grid.poses(human.T_world_camera),
        objects=tuple(
            replace(o, T_world_object=grid.poses(o.T_world_object)) for o in human.objects
        ),
    )
    return replace(
        clip,
        clip=scene,
        commands={s: _commands(c, grid) for s, c in clip.commands.items()},
        T_world_wrist={s: grid.poses(w) for s, w in clip.T_world_wrist.items()},
        valid={s: grid.flags(clip_valid(clip, s)) & ~grid.pause for s in clip.commands},
        tracks={name: np.asarray(track)[grid.nearest] for name, track in clip.tracks.items()},
    )


@dataclass(frozen=True, eq=False)
class Grid:
    """Interpolates values at new frames from those of the old frames.

    Attributes:
        stamps: (T,) timestamps of the new frames [s].
        before: (T,) index of the old frame at or before the time.
        after: (T,) index of the old frame at or after the time.
        share: (T,) position between the two, 0 to 1.
        pause: (T,) True if the tracker paused between the two.
    """

    stamps: np.ndarray
    before: np.ndarray
    after: np.ndarray
    share: np.ndarray
    pause: np.ndarray

    @classmethod
    def of(cls, old: np.ndarray, rate: float) -> Grid:
        """Makes a grid with evenly spaced frames at a rate."""
        count = int(np.floor((old[-1] - old[0]) * rate + 1e-6)) + 1
        return cls.at(old, old[0] + np.arange(count) / rate)

    @classmethod
    def at(cls, old: np.ndarray, new: np.ndarray) -> Grid:
        """Makes a grid with frames at given times, clipped to the range of the old frames."""
        new = np.clip(new, old[0], old[-1])
        before = np.clip(np.searchsorted(old, new, side="right") - 1, 0, len(old) - 1)
        after = np.minimum(before + 1, len(old) - 1)
        step = np.where(after > before, old[after] - old[before], 1.0)
        share = (new - old[before]) / step
        # An old frame stays as it is, and is not made unknown by the one after it.
        share[share < 1e-6] = 0.0
        share[share > 1.0 - 1e-6] = 1.0
        after = np.where(share == 0.0, before, after)
        before = np.where(share == 1.0, after, before)
        share = np.where(before == after, 0.0, share)
        usual = float(np.median(np.diff(old))) if len(old) > 1 else 1.0
        pause = (old[after] - old[before]) > PAUSE * usual
        return cls(new, before, after, share, pause)

    @property
    def nearest(self) -> np.ndarray:
        """(T,) index of the old frame that is nearest to each new frame."""
        return np.where(self.share > 0.5, self.after, self.before)

    def values(self, old: Any) -> np.ndarray:
        """Interpolates numbers at the new frames."""
        rows = np.asarray(old, np.float64)
        share = self.share.reshape(-1, *[1] * (rows.ndim - 1))
        between: np.ndarray = rows[self.before] * (1.0 - share) + rows[self.after] * share
        return between

    def flags(self, old: np.ndarray) -> np.ndarray:
        """Interpolates flags: true where the flag is true in both neighbouring old frames."""
        return np.asarray(old[self.before] & old[self.after])

    def poses(self, old: np.ndarray) -> np.ndarray:
        """Interpolates poses at the new frames."""
        a, b = old[self.before], old[self.after]
        turn = poses.multiply(poses.conjugate(a[..., 3:]), b[..., 3:])
        part = poses.from_rotation_vectors(self.share[:, None] * poses.rotation_vectors(turn))
        moved = np.concatenate([self.values(old[..., :3]), poses.multiply(a[..., 3:], part)], -1)
        return np.where((self.share == 0.0)[:, None], a, moved)


def _hand(hand: HandRecording, grid: Grid) -> HandRecording:
    assert hand.valid is not None  # filled in by HandRecording
    return replace(
        hand,
        landmarks=grid.values(hand.landmarks),
        stamps=grid.stamps,
        valid=grid.flags(hand.valid),
        metacarpals=None if hand.metacarpals is None else grid.values(hand.metacarpals),
        orientations=None if hand.orientations is None else hand.orientations[grid.nearest],
        T_world_wrist=None if hand.T_world_wrist is None else grid.poses(hand.T_world_wrist),
    )


def _commands(commands: CommandTrajectory, grid: Grid) -> CommandTrajectory:
    return replace(
        commands,
        joint_positions=grid.values(commands.joint_positions),
        stamps=grid.stamps,
        latency_ms=np.asarray(commands.latency_ms)[grid.nearest],
        status=np.asarray(commands.status)[grid.nearest],
    )


def clip_arrays(clip: RobotClip) -> dict[str, np.ndarray]:
    """Returns the arrays of a clip by name, in a fixed order; see the docstring of this module.

    Metacarpal bases, orientations of landmarks, quality metrics of single frames, latencies and
    invalid landmarks are left out. All numbers except the timestamps are rounded to float32.
    """
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
    """(T,) True where the command of a side was computed from a hand that the tracker saw."""
    if side in clip.valid:
        return np.asarray(clip.valid[side], bool)
    return np.asarray(np.equal(clip.commands[side].status, Status.OK))


def clip_document(clip: RobotClip, key: str, configuration: str) -> dict[str, Any]:
    """Facts about a clip that are not arrays, as JSON values."""
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
    """Frame rate of a clip, from the median time step [Hz]; None if it has fewer than two
    frames."""
    steps = np.diff(clip.clip.stamps)
    return float(1.0 / np.median(steps)) if len(steps) else None


def clip_key(clip: RobotClip) -> str:
    """Key of a clip. If the clip has no key, a digest of its document and arrays."""
    digest = hashlib.sha256(to_json(clip_document(clip, "", "")).encode())
    for name, array in clip_arrays(clip).items():
        digest.update(f"{name}{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def slug(text: str) -> str:
    """Converts a text to ASCII letters, digits and ``_``, so that it can be part of a file name on
    every system."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")[:60].strip("_") or "clip"


def unique_slug(name: str, key: str) -> str:
    """Makes a unique part of a file name from the clip's name and a digest of its key."""
    return f"{slug(name)}-{hashlib.sha256(key.encode()).hexdigest()[:16]}"


def _single(values: Any) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)

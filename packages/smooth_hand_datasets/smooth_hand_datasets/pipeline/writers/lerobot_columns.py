"""The columns of a LeRobot data set of robot hands.

``observation.state`` and ``action`` are the joints of both hands and the poses of their wrists. No
other column's name begins with either word, because LeRobot uses all columns whose names do as
inputs and outputs of a policy. ``schema.COLUMNS`` of ``episode_files.lerobot`` has the type, unit
and meaning of each.

The state has ``SIDE_JOINT.pos`` [rad], and ``SIDE_tcp.x`` … ``.qz`` of the robot's wrist [m,
quaternion wxyz]; the action is the state of the next frame.

No column contains NaN: a policy can't use it, and LeRobot's tools turn it into a null that its
loader can't read. An unknown pose is replaced by the last known pose; before the first known pose,
by that one; and if no pose is known, by the identity. The column ``…_valid`` is false there. The
joints of a missing hand are 0. Quaternions start with w >= 0 and do not flip their sign between
frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.arrays import clip_valid
from smooth_hand_datasets.pipeline.writers.registry import WritingOptions
from smooth_operator import poses
from smooth_operator.episode_files.lerobot.human import human_columns, human_layout
from smooth_operator.episode_files.lerobot.schema import (
    POSE_NAMES,
    Layout,
    joint_keys,
    pose_keys,
    typed,
)
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import SIDES, Clip
from smooth_operator.types import HandRecording, Side


@dataclass(frozen=True)
class RobotLayout:
    """The columns that all clips of a data set share.

    Attributes:
        joints: side -> names of the joints of the robot hand.
        wrist: True if there are columns for the robot's wrists.
        camera: True if there are columns for the camera's pose.
        objects: number of objects with columns.
        fps: frame rate [Hz].
        robot: names of the hands.
        video: LeRobot feature of the video; None without videos.
    """

    joints: Mapping[Side, tuple[str, ...]]
    wrist: bool
    camera: bool
    objects: int
    fps: float
    robot: str
    video: Mapping[str, Any] | None = None

    @classmethod
    def of(cls, clip: RobotClip, options: WritingOptions, fps: float) -> RobotLayout:
        """Makes the layout from the first clip and the options."""
        names = {side: tuple(c.joint_names) for side, c in clip.commands.items()}
        joints = {**names, **options.joints}
        return cls(
            {side: tuple(joints[side]) for side in SIDES if side in joints},
            _has_wrist(clip),
            options.camera,
            options.objects,
            fps,
            "+".join(dict.fromkeys(clip.hand_names[s] for s in SIDES if s in clip.hand_names)),
        )

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> RobotLayout:
        """Makes the layout from its JSON form."""
        joints = {side: tuple(value["joints"][side]) for side in SIDES if side in value["joints"]}
        return cls(**{**value, "joints": joints})

    def check(self, clip: RobotClip) -> None:
        """Checks that a clip fits these columns; RecordingError if it has another hand, lacks the
        wrists, or has other joints."""
        name = clip.clip.name
        for side, commands in clip.commands.items():
            if side not in self.joints:
                raise RecordingError(
                    f"{name}: it has a {side} hand, for which the data set has no columns; begin "
                    "the data set with a clip of both hands, or write this clip to another data set"
                )
            if tuple(commands.joint_names) != self.joints[side]:
                raise RecordingError(
                    f"{name}: its {side} commands are not for the joints of the data set; write "
                    "the clips of each robot hand to a separate data set"
                )
        if not clip.commands:
            raise RecordingError(f"{name}: this clip has no commands; leave it out")
        with_wrist = _has_wrist(clip)
        if self.wrist != with_wrist:
            has = (
                "it has wrist poses, but the data set does not"
                if with_wrist
                else "its wrists are unknown"
            )
            raise RecordingError(
                f"{name}: {has}; write clips with and without wrist poses to two data sets"
            )

    def layout(self) -> Layout:
        """The columns of the data set, without indices and video."""
        state: list[str] = []
        for side, joints in self.joints.items():
            state += joint_keys([sided(joint, side) for joint in joints])
            if self.wrist:
                state += [f"{side}_{key}" for key in pose_keys()]
        layout: Layout = {"observation.state": tuple(state), "action": tuple(state), "stamp": None}
        for side in self.joints:
            names = ("valid", "wrist_valid", "status", "confidence")
            layout |= {
                f"{side}_{name}": None for name in names if self.wrist or name != "wrist_valid"
            }
            layout |= human_layout(side, ("human_wrist",) if self.wrist else ())
        if self.camera:
            layout |= {"camera": POSE_NAMES, "camera_valid": None}
        if self.objects:
            objects = [f"object{i}" for i in range(self.objects)]
            layout["objects"] = tuple(f"{each}.{name}" for each in objects for name in POSE_NAMES)
            layout["objects_valid"] = tuple(objects)
        return layout

    def columns(self, clip: RobotClip) -> dict[str, np.ndarray]:
        """(T,) or (T, k) values of each column except the indices, in the column's type."""
        human, count = clip.clip, len(clip.clip)
        state: list[np.ndarray] = []
        columns: dict[str, np.ndarray] = {"stamp": np.asarray(human.stamps, np.float64)}
        for side, joints in self.joints.items():
            commands = clip.commands.get(side)
            there = commands is not None
            positions = np.zeros((count, len(joints)))
            columns[f"{side}_valid"] = clip_valid(clip, side) if there else np.zeros(count, bool)
            columns[f"{side}_status"] = np.full(count, -1)
            if commands is not None:
                positions = _held(np.asarray(commands.joint_positions, np.float64))
                columns[f"{side}_status"] = np.asarray(commands.status)
            state.append(positions)
            sure = np.asarray(human.confidence.get(side, np.nan), np.float64)
            columns[f"{side}_confidence"] = np.broadcast_to(
                np.where(np.isfinite(sure), sure, -1.0), (count,)
            )
            columns |= self._human(human, side)
            if self.wrist:
                wrist = clip.T_world_wrist.get(side) if there else None
                held, columns[f"{side}_wrist_valid"] = _poses(wrist, count)
                state.append(held)
        columns["observation.state"] = flat = np.concatenate(state, axis=1)
        # What a hand does next; the last frame stays where it is.
        columns["action"] = np.concatenate([flat[1:], flat[-1:]])
        if self.camera:
            columns["camera"], columns["camera_valid"] = _poses(human.T_world_camera, count)
        if self.objects:
            object_tracks: list[np.ndarray | None] = [
                item.T_world_object for item in human.objects[: self.objects]
            ]
            object_tracks += [None] * (self.objects - len(object_tracks))
            tracks = [_poses(each, count) for each in object_tracks]
            columns["objects"] = np.concatenate([track for track, _ in tracks], axis=1)
            columns["objects_valid"] = np.stack([valid for _, valid in tracks], axis=1)
        return typed(columns, self.layout())

    def _human(self, clip: Clip, side: Side) -> dict[str, np.ndarray]:
        """The columns of the human hand; zeros that are not valid if the clip lacks it."""
        count, hand = len(clip), clip.hands.get(side)
        if hand is None:
            nowhere = np.full((count, 21, 3), np.nan)
            hand = HandRecording(nowhere, clip.stamps, side)
        points = np.stack([_held(track) for track in hand.landmarks.swapaxes(0, 1)], axis=1)
        columns = human_columns(replace(hand, landmarks=points))
        if self.wrist:
            held, known = _poses(hand.T_world_wrist, count)
            columns |= {f"{side}_human_wrist": held, f"{side}_human_wrist_valid": known}
        return columns


def _has_wrist(clip: RobotClip) -> bool:
    return any(
        poses.is_valid(clip.T_world_wrist[side]).any()
        for side in clip.commands
        if side in clip.T_world_wrist
    )


def sided(joint: str, side: Side) -> str:
    """Joint name, prefixed with the side."""
    return joint if joint.lower().startswith(f"{side}_") else f"{side}_{joint}"


def _poses(track: np.ndarray | None, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(T, 7) poses without gaps and sign flips, and (T,) True where the pose was known."""
    valid = np.zeros(count, bool) if track is None else np.asarray(poses.is_valid(track))
    if track is None or not valid.any():
        return np.tile(poses.IDENTITY, (count, 1)), valid
    held = _held(track)
    # q and -q are the same rotation; a jump from one to the other is no motion to learn.
    along = (held[1:, 3:] * held[:-1, 3:]).sum(axis=1)
    signs = np.cumprod(np.concatenate([held[:1, 3] < 0.0, along < 0.0]) * -2.0 + 1.0)
    return np.concatenate([held[:, :3], held[:, 3:] * signs[:, None]], axis=1), valid


def _held(rows: np.ndarray) -> np.ndarray:
    """Replaces rows that are not finite by the last finite row before, or else the first finite
    row; zeros if no row is finite."""
    good = np.isfinite(rows).all(axis=1)
    if good.all():
        return rows
    if not good.any():
        return np.zeros_like(rows)
    last = np.maximum.accumulate(np.where(good, np.arange(len(rows)), -1))
    return np.asarray(rows[np.where(last < 0, int(np.argmax(good)), last)])

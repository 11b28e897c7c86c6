"""Parts of clips, and clips in the frame of their camera."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np

from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.lab.datasets.clip import CAMERA, Clip
from smooth_operator.lab.datasets.robot_clip import RobotClip
from smooth_operator.result_cache import key_digest
from smooth_operator.types import Side

Frame: TypeAlias = Literal["world", "camera"]
"""Where wrists and objects are given: fixed to the scene, or to the camera."""


def clip_part(clip: Clip, frames: slice) -> Clip:
    """Some consecutive frames of a clip; the video starts with them."""
    start = frames.start or 0
    camera = clip.T_world_camera
    return replace(
        clip,
        hands={side: hand[frames] for side, hand in clip.hands.items()},
        confidence={side: values[frames] for side, values in clip.confidence.items()},
        T_world_camera=None if camera is None else camera[frames],
        objects=tuple(
            replace(each, T_world_object=each.T_world_object[frames]) for each in clip.objects
        ),
        video_start_s=clip.video_start_s + float(clip.stamps[start] - clip.stamps[0]),
    )


def robot_part(whole: RobotClip, frames: slice) -> RobotClip:
    """Some consecutive frames of a clip with commands, without figures.

    Its name and key say which frames they are. All frames are the clip itself.
    """
    count = len(whole.clip)
    start, stop, _ = frames.indices(count)
    if (start, stop) == (0, count):
        return whole
    name = f"{whole.clip.name}_{start:06d}-{stop:06d}"
    part = clip_part(whole.clip, slice(start, stop))
    commands = {
        side: replace(
            each,
            joint_positions=each.joint_positions[frames],
            stamps=each.stamps[frames],
            latency_ms=each.latency_ms[frames],
            status=each.status[frames],
        )
        for side, each in whole.commands.items()
    }
    return replace(
        whole,
        clip=replace(part, name=name, meta={**part.meta, "part": [start, stop]}),
        commands=commands,
        T_world_wrist={side: wrist[frames] for side, wrist in whole.T_world_wrist.items()},
        valid={side: valid[frames] for side, valid in whole.valid.items()},
        tracks={track: values[frames] for track, values in whole.tracks.items()},
        figures={},
        key=key_digest([whole.key, start, stop]),
    )


def in_frame(clip: Clip, frame: Frame | None) -> Clip:
    """A clip whose wrists and objects are given in a frame.

    Args:
        clip: the clip.
        frame: ``world`` for one that is fixed to the scene, ``camera`` for the camera's; None for
            the clip's own, which ``Clip.world`` names.

    Raises:
        RecordingError: the clip does not know its hands in that frame.
    """
    own = clip.world
    if frame is None or own is None or (frame == "camera") == (own == CAMERA):
        return clip
    if frame == "world":
        raise RecordingError(
            f"{clip.name}: its wrists are known in the frame of the camera only; give --frame "
            "camera, or leave it out for the frame that each clip has"
        )
    camera = clip.T_world_camera
    if camera is None:
        raise RecordingError(
            f"{clip.name}: the poses of its camera are not known, so neither are its wrists in the "
            "camera's frame; give --frame world, or leave it out"
        )

    def measured(pose: np.ndarray) -> np.ndarray:
        return poses.relative(camera, pose)

    hands = {
        side: hand
        if hand.T_world_wrist is None
        else replace(hand, T_world_wrist=measured(hand.T_world_wrist), world=CAMERA)
        for side, hand in clip.hands.items()
    }
    return replace(
        clip,
        hands=hands,
        T_world_camera=np.where(poses.is_valid(camera)[:, None], poses.IDENTITY, np.nan),
        objects=tuple(
            replace(each, T_world_object=measured(each.T_world_object)) for each in clip.objects
        ),
    )


def with_side(clip: Clip, side: Side | None) -> Clip:
    """A clip with one of its hands; with all of them for None.

    Raises:
        RecordingError: it does not have that hand.
    """
    if side is None or set(clip.hands) == {side}:
        return clip
    if side not in clip.hands:
        raise RecordingError(f"{clip.name}: it has no {side} hand; leave out --side {side}")
    return replace(
        clip,
        hands={side: clip.hands[side]},
        confidence={name: c for name, c in clip.confidence.items() if name == side},
        shape={name: s for name, s in clip.shape.items() if name == side},
    )

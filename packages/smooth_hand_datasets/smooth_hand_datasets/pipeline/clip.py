"""Clips of human hands together with the commands of robot hands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import Clip, clip_part
from smooth_operator.result_cache import key_digest
from smooth_operator.types import CommandTrajectory, Side


@dataclass(frozen=True, eq=False)
class RobotClip:
    """A clip of human hands with one command of each robot hand per frame.

    Attributes:
        clip: the human hands and the scene.
        commands: side -> commands, one for each frame.
        hand_names: side -> name of the robot hand.
        T_world_wrist: side -> (T, 7) pose of the robot hand's wrist in ``clip.world``; NaN where
            unknown.
        valid: side -> (T,) True where the command was computed from a hand that was seen.
        tracks: ``SIDE.NAME`` -> (T,) quality metrics of each frame from ``quality_tracks``; NaN
            where unknown.
        figures: name -> quality metric of the episode, from ``quality_figures``.
        config: the resolved configuration that made the commands, as JSON values.
        key: hexadecimal digest of all inputs, settings and code that determine the commands.

    Raises:
        RecordingError: the timestamps of the commands differ from those of the clip.
    """

    clip: Clip
    commands: Mapping[Side, CommandTrajectory]
    hand_names: Mapping[Side, str]
    T_world_wrist: Mapping[Side, Float[np.ndarray, "T 7"]]
    valid: Mapping[Side, Bool[np.ndarray, " T"]]
    tracks: Mapping[str, Float[np.ndarray, " T"]] = field(default_factory=dict)
    figures: Mapping[str, float] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    key: str = ""

    def __post_init__(self) -> None:
        for side, commands in self.commands.items():
            if not np.array_equal(commands.stamps, self.clip.stamps):
                raise RecordingError(
                    f"{self.clip.name}: the {side} hand has {len(commands)} commands whose "
                    f"timestamps differ from those of its {len(self.clip)} frames"
                )


def robot_part(whole: RobotClip, frames: slice) -> RobotClip:
    """Returns some frames of a clip with commands; the part has no quality metrics.

    The name and the key of the part contain the range of frames.
    """
    count = len(whole.clip)
    start, stop, _ = frames.indices(count)
    if (start, stop) == (0, count):
        return whole
    name = f"{whole.clip.name}_{start:06d}-{stop:06d}"
    part = clip_part(whole.clip, slice(start, stop))
    return replace(
        whole,
        clip=replace(part, name=name, meta={**part.meta, "part": [start, stop]}),
        commands={side: each[frames] for side, each in whole.commands.items()},
        T_world_wrist={side: wrist[frames] for side, wrist in whole.T_world_wrist.items()},
        valid={side: valid[frames] for side, valid in whole.valid.items()},
        tracks={track: values[frames] for track, values in whole.tracks.items()},
        figures={},
        key=key_digest([whole.key, start, stop]),
    )

"""A clip with what the robot hands do: what the writers of data sets take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError
from smooth_operator.lab.datasets.clip import Clip
from smooth_operator.types import CommandTrajectory, Side


@dataclass(frozen=True, eq=False)
class RobotClip:
    """A clip and its commands, frame by frame.

    Attributes:
        clip: the human hands and the scene.
        commands: side -> commands, one for each frame, in the order of the hand's joints.
        hand_names: side -> name of the robot hand.
        T_world_wrist: side -> (T, 7) pose of the robot hand's wrist in ``clip.world``; NaN where it
            is not known.
        valid: side -> (T,) whether the command answers a hand that was seen.
        tracks: figures of each frame, (T,) by name with the side before a dot, as
            ``quality_tracks`` computes them; NaN where one is not known.
        figures: quality of the episode by name, as ``quality_figures`` computes them.
        config: the resolved configuration that made the commands, as JSON has it.
        key: digest of everything that the result depends on, in hexadecimal.

    Raises:
        RecordingError: parts do not fit each other.
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
                    f"{self.clip.name}: the {side} hand has {len(commands)} commands that do not "
                    f"have the stamps of its {len(self.clip)} frames"
                )

"""The human hands as columns of a LeRobot data set; ``record.py`` stores them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lerobot_teleoperator_smooth_operator.commands import Command
from smooth_operator.episode_files.lerobot.human import human_layout
from smooth_operator.episode_files.lerobot.schema import dataset_features, typed


class HumanHands:
    """The columns of the human hands, and their values for the newest action.

    No value is NaN, which LeRobot's statistics refuse: a lost landmark or wrist keeps its last
    value, and is marked as not valid.

    Args:
        sides: sides of the hands.

    Attributes:
        features: LeRobot's features of the columns, by name.
        values: values for the newest action, by name.
    """

    def __init__(self, sides: Sequence[Any]) -> None:
        layout: dict[str, tuple[str, ...] | None] = {"stamp": None}
        for side in sides:
            layout |= human_layout(side, ("human_wrist",))
        self.features = {
            name: {**feature, "shape": tuple(feature["shape"])}
            for name, feature in dataset_features(layout).items()
            if name in layout
        }
        self.values = typed(
            {name: np.zeros(feature["shape"]) for name, feature in self.features.items()},
            layout,
        )
        for side in sides:
            self.values[f"{side}_human_wrist"][3] = 1.0

    def update(self, side: str, command: Command | None, now: float) -> None:
        """Takes the hand that a command was computed from.

        Args:
            command: the command that the action follows; None if it follows none.
            now: time of the action [s].
        """
        values = {name: each.copy() for name, each in self.values.items()}
        values["stamp"][:] = now
        landmarks = None if command is None else command.landmarks
        wrist = None if command is None else command.operator_wrist
        valid = np.zeros(21, bool) if landmarks is None else np.isfinite(landmarks).all(axis=1)
        values[f"{side}_landmarks_valid"] = valid
        if landmarks is not None:
            values[f"{side}_landmarks"].reshape(21, 3)[valid] = landmarks[valid]
        values[f"{side}_human_wrist_valid"][:] = wrist is not None
        if wrist is not None:
            values[f"{side}_human_wrist"][:] = wrist
        self.values = values

"""Stores the human hands in the data set that ``lerobot-record`` writes.

``lerobot-record`` makes the columns of its data set from the features of the robot alone
(``record`` in ``lerobot/scripts/lerobot_record.py``, LeRobot 0.6.1), and has no place for
further columns of a teleoperator. It is therefore given a ``LeRobotDataset`` that adds the columns
of ``smooth_operator.episode_files.lerobot.human`` when it is created, and their values to each
frame. Everything else, also their statistics, is LeRobot's own work.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from lerobot_teleoperator_smooth_operator.commands import Command
from smooth_operator.episode_files.lerobot.human import human_layout
from smooth_operator.episode_files.lerobot.schema import dataset_features, typed

_RECORDERS = ("lerobot.scripts.lerobot_record", "__main__")
"""Modules that ``lerobot-record`` can be: the program, or ``python -m`` of it."""


class HumanHands:
    """The columns of the human hands, and their values for the newest action.

    No value is NaN, which LeRobot's statistics refuse: a lost landmark or wrist keeps its last
    value, and is marked as not valid.

    Args:
        sides: sides of the hands.
    """

    def __init__(self, sides: Sequence[Any]) -> None:
        self._layout: dict[str, tuple[str, ...] | None] = {"stamp": None}
        for side in sides:
            self._layout |= human_layout(side, ("human_wrist",))
        self.features = {
            name: {**feature, "shape": tuple(feature["shape"])}
            for name, feature in dataset_features(self._layout).items()
            if name in self._layout
        }
        self.values = typed(
            {name: np.zeros(feature["shape"]) for name, feature in self.features.items()},
            self._layout,
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

    def keep(self) -> None:
        """Makes ``lerobot-record`` store the hands; ValueError in another program."""
        modules = [sys.modules.get(name) for name in _RECORDERS]
        recorders = [module for module in modules if hasattr(module, "LeRobotDataset")]
        if not recorders:
            raise ValueError(
                "human=true stores the human hands in the data set of lerobot-record, but this is "
                "another program; leave it out"
            )
        for module in recorders:
            former: Any = vars(module)["LeRobotDataset"]
            if not hasattr(former, "resume"):
                raise ValueError(
                    "human=true needs LeRobot 0.6 or newer; upgrade it, or leave it out"
                )
            vars(module)["LeRobotDataset"] = _storing(self, getattr(former, "without", former))


def _storing(hands: HumanHands, former: Any) -> Any:
    """A ``LeRobotDataset`` with the columns of the hands."""

    class WithHumanHands(former):
        without = former

        @classmethod
        def create(cls, *args: Any, features: dict[str, Any], **options: Any) -> Any:
            """Create a data set with further columns."""
            return super().create(*args, features={**features, **hands.features}, **options)

        @property
        def features(self) -> dict[str, Any]:
            """The features of the robot, which ``--resume`` compares with those of the robot."""
            every: dict[str, Any] = super().features
            return {name: each for name, each in every.items() if name not in hands.features}

        def add_frame(self, frame: dict[str, Any]) -> None:
            """Add a frame with the hands of its action."""
            super().add_frame({**frame, **hands.values})

    return WithHumanHands

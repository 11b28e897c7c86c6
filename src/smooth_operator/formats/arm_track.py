"""The commands of an arm that carried a robot hand, over an episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError


@dataclass(frozen=True, eq=False)
class ArmTrack:
    """Where an arm was sent, and where it was: one row for each command of the hand's fingers.

    Attributes:
        name: of the arm.
        joint_names: (n,) from the base.
        positions: (C, n) commanded [rad]; NaN where a command had none.
        measured: (C, n) measured when the command was sent [rad]; NaN where nothing was.
        poses: (C, 7) of the hand's wrist at the commanded positions, in the arm's base: x y z [m]
            and unit quaternion w x y z; NaN where a command had none.

    Raises:
        RecordingError: the arrays do not fit each other.
    """

    name: str
    joint_names: tuple[str, ...]
    positions: Float[np.ndarray, "C n"]
    measured: Float[np.ndarray, "C n"]
    poses: Float[np.ndarray, "C 7"]

    def __post_init__(self) -> None:
        count, joints = len(self.positions), len(self.joint_names)
        shapes = {"positions": (count, joints), "measured": (count, joints), "poses": (count, 7)}
        for name, shape in shapes.items():
            actual = np.shape(getattr(self, name))
            if actual != shape:
                raise RecordingError(f"{name} of the arm must have shape {shape}, not {actual}")

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, rows: slice | Bool[np.ndarray, " C"]) -> ArmTrack:
        """Those of some commands."""
        parts = self.positions[rows], self.measured[rows], self.poses[rows]
        return ArmTrack(self.name, self.joint_names, *parts)

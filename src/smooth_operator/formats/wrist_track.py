"""The commanded wrist of a robot hand over an episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError
from smooth_operator.types import unit_poses

BASE = "base"
"""Name of the frame of commands that name none: the robot's base."""


@dataclass(frozen=True, eq=False)
class WristTrack:
    """Where the wrist of a robot hand was sent, one row for each command of its fingers.

    Attributes:
        poses: (C, 7) x y z [m] and unit quaternion w x y z in ``world``; NaN where a command had
            none.
        engaged: (C,) whether the operator's wrist moved it.
        valid: (C,) whether the operator's wrist was known.
        world: name of the frame.

    Raises:
        RecordingError: the arrays do not fit each other.
    """

    poses: Float[np.ndarray, "C 7"]
    engaged: Bool[np.ndarray, " C"]
    valid: Bool[np.ndarray, " C"]
    world: str = BASE

    def __post_init__(self) -> None:
        count = len(self.poses)
        for name, shape in (("poses", (count, 7)), ("engaged", (count,)), ("valid", (count,))):
            actual = np.shape(getattr(self, name))
            if actual != shape:
                raise RecordingError(
                    f"{name} of the commanded wrist must have shape {shape}, not {actual}"
                )
        object.__setattr__(self, "poses", unit_poses(np.asarray(self.poses, np.float64)))

    def __len__(self) -> int:
        return len(self.poses)

    def __getitem__(self, rows: slice | Bool[np.ndarray, " C"]) -> WristTrack:
        """Those of some commands."""
        return WristTrack(self.poses[rows], self.engaged[rows], self.valid[rows], self.world)

"""The columns that ``lerobot-record`` writes for the robot ``smooth_hand``, from a log.

Data sets of both merge with LeRobot's own tool: keys, units, sizes and type of the robot are equal,
if the robot has its default settings, or with the wrist ``--robot.wrist=quaternion``, and with the
environment state ``--robot.environment_state=joints``.

=================================  ============  =================================================
``observation.state``              float32 (m,)  measured positions of the actuated joints [rad]
``observation.environment_state``  float32 (n,)  on request: measured positions of all joints [rad]
``action``                         float32 (m,)  their newest command [rad]; with the wrist
                                                 (m + 7,), ``tcp.x``, … ``tcp.qz`` [m; wxyz]
=================================  ============  =================================================

A row is a moment of LeRobot's clock, from the first command that is measured to the last one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from smooth_operator.episode_files.lerobot.columns import (
    POSE_KEYS,
    feature,
    index_columns,
    index_features,
)
from smooth_operator.errors import RecordingError
from smooth_operator.formats.episode import Episode
from smooth_operator.hands.registry import load_hand

ROBOT_TYPE: Final = "smooth_hand"
"""Name of the robot plug-in."""

FPS: Final = 30
"""Frames a second unless stated otherwise, as ``lerobot-record`` has it."""

ENVIRONMENT_STATE: Final = "observation.environment_state"

UNITS: Final = {
    "observation.state": "rad, measured joint positions",
    ENVIRONMENT_STATE: "rad, measured positions of all joints",
    "action": "rad, joint positions; m and quaternion wxyz, wrist",
}
"""Unit of each column that is not an index."""


@dataclass(frozen=True)
class RobotLayout:
    """The columns of a data set of one robot hand.

    Attributes:
        joints: names of the actuated joints.
        wrist: with the commanded wrist.
        environment: names of all joints, for ``observation.environment_state``; None without it.
    """

    joints: tuple[str, ...]
    wrist: bool
    environment: tuple[str, ...] | None

    @classmethod
    def of(cls, episode: Episode, wrist: bool, environment_state: bool) -> RobotLayout:
        """The columns of an episode.

        Args:
            environment_state: with the positions of all joints.

        Raises:
            RecordingError: it lacks something of that, or its hand is on an arm.
        """
        config = episode.config or {}
        lacks = next(
            (what for what, there in (
                ("commands", episode.commands is not None),
                ("measured joints; record it with a sink that measures, such as mujoco",
                 episode.states is not None),
                ("name of its robot hand", isinstance(config.get("hand"), str)),
                ("a commanded wrist; leave it out with --columns robot",
                 not wrist or episode.wrist is not None),
            ) if not there), None,
        )  # fmt: skip
        if lacks is not None:
            raise RecordingError(f"{episode.name}: the columns of a robot need {lacks}")
        if wrist and episode.arm is not None:
            raise RecordingError(
                f"{episode.name}: the measured wrist of a hand on an arm is not in a log; take "
                "--columns robot, or record with lerobot-record"
            )
        assert episode.commands is not None and episode.states is not None  # noqa: PT018
        side = config.get("side", "right") if episode.recording is None else episode.recording.side
        hand = load_hand(config["hand"], side)
        for names in (episode.commands.joint_names, episode.states.names):
            missing = [name for name in hand.joint_names if name not in names]
            if missing:
                raise RecordingError(
                    f"{episode.name}: it has no {', '.join(missing)} of the hand {hand.name}"
                )
        return cls(
            hand.actuated_names,
            wrist,
            hand.joint_names if environment_state else None,
        )

    def features(self) -> dict[str, dict[str, Any]]:
        """The ``features`` of ``meta/info.json``."""
        state = [f"{name}.pos" for name in self.joints]
        action = [*state, *(POSE_KEYS if self.wrist else ())]
        named = {"action": action, "observation.state": state}
        if self.environment is not None:
            named[ENVIRONMENT_STATE] = [f"environment.{name}.pos" for name in self.environment]
        features = {key: feature("float32", names) for key, names in named.items()}
        return features | index_features()

    def columns(
        self, episode: Episode, *, number: int, first: int, task: int, fps: int
    ) -> dict[str, np.ndarray]:
        """(T,) or (T, k) of each feature; arguments as of ``columns.episode_columns``.

        Raises:
            RecordingError: there is no moment with a command and a measurement.
        """
        commands, states = episode.commands, episode.states
        assert commands is not None and states is not None  # noqa: PT018
        picked = [commands.joint_names.index(name) for name in self.joints]
        action = np.asarray(commands.joint_positions, np.float64)[:, picked]
        if self.wrist:
            assert episode.wrist is not None
            action = np.concatenate([action, episode.wrist.poses], axis=1)
        valid = np.isfinite(action).all(axis=1)
        action, stamps = action[valid], np.asarray(commands.stamps, np.float64)[valid]
        measured = np.isfinite(states.positions).all(axis=1)
        if not len(stamps) or not measured.any():
            raise RecordingError(f"{episode.name}: no command of it, or no measurement, is whole")
        begin = max(float(stamps[0]), float(states.stamps[measured][0]))
        count = int(np.floor((float(stamps[-1]) - begin) * fps + 1e-6)) + 1
        if count < 1:
            raise RecordingError(f"{episode.name}: its commands end before it is measured")
        moments = begin + np.arange(count) / fps
        newest = np.searchsorted(stamps, moments + 1e-9, side="right") - 1
        rows = np.searchsorted(states.stamps[measured], moments + 1e-9, side="right") - 1
        positions = states.positions[measured][rows]

        def of(names: tuple[str, ...]) -> np.ndarray:
            return np.asarray(positions[:, [states.names.index(name) for name in names]])

        columns = {
            "action": action[newest],
            "observation.state": of(self.joints),
            **index_columns(count, number=number, first=first, task=task, fps=fps),
        }
        if self.environment is not None:
            columns[ENVIRONMENT_STATE] = of(self.environment)
        return {
            name: columns[name].astype(feature["dtype"])
            for name, feature in self.features().items()
        }

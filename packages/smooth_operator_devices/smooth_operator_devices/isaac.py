"""A node for the graphs of NVIDIA's Isaac Teleop: an OpenXR hand in, a robot hand's joints out.

Needs the extra ``isaac``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, MissingExtraError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.spec import HandSpec
from smooth_operator.landmarks import FROM_OPENXR_26, METACARPALS_OPENXR_26
from smooth_operator.poses import WORLD_AXES, is_valid, to_ours
from smooth_operator.retargeting.program_store import ProgramStore
from smooth_operator.retargeting.registry import DEFAULT_METHOD
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LimitsConfig, LoopConfig, SafetyConfig
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import HandFrame, Status, as_side

try:
    from isaacteleop.retargeting_engine import interface, tensor_types
except ImportError as error:
    raise MissingExtraError("the node for Isaac Teleop", "isaac") from error

_WRIST: Final = int(tensor_types.HandJointIndex.WRIST)
_WXYZ: Final = [0, 1, 2, 6, 3, 4, 5]
_XYZW: Final = [0, 1, 2, 4, 5, 6, 3]
"""Isaac Teleop has the real part of a quaternion last."""


class SmoothHandRetargeter(interface.BaseRetargeter):
    """A node that retargets the 26 OpenXR joints of one hand to a robot hand.

    When the hand is lost, or a joint that the method needs is not valid, the joints keep their
    last positions and ``hand_valid`` is 0. When the hand comes back, the joints move to it within
    the limits, without a jump. Before the first frame they are in the neutral pose.

    From a step's context the node uses the real time (stamp of the frame, limits), ``reset`` (the
    method forgets; the joints go on from their positions) and the execution state: while it is
    ``paused`` or ``stopped`` the joints hold.

    Inputs:
        ``hand_right`` or ``hand_left``: ``HandInput``, optional.

    Outputs:
        ``hand_joints``: a float [rad] for each of ``joint_names``.
        ``hand_valid``: 1 if the joints answer this step's frame, else 0.
        ``wrist_pose``: (7,) float32 x y z [m], quaternion x y z w, of the wrist frame in the z-up
            world (``docs/reference/conventions.md``); the last valid one, absent before it.
        ``wrist_valid``: 1 if the pose is of this step, else 0.

    Args:
        hand: name of the robot hand, the path of a spec file, a description or a loaded hand.
        side: ``right`` or ``left``; None for the side of the hand, ``right`` for a name.
        name: name of the node; None for ``smooth_hand_right`` or ``smooth_hand_left``.
        method: retargeting method.
        preset: preset of the method; None for its default.
        joints: ``all``, or only the ``actuated`` ones, without coupled joints.
        world: axes of the input: ``openxr`` (y up) as ``HandsSource`` has it; ``z_up`` after a
            ``HandTransform`` into a z-up base.
        limits: limits of the joints; None for the defaults.
        safety: behaviour on loss; None for the defaults, which hold the last command.
        compile: True to compile now, False at the first frame or with ``warm_up``.

    Attributes:
        retargeter: method and hand.
        joint_names: names of the outputs, in order.

    Raises:
        UnknownNameError: there is no such hand, method or preset.
        ConfigError: a setting has an unknown value.
    """

    def __init__(
        self,
        hand: str | Path | HandSpec | Hand = "mimic_p050",
        side: str | None = None,
        *,
        name: str | None = None,
        method: str = DEFAULT_METHOD,
        preset: str | None = None,
        joints: Literal["all", "actuated"] = "all",
        world: str = "openxr",
        limits: LimitsConfig | None = None,
        safety: SafetyConfig | None = None,
        compile: bool = True,
    ) -> None:
        if joints not in ("all", "actuated"):
            raise ConfigError(f"joints must be all or actuated, not {joints!r}")
        if world not in ("openxr", "z_up"):
            raise ConfigError(f"world must be openxr or z_up, not {world!r}")
        self.retargeter = Retargeter(
            hand, side=side, method=method, preset=preset, cache=ProgramStore.of_user()
        )
        robot = self.retargeter.hand
        self._side = as_side(robot.spec.side)
        self._input = f"hand_{self._side}"
        self._chosen = list(range(len(robot.joint_names)) if joints == "all" else robot.actuated)
        self.joint_names = tuple(robot.joint_names[i] for i in self._chosen)
        self._world = WORLD_AXES[world]
        self._config = LoopConfig(
            safety=safety or SafetyConfig(on_loss="hold"), limits=limits or LimitsConfig()
        )
        self._now = 0.0
        self._pipeline = HandPipeline(self.retargeter, self._config, clock=lambda: self._now)
        self._pose: Float[np.ndarray, "7"] | None = None
        if compile:
            self.warm_up()
        super().__init__(f"smooth_hand_{self._side}" if name is None else name)

    def warm_up(self) -> float:
        """Compile, without a change of the node's state; returns the time [s]."""
        return self.retargeter.warm_up()

    def input_spec(self) -> dict[str, Any]:
        """The hand, which may be absent."""
        return {self._input: interface.OptionalType(tensor_types.HandInput())}

    def output_spec(self) -> dict[str, Any]:
        """Joints and wrist, each with a flag."""
        group = interface.TensorGroupType
        number = tensor_types.FloatType
        pose = tensor_types.NDArrayType(
            "pose", shape=(7,), dtype=tensor_types.DLDataType.FLOAT, dtype_bits=32
        )
        joints = [number(name) for name in self.joint_names]
        return {
            "hand_joints": group(f"hand_joints_{self._side}", joints),
            "hand_valid": group(f"hand_valid_{self._side}", [number("valid")]),
            "wrist_pose": interface.OptionalType(group(f"wrist_pose_{self._side}", [pose])),
            "wrist_valid": group(f"wrist_valid_{self._side}", [number("valid")]),
        }

    def _compute_fn(self, inputs: Any, outputs: Any, context: Any) -> None:
        self._now = context.graph_time.real_time_ns * 1e-9
        self._obey(context.execution_events)
        value = inputs[self._input]
        arrival, wrist = None, None
        if not value.is_none:
            frame, wrist = self._read(value)
            arrival = Arrival(frame, self._now)
        tick = self._pipeline.step(self._now, arrival)
        for place, joint in enumerate(self._chosen):
            outputs["hand_joints"][place] = float(tick.command.joint_positions[joint])
        outputs["hand_valid"][0] = float(tick.status is Status.OK)
        if wrist is not None:
            self._pose = wrist
        if self._pose is not None:
            outputs["wrist_pose"][0] = self._pose[_XYZW].astype(np.float32)
        outputs["wrist_valid"][0] = float(wrist is not None)

    def _obey(self, events: Any) -> None:
        supervisor = self._pipeline.supervisor
        held = events.execution_state in (
            interface.ExecutionState.PAUSED,
            interface.ExecutionState.STOPPED,
        )
        if held and not supervisor.paused:
            supervisor.pause()
        elif supervisor.paused and not held:
            supervisor.resume()
        if events.reset:
            self._pipeline.switch(self.retargeter)

    def _read(self, value: Any) -> tuple[HandFrame, Float[np.ndarray, "7"] | None]:
        """A frame, and the wrist in the z-up world if it is valid."""
        index = tensor_types.HandInputIndex
        points = np.from_dlpack(value[index.JOINT_POSITIONS]).astype(np.float64)
        valid = np.from_dlpack(value[index.JOINT_VALID]).astype(bool)
        turns = np.from_dlpack(value[index.JOINT_ORIENTATIONS]).astype(np.float64)
        rows, bases = list(FROM_OPENXR_26), list(METACARPALS_OPENXR_26)
        metacarpals = np.where(valid[bases, None], points[bases], np.nan)
        frame = HandFrame(
            points[rows], self._now, self._side, valid=valid[rows], metacarpals=metacarpals
        )
        pose = to_ours(np.concatenate([points[_WRIST], turns[_WRIST]])[_WXYZ], self._world)
        return frame, pose if valid[_WRIST] and is_valid(pose) else None

"""The joint-angle method: human joint angles to robot joints, by sign, gain and offset.

The oldest way of retargeting, and the fastest: no search, no memory, so no lag and no wrong basin,
but nothing that holds the fingertips where the human's are. Commands are clipped to the limits, and
joints that others follow answer for all that they move.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from smooth_operator.baselines.joint_angles import joint_angles
from smooth_operator.baselines.joint_map import format_map, joint_map, map_matrix
from smooth_operator.geometry import AnyKind, array_namespace
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.spec import JointMap
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.human.anatomical_axes import PalmAxes
from smooth_operator.human.palm_axes import human_palm_axes
from smooth_operator.landmarks import BASES
from smooth_operator.methods.method import Method, MethodConfig, MethodOutput
from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.loss import Objective, ObjectiveConfig
from smooth_operator.objective.targets import PlainTargets


class JointAngleMap:
    """A hand's map from aligned landmarks to joint positions; a method, or a start for one.

    Attributes:
        hand: the robot hand.
        rows: the map, a row for each actuated joint; ``str()`` of this object prints it.
        axes: the human palm in the palm frame.
        needs: the human landmarks that the map uses.

    Args:
        hand: the robot hand.

    Raises:
        HandModelError: if a finger lacks landmarks, and its joints have no rows in the hand's
            description.
        UnknownNameError: if such a row names a joint or an angle that is not there.
    """

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        self.rows: tuple[JointMap, ...] = joint_map(hand)
        self.axes: PalmAxes[np.ndarray] = human_palm_axes(hand)
        self._gains, self._offsets = map_matrix(self.rows)
        used = np.abs(self._gains).reshape(len(self.rows), len(BASES), 4).sum(axis=(0, 2)) > 0
        self.needs: tuple[int, ...] = tuple(
            base + i for base, use in zip(BASES, used, strict=True) if use for i in range(4)
        )

    def positions(self, aligned: Float[AnyKind, "*batch 21 3"]) -> Float[AnyKind, "*batch m"]:
        """Joint positions for a hand, or many.

        Args:
            aligned: (..., 21, 3) landmarks in the palm frame [m]; those in ``needs`` are
                finite. JAX (traceable), or NumPy (on the host, in its own precision).

        Returns:
            (..., m) positions of the actuated joints [rad], within their limits.
        """
        xp = array_namespace(aligned)
        angles = joint_angles(aligned, self.axes)
        # What is not needed may be NaN, and zero times NaN is not zero.
        angles = xp.where(xp.isfinite(angles), angles, 0)
        gains, offsets, low, high = (
            xp.asarray(a, angles.dtype) for a in (self._gains.T, self._offsets, *self.hand.limits.T)
        )
        q: AnyKind = xp.clip(angles @ gains + offsets, low, high)
        return q

    def __str__(self) -> str:
        return format_map(self.rows)


@dataclass(frozen=True)
class JointAngleConfig(MethodConfig):
    """Settings of the joint-angle method; the map itself is the hand's.

    Attributes:
        alignment: how human landmarks reach the palm frame. Angles don't depend on the scale; the
            tracking loss does.
    """

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)

    def build(self, hand: Hand) -> JointAngle:
        """The method for one hand.

        Raises:
            HandModelError: if the hand has no map and none can be derived.
            UnknownNameError: if its map names a joint or an angle that is not there.
        """
        method = JointAngle(hand, self)
        _ = method.map  # whatever the hand lacks is said now
        return method


class JointAngleState(NamedTuple):
    """What is remembered between frames: nothing that the next command depends on.

    Attributes:
        q: (m,) last command of the actuated joints [rad].
    """

    q: Float[Array, " m"]


@dataclass(frozen=True, eq=False)
class JointAngle(Method):
    """The joint-angle method for one hand."""

    hand: Hand
    config: JointAngleConfig

    @cached_property
    def map(self) -> JointAngleMap:
        """Human joint angles to joint positions."""
        return JointAngleMap(self.hand)

    @cached_property
    def objective(self) -> Objective:
        """Only to say how far the keyvectors are off: they are not minimised."""
        return Objective(self.hand, ObjectiveConfig(targets=PlainTargets()))

    @cached_property
    def needs(self) -> tuple[int, ...]:
        """All landmarks of the mapped fingers, and the wrist, from which keyvectors count."""
        return tuple(sorted({*self.map.needs, *self.objective.layout.landmarks}))

    def init(self, seed: int) -> JointAngleState:
        """Neutral pose; nothing here is random."""
        return JointAngleState(jnp.asarray(self.hand.neutral, jnp.float32))

    def step(
        self, state: JointAngleState, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[JointAngleState, MethodOutput]:
        """One frame."""
        del ticks
        q = self.map.positions(aligned)
        layout = self.objective.layout
        policy = self.objective.config.targets
        targets, _ = policy(policy.init(layout), layout, layout.human(aligned))
        goal = FrameGoal(targets.vectors, targets.weights, state.q, 0.0)
        return JointAngleState(q), MethodOutput(q, self.objective.tracking(list(q), goal))


JOINT_ANGLE_PRESETS: Final = {"default": JointAngleConfig()}

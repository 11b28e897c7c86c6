"""Eq. (1): tracking of keyvectors, pull to the neutral pose, penalty on velocity."""

from __future__ import annotations

import functools
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple, cast

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.kinematics import Keypoint
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.objective.keyvectors import VectorLayout
from smooth_operator.objective.targets import DexPilotTargets, TargetPolicy


@dataclass(frozen=True)
class ObjectiveConfig:
    """Weights of Eq. (1).

    Attributes:
        targets: the target policy.
        loss: ``smooth_l1`` per component, as in the authors' released code and in the figures of
            the paper, or ``squared``, as Eq. (1) is printed.
        transition: where smooth-L1 turns from quadratic to linear [m].
        pose_weight: lambda_reg (gamma of the paper's table), pull to the neutral pose.
        velocity_weight: lambda_vel (w_v of the table), penalty on the change of the command.
    """

    targets: TargetPolicy = field(default_factory=DexPilotTargets)
    loss: Literal["smooth_l1", "squared"] = "smooth_l1"
    transition: float = 0.02
    pose_weight: float = 0.05
    velocity_weight: float = 0.1

    def __post_init__(self) -> None:
        if self.loss not in ("smooth_l1", "squared"):
            raise ConfigError(f"loss must be 'smooth_l1' or 'squared', not {self.loss!r}")
        if self.transition <= 0:
            raise ConfigError(f"transition must be positive [m], not {self.transition}")
        if self.pose_weight < 0 or self.velocity_weight < 0:
            raise ConfigError(
                f"weights must not be negative, not pose_weight={self.pose_weight}, "
                f"velocity_weight={self.velocity_weight}"
            )


class FrameGoal(NamedTuple):
    """What one frame asks of the robot.

    Attributes:
        vectors: (K, 3) keyvector targets [m].
        weights: (K,) their weights.
        previous: (m,) last command of the actuated joints [rad].
        velocity_weight: lambda_vel of the frame; 0 where there is no last command to be near to.
    """

    vectors: Float[Array, "K 3"]
    weights: Float[Array, " K"]
    previous: Float[Array, " m"]
    velocity_weight: Float[Array, ""] | float


@dataclass(frozen=True, eq=False)
class Objective:
    """Eq. (1) for one hand, over arrays whose last axis is the batch of candidates."""

    hand: Hand
    config: ObjectiveConfig

    @cached_property
    def layout(self) -> VectorLayout:
        """The vectors that the target policy speaks of; the hand's keyvectors, as a rule.

        Raises:
            ConfigError: if the hand lacks a point that one of them needs.
        """
        layout = self.config.targets.layout(self.hand.fingers)
        lacking = [LANDMARKS[i] for i in layout.landmarks if LANDMARKS[i] not in self.points]
        if lacking:
            raise ConfigError(
                f"{type(self.config.targets).__name__} needs counterparts of {lacking} on the "
                f"robot, and hand {self.hand.name!r} has only {sorted(self.points)}: add the "
                "points to its description, or choose another method"
            )
        return layout

    @property
    def points(self) -> Mapping[str, Keypoint]:
        """The robot's counterparts of human landmarks, by name."""
        return self.hand.tree.keypoints

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """Those of the layout's landmarks whose counterparts a joint moves; others are fixed."""
        return tuple(i for i in self.layout.landmarks if self.points[LANDMARKS[i]].joint >= 0)

    def tracking(self, q: Sequence[Array], goal: FrameGoal, *, within_limits: bool = True) -> Array:
        """First term of Eq. (1): sum over k of lambda_k l(v_R - v_H).

        Args:
            q: m arrays of a common shape, actuated joint positions [rad].
            goal: targets of the frame.
            within_limits: promise that q respects the limits, for speed.
        """
        walked = self.hand.tree.walk(
            self.hand.expand_rows(q),
            [LANDMARKS[i] for i in self.moving],
            within_limits=within_limits,
        )
        at: dict[int | None, Sequence[Array | float]] = {None: (0.0, 0.0, 0.0)}
        for i in self.layout.landmarks:
            at[i] = tuple(map(float, self.points[LANDMARKS[i]].position))
        at |= {m: cast(Sequence[Array], p) for m, p in zip(self.moving, walked, strict=True)}
        total: Array = jnp.zeros((), q[0].dtype)
        for k, (start, end) in enumerate(self.layout.vectors):
            error = [jnp.asarray(at[end][c] - at[start][c]) - goal.vectors[k, c] for c in range(3)]
            terms = [self.penalty(e) for e in error]
            total = total + goal.weights[k] * (terms[0] + terms[1] + terms[2])
        return total

    def __call__(self, q: Sequence[Array], goal: FrameGoal, *, within_limits: bool = True) -> Array:
        """Eq. (1).

        Args:
            q: m arrays of a common shape, actuated joint positions [rad].
            goal: targets of the frame.
            within_limits: promise that q respects the limits, for speed.

        Returns:
            cost, of that shape.
        """
        total = self.tracking(q, goal, within_limits=within_limits)
        # Two quadratics about two centres are one about their mean, and a constant.
        reg, vel = self.config.pose_weight, goal.velocity_weight
        weight = reg + vel
        neutral = jnp.asarray(self.hand.neutral, q[0].dtype)
        share = vel / jnp.maximum(weight, 1e-12)
        centre = neutral + share * (goal.previous - neutral)
        constant = reg * share * ((neutral - goal.previous) ** 2).sum()
        pull = [(row - centre[i]) ** 2 for i, row in enumerate(q)]
        return total + (weight * functools.reduce(operator.add, pull) + constant)

    def penalty(self, error: Array) -> Array:
        """l of Eq. (1), per component [m] -> cost."""
        if self.config.loss == "squared":
            return error * error
        size = jnp.abs(error)
        near = jnp.minimum(size, self.config.transition)
        return near * (size - 0.5 * near) * (1 / self.config.transition)

    def slopes(self, error: Array) -> tuple[Array, Array]:
        """First and second derivative of the penalty."""
        if self.config.loss == "squared":
            return 2 * error, jnp.full_like(error, 2.0)
        slope = jnp.clip(error / self.config.transition, -1, 1)
        return slope, (jnp.abs(slope) < 1) / self.config.transition

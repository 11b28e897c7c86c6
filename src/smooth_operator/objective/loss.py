"""Eq. (1): tracking of keyvectors, pull to the neutral pose, penalty on velocity."""

from __future__ import annotations

import functools
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, cast, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.geometry import AnyKind
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.kinematics import Keypoint
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.objective.keyvectors import VectorLayout
from smooth_operator.objective.penalties import (
    Loss,
    PenaltySlopes,
    smooth_l1,
    smooth_l1_slopes,
    vector_price,
    vector_slopes,
)
from smooth_operator.objective.targets import DexPilotTargets, TargetPolicy


@dataclass(frozen=True)
class ObjectiveConfig:
    """Weights of Eq. (1).

    Attributes:
        targets: the target policy.
        loss: ``smooth_l1`` per component, as in the authors' released code and in the figures of
            the paper; ``squared``, as Eq. (1) is printed; or ``smooth_l1_norm``, smooth-L1 of the
            weight times the length of the error, as in "Analyzing Key Objectives" (AKO).
        transition: where smooth-L1 turns from quadratic to linear [m].
        pose_weight: lambda_reg (gamma of the paper's table), pull to a pose.
        pose_centre: that pose: the hand's ``neutral`` pose, or ``zero`` angles.
        velocity_weight: lambda_vel (w_v of the table), penalty on the change of the command.
        velocity_loss: ``squared``, the weight times the squared change, as in Eq. (1); or
            ``smooth_l1``, smooth-L1 of the weight times the change of each joint, as in AKO, with
            the same ``transition`` [rad].
    """

    targets: TargetPolicy[Any, Any] = field(default_factory=DexPilotTargets)
    loss: Loss = "smooth_l1"
    transition: float = 0.02
    pose_weight: float = 0.05
    pose_centre: Literal["neutral", "zero"] = "neutral"
    velocity_weight: float = 0.1
    velocity_loss: Literal["squared", "smooth_l1"] = "squared"

    def __post_init__(self) -> None:
        if self.loss not in get_args(Loss):
            raise ConfigError(
                f"loss must be 'smooth_l1', 'squared' or 'smooth_l1_norm', not {self.loss!r}"
            )
        if self.pose_centre not in ("neutral", "zero"):
            raise ConfigError(f"pose_centre must be 'neutral' or 'zero', not {self.pose_centre!r}")
        if self.velocity_loss not in ("squared", "smooth_l1"):
            raise ConfigError(
                f"velocity_loss must be 'squared' or 'smooth_l1', not {self.velocity_loss!r}"
            )
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
        layout: VectorLayout = self.config.targets.layout(self.hand.fingers)
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
            total = total + self.price(error, goal.weights[k])
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
        reg, vel = self.config.pose_weight, goal.velocity_weight
        neutral = jnp.asarray(self.pose_centre, q[0].dtype)
        if self.config.velocity_loss == "smooth_l1":
            for i, row in enumerate(q):
                change = smooth_l1(vel * (row - goal.previous[i]), self.config.transition)
                total = total + reg * (row - neutral[i]) ** 2 + change
            return total
        # Two quadratics about two centres are one about their mean, and a constant.
        weight = reg + vel
        share = vel / jnp.maximum(weight, 1e-12)
        centre = neutral + share * (goal.previous - neutral)
        constant = reg * share * ((neutral - goal.previous) ** 2).sum()
        pull = [(row - centre[i]) ** 2 for i, row in enumerate(q)]
        return total + (weight * functools.reduce(operator.add, pull) + constant)

    @property
    def pose_centre(self) -> Float[np.ndarray, " m"]:
        """The pose that the second term of Eq. (1) pulls to [rad]."""
        neutral: np.ndarray = self.hand.neutral
        return neutral if self.config.pose_centre == "neutral" else np.zeros_like(neutral)

    def regularisation(
        self, q: AnyKind, previous: AnyKind, velocity_weight: AnyKind | float
    ) -> AnyKind:
        """Last two terms of Eq. (1); NumPy or JAX.

        Args:
            q: (..., m) actuated joint positions [rad].
            previous: (..., m) the commands before [rad].
            velocity_weight: lambda_vel.

        Returns:
            (...) cost.
        """
        centre = self.pose_centre.astype(q.dtype)
        pose = self.config.pose_weight * ((q - centre) ** 2).sum(axis=-1)
        change = q - previous
        if self.config.velocity_loss == "squared":
            velocity = velocity_weight * (change**2).sum(axis=-1)
        else:
            velocity = smooth_l1(velocity_weight * change, self.config.transition).sum(axis=-1)
        total: AnyKind = pose + velocity
        return total

    def regularisation_slopes(
        self,
        q: Float[Array, " m"],
        previous: Float[Array, " m"],
        velocity_weight: Array | float,
    ) -> tuple[Float[Array, " m"], Float[Array, " m"] | float]:
        """First derivative of ``regularisation``, and the diagonal of its second derivative,
        whose other elements are zero."""
        reg = self.config.pose_weight
        pull = 2 * reg * (q - jnp.asarray(self.pose_centre, q.dtype))
        if self.config.velocity_loss == "squared":
            return pull + 2 * velocity_weight * (q - previous), 2 * (reg + velocity_weight)
        slope, bend = smooth_l1_slopes(velocity_weight * (q - previous), self.config.transition)
        return pull + velocity_weight * slope, 2 * reg + velocity_weight**2 * bend

    def price(self, error: Sequence[Array], weight: Array) -> Array:
        """lambda_k l(v_R - v_H) of Eq. (1): the cost of one vector's error.

        Args:
            error: its three components [m], arrays of a common shape.
            weight: lambda_k, of a shape that fits.
        """
        return vector_price(error, weight, self.config.loss, self.config.transition)

    def slopes(self, errors: Float[Array, "K 3"], weights: Float[Array, " K"]) -> PenaltySlopes:
        """Derivatives of ``price`` for the errors of all K vectors [m]."""
        return vector_slopes(errors, weights, self.config.loss, self.config.transition)

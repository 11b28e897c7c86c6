"""Cost terms of ``smooth``: motion and position of fingertips, direction and length, spread,
self-collision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.geometry import AnyArray, lengths
from smooth_operator.hands.capsules import CapsulePairs, capsule_pairs, segments_apart
from smooth_operator.hands.differential import PointKinematics, contracted
from smooth_operator.hands.finger_circles import spread_joints
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import LANDMARKS, TIPS
from smooth_operator.retargeting.objective import (
    TRANSITION,
    Derivatives,
    FrameGoal,
    JointTerm,
    PointTerm,
    Quadratic,
    VectorTerm,
)
from smooth_operator.settings import check_numbers, is_off

BELOW_THUMB_TIP: Final = LANDMARKS[TIPS[0] - 1]
"""Landmark at the other end of the thumb's last segment."""
_SHORT: Final = 0.002
"""Smoothing length of vectors, because a vector of length 0 has no direction [m]."""
_LEAST: Final = 0.25
"""Fraction of the curvature that is kept if a vector points away, where it is negative."""


@dataclass(frozen=True)
class FingertipPositionConfig:
    """Settings of the fingertip position cost.

    Attributes:
        weight: weight of a small error, in the units of a keyvector's weight: the cost is
            weight x e^2 / (2 x 20 mm) / (1 + e^2 / width^2) for an error e (Geman-McClure); 0
            leaves the term out.
        width: error beyond which the force decreases [m].
    """

    weight: float = 40.0
    width: float = 0.004

    def __post_init__(self) -> None:
        check_numbers(self, "fingertip_position.", positive=("width",))


@dataclass(frozen=True, eq=False)
class FingertipTracking(VectorTerm):
    """Cost term that makes fingertips follow the human's, on the vectors v from the wrist.

    - Motion: sum of mu_i / (2 beta) |v_i - r_i|^2 with the goal's ``motion_weights`` mu and
      ``reach`` r makes fingertips copy the human's motion, whatever their position error.
    - Position: small position errors are removed completely. This cost is bounded: a fingertip that
      is far from the human's because of different bones is not pulled.

    Attributes:
        config: settings of the cost of position.
    """

    part = "wrist"

    config: FingertipPositionConfig

    def slopes(self, errors: Float[Array, "F 3"], goal: FrameGoal) -> Derivatives:
        """Returns costs and derivatives, as ``VectorTerm.slopes`` does."""
        squared = (errors * errors).sum(-1)
        share = 1 / (1 + squared / self.config.width**2)
        stiffness = self.config.weight / TRANSITION
        behind = errors + goal.vectors[self.which] - jnp.asarray(goal.reach)
        position, motion = stiffness * share**2, jnp.asarray(goal.motion_weights) / TRANSITION
        return Derivatives(
            0.5 * (stiffness * squared * share + motion * (behind * behind).sum(-1)).sum(),
            position[:, None] * errors + motion[:, None] * behind,
            jnp.repeat(position + motion, 3).reshape(errors.shape),
        )


def _turned(
    vectors: Float[Array, "*n 3"], aim: Float[Array, "*n 3"], weight: Array | float
) -> tuple[Array, Array, Array, Array, Array]:
    """Weight times one minus the cosine between vectors and unit vectors. Returns the lengths of
    the vectors, rounded near 0 [m], the vectors over those, the cost, its first derivative, and its
    second across the vector; along it there is none."""
    size = lengths(vectors, _SHORT**2)
    unit = vectors / size[..., None]
    cosine = (aim * unit).sum(-1)
    slope = -(weight / size)[..., None] * (aim - cosine[..., None] * unit)
    curvature = weight * jnp.maximum(cosine, _LEAST) / size**2
    return size, unit, weight * (1 - cosine), slope, curvature


@dataclass(frozen=True, eq=False)
class PadDirection(PointTerm):
    """Cost term that points the thumb's last segment, and so its pad, like the human's: weight
    times one minus the cosine. The pad's direction decides whether a held object rolls.

    Attributes:
        hand: the robot hand.
        weight: weight of one minus the cosine.
    """

    hand: Hand
    weight: float

    @property
    def is_off(self) -> bool:
        """True if the weight is 0, or if the hand has no landmark below the thumb's tip."""
        return is_off(self.weight) or BELOW_THUMB_TIP not in self.hand.tree.names

    def points(self) -> tuple[str, ...]:
        """Names of the thumb's tip and of the joint below it."""
        return self.hand.tip_names[self.hand.fingers.index("thumb")], BELOW_THUMB_TIP

    def expand(
        self, points: Float[Array, "2 3"], jacobian: Float[Array, "2 J 3"], goal: FrameGoal
    ) -> Quadratic:
        """Returns cost and derivatives, which are 0 where the human's segment is unknown."""
        pad = jnp.full(3, jnp.nan) if goal.pad is None else goal.pad
        known = jnp.isfinite(pad).all()
        weight, aim = jnp.where(known, self.weight, 0.0), jnp.where(known, pad, 0.0)
        _, unit, cost, slope, curvature = _turned(points[0] - points[1], aim, weight)
        moves = jacobian[0] - jacobian[1]
        across = moves - (moves @ unit)[:, None] * unit
        return Quadratic(cost, jnp.stack([slope, -slope]), across.T, jnp.full(3, curvature))


SPREAD: Final = 0.2
"""Angle to either side of neutral to which a finger may spread at no cost [rad]."""


@dataclass(frozen=True, eq=False)
class FingerSpread(JointTerm):
    """Cost term on long fingers that spread far: weight times squared excess over ``SPREAD``.

    The tip of a bent finger hardly moves with the joint that spreads it, so a joint with a wide
    range, as LEAP's of 1.05 rad, would drift to its limit, and an opening finger would jump.

    Attributes:
        hand: the robot hand.
        weight: cost per squared radian beyond ``SPREAD``.
    """

    hand: Hand
    weight: float

    @property
    def is_off(self) -> bool:
        """True if the weight is 0, or if no finger can spread that far."""
        return is_off(self.weight) or not self._weights.any()

    @cached_property
    def _weights(self) -> Float[np.ndarray, " m"]:
        beyond = np.abs(self.hand.limits - self.hand.neutral[:, None]).max(axis=1) > SPREAD
        weights: np.ndarray = np.where(spread_joints(self.hand) & beyond, self.weight, 0.0)
        return weights.astype(np.float32)

    def expand(self, q: Float[AnyArray, "*n m"], goal: FrameGoal) -> Derivatives:
        """Returns cost and derivatives, as ``JointTerm.expand`` does."""
        off, weights = q - self.hand.neutral.astype(np.float32), self._weights
        excess = off - off.clip(-SPREAD, SPREAD)
        return Derivatives(
            (weights * excess**2).sum(axis=-1), 2 * weights * excess, 2 * weights * (excess != 0)
        )


@dataclass(frozen=True)
class DirectionLengthConfig:
    """Settings of the direction and length cost. The length cost is linear beyond ``huber_width``,
    so that the force that closes a pinch is bounded.

    Attributes:
        direction: cost of one minus the cosine between a vector and the human's; 0 disables it.
        length: cost per metre of the length error of a short vector; 0 leaves it out.
        huber_width: length error below which that cost is quadratic [m].
        near: length of the human's vector at which that cost is halved; it falls with the fourth
            power [m].
    """

    direction: float = 1.9
    length: float = 160.0
    huber_width: float = 0.0012
    near: float = 0.0145

    def __post_init__(self) -> None:
        check_numbers(self, "direction_length.", positive=("huber_width", "near"))


@dataclass(frozen=True, eq=False)
class DirectionLength(VectorTerm):
    """Cost term on direction (1 - cosine) and length errors of the vectors from the thumb's tip.

    Where touching parts keep a short vector from its target, only a cost of direction keeps it
    close to the human's.

    Attributes:
        config: settings.
    """

    part = "thumb"

    config: DirectionLengthConfig

    def slopes(self, errors: Float[Array, "P 3"], goal: FrameGoal) -> Derivatives:
        """Returns costs and derivatives, as ``VectorTerm.slopes`` does."""
        config, targets = self.config, jnp.asarray(goal.vectors)[self.which]
        # error + target, not the vectors themselves: a compiler shares the error with the keyvector
        # term, and the rounding decides when Newton steps stop
        vectors = errors + targets
        goal_length = lengths(targets, 1e-12)
        size, unit, cost, turn, curvature = _turned(
            vectors, targets / goal_length[:, None], config.direction
        )
        along = unit[:, :, None] * unit[:, None, :]
        across = jnp.eye(3, dtype=unit.dtype) - along
        slope = config.length / (1 + (goal_length / config.near) ** 4)
        longer = size - goal_length
        rounded = jnp.sqrt(longer * longer + config.huber_width**2)
        # the second derivative of the parabola that touches the cost on both sides: not too little
        length_weight = slope / rounded
        return Derivatives(
            (cost + slope * (rounded - config.huber_width)).sum(),
            turn + (length_weight * longer)[:, None] * unit,
            curvature[:, None, None] * across + length_weight[:, None, None] * along,
        )


@dataclass(frozen=True)
class SelfCollisionConfig:
    """Settings of the self-collision cost.

    Attributes:
        weight: weight of a pair that is too close, in the units of a keyvector's weight: the cost
            is weight x d^2 / (2 x 20 mm) for a depth d; 0 disables the term.
        margin: distance below which a pair counts [m]. If negative, soft parts overlap.
    """

    weight: float = 12000.0
    margin: float = -0.00125

    def __post_init__(self) -> None:
        check_numbers(self, "self_collision.", finite=("margin",))


@dataclass(frozen=True, eq=False)
class SelfCollision(PointTerm):
    """Cost term on self-collision: squared depth of capsule pairs within a safety margin."""

    hand: Hand
    config: SelfCollisionConfig

    @cached_property
    def pairs(self) -> CapsulePairs:
        """The P pairs of capsules that could touch."""
        return capsule_pairs(self.hand)

    @cached_property
    def carried(self) -> Float[np.ndarray, "P J"]:
        """Joints that move only the first capsule of each pair (1) or only the second one (-1)."""
        moves = PointKinematics(self.pairs.tree, self.pairs.names[::2]).moves.astype(np.float32)
        first, second = self.pairs.pairs.T
        return np.asarray(moves[first] - moves[second])

    @property
    def is_off(self) -> bool:
        """True if the weight is 0, or if no parts can touch."""
        return is_off(self.config.weight) or len(self.pairs.pairs) == 0

    def points(self) -> tuple[str, ...]:
        """Names of the two ends of each capsule."""
        return self.pairs.names

    def own_points(self) -> Mapping[str, tuple[int, np.ndarray]]:
        """Positions of the capsules' ends, as ``PointTerm.own_points`` returns them."""
        return self.pairs.ends

    def expand(
        self, points: Float[Array, "E 3"], jacobian: Float[Array, "E J 3"], goal: FrameGoal
    ) -> Quadratic:
        """Returns cost and derivatives. Nearest points are held fixed on their segments, so only
        the first derivative is exact."""
        pairs, config = self.pairs, self.config
        ends = points.reshape(-1, 2, 3)[pairs.pairs]
        one, other = ((ends[:, side, 0], ends[:, side, 1]) for side in (0, 1))
        apart, s, t = segments_apart(one, other)
        distance = lengths(apart, 1e-12)
        depth = jnp.asarray(pairs.reach + 0.0, points.dtype) + config.margin - distance
        inside = jnp.maximum(depth, 0.0)
        scale = config.weight / TRANSITION
        direction = -apart / distance[:, None]
        force, s, t = (scale * inside)[:, None] * direction, s[:, None], t[:, None]
        ends_of = [(1 - s) * force, s * force], [(t - 1) * force, -t * force]
        forces = jnp.concatenate([jnp.concatenate(both, axis=1) for both in ends_of])  # (2 P, 6)
        capsules = np.arange(len(points) // 2)[:, None] == pairs.pairs.T.ravel()  # (C, 2 P)
        carried = jnp.asarray(self.carried, points.dtype)
        nearest = one[0] + s * (one[1] - one[0])
        return Quadratic(
            0.5 * scale * (inside * inside).sum(),
            jnp.moveaxis(contracted(forces.T, capsules.T), 0, 1).reshape(-1, 3),
            lambda motion: carried * motion.along(nearest, direction),
            jnp.where(depth > 0, scale, 0.0),
        )

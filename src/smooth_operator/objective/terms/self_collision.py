"""Parts of the hand stay out of each other, by the capsules of its links."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from smooth_operator.hands.capsules import CapsulePairs, capsule_pairs, segments_apart
from smooth_operator.hands.collision import owners
from smooth_operator.hands.differential import PointKinematics, contracted
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS
from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.terms.term import PointTerm, Quadratic
from smooth_operator.settings import check_numbers, is_off

TRANSITION: Final = 0.02
"""That of the keyvectors' smooth-L1 [m], so that weights compare."""


@dataclass(frozen=True)
class SelfCollisionConfig:
    """Settings of the self-collision cost.

    Attributes:
        weight: weight of a pair that is too near, in the units of a keyvector's weight: the cost is
            weight x d^2 / (2 x 20 mm) for a depth d; 0 leaves the term out.
        margin: distance below which a pair counts [m]. Negative lets soft parts sink in.
        grip: further depth that is allowed between thumb and finger whose tips are where the
            human's are [m]: a human who grips an object asks for a pose beyond its surface, and the
            force comes from that.
    """

    weight: float = 7000.0
    margin: float = -0.00125
    grip: float = 0.006

    def __post_init__(self) -> None:
        check_numbers(self, "self_collision.", not_negative=("weight", "grip"))

    def build(self, hand: Hand) -> SelfCollision:
        """The term for one hand."""
        return SelfCollision(hand, self)


@dataclass(frozen=True, eq=False)
class SelfCollision(PointTerm):
    """Squared depth of each pair of capsules that are nearer than the margin."""

    hand: Hand
    config: SelfCollisionConfig

    @cached_property
    def pairs(self) -> CapsulePairs:
        """The P pairs of parts that could touch."""
        return capsule_pairs(self.hand)

    @cached_property
    def opposition(self) -> tuple[Int[np.ndarray, "P 2"], Bool[np.ndarray, " P"]]:
        """(P, 2) fingers of each pair's capsules, and (P,) whether they are thumb and finger."""
        owner, fingers = owners(self.hand), self.hand.fingers
        bodies = [self.pairs.ends[name][0] for name in self.pairs.names[::2]]
        rows = {FINGERS.index(name): f for f, name in enumerate(fingers)}
        of = np.array([rows.get(int(owner[body]), -1) for body in bodies])[self.pairs.pairs]
        thumb = fingers.index("thumb") if "thumb" in fingers else -2
        opposing = (of >= 0).all(axis=1) & ((of == thumb).sum(axis=1) == 1)
        return np.maximum(of, 0), opposing

    @cached_property
    def carried(self) -> Float[np.ndarray, "P J"]:
        """Joints that carry only the first capsule of each pair (1), or only the second (-1)."""
        moves = PointKinematics(self.pairs.tree, self.pairs.names[::2]).moves.astype(np.float32)
        first, second = self.pairs.pairs.T
        return np.asarray(moves[first] - moves[second])

    @property
    def is_off(self) -> bool:
        """Without weight, and where no parts could touch."""
        return is_off(self.config.weight) or len(self.pairs.pairs) == 0

    def points(self) -> tuple[str, ...]:
        """First and second end of each capsule."""
        return self.pairs.names

    def own_points(self) -> Mapping[str, tuple[int, np.ndarray]]:
        """The ends of the capsules."""
        return self.pairs.ends

    def expand(
        self, points: Float[Array, "E 3"], jacobian: Float[Array, "E J 3"], goal: FrameGoal
    ) -> Quadratic:
        """See ``PointTerm``; nearest points are held fixed on their segments: exact for the first
        derivative. Of the second, only what the kinematics adds is kept."""
        pairs, config = self.pairs, self.config
        ends = points.reshape(-1, 2, 3)[pairs.pairs]
        one, other = ((ends[:, side, 0], ends[:, side, 1]) for side in (0, 1))
        apart, s, t = segments_apart(one, other)
        distance = jnp.sqrt((apart * apart).sum(-1) + 1e-12)
        depth = jnp.asarray(pairs.reach + 0.0, points.dtype) + config.margin - distance
        if goal.near is not None and not is_off(config.grip):
            at, opposing = self.opposition
            depth = depth - config.grip * jnp.where(opposing, goal.near[at].prod(axis=-1), 0.0)
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

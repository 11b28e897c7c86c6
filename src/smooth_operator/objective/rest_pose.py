"""Rest pose of a frame, to which a hand is pulled without being pulled off its target; and limits.

The second term of Eq. (1) pulls joints to a neutral pose, and so holds fingertips off targets that
they could reach. Where fingertips are near the human's, only the part of the pull that moves none
of them is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.hands.differential import PointKinematics, all_joints, contracted
from smooth_operator.hands.hand import Hand
from smooth_operator.settings import check_numbers
from smooth_operator.solvers.newton import solve_small


@dataclass(frozen=True)
class RestPoseConfig:
    """Settings of the rest pose.

    Attributes:
        reach: error of a fingertip at which it counts as near its target by a quarter [m]; 0 leaves
            the pull of Eq. (1) as it is.
        damping: motion of all fingertips per unit of joint motion, squared, that counts as none
            [m^2/rad^2].
    """

    reach: float = 0.006
    damping: float = 1e-5

    def __post_init__(self) -> None:
        check_numbers(self, "rest_pose.", positive=("damping",), not_negative=("reach",))


class RestGoal(NamedTuple):
    """Targets that the rest pose gives a frame.

    Attributes:
        tips: (F, 3) fingertips at the last answer [m].
        near: (F,) how nearly each of them is where the human's is, 0 to 1.
        pose: (m,) pose that the hand is pulled to [rad].
    """

    tips: Float[Array, "F 3"]
    near: Float[Array, " F"]
    pose: Float[Array, " m"]


@dataclass(frozen=True, eq=False)
class RestPose:
    """The rest pose for one hand.

    Attributes:
        hand: the robot hand.
        config: settings.
    """

    hand: Hand
    config: RestPoseConfig

    @cached_property
    def kinematics(self) -> PointKinematics:
        """Fingertips."""
        return PointKinematics(self.hand.tree, self.hand.tip_names)

    @cached_property
    def moves(self) -> Bool[np.ndarray, "F m"]:
        """(F, m) mask of the actuated joints that move each fingertip."""
        matrix = self.hand.coupling_matrix[np.array(self.kinematics.order)]
        moves: np.ndarray = (self.kinematics.moves.astype(float) @ np.abs(matrix)) > 0
        return moves

    def __call__(
        self,
        q: Float[Array, " m"],
        places: Float[Array, "F 3"],
        moves: Float[Array, "F 3"],
    ) -> RestGoal:
        """The rest pose of a frame; traceable.

        Args:
            q: (m,) last answer of the actuated joints [rad].
            places: (F, 3) where the robot's fingertips belong, in the palm frame [m].
            moves: (F, 3) their step since the last answer [m].
        """
        config, hand = self.config, self.hand
        motion = self.kinematics(all_joints(hand, q))
        slopes = jnp.swapaxes(self.kinematics.jacobian(motion), 1, 2)
        jacobian = contracted(slopes, hand.coupling_matrix[np.array(self.kinematics.order)])
        tips, neutral = motion.points, jnp.asarray(hand.neutral, q.dtype)
        error = tips + moves - places
        near = 1 / (1 + (error * error).sum(-1) / config.reach**2) ** 2
        rows = jacobian.reshape(-1, len(q))
        apart: Any = jax.lax.optimization_barrier  # has no types; see ``Objective``
        damping = config.damping * jnp.eye(len(q), dtype=q.dtype)
        # (J^T J + damping) step = damping (neutral - q): little is left of what moves fingertips
        step = solve_small(apart(rows.T) @ rows + damping, config.damping * (neutral - q))
        # a joint is free of Eq. (1)'s pull as far as every fingertip that it moves is near
        share = jnp.where(jnp.asarray(self.moves), near[:, None], 1.0).min(axis=0)
        pose = q + share * step + (1 - share) * (neutral - q)
        return RestGoal(tips, near, pose)


_SHORTER: Final = 1e-3  # so much nearer than the finger at its limit [m]
_MOVES: Final = 1e-3  # least way of a fingertip by a joint of its finger [m]
_PARALLEL: Final = 0.9  # cosine between the axes of two joints
_POSES: Final = 101


class StraightFingers:
    """Joint limits of a frame that keep a bent finger on its side of straight.

    Many robot fingers are longest some degrees before the limit of a joint beyond the knuckle: it
    bends them past straight. Between limit and that joint position a finger can't get shorter than
    at the limit: an optimiser that ends there holds it straight or bent backwards, though the
    human's is bent. Where the human's fingertip is nearer to the finger's base than that, the joint
    is kept on the other side.

    Args:
        hand: the robot hand.

    Attributes:
        bends: for each of these joints the finger's row among the hand's, the joint, the joint
            position in which the finger is longest [rad], and its length at the limit next to that
            [m]; other joints as in the straight hand.
        centres: (S, 3) where the knuckle is, from the wrist [m]; lengths are from there.
    """

    def __init__(self, hand: Hand) -> None:
        self.bends: list[tuple[int, int, float, float]] = []
        centres = []
        for f, (name, circles) in enumerate(zip(hand.fingers, _circles(hand), strict=True)):
            parallel = [one for one in circles if abs(one.axis @ circles[-1].axis) > _PARALLEL]
            if len(parallel) < 2 or name == "thumb":  # the thumb's other joint moves about
                continue
            centre = parallel[0].centre
            for one in parallel[1:]:
                length = np.linalg.norm(one.tips - centre, axis=-1)
                longest = int(np.argmax(length))
                if longest < _POSES // 2 and length[longest] - length[0] > _SHORTER:
                    angle = float(one.angles[longest])
                    self.bends.append((f, one.joint, angle, float(length[0])))
                    centres.append(centre)
        self.centres = np.array(centres).reshape(-1, 3)

    def limits(
        self, limits: Float[np.ndarray, "m 2"], tips: Float[Array, "F 3"] | Float[np.ndarray, "F 3"]
    ) -> Float[Array, "m 2"] | Float[np.ndarray, "m 2"]:
        """(m, 2) joint limits of a frame [rad].

        Args:
            tips: (F, 3) where the human's fingertips are, from the robot's wrist [m].
        """
        if not self.bends:
            return limits
        fingers, joints, longest, length = map(np.array, zip(*self.bends, strict=True))
        tips = jnp.asarray(tips)
        away = tips[fingers] - jnp.asarray(self.centres, tips.dtype)
        bent = (away * away).sum(-1) < jnp.asarray(length - _SHORTER, tips.dtype) ** 2
        of = np.full(len(limits), len(joints))
        of[joints] = np.arange(len(joints))
        bent = jnp.concatenate([bent, jnp.zeros(1, bool)])[of]
        raised = limits[:, 0].copy()
        raised[joints] = longest
        low = jnp.where(bent, raised.astype(tips.dtype), limits[:, 0].astype(tips.dtype))
        return jnp.stack([low, jnp.asarray(limits[:, 1], tips.dtype)], axis=1)


def spread_joints(hand: Hand) -> Bool[np.ndarray, " m"]:
    """(m,) mask of the actuated joints that turn a long finger sideways: their axis is across those
    of two or more other joints, about which the finger bends."""
    spread = np.zeros(len(hand.limits), bool)
    for name, circles in zip(hand.fingers, _circles(hand), strict=True):
        axes = np.array([one.axis for one in circles]).reshape(-1, 3)
        parallel = (np.abs(axes @ axes.T) > _PARALLEL).sum(axis=1)
        if name != "thumb" and (parallel > 1).any():
            spread[[one.joint for one in circles]] |= parallel == 1
    return spread


class _Circle(NamedTuple):
    """Circle of a fingertip about an actuated joint of the straight hand.

    Attributes:
        radius: [m].
        centre: (3,) from the robot's wrist [m].
        axis: (3,) unit vector.
        joint: number of the joint.
        angles: (N,) positions of the joint [rad].
        tips: (N, 3) fingertip at these, from the robot's wrist [m].
    """

    radius: float
    centre: np.ndarray
    axis: np.ndarray
    joint: int
    angles: np.ndarray
    tips: np.ndarray


@lru_cache(maxsize=8)
def _circles(hand: Hand) -> tuple[list[_Circle], ...]:
    """For each finger, the circles of its tip about the joints that move it, the largest first."""
    circles: tuple[list[_Circle], ...] = tuple([] for _ in hand.fingers)
    for joint, (low, high) in enumerate(hand.limits):
        q = np.tile(hand.straight_pose.q, (_POSES, 1))
        q[:, joint] = angles = np.linspace(low, high, _POSES)
        every = hand.tips(hand.full_configuration(q)) - hand.wrist
        for own, tips in zip(circles, np.swapaxes(every, 0, 1), strict=True):
            if np.ptp(tips, axis=0).max() > _MOVES:
                own.append(_Circle(*_circle(tips), joint, angles, tips))
    for own in circles:
        own.sort(key=lambda one: -one.radius)
    return circles


def _circle(points: Float[np.ndarray, "N 3"]) -> tuple[float, np.ndarray, np.ndarray]:
    """Radius, centre and axis of the circle on which points lie."""
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle)[2]
    flat = (points - middle) @ axes[:2].T
    rows = np.column_stack([2 * flat, np.ones(len(flat))])
    solution = np.linalg.lstsq(rows, (flat**2).sum(axis=-1), rcond=None)[0]
    radius = float(np.sqrt(solution[2] + solution[:2] @ solution[:2]))
    return radius, middle + solution[:2] @ axes[:2], axes[2]

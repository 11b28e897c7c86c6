"""What the method ``smooth`` minimises near one pose: value, gradient and Hessian.

Eq. (1) with three more terms: fingertips move as the human's do, parts of the hand stay out of each
other (``smooth_operator.objective.clearance``), and the thumb's vectors are held by angle and
length, too (``smooth_operator.objective.polar``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.capsules import CapsulePairs, capsule_pairs
from smooth_operator.hands.differential import PointKinematics
from smooth_operator.human.pursuit import is_off
from smooth_operator.landmarks import FINGERS, LANDMARKS, TIPS
from smooth_operator.objective.clearance import ClearanceConfig, crowding
from smooth_operator.objective.keyvectors import KeyvectorLayout
from smooth_operator.objective.loss import FrameGoal, Objective
from smooth_operator.objective.polar import PolarConfig, polar


class SmoothGoal(NamedTuple):
    """What one frame asks of the robot.

    Attributes:
        frame: targets and weights of Eq. (1).
        tips: (F, 3) where fingertips come to if they move as the human's [m].
        motion_weights: (F,) of being there, in the units of a keyvector's weight.
    """

    frame: FrameGoal
    tips: Float[Array, "F 3"]
    motion_weights: Float[Array, " F"]


@dataclass(frozen=True, eq=False)
class SmoothObjective:
    """The objective of ``smooth`` for one hand.

    Attributes:
        objective: Eq. (1).
        clearance: of the hand's parts from each other.
        polar: prices on angle and length of the thumb's vectors.
    """

    objective: Objective
    clearance: ClearanceConfig
    polar: PolarConfig

    @cached_property
    def collides(self) -> bool:
        """Whether any parts are kept out of each other."""
        return not is_off(self.clearance.weight) and len(self.pairs.pairs) > 0

    @cached_property
    def pairs(self) -> CapsulePairs:
        """Pairs of parts that could touch."""
        return capsule_pairs(self.objective.hand)

    @cached_property
    def kinematics(self) -> PointKinematics:
        """Landmarks that move, fingertips first among them, then the ends of capsules."""
        marks = tuple(LANDMARKS[i] for i in self.marks)
        if not self.collides:
            return PointKinematics(self.objective.hand.tree, marks)
        return PointKinematics(self.pairs.tree, (*marks, *self.pairs.names))

    @cached_property
    def thumb(self) -> slice:
        """The vectors from the thumb's tip to others."""
        layout = self.objective.layout
        if not isinstance(layout, KeyvectorLayout):
            raise ConfigError(f"smooth needs the paper's keyvectors, not {type(layout).__name__}")
        return layout.thumb

    @cached_property
    def marks(self) -> tuple[int, ...]:
        """Landmarks whose counterparts move, fingertips first."""
        tips = [TIPS[FINGERS.index(finger)] for finger in self.objective.hand.fingers]
        return (*tips, *(i for i in self.objective.moving if i not in tips))

    @cached_property
    def incidence(self) -> Float[np.ndarray, "K P"]:
        """Vectors from the landmarks that move, but for a constant."""
        matrix = np.zeros((len(self.objective.layout.vectors), len(self.marks)))
        for k, (i, j) in enumerate(self.objective.layout.vectors):
            for landmark, sign in ((j, 1.0), (i, -1.0)):
                if landmark in self.marks:
                    matrix[k, self.marks.index(landmark)] = sign
        return matrix

    def tips(self, q: Float[Array, " m"]) -> Float[Array, "F 3"]:
        """Fingertips at a pose [m]."""
        tree, names = self.objective.hand.tree, self.objective.hand.tip_names
        rows = tree.walk(self.objective.hand.expand_rows(list(q)), names, within_limits=True)
        return jnp.stack([jnp.stack([jnp.asarray(c, q.dtype) for c in point]) for point in rows])

    def values(self, q: Float[Array, "c m"], goal: SmoothGoal) -> Float[Array, " c"]:
        """Costs of a few candidates."""
        costs: Array = jax.vmap(lambda one: self.derivatives(one, goal)[0])(q)
        return costs

    def derivatives(
        self, q: Float[Array, " m"], goal: SmoothGoal
    ) -> tuple[Float[Array, ""], Float[Array, " m"], Float[Array, "m m"]]:
        """Value, gradient and Hessian at a pose.

        The Hessian is exact but for the turning of the line between two parts that touch, and for
        what is negative in that of an angle.
        """
        objective, frame, dtype = self.objective, goal.frame, q.dtype
        matrix, offset = (jnp.asarray(a, dtype) for a in objective.hand.expansion)
        motion = self.kinematics(matrix @ q + offset)
        marks, fingers = len(self.marks), len(objective.hand.fingers)
        points = motion.points
        errors = self._errors(points[:marks], frame)
        slope, bend = objective.slopes(errors, frame.weights)
        incidence = jnp.asarray(self.incidence, dtype)
        force = incidence.T @ slope
        # of the fingertips' motion
        stiff = jnp.repeat(goal.motion_weights / objective.config.transition, 3)
        astray = points[:fingers] - goal.tips
        force = force.at[:fingers].add(stiff.reshape(astray.shape) * astray)
        cost = objective.price([errors[:, c] for c in range(3)], frame.weights).sum()
        cost = cost + 0.5 * (stiff * (astray * astray).reshape(-1)).sum()
        levers = motion.velocities
        relative = jnp.einsum("kf,fjc->kcj", incidence, levers[:marks])
        rows = [jnp.swapaxes(levers[:fingers], 1, 2).reshape(-1, levers.shape[1])]
        bends = [stiff]
        if bend.ndim == 2:
            rows.insert(0, relative.reshape(-1, relative.shape[-1]))
            bends.insert(0, bend.reshape(-1))
        held = None
        if not self.polar.is_off:
            thumb = self.thumb
            held = polar((errors + frame.vectors)[thumb], frame.vectors[thumb], self.polar)
            cost = cost + held.cost
            force = force + incidence[thumb].T @ held.pull
        if self.collides:
            crowd = crowding(self.pairs, points[marks:], self.clearance)
            cost = cost + crowd.cost
            force = jnp.concatenate([force, crowd.force])
            rows.append(jnp.einsum("pec,ejc->pj", crowd.rows, levers[marks:]))
            bends.append(crowd.bend)
        every = jnp.concatenate(rows)
        hessian = (every * jnp.concatenate(bends)[:, None]).T @ every
        if bend.ndim == 3:
            hessian = hessian + jnp.einsum("kcj,kcd,kdi->ji", relative, bend, relative)
        if held is not None:
            turning = relative[thumb]
            hessian = hessian + jnp.einsum("kcj,kcd,kdi->ji", turning, held.bend, turning)
        hessian = hessian + self.kinematics.curvature(motion, force)
        gradient = jnp.einsum("fc,fjc->j", force, levers)
        spread = matrix[np.array(self.kinematics.order)]
        pull, firm = objective.regularisation_slopes(q, frame.previous, frame.velocity_weight)
        return (
            cost + self.regularisation(q, goal),
            gradient @ spread + pull,
            spread.T @ hessian @ spread + firm * jnp.eye(len(q), dtype=dtype),
        )

    def regularisation(self, q: Float[Array, " m"], goal: SmoothGoal) -> Float[Array, ""]:
        """Last two terms of Eq. (1) at a pose."""
        frame = goal.frame
        return self.objective.regularisation(q, frame.previous, frame.velocity_weight)

    def tracking(self, q: Float[Array, " m"], goal: SmoothGoal) -> Float[Array, ""]:
        """First term of Eq. (1) at a pose."""
        return self.objective.tracking(list(q), goal.frame)

    def _errors(self, moving: Float[Array, "P 3"], goal: FrameGoal) -> Float[Array, "K 3"]:
        layout, known = self.objective.layout, self.objective.points
        at = {i: moving[p] for p, i in enumerate(self.marks)}
        points = [
            at[i] if i in at else jnp.asarray(known[LANDMARKS[i]].position, moving.dtype)
            for i in layout.landmarks
        ]
        return layout.among(points) - goal.vectors

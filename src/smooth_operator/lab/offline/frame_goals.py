"""What each frame of a recording asks, without regard to the command before: for two methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.differential import PointKinematics
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.methods.sbr import Sbr
from smooth_operator.methods.smooth import Smooth
from smooth_operator.objective.local import LocalObjective
from smooth_operator.objective.loss import FrameGoal
from smooth_operator.objective.smooth import SmoothGoal

Goal: TypeAlias = Any
"""A frame's goal, as its method's objective takes it: a pytree of arrays."""


class NearObjective(Protocol):
    """A frame's cost near a pose."""

    def derivatives(self, q: Float[Array, " m"], goal: Goal) -> tuple[Array, Array, Array]:
        """Value, (m,) gradient and (m, m) Hessian."""

    def regularisation(self, q: Float[Array, " m"], goal: Goal) -> Float[Array, ""]:
        """The part of the value that is not about the human."""


class FrameGoals(Protocol):
    """Goals of successive frames; what passes from frame to frame is in and out, never inside."""

    @property
    def objective(self) -> NearObjective:
        """What the goals are for."""

    def begin(self) -> Any:
        """What is remembered before the first frame: a pytree of arrays."""

    def follow(self, memory: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, Goal]:
        """The goal of a frame; traceable."""


@dataclass(frozen=True, eq=False)
class SbrGoals:
    """Eq. (1) without its velocity term."""

    method: Sbr

    @property
    def objective(self) -> NearObjective:
        """Eq. (1) near a pose."""
        return LocalObjective(self.method.objective)

    def begin(self) -> Any:
        """The target policy's first state."""
        return self.method.config.objective.targets.init(self.method.objective.layout)

    def follow(self, memory: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, FrameGoal]:
        """Targets of the frame."""
        layout = self.method.objective.layout
        targets, memory = self.method.config.objective.targets(
            memory, layout, layout.human(aligned)
        )
        neutral = jnp.asarray(self.method.hand.neutral, aligned.dtype)
        goal = FrameGoal(targets.vectors, targets.weights, neutral, jnp.zeros((), aligned.dtype))
        return memory, goal


@dataclass(frozen=True, eq=False)
class SmoothGoals:
    """The objective of ``smooth`` on the landmarks as they are: a future makes filters needless."""

    method: Smooth

    @property
    def objective(self) -> NearObjective:
        """Its objective near a pose."""
        return self.method.objective

    def begin(self) -> Any:
        """The target policy's first state."""
        return self.method.config.objective.targets.init(self.method.objective.objective.layout)

    def follow(self, memory: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, SmoothGoal]:
        """Targets of the frame."""
        method = self.method
        seen = jnp.asarray(method.needs)
        points = jnp.zeros((NUM_LANDMARKS, 3), aligned.dtype).at[seen].set(aligned[seen])
        layout = method.objective.objective.layout
        targets, memory = method.config.objective.targets(memory, layout, layout.human(points))
        neutral = jnp.asarray(method.hand.neutral, aligned.dtype)
        frame = FrameGoal(targets.vectors, targets.weights, neutral, jnp.zeros((), aligned.dtype))
        tips = jnp.zeros((len(method.hand.fingers), 3), aligned.dtype)
        return memory, SmoothGoal(frame, tips, tips[:, 0])


def frame_goals(method: object) -> FrameGoals:
    """Goals of a method.

    Raises:
        ConfigError: the method has no objective with derivatives that could be solved for all
            frames at once.
    """
    if isinstance(method, Sbr):
        return SbrGoals(method)
    if isinstance(method, Smooth):
        return SmoothGoals(method)
    raise ConfigError(
        f"{type(method).__name__} can't be solved for a whole recording at once; sbr and smooth can"
    )


def fingertips(
    hand: Hand, q: Float[Array, " m"]
) -> tuple[Float[Array, "F 3"], Float[Array, "F 3 m"]]:
    """Fingertips at a pose [m] and their derivatives [m/rad]; traceable."""
    matrix, offset = (jnp.asarray(part, q.dtype) for part in hand.expansion)
    kinematics = PointKinematics(hand.tree, hand.tip_names)
    motion = kinematics(matrix @ q + offset)
    spread = matrix[np.array(kinematics.order)]
    return motion.points, jnp.einsum("fjc,jm->fcm", motion.velocities, spread)


def stacked(goals: list[Goal]) -> Goal:
    """Goals of several calls as one, frame by frame; NumPy."""
    import jax

    return jax.tree.map(lambda *parts: np.concatenate([np.asarray(p) for p in parts]), *goals)

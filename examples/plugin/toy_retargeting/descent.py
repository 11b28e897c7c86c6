"""Retargeting by gradient descent on Eq. (1), from the last command."""

from dataclasses import dataclass, field
from functools import cached_property

import jax
import jax.numpy as jnp

from smooth_operator import AlignmentConfig
from smooth_operator.retargeting import (
    FrameGoal,
    Method,
    MethodOutput,
    ObjectiveConfig,
    ObjectiveMethodConfig,
    SampledObjective,
)


@dataclass(frozen=True)
class DescentConfig(ObjectiveMethodConfig):
    """Settings: the number of steps, and the length of the first one [rad]."""

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    steps: int = 40
    length: float = 0.2

    def build(self, hand):
        return Descent(hand, self)


@dataclass(frozen=True, eq=False)
class Descent(Method):
    hand: object
    config: DescentConfig

    @cached_property
    def objective(self):
        return SampledObjective(self.hand, self.config.objective)

    @property
    def needs(self):
        return self.objective.layout.landmarks

    def init(self, seed):
        policy = self.config.objective.targets
        return jnp.asarray(self.hand.neutral, jnp.float32), policy.init(self.objective.layout)

    def step(self, state, aligned, ticks):
        (previous, policy_state), layout = state, self.objective.layout
        policy = self.config.objective.targets
        targets, policy_state = policy(policy_state, layout, layout.human(aligned))
        weight = self.config.objective.velocity_weight
        goal = FrameGoal(targets.vectors, targets.weights, previous, weight)
        gradient = jax.grad(lambda q: self.objective(list(q), goal))
        low, high = jnp.asarray(self.hand.limits.T, jnp.float32)

        def descend(k, q):  # steps that become shorter end at the minimum
            slope = gradient(q)
            length = self.config.length * 0.9**k
            return jnp.clip(q - length * slope / (jnp.linalg.norm(slope) + 1e-9), low, high)

        q = jax.lax.fori_loop(0, self.config.steps, descend, previous)
        return (q, policy_state), MethodOutput(q, self.objective.tracking(list(q), goal))


PRESETS = {"default": DescentConfig(), "quick": DescentConfig(steps=10)}

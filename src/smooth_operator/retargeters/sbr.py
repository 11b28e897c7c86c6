"""The paper's sampling-based retargeter (SBR), with an optional second-order polish."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, UInt32

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.objective.local import LocalObjective
from smooth_operator.objective.loss import FrameGoal, Objective, ObjectiveConfig
from smooth_operator.retargeters.method import MethodOutput
from smooth_operator.solvers.newton import NewtonConfig, newton_minimise
from smooth_operator.solvers.normals import frame_key, seed_words
from smooth_operator.solvers.sampling import SamplingConfig, sample_minimise


@dataclass(frozen=True)
class SbrConfig:
    """Settings of SBR.

    Attributes:
        alignment: how human landmarks reach the palm frame.
        objective: weights of Eq. (1).
        sampling: hyper-parameters of Algorithm 1.
        polish: Newton steps on the same objective after Algorithm 1; none in the paper.
        settle_rounds: how often the first frame is solved, each time from the last answer and
            without the velocity term, since there is no last command to be near to. The hand then
            starts where the operator is, and does not creep there from the neutral pose over
            several frames. 1 is as published: once, velocity term and all.
    """

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    polish: NewtonConfig = field(default_factory=lambda: NewtonConfig(iterations=0))
    settle_rounds: int = 1

    def __post_init__(self) -> None:
        if self.settle_rounds < 1:
            raise ConfigError(f"settle_rounds must be 1 or more, not {self.settle_rounds}")

    def build(self, hand: Hand) -> Sbr:
        """The method for one hand."""
        return Sbr(hand, self)


class SbrState(NamedTuple):
    """All that SBR remembers between frames.

    Attributes:
        q: (m,) last command of the actuated joints [rad].
        latched: (F - 1,) fingers latched to the thumb.
        seed: two words, constant.
        count: frames answered so far; with the seed it gives each frame its random numbers.
    """

    q: Float[Array, " m"]
    latched: Bool[Array, " P"]
    seed: UInt32[Array, "2"]
    count: UInt32[Array, ""]


@dataclass(frozen=True, eq=False)
class Sbr:
    """SBR for one hand."""

    hand: Hand
    config: SbrConfig

    @cached_property
    def objective(self) -> Objective:
        """Eq. (1)."""
        return Objective(self.hand, self.config.objective)

    @property
    def needs(self) -> tuple[int, ...]:
        """Wrist and fingertips."""
        return self.objective.layout.landmarks

    def init(self, seed: int) -> SbrState:
        """Neutral pose, open latches."""
        return SbrState(
            np.asarray(self.hand.neutral, np.float32),
            np.zeros(len(self.hand.fingers) - 1, bool),
            seed_words(seed),
            np.uint32(0),
        )

    def step(self, state: SbrState, aligned: Float[Array, "21 3"]) -> tuple[SbrState, MethodOutput]:
        """One frame."""
        config, limits, layout = self.config, self.hand.limits, self.objective.layout
        targets = config.objective.targets(layout, layout.human(aligned), state.latched)
        starting = (state.count == 0) & (config.settle_rounds > 1)
        velocity_weight = jnp.where(starting, 0.0, config.objective.velocity_weight)
        goal = FrameGoal(targets.vectors, targets.weights, state.q, velocity_weight)
        local = LocalObjective(self.objective)

        def solve(round: Array, q: Array) -> Array:
            q = sample_minimise(
                lambda candidates: self.objective(candidates, goal),
                q,
                limits,
                frame_key(state.seed, state.count + jnp.uint32(round)),
                config.sampling,
            )
            return newton_minimise(
                lambda q: local.derivatives(q, goal),
                lambda candidates: local.costs(candidates, goal),
                q,
                limits,
                config.polish,
            )

        if config.settle_rounds > 1:
            rounds = jnp.where(starting, config.settle_rounds, 1)
            q = lax.fori_loop(0, rounds, solve, state.q)
        else:
            q = solve(jnp.uint32(0), state.q)
        after = SbrState(q, targets.latched, state.seed, state.count + jnp.uint32(1))
        return after, MethodOutput(q, local.tracking(q, goal))

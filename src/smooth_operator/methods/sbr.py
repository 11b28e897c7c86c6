"""The paper's sampling-based retargeter (SBR), with an optional second-order polish."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, UInt32

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.methods.method import FrameGoals, Method, MethodOutput, ObjectiveMethodConfig
from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.loss import Objective, ObjectiveConfig
from smooth_operator.solvers.newton import NewtonConfig, newton_minimise
from smooth_operator.solvers.normals import frame_key, seed_words
from smooth_operator.solvers.sampling import SamplingConfig, sample_minimise


@dataclass(frozen=True)
class SbrConfig(ObjectiveMethodConfig):
    """Settings of SBR.

    Attributes:
        alignment: alignment of human landmarks to the palm frame.
        objective: weights of Eq. (1).
        sampling: hyper-parameters of Algorithm 1.
        polish: Newton steps on the same objective after Algorithm 1; none in the paper.
        settle_rounds: number of solutions of the first frame, each from the last answer and
            without the velocity term, since there is no last command to be near to. The hand then
            starts where the operator is, and does not creep there from the neutral pose over
            several frames. 1 is as published: once, velocity term and all.
        settle_sigma: initial standard deviation of the sampler while it settles [rad]: the first
            pose may be anywhere, and the wrong basin would last.
    """

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    polish: NewtonConfig = field(default_factory=lambda: NewtonConfig(iterations=0))
    settle_rounds: int = 1
    settle_sigma: float = 0.4

    def __post_init__(self) -> None:
        if self.settle_rounds < 1:
            raise ConfigError(f"settle_rounds must be 1 or more, not {self.settle_rounds}")
        if self.settle_sigma <= 0:
            raise ConfigError(f"settle_sigma must be positive [rad], not {self.settle_sigma}")

    @property
    def one_thread(self) -> bool:
        """Up to 2,048 samples are faster on one; 4,096 are 12 % slower."""
        return self.sampling.samples <= 2048

    def build(self, hand: Hand) -> Sbr:
        """The method for one hand."""
        return Sbr(hand, self)


class SbrState(NamedTuple):
    """All that SBR remembers between frames.

    Attributes:
        q: (m,) last command of the actuated joints [rad].
        targets: state of the target policy.
        seed: two words, constant.
        frames: frames answered so far; with the seed it gives each frame its random numbers.
    """

    q: Float[Array, " m"]
    targets: Any
    seed: UInt32[Array, "2"]
    frames: UInt32[Array, ""]


@dataclass(frozen=True, eq=False)
class Sbr(Method):
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
        """Neutral pose, the target policy's first state."""
        return SbrState(
            jax.device_put(self.hand.neutral.astype(np.float32)),
            self.config.objective.targets.init(self.objective.layout),
            *jax.device_put((seed_words(seed), np.uint32(0))),
        )

    def latched(self, state: SbrState) -> Bool[Array, " P"] | None:
        """(F - 1,) which fingers are latched to the thumb; None if the policy has no latches."""
        return self.config.objective.targets.latched(state.targets)

    def frame_goals(self) -> FrameGoals:
        """Eq. (1) without its velocity term."""
        return FrameGoals(self.objective)

    def step(
        self, state: SbrState, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[SbrState, MethodOutput]:
        """One frame."""
        del ticks
        config, limits, layout = self.config, self.hand.limits, self.objective.layout
        targets, policy_state = config.objective.targets(
            state.targets, layout, layout.human(aligned)
        )
        starting = (state.frames == 0) & (config.settle_rounds > 1)
        velocity_weight = jnp.where(starting, 0.0, config.objective.velocity_weight)
        sigma = jnp.where(starting, config.settle_sigma, config.sampling.sigma)
        goal = FrameGoal(targets.vectors, targets.weights, state.q, velocity_weight)

        def solve(round: Array | int, q: Array) -> tuple[Array, Array]:
            q = sample_minimise(
                lambda candidates: self.objective(candidates, goal),
                q,
                limits,
                frame_key(state.seed, state.frames + jnp.uint32(round)),
                config.sampling,
                sigma,
            )
            solution = newton_minimise(
                lambda few: self.objective.few_value_grad_hess(few, goal), q, limits, config.polish
            )
            return solution[:2]

        if config.settle_rounds > 1:
            q, cost = lax.fori_loop(
                0,
                jnp.where(starting, config.settle_rounds, 1),
                lambda round, last: solve(round, last[0]),
                (state.q, jnp.zeros_like(state.q[0])),
            )
        else:
            q, cost = solve(0, state.q)
        tracking = cost - self.objective.regularisation(q, goal)
        after = SbrState(q, policy_state, state.seed, state.frames + jnp.uint32(1))
        return after, MethodOutput(q, tracking)

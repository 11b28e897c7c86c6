"""SBR, the sampling-based retargeter of the Smooth Operator paper, with optional Newton steps."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, UInt32

from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.method import (
    Method,
    MethodOutput,
    ObjectiveMethodConfig,
)
from smooth_operator.retargeting.objective import FrameGoal, Objective
from smooth_operator.retargeting.sbr.newton import NewtonConfig, newton_minimise
from smooth_operator.retargeting.sbr.published import DexPilotTargets, ObjectiveConfig
from smooth_operator.retargeting.sbr.random_numbers import frame_key, seed_words
from smooth_operator.retargeting.sbr.sampled import SampledObjective
from smooth_operator.retargeting.sbr.sampling import SamplingConfig, sample_minimise
from smooth_operator.retargeting.trajectory import FUTURE, TrajectoryMethodConfig
from smooth_operator.settings import check_numbers


@dataclass(frozen=True)
class SbrConfig(ObjectiveMethodConfig):
    """Settings of SBR.

    Attributes:
        alignment: alignment of human landmarks to the palm frame.
        objective: weights of Eq. (1).
        sampling: hyper-parameters of Algorithm 1.
        polish: Newton steps on the same objective after Algorithm 1; the paper has none.
        settle_rounds: number of solutions of the first frame, each from the previous one and
            without the velocity term, so that the hand starts in the operator's pose. 1, as
            published, solves once, with the velocity term.
        settle_sigma: initial standard deviation of the sampler in these solutions [rad]; larger,
            because the first pose may be anywhere.
    """

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    polish: NewtonConfig = field(default_factory=lambda: NewtonConfig(iterations=0))
    settle_rounds: int = 1
    settle_sigma: float = 0.4

    def __post_init__(self) -> None:
        check_numbers(self, positive=("settle_rounds", "settle_sigma"))

    @property
    def one_thread(self) -> bool:
        """True up to 2,048 samples; 4,096 samples are 12 % slower on one thread."""
        return self.sampling.samples <= 2048

    def build(self, hand: Hand) -> Sbr:
        """Builds the method for one hand."""
        return Sbr(hand, self)


class SbrState(NamedTuple):
    """Everything that SBR remembers between frames.

    Attributes:
        q: (m,) last command of the actuated joints [rad].
        targets: state of the target policy.
        seed: two words; they do not change.
        frames: number of frames with a command so far. With the seed, it determines the random
            numbers of a frame.
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
    def objective(self) -> SampledObjective:
        """The objective of this preset: Eq. (1) of the Smooth Operator paper."""
        return SampledObjective(self.hand, self.config.objective)

    @property
    def needs(self) -> tuple[int, ...]:
        """Indices of the wrist and the fingertips."""
        return self.objective.layout.landmarks

    def init(self, seed: int) -> SbrState:
        """State with the neutral pose and the target policy's initial state."""
        seeds, frames = jax.device_put((seed_words(seed), np.uint32(0)))
        return SbrState(
            jax.device_put(self.hand.neutral.astype(np.float32)),
            self.config.objective.targets.init(self.objective.layout),
            seeds,
            frames,
        )

    def latched(self, state: SbrState) -> Bool[Array, " P"] | None:
        """(F - 1,) True for fingers latched to the thumb; None if the policy has no latches."""
        return self.config.objective.targets.latched(state.targets)

    @property
    def trajectory_objective(self) -> Objective:
        """The objective of this preset, which is differentiable."""
        return self.objective

    def step(
        self, state: SbrState, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[SbrState, MethodOutput]:
        """Computes one frame; see ``Method.step``."""
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
                lambda one: self.objective.value_grad_hess(one, goal), q, limits, config.polish
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
        tracking = cost - self.objective.regularisation(q, goal).cost
        after = SbrState(q, policy_state, state.seed, state.frames + jnp.uint32(1))
        return after, MethodOutput(q, tracking)


SBR_PAPER: Final = SbrConfig()
"""Hyper-parameters of the paper's table, with fresh normals in every cycle."""

SBR_REALTIME: Final = SbrConfig(
    objective=ObjectiveConfig(
        targets=DexPilotTargets(w_thumb=1.4, w_between=0.85, blend=0.4),
        pose_weight=0.049,
        velocity_weight=0.107,
    ),
    sampling=SamplingConfig(samples=256, elites=24, cycles=5, draws="quasi"),
    polish=NewtonConfig(iterations=3, damping=(0.0, 1.0)),
    settle_rounds=10,
)
"""Preset for an ordinary CPU: a few quasi-random base samples find the basin, and Newton steps find
its minimum, which follows jumps of the pinch latches more closely than the paper's sampler.
Therefore a latch takes effect over 2.5 frames. docs/reference/benchmarks.md names the recordings of
the tuning."""

SBR_OFFLINE: Final = TrajectoryMethodConfig(
    replace(SBR_REALTIME, objective=replace(SBR_REALTIME.objective, pose_weight=0.02)),
    FUTURE,
    jump=0.03,
)
"""Preset for recordings: Eq. (1) for all frames together, with a cost of acceleration, and of
fingertip motion that differs from the human's, in place of the cost of velocity."""

SBR: Final = {"realtime": SBR_REALTIME, "paper": SBR_PAPER, "offline": SBR_OFFLINE}

"""Solvers compared on one objective: from a single start, and from N starts in parallel.

Each solver starts at its own last solution and stays within the joint limits. All descent methods
stop if an iteration gains less than 1e-6, or after 100 evaluations; SLSQP in the published form
stops after 20 iterations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt32

from smooth_operator.baselines.slsqp_method import (
    SlsqpConfig,
    SlsqpResult,
    ValueAndGradient,
    slsqp_minimise,
)
from smooth_operator.errors import ConfigError
from smooth_operator.geometry import AnyKind, array_namespace
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator.retargeting.sbr.newton import NewtonConfig, newton_minimise
from smooth_operator.retargeting.sbr.random_numbers import counter_normal_matrix
from smooth_operator.retargeting.sbr.sampled import SampledObjective
from smooth_operator.retargeting.sbr.sampling import SamplingConfig, sample_minimise
from smooth_operator_research.paper.nlopt_slsqp import NloptConfig, nlopt_minimise

BatchGradient: TypeAlias = Callable[[Array], tuple[Array, Array]]
"""Maps (m, N) candidates, batch last, to their costs (N,) and gradients (m, N)."""


@dataclass(frozen=True)
class RmspropConfig:
    """Settings of RMSProp (Tieleman and Hinton 2012, lecture 6.5).

    Attributes:
        step: learning rate of the first iteration [rad].
        final: learning rate of the last iteration over that of the first; between them it falls
            geometrically. With 1, as in the lecture, a point may circle the minimum at the distance
            of a step.
        decay: decay of the running mean of squared gradients, as in the lecture.
        epsilon: added to the root of that mean, to prevent a division by zero.
        max_evaluations: evaluations per frame.
        tolerance: change of the cost in one iteration that counts as none.
    """

    step: float = 0.01
    final: float = 0.01
    decay: float = 0.9
    epsilon: float = 1e-8
    max_evaluations: int = 100
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        if self.step <= 0 or not 0 < self.final <= 1 or not 0 <= self.decay < 1:
            raise ConfigError(
                "RMSProp needs step > 0, final in (0, 1] and decay in [0, 1), not "
                f"step={self.step}, final={self.final}, decay={self.decay}"
            )
        if self.max_evaluations < 2 or self.tolerance <= 0:
            raise ConfigError(
                "RMSProp needs max_evaluations >= 2 and tolerance > 0, not "
                f"max_evaluations={self.max_evaluations}, tolerance={self.tolerance}"
            )


class _Carry(NamedTuple):
    evaluations: Int[Array, ""]
    q: Float[Array, "m N"]
    square: Float[Array, "m N"]
    last: Float[Array, " N"]
    best: Float[Array, "m N"]
    lowest: Float[Array, " N"]
    done: Bool[Array, " N"]


def rmsprop_minimise(
    value_and_gradient: BatchGradient,
    starts: Float[Array, "m N"],
    limits: Float[np.ndarray, "m 2"],
    config: RmspropConfig,
    step: Float[Array, ""] | float | None = None,
    final: Float[Array, ""] | float | None = None,
) -> tuple[Float[Array, "m N"], Float[Array, " N"], Int[Array, ""]]:
    """Minimises by RMSProp from every start; each step is clipped to the bounds.

    The result of a start is the best point that it has evaluated, as with SLSQP here. A start stops
    when an iteration changes its cost by less than the tolerance.

    Args:
        starts: (m, N) points within the bounds.
        limits: (m, 2) bounds.
        config: settings.
        step: learning rate, instead of the configured one; may be traced.
        final: ``final``, instead of the configured one; may be traced.

    Returns:
        (m, N) the solutions, (N,) their costs, and the number of evaluations of the objective by
        the start that needed the most.
    """
    low, high = (jnp.asarray(limits[:, i, None], starts.dtype) for i in (0, 1))
    first = jnp.asarray(config.step if step is None else step, starts.dtype)
    share = jnp.asarray(config.final if final is None else final, starts.dtype)

    def onward(carry: _Carry) -> Array:
        return (carry.evaluations < config.max_evaluations) & ~carry.done.all()

    def iterate(carry: _Carry) -> _Carry:
        value, gradient = value_and_gradient(carry.q)
        better = (value < carry.lowest) & ~carry.done
        done = carry.done | (jnp.abs(value - carry.last) < config.tolerance)
        square = config.decay * carry.square + (1 - config.decay) * gradient**2
        rate = first * share ** (carry.evaluations / (config.max_evaluations - 1))
        move = rate * gradient / (jnp.sqrt(square) + config.epsilon)
        return _Carry(
            carry.evaluations + 1,
            jnp.where(done, carry.q, jnp.clip(carry.q - move, low, high)),
            square,
            value,
            jnp.where(better, carry.q, carry.best),
            jnp.where(better, value, carry.lowest),
            done,
        )

    many = starts.shape[1:]
    end = lax.while_loop(
        onward,
        iterate,
        _Carry(
            jnp.int32(0),
            starts,
            jnp.zeros_like(starts),
            jnp.full(many, jnp.inf, starts.dtype),
            starts,
            jnp.full(many, jnp.inf, starts.dtype),
            jnp.zeros(many, bool),
        ),
    )
    return end.best, end.lowest, end.evaluations


def scattered_starts(
    last: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"],
    key: UInt32[Array, "2"],
    count: int,
    spread: float,
) -> Float[Array, "m N"]:
    """N starts: the last solution, and normally distributed points around it, within the bounds.

    Args:
        last: (m,) solution of the last frame [rad].
        limits: (m, 2) bounds.
        key: two random words for this frame.
        count: N.
        spread: standard deviation [rad].
    """
    normals = counter_normal_matrix(jnp.arange(count, dtype=jnp.uint32), key, len(limits))
    moved = last[:, None] + spread * normals * (jnp.arange(count) > 0)
    low, high = (jnp.asarray(limits[:, i, None], last.dtype) for i in (0, 1))
    return jnp.clip(moved, low, high)


def soft_mean(
    outputs: Float[AnyKind, "m N"], costs: Float[AnyKind, " N"], temperature: float
) -> Float[AnyKind, " m"]:
    """Mean of the outputs, weighted by the softmax of -cost / temperature.

    An output whose cost is not finite has no weight; if no cost is finite, the mean is not either.
    """
    xp = array_namespace(costs)
    finite = xp.isfinite(costs)
    costs = xp.where(finite, costs, xp.inf)
    weights = xp.where(finite, xp.exp(-(costs - costs.min()) / temperature), 0.0)
    outputs = xp.where(weights > 0, outputs, 0.0)
    mean: AnyKind = (outputs * weights).sum(axis=-1) / weights.sum()
    return mean


SPREAD: Final = 0.2
"""Standard deviation of parallel starts around the last solution [rad], as for the sampler."""

TEMPERATURE: Final = 0.1
"""Temperature of the softmax over the outputs, as for the sampler."""

NEWTON_CONFIG: Final = NewtonConfig(10, (0.0, 0.1, 1.0, 10.0, 100.0, 1000.0))
"""DexPilot's closed pinches have weights of 200 and 400, so the loss is far from convex there, and
less damping would find no descent."""

_FEW: Final = 64
"""Largest number of starts for the small gradient program, which compiles in a second. The unrolled
program for more starts takes eight seconds to compile, and a sixth of the time to run."""

Knobs: TypeAlias = Float[Array, " k"]
"""Tuned settings. They are arguments of the compiled program, so all values share one program."""


@dataclass(frozen=True)
class Starts:
    """Starts of a descent.

    Attributes:
        count: N; with 1, only the last solution.
        spread: standard deviation of the other starts around it [rad].
        temperature: temperature of the softmax over their results.
    """

    count: int = 1
    spread: float = SPREAD
    temperature: float = TEMPERATURE

    def __str__(self) -> str:
        return "" if self.count == 1 else f" × {self.count}"


class Solver(ABC):
    """A solver with its settings; frozen.

    Attributes:
        family: sampling, rmsprop, slsqp or newton.
    """

    family: ClassVar[str]

    @property
    @abstractmethod
    def label(self) -> str:
        """Name in tables and figures."""

    @property
    @abstractmethod
    def random(self) -> bool:
        """True if the result depends on a seed."""

    @property
    @abstractmethod
    def effort(self) -> float:
        """Approximate time of a frame on two cores [ms], to estimate the remaining time."""


class CompiledSolver(Solver):
    """Solver whose frame is a compiled program."""

    @property
    def knobs(self) -> tuple[float, ...]:
        """Values of the settings that are arguments of the program."""
        return ()

    def program_key(self) -> CompiledSolver:
        """The solver with default knobs; solvers with equal keys share a program."""
        return self

    @abstractmethod
    def solve(
        self,
        objective: SampledObjective,
        goal: FrameGoal,
        last: Float[Array, " m"],
        key: UInt32[Array, "2"],
        knobs: Knobs,
    ) -> tuple[Float[Array, " m"], Int[Array, ""]]:
        """Solution of a frame, and its number of iterations or evaluations; traceable."""


@dataclass(frozen=True)
class Sampling(CompiledSolver):
    """Algorithm 1.

    Attributes:
        samples, elites, cycles, sigma: N, M, L and the initial standard deviation [rad].
        most_cycles: L that the program is compiled for.
        note: text that follows the name.
    """

    samples: int = 8192
    cycles: int = 20
    sigma: float = 0.2
    elites: int = 128
    most_cycles: int = 20
    note: str = ""
    family: ClassVar[str] = "sampling"
    random = True

    @property
    def label(self) -> str:
        """See ``Solver``."""
        return f"sampling{self.note}"

    @property
    def effort(self) -> float:
        """Proportional to the number of candidates."""
        return 3e-5 * self.samples * self.cycles + 0.05 * self.cycles

    @property
    def knobs(self) -> tuple[float, ...]:
        """Initial deviation, and number of cycles."""
        return (self.sigma, float(self.cycles))

    def program_key(self) -> Sampling:
        """Without them."""
        return replace(self, sigma=0.2, cycles=self.most_cycles, note="")

    def solve(
        self,
        objective: SampledObjective,
        goal: FrameGoal,
        last: Float[Array, " m"],
        key: UInt32[Array, "2"],
        knobs: Knobs,
    ) -> tuple[Float[Array, " m"], Int[Array, ""]]:
        """See ``CompiledSolver``."""
        config = SamplingConfig(self.samples, min(self.elites, self.samples), self.most_cycles)
        cycles = knobs[1].astype(jnp.int32)
        limits = objective.hand.limits
        q = sample_minimise(
            lambda c: objective(c, goal), last, limits, key, config, knobs[0], cycles
        )
        return q, cycles


class _FromStarts(Solver):
    """Solvers that descend from one start or several."""

    name: ClassVar[str]
    starts: Starts

    @property
    def label(self) -> str:
        """Name with the number of starts."""
        return f"{self.name}{self.starts}"

    @property
    def random(self) -> bool:
        """True if there are other starts than the last solution."""
        return self.starts.count > 1

    def all_starts(
        self, objective: SampledObjective, last: Float[Array, " m"], key: UInt32[Array, "2"]
    ) -> Float[Array, "m N"]:
        """All starts of a frame."""
        limits = objective.hand.limits
        return scattered_starts(last, limits, key, self.starts.count, self.starts.spread)


@dataclass(frozen=True)
class Rmsprop(_FromStarts, CompiledSolver):
    """RMSProp, single-start or in the batched form."""

    config: RmspropConfig = field(default_factory=RmspropConfig)
    starts: Starts = field(default_factory=Starts)
    name: ClassVar[str] = "RMSProp"
    family: ClassVar[str] = "rmsprop"

    @property
    def effort(self) -> float:
        """Proportional to the number of evaluations."""
        return self.config.max_evaluations * (0.02 + 5e-4 * self.starts.count)

    @property
    def knobs(self) -> tuple[float, ...]:
        """Learning rates."""
        return (self.config.step, self.config.final)

    def program_key(self) -> Rmsprop:
        """Without them."""
        return replace(self, config=replace(self.config, step=0.01, final=0.01))

    def solve(
        self,
        objective: SampledObjective,
        goal: FrameGoal,
        last: Float[Array, " m"],
        key: UInt32[Array, "2"],
        knobs: Knobs,
    ) -> tuple[Float[Array, " m"], Int[Array, ""]]:
        """See ``CompiledSolver``."""
        both = _few_gradients if self.starts.count <= _FEW else _many_gradients
        solution, costs, evaluations = rmsprop_minimise(
            lambda q: both(objective, goal, q),
            self.all_starts(objective, last, key),
            objective.hand.limits,
            self.config,
            knobs[0],
            knobs[1],
        )
        return soft_mean(solution, costs, self.starts.temperature), evaluations


@dataclass(frozen=True)
class Newton(_FromStarts, CompiledSolver):
    """Projected Newton steps with the exact Hessian; this solver is ours, not the paper's.

    The number of steps is fixed; steps that no longer gain are cheap and change nothing.
    """

    config: NewtonConfig = NEWTON_CONFIG
    starts: Starts = field(default_factory=Starts)
    name: ClassVar[str] = "Newton"
    family: ClassVar[str] = "newton"

    @property
    def effort(self) -> float:
        """Proportional to the number of Hessians."""
        return 0.5 * (1 + self.starts.count)

    def solve(
        self,
        objective: SampledObjective,
        goal: FrameGoal,
        last: Float[Array, " m"],
        key: UInt32[Array, "2"],
        knobs: Knobs,
    ) -> tuple[Float[Array, " m"], Int[Array, ""]]:
        """See ``CompiledSolver``."""

        def descend(q: Array) -> tuple[Array, Array]:
            return newton_minimise(
                lambda one: objective.value_grad_hess(one, goal),
                q,
                objective.hand.limits,
                self.config,
            )[:2]

        many = self.all_starts(objective, last, key)
        solution, costs = jax.vmap(descend, in_axes=1, out_axes=(1, 0))(many)
        mean = soft_mean(solution, costs, self.starts.temperature)
        return mean, jnp.int32(self.config.iterations)


@dataclass(frozen=True)
class Slsqp(_FromStarts):
    """SLSQP, single-start or from N starts one after the other: it runs on the host.

    It is NLopt's, until it gains no more, or SciPy's with the limit of the paper's authors.
    """

    config: NloptConfig | SlsqpConfig = field(default_factory=NloptConfig)
    starts: Starts = field(default_factory=Starts)
    name: ClassVar[str] = "SLSQP"
    family: ClassVar[str] = "slsqp"

    @property
    def label(self) -> str:
        """Name with the limit of iterations, if there is one, and the number of starts."""
        limited = isinstance(self.config, SlsqpConfig)
        return f"{self.name}, published limit{self.starts}" if limited else super().label

    @property
    def effort(self) -> float:
        """Proportional to the number of starts."""
        return 2.5 * self.starts.count

    def minimise(
        self,
        objective: ValueAndGradient,
        start: Float[np.ndarray, " m"],
        limits: Float[np.ndarray, "m 2"],
    ) -> SlsqpResult:
        """Minimises from one start."""
        if isinstance(self.config, SlsqpConfig):
            return slsqp_minimise(objective, start, limits, self.config)
        return nlopt_minimise(objective, start, limits, self.config)


def _many_gradients(
    objective: SampledObjective, goal: FrameGoal, q: Float[Array, "m N"]
) -> tuple[Float[Array, " N"], Float[Array, "m N"]]:
    def total(rows: list[Array]) -> tuple[Array, Array]:
        costs = objective(rows, goal)
        return costs.sum(), costs

    rows = [q[i] for i in range(q.shape[0])]
    (_, costs), gradient = jax.value_and_grad(total, has_aux=True)(rows)
    return costs, jnp.stack(gradient)


def _few_gradients(
    objective: SampledObjective, goal: FrameGoal, q: Float[Array, "m N"]
) -> tuple[Float[Array, " N"], Float[Array, "m N"]]:
    def one(point: Array) -> tuple[Array, Array]:
        cost, gradient, _ = objective.value_grad_hess(point, goal)
        return cost, gradient

    costs, gradients = jax.vmap(one, in_axes=1, out_axes=(0, 1))(q)
    return costs, gradients


def slsqp_objective(objective: SampledObjective) -> Callable[[Array, FrameGoal], Array]:
    """Maps joint positions (m,) and a goal to value and gradient in one array; traceable."""

    def both(q: Array, goal: FrameGoal) -> Array:
        cost, gradient, _ = objective.value_grad_hess(q, goal)
        return jnp.concatenate([cost[None], gradient])

    return both

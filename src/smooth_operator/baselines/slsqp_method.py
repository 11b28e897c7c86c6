"""DexPilot, AKO, the keyvector method and its hybrid: SLSQP minimises an objective in each frame.

SLSQP is sequential least-squares quadratic programming (Kraft 1988) within bounds, by SciPy. The
published methods use at most 20 iterations. If the limit ends a frame, the result is not a minimum,
and the next frame continues from it, so the limit acts as a filter.

Preset ``published`` uses SLSQP alone, with the settings of the paper's authors. Preset ``fast``
first makes Newton steps in the compiled program; SLSQP continues from their result, unless it is a
minimum. The methods differ only in targets, penalties, weights and starting point.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from smooth_operator.baselines.ako import AkoObjectiveConfig, AkoTargets
from smooth_operator.baselines.joint_angle import JointAngleMap, PublishedAngles
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.method import (
    Compiling,
    Method,
    MethodOutput,
    ObjectiveMethodConfig,
)
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator.retargeting.program import (
    FrameResult,
    FrameState,
    Program,
    RetargetState,
    align_frame,
    packed_result,
)
from smooth_operator.retargeting.sbr.newton import NewtonConfig, newton_minimise
from smooth_operator.retargeting.sbr.published import (
    DexPilotTargets,
    ObjectiveConfig,
    PlainTargets,
)
from smooth_operator.retargeting.sbr.sampled import SampledObjective
from smooth_operator.retargeting.targets import Targets
from smooth_operator.settings import check_choice, check_numbers
from smooth_operator.types import Status

ValueAndGradient: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""Function from (m,) float64 to (1 + m,): the value, followed by the gradient."""


@dataclass(frozen=True)
class SlsqpConfig:
    """Stopping conditions of SLSQP.

    Attributes:
        tolerance: smallest change of the objective in an iteration.
        max_iterations: largest number of iterations per frame; each is a quadratic subproblem and
            a line search with one or more evaluations.
    """

    tolerance: float = 1e-6
    max_iterations: int = 20

    def __post_init__(self) -> None:
        check_numbers(self, positive=("tolerance", "max_iterations"))


class SlsqpResult(NamedTuple):
    """Result of SLSQP.

    Attributes:
        x: (m,) the point, within the bounds.
        value: objective at the point; NaN if it is not finite.
        evaluations: number of evaluations of the objective.
    """

    x: Float[np.ndarray, " m"]
    value: float
    evaluations: int


def slsqp_minimise(
    objective: ValueAndGradient,
    start: Float[np.ndarray, " m"],
    limits: Float[np.ndarray, "m 2"],
    config: SlsqpConfig,
) -> SlsqpResult:
    """Minimises an objective within (m, 2) bounds with SLSQP, from a start that is clipped to the
    bounds. Returns the last point, as the published code does."""
    from scipy.optimize import minimize  # here, since the import takes half a second

    low, high = limits[:, 0], limits[:, 1]

    def evaluate(x: np.ndarray) -> tuple[float, np.ndarray]:
        both = objective(x).astype(np.float64)
        return float(both[0]), both[1:]

    solution = minimize(
        evaluate,
        np.clip(np.asarray(start, np.float64), low, high),
        jac=True,
        method="SLSQP",
        bounds=np.stack([low, high], axis=1),
        tol=config.tolerance,
        options={"maxiter": config.max_iterations},
    )
    x = np.clip(np.asarray(solution.x, np.float64), low, high)
    value = float(solution.fun)
    finite = math.isfinite(value) and bool(np.isfinite(x).all())
    return SlsqpResult(x, value if finite else math.nan, solution.nfev)


@dataclass(frozen=True)
class SlsqpMethodConfig(ObjectiveMethodConfig):
    """Settings of a method that is solved by SLSQP.

    Attributes:
        alignment: alignment of human landmarks to the palm frame.
        objective: targets, loss and weights.
        solver: stopping conditions of SLSQP.
        start: start of the search: ``previous`` for the last command, or ``published_angles`` for
            the joint angles of the paper's authors; those of ``joint_angle`` on other hands.
        approach: Newton steps before SLSQP; without iterations, SLSQP alone.
        optimality: largest component of the gradient within the limits at which the result of the
            Newton steps counts as a minimum, so that SLSQP is left out.
    """

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    solver: SlsqpConfig = field(default_factory=SlsqpConfig)
    start: Literal["previous", "published_angles"] = "previous"
    approach: NewtonConfig = field(default_factory=lambda: NewtonConfig(iterations=0))
    optimality: float = 1e-4

    def __post_init__(self) -> None:
        check_numbers(self)
        check_choice(self, "start", ("previous", "published_angles"))

    def build(self, hand: Hand) -> SlsqpMethod:
        """Builds the method for one hand. Raises SmoothOperatorError if the hand lacks points or a
        joint-angle map that the method needs."""
        method = SlsqpMethod(hand, self)
        _ = method.needs  # raises its errors here
        return method


class SlsqpMethodState(NamedTuple):
    """State of the method between frames.

    Attributes:
        q: (m,) last command of the actuated joints [rad].
        targets: state of the target policy.
    """

    q: Float[np.ndarray, " m"]
    targets: Any


class SlsqpProblem(NamedTuple):
    """Optimisation problem of one frame. It is packed into few arrays, because each array costs 2
    to 5 us.

    Attributes:
        targets: vectors and weights of the frame.
        start: (m,) start of SLSQP [rad].
        optimality: (2,) objective at the start, and the largest free component of its gradient (KKT
            residual); NaN without Newton steps.
        policy: state of the target policy after this frame.
    """

    targets: Targets
    start: Float[Array, " m"]
    optimality: Float[Array, "2"]
    policy: Any


class SlsqpMethod(Method):
    """A retargeting method that minimises its objective with SLSQP, for one hand. The steps before
    the solver are compiled; the solver runs in plain Python."""

    on_host = True

    def __init__(self, hand: Hand, config: SlsqpMethodConfig) -> None:
        self.hand, self.config = hand, config
        self._compiling: Compiling = lambda function, _: jax.jit(function)

    def program(self, alignment: AlignmentConfig, compiling: Compiling) -> Program:
        """Returns the program of one frame; ``compiling`` is the function that compiles its
        parts."""

        def prepare(state: Any, landmarks: Array, valid: Array, ticks: Array) -> tuple[Any, Array]:
            frame = align_frame(self, alignment, landmarks, valid)
            result = packed_result(frame.status, frame.scale)
            return self.prepare(state, frame.aligned, ticks), result

        self._compiling, before = compiling, compiling(prepare, "frame")

        def run(
            state: RetargetState, landmarks: np.ndarray, valid: np.ndarray, ticks: np.uint32
        ) -> tuple[RetargetState, FrameResult]:
            problem, flat = before(state.method, landmarks, valid, ticks)
            code, scale = np.asarray(flat).tolist()
            if code != Status.OK:
                return state, FrameResult(state.trees.q, int(code), np.nan, scale)
            after, output = self.solve(state.method, problem)
            loss = float(output.tracking_loss)
            if not np.isfinite(output.q).all():
                return state, FrameResult(state.trees.q, Status.SOLVER_FAILED, loss, scale)
            state = RetargetState.of(FrameState(after, np.asarray(output.q)))
            return state, FrameResult(output.q, int(code), loss, scale)

        return run

    def step(
        self, state: SlsqpMethodState, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[SlsqpMethodState, MethodOutput]:
        """Computes one frame on the host; not traceable."""
        return self.solve(state, self.prepare(state, aligned, ticks))

    @cached_property
    def objective(self) -> SampledObjective:
        """The objective that the method minimises."""
        return SampledObjective(self.hand, self.config.objective)

    @cached_property
    def joint_angles(self) -> JointAngleMap | PublishedAngles | None:
        """Joint-angle map that provides the start of the search; None to start from the previous
        command."""
        if self.config.start == "previous":
            return None
        fits = PublishedAngles.fits(self.hand)
        return PublishedAngles(self.hand) if fits else JointAngleMap(self.hand)

    @cached_property
    def needs(self) -> tuple[int, ...]:
        """Indices of the landmarks that the vectors use, and of those that the joint-angle map uses
        if the search starts from it."""
        angles = () if self.joint_angles is None else self.joint_angles.needs
        return tuple(sorted({*self.objective.layout.landmarks, *angles}))

    @cached_property
    def evaluate(self) -> Callable[[Float[np.ndarray, " n"]], Float[Array, " 1+m"]]:
        """Compiled function that computes value and gradient from a ``packed`` point and goal.
        Arguments and results are one array each, because each array costs 2 to 5 us."""
        count, joints = len(self.objective.layout.vectors), len(self.hand.neutral)
        ends = np.cumsum([joints, 3 * count, count, joints])

        def both(point: Array) -> Array:
            q, vectors, weights, previous, velocity = jnp.split(point, ends)
            goal = FrameGoal(vectors.reshape(count, 3), weights, previous, velocity[0])
            value, gradient = jax.value_and_grad(lambda q: self.objective(list(q), goal))(q)
            return jnp.concatenate([value[None], gradient])

        evaluate = self._compiling(both, "evaluate")
        # compile at the first frame, even if SLSQP is not needed before a later one
        evaluate(np.zeros(ends[-1] + 1, np.float32))
        return evaluate

    def packed(self, q: Float[np.ndarray, " m"], goal: FrameGoal) -> Float[np.ndarray, " n"]:
        """Packs joint positions and a goal into the single array that ``evaluate`` takes."""
        parts = (q, goal.vectors, goal.weights, goal.previous, goal.velocity_weight)
        return np.concatenate([np.ravel(np.asarray(part, np.float32)) for part in parts])

    def init(self, seed: int) -> SlsqpMethodState:
        """State with the neutral pose; the seed is not used."""
        return SlsqpMethodState(
            np.asarray(self.hand.neutral, np.float32),
            self.config.objective.targets.init(self.objective.layout),
        )

    def latched(self, state: SlsqpMethodState) -> Bool[Array, " P"] | None:
        """(F - 1,) True for fingers that are latched to the thumb; None without latches."""
        return self.config.objective.targets.latched(state.targets)

    def prepare(
        self, state: SlsqpMethodState, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> SlsqpProblem:
        """Computes the targets of the frame and the point at which SLSQP starts."""
        del ticks
        config, layout = self.config.objective, self.objective.layout
        targets, policy_state = config.targets(state.targets, layout, layout.human(aligned))
        previous = jnp.asarray(state.q)
        start = previous if self.joint_angles is None else self.joint_angles.positions(aligned)
        targets = Targets(targets.vectors, targets.weights.astype(jnp.float32))
        goal = FrameGoal(*targets, previous, jnp.float32(config.velocity_weight))
        optimality = jnp.full(2, jnp.nan, jnp.float32)
        if self.config.approach.iterations:
            low, high = (jnp.asarray(side, jnp.float32) for side in self.hand.limits.T)
            start, cost, gradient = newton_minimise(
                lambda q: self.objective.value_grad_hess(q, goal),
                jnp.clip(start, low, high),
                self.hand.limits,
                self.config.approach,
            )
            free = jnp.clip(start - gradient, low, high) - start
            optimality = jnp.stack([cost, jnp.abs(free).max()])
        return SlsqpProblem(targets, start, optimality, policy_state)

    def solve(
        self, state: SlsqpMethodState, problem: SlsqpProblem
    ) -> tuple[SlsqpMethodState, MethodOutput]:
        """Minimises with SLSQP, unless the start is a minimum."""
        evaluate = self.evaluate  # compiles at the first frame
        start = np.asarray(problem.start)
        velocity_weight = self.config.objective.velocity_weight
        on_host = FrameGoal(*problem.targets, np.asarray(state.q), velocity_weight)
        value, residual = np.asarray(problem.optimality).tolist()
        if residual <= self.config.optimality:
            x = start.astype(np.float64)
        else:
            point = self.packed(start, on_host)

            def objective(q: np.ndarray) -> np.ndarray:
                point[: len(q)] = q
                return np.asarray(evaluate(point))

            x, value, _ = slsqp_minimise(objective, start, self.hand.limits, self.config.solver)
        q = x.astype(np.float32)
        regular = float(self.objective.regularisation(x, on_host).cost)
        after = SlsqpMethodState(q, problem.policy)
        if not math.isfinite(value):  # the frame gets the status SOLVER_FAILED
            q = np.full_like(q, np.nan)
        return after, MethodOutput(q, np.float32(value - regular))


def _published(
    objective: ObjectiveConfig,
    *,
    tolerance: float = 1e-6,
    start: Literal["previous", "published_angles"] = "previous",
) -> SlsqpMethodConfig:
    """Settings of the authors: SciPy's SLSQP, at most 20 iterations a frame."""
    return SlsqpMethodConfig(
        objective=objective,
        solver=SlsqpConfig(tolerance=tolerance, max_iterations=20),
        start=start,
    )


_FIVE_VECTORS: Final = ObjectiveConfig(
    targets=PlainTargets(w_thumb=0.0, w_between=0.0),
    loss="squared",
    pose_weight=0.0,
    velocity_weight=0.0,
)

KEYVECTOR: Final = _published(_FIVE_VECTORS)
"""The keyvector method of the paper's authors: squared errors of the vectors from wrist to tips."""

HYBRID: Final = _published(_FIVE_VECTORS, start="published_angles")
"""The hybrid of mimic-one (Nava et al. 2025): ``KEYVECTOR``, from the authors' joint angles."""

DEXPILOT: Final = _published(
    ObjectiveConfig(
        targets=DexPilotTargets(
            project=0.03, escape=0.05, eta1=5e-3, eta2=0.03, w_set1=200.0, w_set2=400.0
        ),
        pose_weight=2.5e-3,
        pose_centre="zero",
        velocity_weight=0.0,
    )
)
"""DexPilot (Handa et al. 2019) with the paper's numbers; the pose term pulls to zero angles."""

AKO: Final = _published(
    AkoObjectiveConfig(targets=AkoTargets(), pose_weight=0.0, velocity_weight=0.1),
    tolerance=1e-5,
)
"""Analyzing Key Objectives (Xin et al. 2025)."""


def _fast(
    config: SlsqpMethodConfig, approach: NewtonConfig, optimality: float
) -> SlsqpMethodConfig:
    """Newton steps on the same objective first, then SLSQP up to a minimum if necessary."""
    solver = SlsqpConfig(tolerance=1e-9, max_iterations=100)
    return replace(config, approach=approach, optimality=optimality, solver=solver)


_EIGHT_STEPS: Final = NewtonConfig(iterations=8)
_SQUARED_DAMPING: Final = (0.0, 0.001, 0.01, 0.1)
"""Damping for a squared error in metres, whose Hessian is small. Without pose and velocity terms,
it is zero in some directions."""

KEYVECTOR_PRESETS: Final = {
    "published": KEYVECTOR,
    "fast": _fast(KEYVECTOR, NewtonConfig(8, _SQUARED_DAMPING), 1e-5),
}
HYBRID_PRESETS: Final = {
    "published": HYBRID,
    # its start is farther from the minimum than the last command
    "fast": _fast(HYBRID, NewtonConfig(20, _SQUARED_DAMPING), 1e-5),
}
DEXPILOT_PRESETS: Final = {"published": DEXPILOT, "fast": _fast(DEXPILOT, _EIGHT_STEPS, 1e-4)}
AKO_PRESETS: Final = {"published": AKO, "fast": _fast(AKO, _EIGHT_STEPS, 1e-4)}

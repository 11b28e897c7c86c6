"""Optimisation-based methods: an objective that SLSQP minimises from a warm start.

Newton steps in the compiled program come first: they have the objective's exact Hessian, which
SLSQP estimates again in every frame. SLSQP continues from their result, unless that is a minimum.

DexPilot, AKO, the keyvector method and its hybrid with joint angles differ only in their targets,
weights and starting point. AKO is "Analyzing Key Objectives" (Xin et al. 2025): the nearer a finger
is to the thumb, the less its wrist vectors count, by a sigmoid instead of DexPilot's latch.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from smooth_operator.baselines.joint_angle import JointAngleMap, PublishedAngles
from smooth_operator.baselines.slsqp import (
    ScipySlsqpConfig,
    SlsqpConfig,
    ValueAndGradient,
    scipy_slsqp_minimise,
    slsqp_minimise,
)
from smooth_operator.compilation.compiled_program import compiled
from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.landmarks import WRIST
from smooth_operator.methods.host_method import HostMethod
from smooth_operator.methods.method import Compiling, MethodOutput, ObjectiveMethodConfig
from smooth_operator.objective.keyvectors import VectorLayout, tips_of
from smooth_operator.objective.published import (
    DexPilotTargets,
    ObjectiveConfig,
    PlainTargets,
    StatelessTargets,
)
from smooth_operator.objective.sampled import SampledObjective
from smooth_operator.objective.targets import Targets
from smooth_operator.objective.terms import FrameGoal
from smooth_operator.settings import check_choice, check_numbers
from smooth_operator.solvers.newton import NewtonConfig, newton_minimise


@dataclass(frozen=True)
class SlsqpMethodConfig(ObjectiveMethodConfig):
    """Settings of a method that is solved by SLSQP.

    Attributes:
        alignment: alignment of human landmarks to the palm frame.
        objective: targets, loss and weights.
        solver: implementation of SLSQP and its stopping conditions: NLopt's (``SlsqpConfig``) or
            SciPy's (``ScipySlsqpConfig``).
        start: start of the search: the ``previous`` command; the ``joint_angle`` method's command
            for the frame; or the joint angles of the paper's authors (``published_angles``), which
            exist for the joints of the mimic hand, and are ``joint_angle`` for another hand.
        approach: Newton steps before SLSQP; without iterations, SLSQP alone.
    """

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    solver: SlsqpConfig | ScipySlsqpConfig = field(
        default_factory=lambda: SlsqpConfig(optimality=1e-4)
    )
    start: Literal["previous", "joint_angle", "published_angles"] = "previous"
    approach: NewtonConfig = field(default_factory=lambda: NewtonConfig(iterations=5))

    def __post_init__(self) -> None:
        check_choice(self, "start", ("previous", "joint_angle", "published_angles"))

    def build(self, hand: Hand) -> SlsqpMethod:
        """The method for one hand.

        Raises:
            ConfigError: the hand lacks points that the targets need.
            SmoothOperatorError: the start needs a map of joint angles that the hand does not have.
        """
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
    """Optimisation problem of one frame; in few arrays, since each costs 2 to 5 us per frame.

    Attributes:
        targets: vectors and weights of the frame.
        start: (m,) start of SLSQP [rad].
        optimality: (2,) objective at the start, and the largest component of its gradient that the
            limits leave free (the KKT residual); NaN without Newton steps.
        policy: state of the target policy after this frame.
    """

    targets: Targets
    start: Float[Array, " m"]
    optimality: Float[Array, "2"]
    policy: Any


@dataclass(frozen=True, eq=False)
class SlsqpMethod(HostMethod):
    """A method solved by SLSQP, for one hand."""

    hand: Hand
    config: SlsqpMethodConfig
    compiling: Compiling | None = field(default=None, init=False, repr=False)

    def compile_with(self, compiling: Compiling) -> None:
        """Set the function that compiles ``evaluate``."""
        object.__setattr__(self, "compiling", compiling)

    @cached_property
    def objective(self) -> SampledObjective:
        """The minimised objective."""
        return SampledObjective(self.hand, self.config.objective)

    @cached_property
    def joint_angles(self) -> JointAngleMap | PublishedAngles | None:
        """Map that gives the start of the search; None for the previous command."""
        if self.config.start == "previous":
            return None
        if self.config.start == "published_angles" and PublishedAngles.fits(self.hand):
            return PublishedAngles(self.hand)
        return JointAngleMap(self.hand)

    @cached_property
    def needs(self) -> tuple[int, ...]:
        """Landmarks of the vectors, and of the joint angles if they give the start."""
        angles = () if self.joint_angles is None else self.joint_angles.needs
        return tuple(sorted({*self.objective.layout.landmarks, *angles}))

    @cached_property
    def evaluate(self) -> Callable[[Float[np.ndarray, " n"]], Float[Array, " 1+m"]]:
        """Compiled function from a ``packed`` point and goal to value and gradient.

        It has one array in and one out, since each costs 2 to 5 us per call. It uses the unrolled
        kinematics, which takes 2 s longer to compile than the small program of
        ``Objective.value_grad_hess``, and a third of its time to run.
        """
        count, joints = len(self.objective.layout.vectors), len(self.hand.neutral)
        ends = np.cumsum([joints, 3 * count, count, joints])

        def both(point: Array) -> Array:
            q, vectors, weights, previous, velocity = jnp.split(point, ends)
            goal = FrameGoal(vectors.reshape(count, 3), weights, previous, velocity[0])
            value, gradient = jax.value_and_grad(lambda q: self.objective(list(q), goal))(q)
            return jnp.concatenate([value[None], gradient])

        compiling = self.compiling
        evaluate = compiled(both) if compiling is None else compiling(both, "evaluate")
        # compile at the first frame, also if SLSQP is first needed at a later one
        evaluate(np.zeros(ends[-1] + 1, np.float32))
        return evaluate

    def packed(self, q: Float[np.ndarray, " m"], goal: FrameGoal) -> Float[np.ndarray, " n"]:
        """Joint positions, followed by a goal, in the one array that ``evaluate`` takes."""
        parts = (q, goal.vectors, goal.weights, goal.previous, goal.velocity_weight)
        return np.concatenate([np.ravel(np.asarray(part, np.float32)) for part in parts])

    def init(self, seed: int) -> SlsqpMethodState:
        """Neutral pose, and the first state of the target policy; the seed is not used."""
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
        """Targets of the frame, and start of SLSQP."""
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
        """Minimise by SLSQP, unless the start is a minimum."""
        evaluate, solver = self.evaluate, self.config.solver  # compiles at the first frame
        start = np.asarray(problem.start)
        velocity_weight = self.config.objective.velocity_weight
        on_host = FrameGoal(*problem.targets, np.asarray(state.q), velocity_weight)
        value, residual = np.asarray(problem.optimality).tolist()
        if isinstance(solver, SlsqpConfig) and residual <= solver.optimality:
            x = start.astype(np.float64)
        else:
            point = self.packed(start, on_host)

            def objective(q: np.ndarray) -> np.ndarray:
                point[: len(q)] = q
                return np.asarray(evaluate(point))

            x, value = self._slsqp(objective, start)
        q = x.astype(np.float32)
        regular = float(self.objective.regularisation(x, on_host))
        after = SlsqpMethodState(q, problem.policy)
        if not math.isfinite(value):  # the frame gets the status SOLVER_FAILED
            q = np.full_like(q, np.nan)
        return after, MethodOutput(q, np.float32(value - regular))

    def _slsqp(
        self, objective: ValueAndGradient, start: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, " m"], float]:
        """Result of SLSQP from a start, and the objective there."""
        solver, limits = self.config.solver, self.hand.limits
        if isinstance(solver, SlsqpConfig):
            result = slsqp_minimise(objective, start, limits, solver)
        else:
            result = scipy_slsqp_minimise(objective, start, limits, solver)
        return result.x, result.value


@dataclass(frozen=True)
class PinchLayout(VectorLayout):
    """Vectors wrist to tip (F), thumb tip to other tip (F - 1), and last joint to tip (F).

    Attributes:
        fingers: human finger names, thumb first.
    """

    fingers: tuple[str, ...]

    @cached_property
    def vectors(self) -> tuple[tuple[int | None, int], ...]:
        """(K,) (from, to) landmark indices."""
        tips = tips_of(self.fingers)
        return (
            *((WRIST, tip) for tip in tips),
            *((tips[0], tip) for tip in tips[1:]),
            *((tip - 1, tip) for tip in tips),
        )


@dataclass(frozen=True)
class AkoTargets(StatelessTargets[PinchLayout]):
    """Targets and weights of AKO.

    Attributes:
        w_thumb_wrist: weight of wrist to thumb tip, before switching.
        w_wrist: weight of wrist to each other tip, before switching.
        w_pinch: weight of thumb tip to each other tip.
        w_distal: weight of last joint to tip, which determines the direction of the pad.
        switch_distance: thumb-to-tip distance at which a switched vector has half its weight [m].
            The finger nearest to the thumb switches all wrist vectors.
        switch_scale: steepness of the switch [1/m].
        contact: distance below which the target of a pinch is closed [m].
        release: distance from which on the pinch vector is the human's own [m]; in between, the
            target length rises from 0 at ``contact``.
        switch_pinch: True fades each pinch vector with the distance from the thumb, as published.
            With False, pinches close further and directions are nearer to the human's:
            docs/reference/methods.md.
    """

    w_thumb_wrist: float = 10.0
    w_wrist: float = 1.0
    w_pinch: float = 10.0
    w_distal: float = 10.0
    switch_distance: float = 0.02
    switch_scale: float = 10.0
    contact: float = 0.01
    release: float = 0.02
    switch_pinch: bool = False

    def __post_init__(self) -> None:
        lengths = ("switch_distance", "switch_scale", "release")
        weights = ("w_thumb_wrist", "w_wrist", "w_pinch", "w_distal", "contact")
        check_numbers(self, "targets.", positive=lengths, not_negative=weights)
        if not self.contact < self.release:
            raise ConfigError(
                f"pinch distances must satisfy 0 <= contact < release, not contact={self.contact}, "
                f"release={self.release} [m]"
            )

    def layout(self, fingers: tuple[str, ...]) -> PinchLayout:
        """AKO's vectors."""
        return PinchLayout(fingers)

    def __call__(
        self, state: tuple[()], layout: PinchLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, tuple[()]]:
        """Targets of one frame."""
        fingers = len(layout.fingers)
        pinch = slice(fingers, 2 * fingers - 1)
        distance = jnp.linalg.norm(human[pinch], axis=-1)
        open_share = jax.nn.sigmoid(self.switch_scale * (distance - self.switch_distance))
        wrist = jnp.full(fingers, self.w_wrist, human.dtype).at[0].set(self.w_thumb_wrist)
        # 2 (d - contact) for the published 10 and 20 mm
        slope = self.release / (self.release - self.contact)
        length = jnp.where(
            distance >= self.release, distance, slope * jnp.maximum(distance - self.contact, 0.0)
        )
        scaled = human[pinch] * (length / jnp.maximum(distance, 1e-9))[:, None]
        weights = jnp.concatenate(
            [
                wrist * open_share.min(),
                self.w_pinch * (1 - open_share if self.switch_pinch else jnp.ones_like(open_share)),
                jnp.full(fingers, self.w_distal, human.dtype),
            ]
        )
        return Targets(human.at[pinch].set(scaled), weights), state


@dataclass(frozen=True)
class TipLayout(VectorLayout):
    """Vectors from the origin of the palm frame to each fingertip.

    Attributes:
        fingers: human finger names, thumb first.
    """

    fingers: tuple[str, ...]

    @cached_property
    def vectors(self) -> tuple[tuple[int | None, int], ...]:
        """(F,) (origin, tip)."""
        return tuple((None, tip) for tip in tips_of(self.fingers))


@dataclass(frozen=True)
class TipTargets(StatelessTargets[TipLayout]):
    """Targets at the human's fingertip positions in the palm frame.

    Attributes:
        beta: scale of the human positions.
    """

    beta: float = 1.0

    def __post_init__(self) -> None:
        check_numbers(self, "targets.", positive=("beta",))

    def layout(self, fingers: tuple[str, ...]) -> TipLayout:
        """Vectors from the palm's origin to each tip."""
        return TipLayout(fingers)

    def __call__(
        self, state: tuple[()], layout: TipLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, tuple[()]]:
        """Targets of one frame."""
        return Targets(human * self.beta, jnp.ones(len(human), human.dtype)), state


KEYVECTOR: Final = SlsqpMethodConfig(
    objective=ObjectiveConfig(targets=PlainTargets(), pose_weight=2.5e-3, velocity_weight=0.0)
)
"""All keyvectors follow the human's, by SLSQP from the last command.

Smooth-L1 in units of its transition and a tolerance of 1e-6 leave no dead band: the hand moves in
every frame in which the human's moves.
"""

KEYVECTOR_VECTOR: Final = replace(
    KEYVECTOR,
    objective=ObjectiveConfig(
        targets=PlainTargets(w_thumb=0.0, w_between=0.0), pose_weight=0.0, velocity_weight=4e-3
    ),
)
"""``vector`` as in dex-retargeting: wrist-to-tip vectors, regularised to the last command."""

KEYVECTOR_POSITION: Final = replace(
    KEYVECTOR,
    objective=ObjectiveConfig(targets=TipTargets(), pose_weight=0.0, velocity_weight=4e-3),
)
"""``position`` as in dex-retargeting: fingertips at the human's positions in the palm frame."""

HYBRID: Final = replace(KEYVECTOR, start="joint_angle", approach=NewtonConfig(iterations=12))
"""The hybrid of mimic-one (Nava et al. 2025): the keyvector method from the joint-angle solution.

That start lies further from the minimum than the last command, so it takes more Newton steps.
"""

DEXPILOT: Final = SlsqpMethodConfig(
    objective=ObjectiveConfig(
        targets=DexPilotTargets(
            project=0.03, escape=0.05, eta1=5e-3, eta2=0.03, w_set1=200.0, w_set2=400.0
        ),
        pose_weight=2.5e-3,
        velocity_weight=0.0,
    )
)
"""DexPilot (Handa et al. 2019) with its published numbers, without a velocity term."""

AKO: Final = SlsqpMethodConfig(
    objective=ObjectiveConfig(
        targets=AkoTargets(),
        loss="smooth_l1_norm",
        pose_weight=0.0,
        velocity_weight=0.1,
        velocity_loss="smooth_l1",
    )
)
"""Analyzing Key Objectives (Yu et al. 2025), but pinch vectors do not fade with distance."""


def _as_published(
    config: SlsqpMethodConfig, objective: ObjectiveConfig, tolerance: float = 1e-6
) -> SlsqpMethodConfig:
    """The configuration with the authors' solver: SciPy's SLSQP, at most 20 iterations a frame."""
    return replace(
        config,
        objective=objective,
        approach=NewtonConfig(iterations=0),
        solver=ScipySlsqpConfig(tolerance=tolerance, max_iterations=20),
    )


_FIVE_VECTORS: Final = ObjectiveConfig(
    targets=PlainTargets(w_thumb=0.0, w_between=0.0),
    loss="squared",
    pose_weight=0.0,
    velocity_weight=0.0,
)

KEYVECTOR_PUBLISHED: Final = _as_published(KEYVECTOR, _FIVE_VECTORS)
"""The baseline of the paper's authors: wrist to tips with a squared error."""

HYBRID_PUBLISHED: Final = replace(KEYVECTOR_PUBLISHED, start="published_angles")
"""The paper's baseline: the same, from the authors' joint angles."""

DEXPILOT_PUBLISHED: Final = _as_published(DEXPILOT, replace(DEXPILOT.objective, pose_centre="zero"))
"""The paper's baseline: the pose term pulls to zero angles."""

AKO_PUBLISHED: Final = _as_published(
    AKO, replace(AKO.objective, targets=AkoTargets(switch_pinch=True)), tolerance=1e-5
)
"""The paper's baseline: pinch vectors fade with the distance from the thumb."""


def _alone(config: SlsqpMethodConfig) -> SlsqpMethodConfig:
    """The configuration with NLopt's SLSQP alone, until its own tolerance."""
    return replace(config, approach=NewtonConfig(iterations=0), solver=SlsqpConfig())


KEYVECTOR_PRESETS: Final = {
    "default": KEYVECTOR,
    "vector": KEYVECTOR_VECTOR,
    "position": KEYVECTOR_POSITION,
    "slsqp": _alone(KEYVECTOR),
    "published": KEYVECTOR_PUBLISHED,
}
HYBRID_PRESETS: Final = {
    "default": HYBRID,
    "slsqp": _alone(HYBRID),
    "published": HYBRID_PUBLISHED,
}
DEXPILOT_PRESETS: Final = {
    "default": DEXPILOT,
    "slsqp": _alone(DEXPILOT),
    "published": DEXPILOT_PUBLISHED,
}
AKO_PRESETS: Final = {"default": AKO, "slsqp": _alone(AKO), "published": AKO_PUBLISHED}

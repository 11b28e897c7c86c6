"""Targets and costs of published methods: plain keyvectors, DexPilot's keyvectors, penalties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple, TypeAlias, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.retargeting.objective import (
    TRANSITION,
    Derivatives,
    FrameGoal,
    JointTerm,
    Keyvectors,
    TermsConfig,
)
from smooth_operator.retargeting.targets import (
    KeyvectorLayout,
    LayoutT,
    TargetPolicy,
    Targets,
    VectorLayout,
)
from smooth_operator.settings import check_choice, check_numbers

Loss: TypeAlias = Literal["smooth_l1", "squared"]
"""Cost of a keyvector's error: weight times smooth-L1 (``smooth_l1``), or times the square
(``squared``), of each component."""


def base_weights(
    layout: KeyvectorLayout, wrist: float, thumb: float, between: float
) -> Float[np.ndarray, " K"]:
    """(K,) weights of vectors from the wrist, vectors from the thumb, and those between fingers."""
    weights = np.full(len(layout.vectors), between)
    weights[: len(layout.fingers)] = wrist
    weights[layout.thumb] = thumb
    return weights


class StatelessTargets(TargetPolicy[LayoutT, tuple[()]]):
    """Base class of target policies without a state."""

    def init(self, layout: LayoutT) -> tuple[()]:
        """Returns the empty state."""
        del layout
        return ()


@dataclass(frozen=True)
class PlainTargets(StatelessTargets[KeyvectorLayout]):
    """Targets that equal the human's keyvectors.

    Attributes:
        beta: scale of the human's vectors.
        w_wrist, w_thumb, w_between: weights of the wrist-to-tip, thumb-to-tip and finger-to-finger
            keyvectors.
    """

    beta: float = 1.0
    w_wrist: float = 1.0
    w_thumb: float = 1.0
    w_between: float = 1.0

    def __post_init__(self) -> None:
        check_numbers(self, "targets.", positive=("beta",))

    def layout(self, fingers: tuple[str, ...]) -> KeyvectorLayout:
        """Returns the keyvectors of the Smooth Operator paper for these fingers."""
        return KeyvectorLayout(fingers)

    def __call__(
        self, state: tuple[()], layout: KeyvectorLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, tuple[()]]:
        """Targets of one frame."""
        weights = jnp.asarray(base_weights(layout, self.w_wrist, self.w_thumb, self.w_between))
        return Targets(human * self.beta, weights.astype(human.dtype)), state


class LatchState(NamedTuple):
    """State of ``DexPilotTargets`` between frames.

    Attributes:
        latched: (F - 1,) True for fingers that are latched to the thumb.
        closure: (F - 1,) effect of each latch, from 0 to 1.
    """

    latched: Bool[Array, " P"]
    closure: Float[Array, " P"]


@dataclass(frozen=True)
class DexPilotTargets(TargetPolicy[KeyvectorLayout, LatchState]):
    """DexPilot's targets (Handa et al. 2019), with weights by group as in the paper on SBR.

    A finger's latch closes when the human thumb-to-tip distance falls below ``project``, and opens
    when it rises above ``escape``. The target of a closed thumb vector is direction x eta1, that of
    a vector between two latched fingers direction x eta2, that of all others the human vector x
    beta.

    Attributes:
        project: closing distance [m].
        escape: opening distance [m].
        eta1: closed thumb-to-tip distance [m].
        eta2: distance between two latched fingers [m].
        w_set1: weight of closed thumb vectors.
        w_set2: weight between latched fingers.
        w_default: weight of the other vectors.
        w_thumb: factor on the open thumb-to-tip vectors (1 in the paper).
        w_between: factor on the open finger-to-finger vectors (1 in the paper).
        beta: scale of the human vectors.
        blend: change of a latch's effect per frame; with 1, as published, targets jump.
    """

    project: float = 0.010
    escape: float = 0.015
    eta1: float = 0.001
    eta2: float = 0.0
    w_set1: float = 2.0
    w_set2: float = 0.0
    w_default: float = 1.0
    w_thumb: float = 1.0
    w_between: float = 1.0
    beta: float = 1.0
    blend: float = 1.0

    def __post_init__(self) -> None:
        check_numbers(self, "targets.", positive=("escape", "beta"), finite=("project", "blend"))
        if not 0 < self.blend <= 1:
            raise ConfigError(f"blend must be in (0, 1], not {self.blend}")
        if not 0 < self.project <= self.escape:
            raise ConfigError(
                f"pinch distances must satisfy 0 < project <= escape, not project={self.project}, "
                f"escape={self.escape} [m]"
            )

    def layout(self, fingers: tuple[str, ...]) -> KeyvectorLayout:
        """Returns the keyvectors of the Smooth Operator paper for these fingers."""
        return KeyvectorLayout(fingers)

    def init(self, layout: KeyvectorLayout) -> LatchState:
        """Returns the state before the first frame, in which all latches are open."""
        count = len(layout.fingers) - 1
        return LatchState(*jax.device_put((np.zeros(count, bool), np.zeros(count, np.float32))))

    def latched(self, state: LatchState) -> Bool[Array, " P"]:
        """(F - 1,) True for fingers that are latched to the thumb."""
        return state.latched

    def __call__(
        self, state: LatchState, layout: KeyvectorLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, LatchState]:
        """Targets of one frame, and the latches after it."""
        latched, closure = state
        length = jnp.linalg.norm(human, axis=-1)
        direction = human / jnp.maximum(length, 1e-9)[:, None]
        distance = length[layout.thumb]
        latched = jnp.where(latched, distance <= self.escape, distance < self.project)
        closure = jnp.clip(closure + jnp.where(latched, self.blend, -self.blend), 0.0, 1.0)

        weights = base_weights(
            layout, self.w_default, self.w_default * self.w_thumb, self.w_default * self.w_between
        )
        # share of each keyvector as a closed thumb vector, and as one between latched fingers
        i, j = np.triu_indices(len(closure), 1)
        fingers = len(layout.fingers)
        closed = jnp.zeros(len(layout.vectors), human.dtype).at[layout.thumb].set(closure)
        both = jnp.zeros_like(closed).at[2 * fingers - 1 :].set(jnp.minimum(closure[i], closure[j]))
        held = closed + both  # of different keyvectors
        eta = closed * self.eta1 + both * self.eta2
        free = (1 - held) * self.beta
        vectors = human * free[:, None] + direction * eta[:, None]
        lambdas = (1 - held) * weights + closed * self.w_set1 + both * self.w_set2
        return Targets(vectors, lambdas.astype(human.dtype)), LatchState(latched, closure)


class SquaredKeyvectors(Keyvectors):
    """Cost term: weighted squares of keyvector errors, as the paper on SBR prints Eq. (1)."""

    def price(self, error: Sequence[Array], weight: Array) -> Array:
        """Returns the cost of one vector, as ``Keyvectors.price`` does."""
        return weight * (error[0] ** 2 + error[1] ** 2 + error[2] ** 2)

    def slopes(self, errors: Float[Array, "K 3"], goal: FrameGoal) -> Derivatives:
        """Returns costs and exact derivatives, as ``VectorTerm.slopes`` does."""
        double = 2 * jnp.asarray(goal.weights)[:, None]
        cost = 0.5 * (double * errors * errors).sum()
        return Derivatives(cost, double * errors, double * jnp.ones_like(errors))


KEYVECTORS: Final[dict[Loss, type[Keyvectors]]] = {
    "smooth_l1": Keyvectors,
    "squared": SquaredKeyvectors,
}
"""Maps the name of a penalty to the class of the first term of Eq. (1)."""


@dataclass(frozen=True)
class ObjectiveConfig(TermsConfig):
    """Weights of the objective of the Smooth Operator paper, Eq. (1).

    Attributes:
        targets: the target policy; by default DexPilot's, as in the paper's table.
        pose_weight: lambda_reg (gamma of the paper's table), pull to a pose.
        terms: additional terms, which are built for the hand.
        transition: error at which smooth-L1 changes from quadratic to linear [m].
        loss: ``smooth_l1`` per component, as in the authors' released code and in the figures of
            the paper; or ``squared``, as Eq. (1) is printed.
        pose_centre: pose of the pull: the hand's ``neutral`` pose, or ``zero`` angles.
        velocity_weight: lambda_vel (w_v of the table), weight of the squared change of the command.
    """

    targets: TargetPolicy[Any, Any] = field(default_factory=DexPilotTargets)
    pose_weight: float = 0.05
    transition: float = TRANSITION
    loss: Loss = "smooth_l1"
    pose_centre: Literal["neutral", "zero"] = "neutral"
    velocity_weight: float = 0.1

    def __post_init__(self) -> None:
        check_choice(self, "loss", get_args(Loss))
        check_choice(self, "pose_centre", ("neutral", "zero"))
        check_numbers(self, positive=("transition",))

    def keyvectors(self, layout: VectorLayout) -> Keyvectors:
        """Builds the keyvector term with the penalty that the settings choose."""
        return KEYVECTORS[self.loss](layout, self.transition)

    def pulls(self, neutral: Float[np.ndarray, " m"]) -> tuple[JointTerm, JointTerm]:
        """Builds the pull to a pose and the velocity term, for this neutral pose [rad]."""
        centre = neutral if self.pose_centre == "neutral" else np.zeros_like(neutral)
        return super().pulls(centre)

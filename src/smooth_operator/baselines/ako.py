"""Targets and penalties of AKO, "Analyzing Key Objectives" (Xin et al. 2025). AKO weights each
finger by a sigmoid of its distance to the thumb instead of DexPilot's latch, and applies smooth-L1
to the length of the weighted error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.geometry import AnyArray
from smooth_operator.landmarks import WRIST
from smooth_operator.retargeting.objective import (
    Derivatives,
    FrameGoal,
    JointTerm,
    Keyvectors,
    smooth_l1,
)
from smooth_operator.retargeting.sbr.published import ObjectiveConfig, StatelessTargets
from smooth_operator.retargeting.targets import Targets, VectorLayout, tips_of
from smooth_operator.settings import check_numbers

_TINY_AREA: Final = 1e-12  # so that a length has a derivative at 0 [m^2]


@dataclass(frozen=True)
class PinchLayout(VectorLayout):
    """AKO's vectors: from the wrist to each tip (F), from the thumb's tip to the other tips (F -
    1), and from the last joint to the tip of each finger (F).

    Attributes:
        fingers: human finger names, thumb first.
    """

    fingers: tuple[str, ...]

    @cached_property
    def vectors(self) -> tuple[tuple[int | None, int], ...]:
        """Landmark indices of the (K,) vectors, each as (from, to)."""
        tips = tips_of(self.fingers)
        return (
            *((WRIST, tip) for tip in tips),
            *((tips[0], tip) for tip in tips[1:]),
            *((tip - 1, tip) for tip in tips),
        )


@dataclass(frozen=True)
class AkoTargets(StatelessTargets[PinchLayout]):
    """Computes the target vectors of AKO and their weights.

    Attributes:
        w_thumb_wrist: weight of wrist to thumb tip, before switching.
        w_wrist: weight of wrist to each other tip, before switching.
        w_pinch: weight of thumb tip to each other tip, before it fades with the distance from the
            thumb.
        w_distal: weight of last joint to tip, which determines the direction of the pad.
        switch_distance: thumb-to-tip distance at which a switched vector has half its weight [m].
            The finger nearest to the thumb switches all wrist vectors.
        switch_scale: steepness of the switch [1/m].
        contact: distance below which the target of a pinch is closed [m].
        release: distance above which the pinch vector is the human's [m]; below, the target length
            rises from 0 at ``contact``.
    """

    w_thumb_wrist: float = 10.0
    w_wrist: float = 1.0
    w_pinch: float = 10.0
    w_distal: float = 10.0
    switch_distance: float = 0.02
    switch_scale: float = 10.0
    contact: float = 0.01
    release: float = 0.02

    def __post_init__(self) -> None:
        lengths = ("switch_distance", "switch_scale", "release")
        check_numbers(self, "targets.", positive=lengths)
        if not self.contact < self.release:
            raise ConfigError(
                f"pinch distances must satisfy 0 <= contact < release, not contact={self.contact}, "
                f"release={self.release} [m]"
            )

    def layout(self, fingers: tuple[str, ...]) -> PinchLayout:
        """Returns AKO's vectors for these fingers."""
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
                self.w_pinch * (1 - open_share),
                jnp.full(fingers, self.w_distal, human.dtype),
            ]
        )
        return Targets(human.at[pinch].set(scaled), weights), state


class NormKeyvectors(Keyvectors):
    """Cost term: smooth-L1 of the weight times the length of a vector's error."""

    def price(self, error: Sequence[Array], weight: Array) -> Array:
        """Returns the cost of one vector, as ``Keyvectors.price`` does."""
        x, y, z = error
        length = jnp.sqrt(x * x + y * y + z * z + _TINY_AREA)
        return smooth_l1(weight * length, self.transition)[0]

    def slopes(self, errors: Float[Array, "K 3"], goal: FrameGoal) -> Derivatives:
        """Returns costs and derivatives, as ``VectorTerm.slopes`` does; exact except at the kink of
        smooth-L1."""
        weights = jnp.asarray(goal.weights)
        length = jnp.sqrt((errors * errors).sum(axis=-1) + _TINY_AREA)
        unit = errors / length[:, None]
        cost, slope, second = smooth_l1(weights * length, self.transition)
        along = unit[:, :, None] * unit[:, None, :]
        radial, tangential = weights**2 * second, weights * slope / length
        across = jnp.eye(3, dtype=errors.dtype) - along
        return Derivatives(
            cost.sum(),
            (weights * slope)[:, None] * unit,
            radial[:, None, None] * along + tangential[:, None, None] * across,
        )


@dataclass(frozen=True, eq=False)
class SmoothL1Velocity(JointTerm):
    """Cost term: smooth-L1 of the weight times the change of each joint.

    Attributes:
        transition: change at which smooth-L1 changes from quadratic to linear [rad].
    """

    transition: float

    def expand(self, q: Float[AnyArray, "*n m"], goal: FrameGoal) -> Derivatives:
        """Returns cost and derivatives, as ``JointTerm.expand`` does."""
        weight: Any = goal.velocity_weight
        change = weight * (q - goal.previous)
        cost, first, second = smooth_l1(change, self.transition)
        return Derivatives(cost.sum(axis=-1), weight * first, weight**2 * second)


@dataclass(frozen=True)
class AkoObjectiveConfig(ObjectiveConfig):
    """Settings of AKO's objective, which has its own penalties on vectors and joint changes."""

    def keyvectors(self, layout: VectorLayout) -> Keyvectors:
        """Returns the term for vectors: smooth-L1 of the weight times the length of each error."""
        return NormKeyvectors(layout, self.transition)

    def pulls(self, neutral: Float[np.ndarray, " m"]) -> tuple[JointTerm, JointTerm]:
        """Returns the terms on joints: the pull to a pose, and smooth-L1 of the weight times the
        change of each joint."""
        return super().pulls(neutral)[0], SmoothL1Velocity(self.transition)

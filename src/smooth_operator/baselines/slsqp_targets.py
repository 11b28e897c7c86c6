"""Targets of the method ``ako`` and of the preset ``keyvector:position``.

AKO is "Analyzing Key Objectives" (Xin et al. 2025). The nearer a finger is to the thumb, the less
its wrist vectors count, by a sigmoid instead of DexPilot's latch: without state and jumps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.landmarks import WRIST
from smooth_operator.objective.keyvectors import VectorLayout, tips_of
from smooth_operator.objective.targets import StatelessTargets, Targets


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
        if not 0 <= self.contact < self.release:
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

    def layout(self, fingers: tuple[str, ...]) -> TipLayout:
        """Vectors from the palm's origin to each tip."""
        return TipLayout(fingers)

    def __call__(
        self, state: tuple[()], layout: TipLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, tuple[()]]:
        """Targets of one frame."""
        return Targets(human * self.beta, jnp.ones(len(human), human.dtype)), state

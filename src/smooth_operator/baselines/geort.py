"""GeoRT: fingertip to joint positions by trained networks (Yin et al., "Geometric Retargeting").

Here is only what runs; ``smooth_operator.lab.training`` makes the networks.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from smooth_operator.baselines.geort_model import (
    GeortModel,
    finger_joints,
    forward,
    human_tips,
    read_geort_model,
    training_command,
)
from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.landmarks import WRIST
from smooth_operator.methods.method import Method, MethodConfig, MethodOutput
from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.loss import Objective, ObjectiveConfig
from smooth_operator.objective.targets import PlainTargets

_MODELS: Final = Path(__file__).parent / "models"


@dataclass(frozen=True)
class GeortConfig(MethodConfig):
    """Settings of GeoRT.

    Attributes:
        alignment: how human landmarks reach the palm frame; as in training.
        model: a file of ``write_geort_model``; None
            for the one that comes with the hand.
    """

    shareable: ClassVar[bool] = False  # a model is a file, which may change, and is of one side

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    model: Path | None = None

    def build(self, hand: Hand) -> Geort:
        """The method for one hand.

        Raises:
            ConfigError: there is no built-in model for the hand; the file can't be read; or it
                holds a model for another hand.
        """
        path = built_in_model(hand.name) if self.model is None else Path(self.model)
        if path is None:
            names_built_in = ", ".join(
                sorted(file.stem.removeprefix("geort_") for file in _built_in())
            )
            raise ConfigError(
                f"there is no built-in GeoRT model for hand {hand.name!r} (there is one for: "
                f"{names_built_in or 'none'}); train one: {training_command(hand)}"
            )
        model = read_geort_model(path)
        return Geort(hand, self, model, model.mirrored_for(hand))

    def with_file(self, path: Path) -> GeortConfig:
        """The same with another model."""
        return replace(self, model=path)


def built_in_model(hand: str) -> Path | None:
    """The model that comes with the package for a hand, by its name; None if there is none."""
    path = _MODELS / f"geort_{hand}.npz"
    return path if path in _built_in() else None


def _built_in() -> list[Path]:
    return sorted(_MODELS.glob("geort_*.npz"))


class GeortState(NamedTuple):
    """GeoRT has no memory: a map from fingertips to joints. No field, no leaf."""


@dataclass(frozen=True, eq=False)
class Geort(Method):
    """GeoRT for one hand.

    Attributes:
        hand: the robot hand.
        config: its settings.
        model: the networks.
        mirrored: whether the hand is the mirror image of the one trained for. The palm frame's x is
            then reflected, and the joints' answer is the same.
    """

    hand: Hand
    config: GeortConfig
    model: GeortModel
    mirrored: bool

    @cached_property
    def objective(self) -> Objective:
        """Eq. (1) without latches, which gives the tracking loss."""
        return Objective(self.hand, ObjectiveConfig(targets=PlainTargets()))

    @property
    def needs(self) -> tuple[int, ...]:
        """Fingertips, and the wrist for the tracking loss."""
        return (WRIST, *human_tips(self.hand))

    @property
    def constants(self) -> Any:
        """The networks, as read."""
        return self.model.weights, self.model.centre, self.model.scale, self.mirrored

    def init(self, seed: int) -> GeortState:
        """Nothing to remember; the seed is not used."""
        del seed
        return GeortState()

    def step(
        self, state: GeortState, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[GeortState, MethodOutput]:
        """One frame."""
        del ticks
        layout, model = self.objective.layout, self.model
        tips = aligned[np.array(human_tips(self.hand))]
        flip = np.array([-1.0 if self.mirrored else 1.0, 1.0, 1.0])
        centre, scale = model.centre * flip, model.scale[:, None]
        inputs = ((tips - centre) / scale * flip).astype(jnp.float32)
        unit = forward(model.weights, inputs)
        q = jnp.asarray(self.hand.neutral, jnp.float32)
        fingers, outputs, joints = self._wiring
        low, high = self.hand.limits[joints].T.astype(np.float32)
        q = q.at[joints].set((low + high) / 2 + (high - low) / 2 * unit[fingers, outputs])

        human = layout.human(aligned)
        weights = jnp.ones(len(layout.vectors), human.dtype)
        goal = FrameGoal(human, weights, q, 0.0)
        return state, MethodOutput(q, self.objective.tracking(list(q), goal))

    @cached_property
    def _wiring(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(finger, output of its network, actuated joint), one column each."""
        columns = [
            (finger, output, joint)
            for finger, joints in enumerate(finger_joints(self.hand))
            for output, joint in enumerate(joints)
        ]
        fingers, outputs, joints = np.array(columns).T
        return fingers, outputs, joints


GEORT_PRESETS: Final = {"default": GeortConfig()}

"""Contact of a hand's fingers from the readings of its driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS
from smooth_operator.simulation.physics import finger_bodies
from smooth_operator.teleop.sinks.tick import Contact

Measured: TypeAlias = Literal["currents", "touch", "pads"]
"""Measurement of ``Reading`` that tells the contact."""

_IDLE: Final = 0.3
"""Share of the limit of current up to which a motor without a scale counts as free; our choice, as
motors need current to move."""


@dataclass(frozen=True)
class ContactScale:
    """Scale from a reading to contact: ``contact`` of a table.

    Attributes:
        values: measurement that tells the contact; of a pad, the sum of its cells.
        idle: value up to which there is no contact, in the driver's unit.
        full: value at which contact is 1.
        fingers: finger of each of the first values of ``touch``.
        newtons: force of one unit [N]; None if unknown.

    Raises:
        ConfigError: the values don't increase, or a finger has no such name.
    """

    values: Measured
    idle: float
    full: float
    fingers: tuple[str, ...] = ()
    newtons: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.idle < self.full:
            raise ConfigError(
                f"contact: idle must be 0 or more and full larger, not {self.idle:g} and "
                f"{self.full:g}"
            )
        unknown = [name for name in self.fingers if name not in FINGERS]
        if unknown or (self.values == "touch") != bool(self.fingers):
            raise ConfigError(
                "contact: fingers must be the finger of each value of touch, out of "
                f"{', '.join(FINGERS)}, and is for touch only, not {self.fingers}"
            )


class ContactMap:
    """Computes the contact of the fingers; without a scale, from currents and their limits.

    Args:
        scale: scale of the table, or None.
        limits: (a,) limit of current of each actuator; NaN for an actuator without a limit.
        joints: (a,) joints that each actuator moves.
        hand: the hand.
    """

    def __init__(
        self,
        scale: ContactScale | None,
        limits: Float[np.ndarray, " a"],
        joints: Sequence[Mapping[str, float]],
        hand: Hand,
    ) -> None:
        self._values: Measured = "currents" if scale is None else scale.values
        self._idle = _IDLE * limits if scale is None else np.array(scale.idle)
        self._full = limits if scale is None else np.array(scale.full)
        self._newtons = None if scale is None else scale.newtons
        self._fingers = hand.fingers
        if self._values == "touch":
            assert scale is not None
            self._owners = self._numbers(scale.fingers)
            return
        bodies, model = finger_bodies(hand, hand.model, ""), hand.model
        finger_of = {
            model.joint(number).name: int(bodies[body])
            for number, body in enumerate(model.jnt_bodyid)
        }
        moved = [[finger_of.get(name, -1) for name in each] for each in joints]
        self._owners = np.array([max(numbers, default=-1) for numbers in moved])
        if scale is None:
            self._owners[np.isnan(limits)] = -1

    def __call__(
        self,
        currents: Float[np.ndarray, " a"] | None,
        touch: Float[np.ndarray, " k"] | None,
        pads: Mapping[str, Float[np.ndarray, "rows columns"]],
    ) -> Contact | None:
        """Contact of each finger by its largest value, 0 without a sensor; None if the table's
        measurement is missing. The arguments are those of ``Reading``."""
        owners = self._owners
        if self._values == "pads":
            owners = self._numbers([name.partition("_")[0] for name in pads])
            values = np.array([cells.sum() for cells in pads.values()], float)
        elif self._values == "touch" and touch is not None:
            values = touch[: len(owners)]
        elif self._values == "currents" and currents is not None:
            values = np.abs(currents)
        else:
            return None
        own = owners >= 0
        if not own.any():
            return None
        shares = (values - self._idle) / (self._full - self._idle)
        levels, newtons = np.zeros(len(self._fingers)), np.zeros(len(self._fingers))
        with np.errstate(invalid="ignore"):  # a NaN stays
            np.maximum.at(levels, owners[own], np.clip(shares[own], 0.0, 1.0))
            if self._newtons is None:
                return Contact(levels, np.full(len(levels), np.nan))
            np.maximum.at(newtons, owners[own], self._newtons * values[own])
        return Contact(levels, newtons)

    def _numbers(self, names: Sequence[str]) -> np.ndarray:
        """Number of each finger of the hand; -1 for a palm or a finger that is not driven."""
        ours = ["pinky" if name == "little" else name for name in names]
        return np.array([self._fingers.index(n) if n in self._fingers else -1 for n in ours], int)

"""Which joints a ROS 2 driver is sent: their names, order, scale and offset."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import UnknownNameError
from smooth_operator.hands.hand import Hand

Unit: TypeAlias = Literal["rad", "deg"]
"""Of joint angles."""

UNITS: Final[dict[Unit, float]] = {"rad": 1.0, "deg": 180.0 / math.pi}
"""How many of a unit make a radian."""


@dataclass(frozen=True)
class JointLayout:
    """Joints of a hand as a driver wants them: value = gain · position [rad] + offset.

    Attributes:
        names: (k,) what the driver calls them.
        indices: (k,) their places among the joints of the hand.
        gain: factor to the driver's unit.
        offset: in the driver's unit.
    """

    names: tuple[str, ...]
    indices: tuple[int, ...]
    gain: float = 1.0
    offset: float = 0.0

    def values(self, positions: Float[np.ndarray, " n"]) -> list[float]:
        """(k,) what is sent for joint positions [rad]."""
        picked: list[float] = (self.gain * positions[list(self.indices)] + self.offset).tolist()
        return picked

    def rates(self, velocities: Float[np.ndarray, " n"]) -> list[float]:
        """(k,) what is sent for joint velocities [rad/s]."""
        picked: list[float] = (self.gain * velocities[list(self.indices)]).tolist()
        return picked


def joint_layout(
    hand: Hand, joints: str, *, prefix: str = "", gain: float = 1.0, offset: float = 0.0
) -> JointLayout:
    """The layout for a hand.

    Args:
        hand: the hand.
        joints: ``all``, ``actuated`` (those without couplings to another), or names with ``*`` for
            any letters, separated by blanks, in the order in which they are sent.
        prefix: put before each name.
        gain: see ``JointLayout``.
        offset: see ``JointLayout``.

    Raises:
        UnknownNameError: the hand has no joint of a name.
    """
    if joints in ("all", "actuated"):
        indices = hand.actuated if joints == "actuated" else tuple(range(len(hand.joint_names)))
    else:
        indices = tuple(dict.fromkeys(i for word in joints.split() for i in _matching(hand, word)))
    names = tuple(prefix + hand.joint_names[i] for i in indices)
    return JointLayout(names, indices, gain, offset)


def _matching(hand: Hand, pattern: str) -> list[int]:
    found = [i for i, name in enumerate(hand.joint_names) if fnmatchcase(name, pattern)]
    if not found:
        raise UnknownNameError(
            f"joint of hand {hand.name!r}:",
            pattern,
            hand.joint_names,
            "joints= takes all, actuated, or names separated by blanks.",
        )
    return found

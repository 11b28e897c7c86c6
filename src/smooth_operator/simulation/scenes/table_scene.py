"""Base of scenes with a moving wrist: the hand starts above a table on which the object lies."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Final

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.scene import (
    PLATFORM,
    Mount,
    Scene,
    add_shape,
    mount,
    opposition,
)

TOP: Final = 0.02
"""Height of the table's top above the floor [m]."""

GRASP_GAP: Final = 0.05
"""Distance of thumb and fingers at which a hand's grasp centre is taken [m]."""

_TABLE: Final = 0.3  # half of the table's side [m]
_TABLE_FRICTION: Final = (0.5, 0.001)
_ROLLING: Final = 0.001  # rolling resistance of the table's cloth [m]
_REACH: Final = 0.6  # half of the side of the workspace [m]


@dataclass(frozen=True, eq=False, kw_only=True)
class TableScene(Scene):
    """Scene whose object lies on a table, near the origin of the world.

    Attributes:
        target: (3,) place of the goal in the world [m].
        scale: factor of the lengths of object and goal.
    """

    view: ClassVar = (140.0, -20.0)

    lower: Float[np.ndarray, "3"] = field(default_factory=lambda: np.array([-_REACH, -_REACH, 0]))
    upper: Float[np.ndarray, "3"] = field(default_factory=lambda: np.array([_REACH, _REACH, 1]))
    fixture: bool = False
    target: Float[np.ndarray, "3"]
    scale: float

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds the table."""
        add_shape(
            world.worldbody,
            PLATFORM,
            mujoco.mjtGeom.mjGEOM_BOX,
            (_TABLE, _TABLE, TOP / 2),
            mass=0.0,
            at=(0.0, 0.0, TOP / 2),
            friction=_TABLE_FRICTION,
            color=(0.62, 0.5, 0.38, 1.0),
            priority=2,
        )
        table = world.geom(PLATFORM)
        table.condim, table.friction = 6, (*_TABLE_FRICTION, _ROLLING)


def grasp_centre(hand: Hand) -> Float[np.ndarray, "3"]:
    """Returns the (3,) point midway between thumb and fingers when they are ``GRASP_GAP`` apart, as
    (distal, radial, palmar) from the wrist [m]; HandModelError if the hand can't open that far."""
    middle = np.concatenate([opposition(hand, name, GRASP_GAP) for name in hand.fingers[1:3]])
    return np.asarray(np.median(middle, axis=0))


def mount_over(hand: Hand, centre: ArrayLike, *, up: ArrayLike, forward: ArrayLike) -> Mount:
    """Places a hand so that its grasp centre is at a given point of the world.

    Args:
        centre: (3,) the point [m].
        up: see ``mount``.
        forward: see ``mount``.
    """
    oriented = mount(hand, up=up, forward=forward)
    wrist = np.asarray(centre, float) - oriented.directions @ grasp_centre(hand)
    return mount(hand, up=up, forward=forward, wrist=wrist)

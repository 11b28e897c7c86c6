"""What a scene shows of itself: where the object is, and what touches it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class SceneState:
    """A scene at one moment; the world's z points up.

    Attributes:
        time: simulated time [s].
        position: (3,) of the object's centre in the world [m].
        quaternion: (4,) w x y z, from the object's frame to the world.
        velocity: (3,) of the object's centre [m/s].
        spin: (3,) angular velocity of the object in the world [rad/s].
        force: (f,) with which each finger presses on the object [N], thumb first.
        touch: (f, 3) where it does so, in the object's frame [m]; NaN where it does not.
        palm: with which the rest of the hand presses on it [N].
        support: with which the platform or the floor presses on it [N].
        placed: False while the object waits, untouchable, for the hand to leave its place.
        fixed: the fixture still holds the object.
        starts: how often the object was put to its start.
        away: there is no object now, as in free movement; where it would start is ``position``.
    """

    time: float
    position: Float[np.ndarray, "3"]
    quaternion: Float[np.ndarray, "4"]
    velocity: Float[np.ndarray, "3"]
    spin: Float[np.ndarray, "3"]
    force: Float[np.ndarray, " f"]
    touch: Float[np.ndarray, "f 3"]
    palm: float = 0.0
    support: float = 0.0
    placed: bool = True
    fixed: bool = False
    starts: int = 0
    away: bool = False


@dataclass(frozen=True, eq=False)
class ScenePart:
    """One shape of a scene, to draw.

    Attributes:
        name: of the shape.
        kind: ``box``, ``capsule`` or ``cylinder``.
        size: half lengths [m] of a box; radius and half length along its z of the others.
        color: (4,) red, green, blue and opacity, 0 to 1.
        position: (3,) in the object's frame if it moves with it, else in the world [m].
        quaternion: (4,) w x y z, likewise.
        moves: whether it is a part of the object.
    """

    name: str
    kind: str
    size: tuple[float, ...]
    color: tuple[float, float, float, float]
    position: Float[np.ndarray, "3"]
    quaternion: Float[np.ndarray, "4"]
    moves: bool

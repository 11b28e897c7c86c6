"""State of a scene (pose and contacts of the object), and its shapes to draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class SceneState:
    """State of a scene at one moment; the world's z points up.

    Attributes:
        time: simulated time [s].
        position: (3,) position of the object's centre in the world [m].
        quaternion: (4,) rotation from the object's frame to the world, w x y z.
        velocity: (3,) velocity of the object's centre [m/s].
        spin: (3,) angular velocity of the object in the world [rad/s].
        force: (f,) normal force of each finger on the object [N], thumb first.
        touch: (f, 3) point of contact of each finger in the object's frame [m]; NaN without one.
        palm: normal force of the rest of the hand on the object [N].
        support: normal force of the platform or the floor on the object [N].
        placed: False while the object waits, untouchable, for the hand to leave its place.
        fixed: True while the fixture holds the object.
        starts: number of times that the object was put to its start.
        away: True while there is no object, as in free movement; ``position`` is then its start.
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
        name: name of the shape.
        kind: ``box``, ``capsule`` or ``cylinder``.
        size: half lengths of a box; radius and half length along z of the others [m].
        color: (4,) red, green, blue and opacity, 0 to 1.
        position: (3,) position in the object's frame if ``moves``, else in the world [m].
        quaternion: (4,) rotation to that frame, w x y z.
        moves: True for a part of the object.
    """

    name: str
    kind: str
    size: tuple[float, ...]
    color: tuple[float, float, float, float]
    position: Float[np.ndarray, "3"]
    quaternion: Float[np.ndarray, "4"]
    moves: bool

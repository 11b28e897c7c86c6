"""Variations of a task's object: another start, friction and mass."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene import OBJECT, Scene

_S = TypeVar("_S", bound=Scene)

SHIFT_M: Final = 0.002
"""Largest shift of the object along x and along y of the world, in a benchmark's worlds [m]."""

TURN_RAD: Final = float(np.radians(3.0))
"""Largest turn of the object about the vertical [rad]."""

FRICTION: Final = 0.1
"""Largest share by which the object's friction differs, sliding and torsional alike."""

MASS: Final = 0.2
"""Largest share by which the object's mass and inertia differ."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectVariation:
    """A variation of a task's object. The defaults change nothing.

    Attributes:
        shift: (2,) of the object along x and y of the world [m].
        turn: turn of the object about the vertical [rad].
        friction: factor of the object's friction.
        mass: factor of its mass.
    """

    shift: Float[np.ndarray, "2"] = field(default_factory=lambda: np.zeros(2))
    turn: float = 0.0
    friction: float = 1.0
    mass: float = 1.0

    def scene(self, scene: _S) -> _S:
        """The scene with the object where it starts in this world."""
        position, quaternion = scene.start
        shift = np.array([*self.shift, 0.0])
        about = np.array([np.cos(self.turn / 2), 0.0, 0.0, np.sin(self.turn / 2)])
        turned = np.zeros(4)
        mujoco.mju_mulQuat(turned, about, np.asarray(quaternion, float))
        return replace(scene, start=(position + shift, turned))

    def prepare(self, physics: ScenePhysics) -> None:
        """Give the object its friction and mass; once, before a trial."""
        model = physics.model
        body = model.body(OBJECT).id
        own = np.flatnonzero(np.asarray(model.geom_bodyid) == body)
        model.geom_friction[own, :2] *= self.friction
        model.body_mass[body] *= self.mass
        model.body_inertia[body] *= self.mass
        # What MuJoCo derives from masses; it also forgets what an object that still waits for the
        # hand to leave its place will touch.
        touches = [np.array(one) for one in (model.body_contype, model.body_conaffinity)]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        model.body_contype[:], model.body_conaffinity[:] = touches


def draw_variation(rng: np.random.Generator, scale: float = 1.0) -> ObjectVariation:
    """A random variation, uniform within the benchmark's limits.

    Args:
        scale: factor of all limits; 0 for the nominal object.
    """
    unit = scale * rng.uniform(-1.0, 1.0, 5)
    return ObjectVariation(
        shift=SHIFT_M * unit[:2],
        turn=TURN_RAD * float(unit[2]),
        friction=1.0 + FRICTION * float(unit[3]),
        mass=1.0 + MASS * float(unit[4]),
    )

"""A scene: a hand on its fixture, an object, and what the object lies on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.arms.carried import CarriedHand
from smooth_operator.simulation.physics_model import FURNISHED
from smooth_operator.simulation.scenes.mount import Mount

OBJECT: Final = "object"
"""Name of the body that the task is about."""

PLATFORM: Final = "platform"
"""Begins the names of the shapes that it may lie on."""

_ALL: Final = 0xFFFF  # touches every shape that touches anything
_STIFF: Final = 0.004  # time constant of contacts [s]; MuJoCo's default lets a card sink in
_WIDTH, _HEIGHT = 1280, 960  # largest picture


@dataclass(frozen=True, eq=False)
class Scene(ABC):
    """A hand and its object, ready to be built; the world's z points up, the floor is at 0.

    Attributes:
        mount: how the hand stands.
        start: position (3,) [m] and quaternion (4,) of the object where a trial starts.
        lower: (3,) of the workspace [m]; an object that leaves it is dropped.
        upper: (3,) likewise.
        fixture: whether something holds the object until the hand does.
        view: azimuth and elevation of a camera that sees a right hand at it [degrees], as MuJoCo
            counts them; of a left hand the azimuth is the opposite.
    """

    view: ClassVar[tuple[float, float]]

    mount: Mount
    start: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]
    lower: Float[np.ndarray, "3"]
    upper: Float[np.ndarray, "3"]
    fixture: bool

    @abstractmethod
    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Put in what the object lies on."""

    @abstractmethod
    def add_object(self, body: mujoco.MjsBody) -> None:
        """Give the object its shapes."""

    def furnish(self, hand: mujoco.MjSpec, carried: CarriedHand | None = None) -> mujoco.MjSpec:
        """The world with the hand in it; see ``physics_model``.

        Args:
            hand: the hand's model.
            carried: the arm that carries it, on its place in the scene; None for a fixture.
        """
        hand.option.gravity = (0.0, 0.0, -9.81)
        world = empty_world(hand)
        if carried is None:
            position, quaternion = self.mount.frame
            world.attach(hand, prefix=FURNISHED, frame=world.worldbody.add_frame(
                pos=position, quat=quaternion))  # fmt: skip
        else:
            carried.attach(world, hand, FURNISHED)
        self.add_platform(world)
        body = world.worldbody.add_body(name=OBJECT, pos=self.start[0], quat=self.start[1])
        body.add_freejoint(name=OBJECT)
        self.add_object(body)
        if self.fixture:
            hold = world.add_equality(name=OBJECT, type=mujoco.mjtEq.mjEQ_WELD, active=True)
            hold.objtype = mujoco.mjtObj.mjOBJ_BODY
            hold.name1, hold.name2 = "world", OBJECT
            hold.solref = (_STIFF, 1.0)
            data = np.zeros_like(np.asarray(hold.data))
            data[10] = 1.0  # torque as force; the pose is that of the start
            hold.data = data
        return world


def add_shape(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    size: Sequence[float] | Float[np.ndarray, " k"],
    *,
    mass: float,
    friction: tuple[float, float],
    color: tuple[float, float, float, float],
    at: Sequence[float] = (0.0, 0.0, 0.0),
    turn: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    priority: int = 1,
) -> None:
    """Add a shape that touches everything.

    Args:
        body: that it belongs to.
        name: of the shape.
        kind: of MuJoCo's shapes.
        size: half lengths [m], or radius and half length.
        mass: [kg].
        friction: coefficient of sliding, and of turning on the spot [m], which is how a soft
            fingertip resists it.
        color: red, green, blue, opacity.
        at: its centre in the body's frame [m].
        turn: its quaternion there.
        priority: of two shapes that touch, the one with the higher says how.
    """
    body.add_geom(
        name=name, type=kind, size=[*size, *[0.0] * (3 - len(size))], pos=at, quat=turn, mass=mass,
        friction=(*friction, 1e-4), condim=4, rgba=color, priority=priority,
        contype=_ALL, conaffinity=_ALL, solref=(_STIFF, 1.0), solimp=(0.95, 0.99, 0.0005, 0.5, 2.0),
    )  # fmt: skip


def empty_world(hand: mujoco.MjSpec) -> mujoco.MjSpec:
    """A floor, a light and the hand's own settings of the physics."""
    world = mujoco.MjSpec()
    for name in ("timestep", "integrator", "disableflags"):
        setattr(world.option, name, getattr(hand.option, name))
    world.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    world.option.impratio = 10.0
    world.option.noslip_iterations = 4  # soft friction lets what is held creep out of the fingers
    for name in ("fusestatic", "balanceinertia", "boundmass", "boundinertia"):
        setattr(world.compiler, name, getattr(hand.compiler, name))
    world.visual.global_.offwidth, world.visual.global_.offheight = _WIDTH, _HEIGHT
    world.visual.headlight.ambient = (0.35, 0.35, 0.35)
    world.visual.headlight.diffuse = (0.45, 0.45, 0.45)
    world.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=32, height=192,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, rgb1=(0.98, 0.98, 0.98),
        rgb2=(0.8, 0.84, 0.9),
    )  # fmt: skip
    world.worldbody.add_light(pos=(0.2, -0.3, 1.0), dir=(-0.2, 0.3, -1.0), castshadow=True)
    add_shape(
        world.worldbody, "floor", mujoco.mjtGeom.mjGEOM_PLANE, (0.6, 0.6, 0.01), mass=0.0,
        friction=(0.5, 0.001), color=(0.93, 0.93, 0.92, 1.0), priority=2,
    )  # fmt: skip
    return world

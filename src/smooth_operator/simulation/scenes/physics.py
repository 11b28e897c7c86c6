"""Simulates a hand in a task's scene: object contacts, soft fingertips, fixture and reset.

MuJoCo scales a contact's stiffness by the mass that it moves. The parameters of an object follow
from its mass, so that a given force presses a pad equally far into an object of any mass. The
force at a contact of depth ``r`` is, at rest,

    F = d(r)^2 r / ((1 - d(r)) d_max^2 tau^2 A)

with the impedance ``d`` (``solimp``), the time constant ``tau`` (``solref``) and the inverse mass
``A`` of both bodies (https://mujoco.readthedocs.io/en/stable/modeling.html#solver-parameters).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

import mujoco
import numpy as np
from jaxtyping import Float, Int

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.arm import CarriedHand, WristKinematics
from smooth_operator.simulation.arms.free_wrist import HandCarrier
from smooth_operator.simulation.physics import FURNISHED, HandPhysics, finger_bodies
from smooth_operator.simulation.scenes.scene import (
    OBJECT,
    PLATFORM,
    Scene,
    ScenePart,
    SceneState,
    empty_world,
)

TOUCH_STIFFNESS: Final = 2000.0
"""Stiffness of one contact where a pad begins to touch [N/m]."""

PRESSED_STIFFNESS: Final = 8000.0
"""Force over depth of one contact where a pad is ``PRESSED_DEPTH`` deep [N/m].

With ``TOUCH_STIFFNESS`` it gives 0.35 mm at 1 N and 0.85 mm at 5 N. By Hertz's theory, a solid
silicone fingertip of 8 mm radius and Shore A 30 gives 0.31 and 0.90 mm (E = 1.16 MPa by Ruess'
relation, incompressible; F = 4/3 E* R^1/2 r^3/2). Soft robot fingertips were measured to follow
such power laws (Xydas and Kao 1999, doi:10.1177/02783649922066673). A human fingertip is softer and
stiffens exponentially (Pawluk and Howe 1999, doi:10.1115/1.2835100).
"""

PRESSED_DEPTH: Final = 0.001
"""Depth at which ``PRESSED_STIFFNESS`` holds [m]."""

TIME_CONSTANT: Final = 0.01
"""Time constant of the pads' damping, which is critical or above [s]; five steps of 2 ms."""

_SOFTEST: Final = 0.05  # lowest impedance: an object much heavier than a finger
_HARDEST: Final = 0.9995  # highest impedance: an object below 1 g


def soften_pads(model: mujoco.MjModel, body: int, fingertips: list[int]) -> None:
    """Gives the shapes of an object and its moving parts the contact parameters of soft pads.

    Args:
        model: the scene; it is changed.
    """
    tips = float(np.median(model.body_invweight0[fingertips, 0]))
    for geom in np.flatnonzero(model.body_rootid[model.geom_bodyid] == body):
        part = model.geom_bodyid[geom]
        low, high = pad_impedance(float(model.body_invweight0[part, 0]) + tips)
        model.geom_solref[geom] = TIME_CONSTANT, 1.0
        model.geom_solimp[geom] = low, high, PRESSED_DEPTH, 0.5, 1.0


def pad_impedance(inverse_mass: float) -> tuple[float, float]:
    """Contact impedance at first touch and at ``PRESSED_DEPTH``.

    Args:
        inverse_mass: sum of the inverse masses of object and fingertip [1/kg].
    """
    scale = TIME_CONSTANT**2 * inverse_mass
    high = float(np.clip(1.0 - 1.0 / (PRESSED_STIFFNESS * scale), _SOFTEST, _HARDEST))
    # d^2 / (1 - d) = touch
    touch = TOUCH_STIFFNESS * scale * high**2
    low = (np.sqrt(touch * touch + 4.0 * touch) - touch) / 2.0
    return float(np.clip(low, _SOFTEST, high)), high


_PALM, _REST, _OBJECT = -1, -2, -3


class Touching:
    """Reads contact forces and contact points from a scene's model.

    Args:
        hand: the hand in the scene.
        model: the compiled scene.
    """

    def __init__(self, hand: Hand, model: mujoco.MjModel) -> None:
        self._model = model
        self._fingers = len(hand.fingers)
        self._body = model.body(OBJECT).id
        self._owner = _owners(hand, model)
        self.own = [
            g
            for g in range(model.ngeom)
            if self._owner[g] >= _PALM and (model.geom_contype[g] or model.geom_conaffinity[g])
        ]
        self.things = [
            g for g in range(model.ngeom) if self._owner[g] == _OBJECT and model.geom_contype[g]
        ]

    def read(
        self, data: mujoco.MjData
    ) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, "f 3"], float, float]:
        """Reads the forces that the fingers, the palm and everything else exert on the object, and
        where fingers touch it.

        Returns:
            (f,) normal force of each finger [N]; (f, 3) its point of contact in the object's frame
            [m], NaN without one; force of the palm [N]; force of everything else [N].
        """
        force, palm, rest = np.zeros(self._fingers), 0.0, 0.0
        points = np.zeros((self._fingers, 3))
        wrench = np.zeros(6)
        for index in range(data.ncon):
            contact = data.contact[index]
            one, two = (int(self._owner[g]) for g in contact.geom)
            if _OBJECT not in (one, two) or contact.efc_address < 0:
                continue
            other = two if one == _OBJECT else one
            mujoco.mj_contactForce(self._model, data, index, wrench)
            normal = float(wrench[0])
            if other >= 0:
                force[other] += normal
                points[other] += normal * contact.pos
            elif other == _PALM:
                palm += normal
            else:
                rest += normal
        with np.errstate(invalid="ignore"):
            points = np.where(force[:, None] > 0, points / force[:, None], np.nan)
        turn = data.xmat[self._body].reshape(3, 3)
        return force, (points - data.xpos[self._body]) @ turn, palm, rest


def finger_geoms(hand: Hand, model: mujoco.MjModel) -> list[list[int]]:
    """Colliding shapes of each finger, thumb first."""
    owner = _owners(hand, model)
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return [np.flatnonzero((owner == n) & solid).tolist() for n in range(len(hand.fingers))]


def _owners(hand: Hand, model: mujoco.MjModel) -> Int[np.ndarray, " g"]:
    """(g,) number of the finger of each shape, or ``_PALM``, ``_REST`` or ``_OBJECT``."""
    fingers, owners = finger_bodies(hand, model), np.full(model.ngeom, _REST)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if model.body(model.body_rootid[body]).name == OBJECT:
            owners[geom] = _OBJECT
        elif model.body(body).name.startswith(FURNISHED):
            owners[geom] = _PALM if fingers[body] < 0 else fingers[body]
    return owners


_CLEAR: Final = 0.001
"""Distance above which the hand counts as clear of the object's place [m]."""

_GRIP_N: Final = 0.3
"""Force above which a finger counts as holding [N]."""

_GRIP_S: Final = 0.25
"""Time for which thumb and two fingers must hold before the fixture releases the object [s]."""

_KINDS: Final = {
    int(mujoco.mjtGeom.mjGEOM_BOX): ("box", 3),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): ("capsule", 2),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", 2),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): ("capsule", 2),  # of length 0
}


def in_front(carried: CarriedHand, scene: Scene) -> CarriedHand:
    """Places the arm on the table so that its hand starts where the fixture would hold it."""
    wrist = WristKinematics(carried).wrist(carried.home)
    place = scene.mount.wrist - wrist[:3]
    return carried.at_base((place[0] - carried.arm.back, place[1], 0.0))


class ScenePhysics(HandPhysics):
    """Simulates a hand and the object of a task.

    The object first stays at its start and touches nothing until the hand is clear of its place, as
    an experimenter would wait before placing it. In a scene with a fixture, the fixture holds the
    object until thumb and two fingers do.

    Args:
        hand: the robot hand.
        scene: the scene around the hand.
        timestep: time step of the physics [s].
        bandwidth: bandwidth of the servos [Hz].
        carried: an arm that carries the hand and stands in front of the task, or a free wrist;
            None for a fixture.

    Attributes:
        scene: the scene around the hand.
        starts: number of times that the object was put to its start, including those after the
            simulation diverged.
    """

    def __init__(
        self,
        hand: Hand,
        scene: Scene,
        timestep: float = 0.002,
        bandwidth: float = 20.0,
        carried: HandCarrier | None = None,
    ) -> None:
        self.scene = scene
        self._ghost = self._fixed = self._away = False  # until there is a model
        self.starts = 0
        placed = in_front(carried, scene) if isinstance(carried, CarriedHand) else carried
        super().__init__(
            hand,
            timestep,
            bandwidth,
            furnish=lambda spec: scene.furnish(spec, placed),
            carried=placed,
        )
        model = self.model
        self._touching = Touching(hand, model)
        joint = model.joint(OBJECT)
        self._at, self._moves = int(joint.qposadr[0]), int(joint.dofadr[0])
        self._body = model.body(OBJECT).id
        part = scene.mechanism
        self._mechanism = int(model.joint(part).qposadr[0]) if part else None
        tips = [model.body(FURNISHED + finger.tip.body).id for finger in hand.spec.fingers]
        soften_pads(model, self._body, tips)
        self._needed = min(2, len(hand.fingers) - 1)
        self._gripped = 0
        self.reset_object()

    def restart(self) -> None:
        """Resets to time 0: the hand rests in the neutral pose, and the object is at its start."""
        super().restart()
        self.starts = 0
        self.reset_object()

    def reset_object(self) -> None:
        """Puts the object back to its start as soon as the hand is clear of that place."""
        self._away = False
        self.starts += 1
        self._begin()

    def put_away(self) -> None:
        """Removes the object until it is put back, so that nothing touches it."""
        self._away = True
        self._begin()

    def _begin(self) -> None:
        self._ghost, self._fixed, self._gripped = True, self.scene.fixture, 0
        self._solid(False)
        if self.scene.fixture:
            self._data.eq_active[self.model.equality(OBJECT).id] = 1
        self._put()
        mujoco.mj_forward(self.model, self._data)
        self._try_to_place()

    def observe(self) -> SceneState:
        """Returns the state of the object and of its contacts."""
        force, touch, palm, rest = self._touching.read(self._data)
        speed = self._data.qvel[self._moves : self._moves + 6]
        turn = self._data.xmat[self._body].reshape(3, 3)
        pose = self._data.qpos[self._at : self._at + 7]
        return SceneState(
            self.time,
            pose[:3].copy(),
            pose[3:].copy(),
            speed[:3].copy(),
            turn @ speed[3:],
            force,
            touch,
            palm,
            rest,
            not self._ghost,
            self._fixed,
            self.starts,
            self._away,
            0.0 if self._mechanism is None else float(self._data.qpos[self._mechanism]),
        )

    def parts(self) -> list[ScenePart]:
        """Returns the current shapes of the platform and of the object, for drawing."""
        model, data, parts = self.model, self._data, []
        own = data.xpos[self._body], data.xmat[self._body].reshape(3, 3)
        for geom in range(model.ngeom):
            root = int(model.body_rootid[model.geom_bodyid[geom]])
            kind = _KINDS.get(int(model.geom_type[geom]))
            platform = not root or model.body(root).name.startswith(PLATFORM)
            if kind is None or not (platform or root == self._body):
                continue
            word, count = kind
            at, turn = (np.zeros(3), np.eye(3)) if platform else own
            quaternion = np.zeros(4)
            relative = turn.T @ data.geom_xmat[geom].reshape(3, 3)
            mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(relative).ravel())
            parts.append(
                ScenePart(
                    model.geom(geom).name or f"part{geom}",
                    word,
                    tuple(float(s) for s in model.geom_size[geom][:count]),
                    tuple(float(c) for c in model.geom_rgba[geom]),  # type: ignore[arg-type]
                    turn.T @ (data.geom_xpos[geom] - at),
                    quaternion,
                    not platform,
                )
            )
        return parts

    def _step(self, count: int) -> None:
        for _ in range(count):
            if not (self._ghost or self._fixed):
                mujoco.mj_step(self.model, self._data, count)
                return
            mujoco.mj_step(self.model, self._data)
            count -= 1
            if self._ghost:
                self._put()
                self._try_to_place()
            else:
                self._let_go_if_held()

    def _put(self) -> None:
        self._data.qpos[self._at : self._at + 7] = np.concatenate(self.scene.start)
        self._data.qvel[self._moves : self._moves + 6] = 0.0
        if self._mechanism is not None:
            self._data.qpos[self._mechanism] = self.model.qpos0[self._mechanism]

    def _try_to_place(self) -> None:
        if self._away:
            return
        mujoco.mj_kinematics(self.model, self._data)
        nearest = min(
            mujoco.mj_geomDistance(self.model, self._data, own, thing, 2 * _CLEAR, None)
            for own in self._touching.own
            for thing in self._touching.things
        )
        if nearest > _CLEAR:
            self._ghost = False
            self._solid(True)

    def _let_go_if_held(self) -> None:
        force, *_ = self._touching.read(self._data)
        holds = force > _GRIP_N
        held = bool(holds[0]) and int(holds[1:].sum()) >= self._needed
        self._gripped = self._gripped + 1 if held else 0
        if self._gripped * float(self.model.opt.timestep) >= _GRIP_S:
            self._fixed = False
            self._data.eq_active[self.model.equality(OBJECT).id] = 0

    def _solid(self, solid: bool) -> None:
        """Switch the collisions of the object's shapes on or off."""
        for geom in self._touching.things:
            self.model.geom_contype[geom] = self.model.geom_conaffinity[geom] = (
                0xFFFF if solid else 0
            )

    def _place(self, target: np.ndarray) -> None:
        super()._place(target)
        if hasattr(self, "_touching"):  # the physics diverged: the object is reset, too
            if self._away:
                self.put_away()
            else:
                self.reset_object()


class ArmPhysics(HandPhysics):
    """Simulates a hand on an arm that stands on an empty table (the floor of its world).

    Gravity acts on objects only: the weight of arm and hand is compensated.

    Args:
        hand: the robot hand.
        carried: the arm at its place.
        timestep: time step of the physics [s].
        bandwidth: bandwidth of the hand's servos [Hz].
    """

    def __init__(
        self, hand: Hand, carried: CarriedHand, timestep: float = 0.002, bandwidth: float = 20.0
    ) -> None:
        def furnish(spec: mujoco.MjSpec) -> mujoco.MjSpec:
            spec.option.gravity = (0.0, 0.0, -9.81)
            world = empty_world(spec)
            carried.attach(world, spec, FURNISHED)
            return world

        super().__init__(hand, timestep, bandwidth, furnish=furnish, carried=carried)


_S = TypeVar("_S", bound=Scene)

SHIFT_M: Final = 0.002
"""Largest shift of the object along x and along y of the world, in a benchmark's worlds [m]."""

TURN_RAD: Final = float(np.radians(3.0))
"""Largest rotation of the object about the vertical [rad]."""

FRICTION: Final = 0.1
"""Largest relative deviation of the object's friction, both sliding and torsional."""

MASS_SHARE: Final = 0.2
"""Largest relative deviation of the object's mass and inertia."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectVariation:
    """How a task's object differs from the standard one. The defaults change nothing.

    Attributes:
        shift: (2,) shift of the object along x and y of the world [m].
        turn: rotation of the object about the vertical [rad].
        friction: factor of the object's friction.
        mass: factor of the object's mass.
        shape: number of the object's shape, in scenes that have several.
        target: (3,) shift of the target, in scenes that have one [m].
    """

    shift: Float[np.ndarray, "2"] = field(default_factory=lambda: np.zeros(2))
    turn: float = 0.0
    friction: float = 1.0
    mass: float = 1.0
    shape: int = 0
    target: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))

    def scene(self, scene: _S) -> _S:
        """Returns the scene with the object at the start that this variation gives."""
        scene = scene.varied(self.shape, self.target)
        position, quaternion = scene.start
        shift = np.array([*self.shift, 0.0])
        about = np.array([np.cos(self.turn / 2), 0.0, 0.0, np.sin(self.turn / 2)])
        turned = np.zeros(4)
        mujoco.mju_mulQuat(turned, about, np.asarray(quaternion, float))
        return replace(scene, start=(position + shift, turned))

    def prepare(self, physics: ScenePhysics) -> None:
        """Sets friction and mass of the object; call it once, before a trial."""
        model = physics.model
        own = model.body_rootid == model.body(OBJECT).id
        model.geom_friction[own[model.geom_bodyid], :2] *= self.friction
        model.body_mass[own] *= self.mass
        model.body_inertia[own] *= self.mass
        # mj_setConst derives values from masses. It also clears the collision masks of the bodies,
        # which an object that still waits for the hand needs later.
        touches = [np.array(one) for one in (model.body_contype, model.body_conaffinity)]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        model.body_contype[:], model.body_conaffinity[:] = touches


def draw_variation(rng: np.random.Generator, scale: float = 1.0) -> ObjectVariation:
    """Draws a random variation, uniform within the limits of the benchmark.

    Args:
        scale: factor of all limits; 0 for the nominal object.
    """
    unit = scale * rng.uniform(-1.0, 1.0, 5)
    return ObjectVariation(
        shift=SHIFT_M * unit[:2],
        turn=TURN_RAD * float(unit[2]),
        friction=1.0 + FRICTION * float(unit[3]),
        mass=1.0 + MASS_SHARE * float(unit[4]),
    )


WRIST_SHIFT_M: Final = 0.02
"""Largest shift of the object along x and y in tasks with a moving wrist [m]."""

WRIST_TURN_RAD: Final = float(np.radians(15.0))
"""Largest rotation of the object about the vertical in those tasks [rad]."""

TARGET_M: Final = (0.10, 0.10, 0.05)
"""Largest shift of the target along x, y and z in those tasks [m]."""

WRIST_FRICTION: Final = 0.25
"""Largest relative deviation of the object's friction in those tasks."""

_SHAPES: Final = 6  # a multiple of the number of shapes of every scene


def draw_wrist_variation(rng: np.random.Generator, scale: float = 1.0) -> ObjectVariation:
    """Draws a random variation for a task with a moving wrist, uniform within that task's limits.

    Args:
        scale: factor of all limits; 0 for the nominal object, of any shape.
    """
    unit = scale * rng.uniform(-1.0, 1.0, 8)
    return ObjectVariation(
        shift=WRIST_SHIFT_M * unit[:2],
        turn=WRIST_TURN_RAD * float(unit[2]),
        friction=1.0 + WRIST_FRICTION * float(unit[3]),
        mass=1.0 + MASS_SHARE * float(unit[4]),
        shape=int(rng.integers(_SHAPES)),
        target=np.array(TARGET_M) * unit[5:],
    )

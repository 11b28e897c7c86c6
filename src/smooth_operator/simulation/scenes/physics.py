"""A hand under physics in a scene: the task's object, its fixture and its reset."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.carried import CarriedHand, WristKinematics
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.simulation.physics_model import FURNISHED
from smooth_operator.simulation.scenes.pads import soften_pads
from smooth_operator.simulation.scenes.scene import (
    OBJECT,
    Scene,
    ScenePart,
    SceneState,
    empty_world,
)
from smooth_operator.simulation.scenes.touching import Touching

_CLEAR: Final = 0.001
"""Distance from which on the hand counts as out of the object's place [m]."""

_GRIP_N: Final = 0.3
"""Force from which on a finger counts as holding [N]."""

_GRIP_S: Final = 0.25
"""Time for which thumb and two fingers must hold before the fixture releases the object [s]."""

_KINDS: Final = {
    int(mujoco.mjtGeom.mjGEOM_BOX): ("box", 3),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): ("capsule", 2),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", 2),
}


def in_front(carried: CarriedHand, scene: Scene) -> CarriedHand:
    """The arm on the table, placed so that its hand starts where the fixture would hold it."""
    wrist = WristKinematics(carried).wrist(carried.home)
    place = scene.mount.wrist - wrist[:3]
    return carried.at_base((place[0] - carried.arm.back, place[1], 0.0))


class ScenePhysics(HandPhysics):
    """Physics of a hand and the object of a task.

    The object starts as a ghost: it stays at its start and touches nothing until the hand is out
    of its place, as an experimenter would wait before placing it. In a scene with a fixture, the
    fixture holds the object until thumb and two fingers do.

    Args:
        hand: the robot hand.
        scene: the scene around the hand.
        timestep: time step of the physics [s].
        bandwidth: bandwidth of the servos [Hz].
        carried: an arm that carries the hand and stands in front of the task; None for a fixture.

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
        carried: CarriedHand | None = None,
    ) -> None:
        self.scene = scene
        self._ghost = self._fixed = self._away = False  # until there is a model
        self.starts = 0
        placed = None if carried is None else in_front(carried, scene)
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
        tips = [model.body(FURNISHED + finger.tip.body).id for finger in hand.spec.fingers]
        soften_pads(model, self._body, tips)
        self._needed = min(2, len(hand.fingers) - 1)
        self._gripped = 0
        self.reset_object()

    def restart(self) -> None:
        """Reset to time 0, the hand at rest in the neutral pose, the object at its start."""
        super().restart()
        self.starts = 0
        self.reset_object()

    def reset_object(self) -> None:
        """Put the object back to its start, as soon as the hand is out of its place."""
        self._away = False
        self.starts += 1
        self._begin()

    def put_away(self) -> None:
        """Take the object out until it is put back: nothing touches it."""
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
        """State of the object and of its contacts."""
        force, touch, palm, rest = self._touching.read(self._data)
        speed = self._data.qvel[self._moves : self._moves + 6]
        turn = self._data.xmat[self._body].reshape(3, 3)
        pose = self._data.qpos[self._at : self._at + 7]
        return SceneState(
            self.time, pose[:3].copy(), pose[3:].copy(), speed[:3].copy(), turn @ speed[3:],
            force, touch, palm, rest, not self._ghost, self._fixed, self.starts, self._away,
        )  # fmt: skip

    def parts(self) -> list[ScenePart]:
        """The shapes of the platform and of the object, to draw."""
        model, parts = self.model, []
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            kind = _KINDS.get(int(model.geom_type[geom]))
            if kind is None or body not in (0, self._body):
                continue
            word, count = kind
            parts.append(
                ScenePart(
                    model.geom(geom).name or f"part{geom}", word,
                    tuple(float(s) for s in model.geom_size[geom][:count]),
                    tuple(float(c) for c in model.geom_rgba[geom]),  # type: ignore[arg-type]
                    model.geom_pos[geom].copy(), model.geom_quat[geom].copy(), body == self._body,
                )
            )  # fmt: skip
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
    """Physics of a hand on an arm that stands on an empty table (the floor of its world).

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

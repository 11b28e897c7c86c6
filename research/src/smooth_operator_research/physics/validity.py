"""Tests the physics simulation: pads, energy, slip, creep, and results at half the time step.

``python -m smooth_operator_research.physics.validity`` prints the table of
``research/docs/physics-measures.md``.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import mujoco
import numpy as np

from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.scenes.physics import soften_pads
from smooth_operator.simulation.scenes.scene import OBJECT, empty_world
from smooth_operator_research.physics.grasp_measures import GraspResult, RobotPinch, try_pinch
from smooth_operator_research.physics.grasp_physics import GRASP_OBJECTS, GraspObject, PinchPhysics
from smooth_operator_research.run_report import markdown

STEP_S: Final = 0.002
FRICTION: Final = 0.9

_PADS: Final = ("left", "right")
_RADIUS, _HALF = 0.008, 0.009  # of a pad: a fingertip's capsule [m]
_PAD_MASS: Final = 0.25  # what a fingertip weighs with its motors' rotors behind it [kg]
_HIGH: Final = 0.3  # of the pads over the floor [m]
_SETTLE_S: Final = 1.0
_SLIDES: Final = 0.005  # faster is slipping [m/s]

WIDE: Final = (
    0.658, -1.166, 0.928, 0.963, 0.478, 1.298, 0.594, 0.454, 1.182, 0.958, 0.302, 0.224, 0.196,
    0.586, 0.418, 0.213,
)  # fmt: skip
TIGHT: Final = (
    0.458, -0.553, 1.723, 1.482, 0.593, 1.129, 1.457, 0.079, 1.368, 1.336, 0.269, 0.303, 0.027,
    0.369, 0.361, 0.187,
)  # fmt: skip
"""Poses of the mimic hand [rad]: thumb and index 44 mm apart, and 3.6 mm inside each other."""


class Pinched(NamedTuple):
    """Simulated world of two pads on slide joints along x that press on an object from both sides.

    Attributes:
        model: model of the world; its two motors press the pads towards each other [N].
        data: its state.
        body: body of the object.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    body: int

    def run(self, seconds: float, pull: float = 0.0) -> None:
        """Advances time with a force along -z on the object [N]."""
        self.data.xfrc_applied[self.body, 2] = -pull
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)

    @property
    def depth(self) -> float:
        """Mean depth of a pad in the object [m]."""
        contacts = [-float(c.dist) for c in self.data.contact[: self.data.ncon]]
        return float(np.mean(contacts)) if contacts else 0.0

    @property
    def energy(self) -> float:
        """Kinetic and potential energy of the object [J]."""
        joint = self.model.joint(OBJECT)
        speed = self.data.qvel[int(joint.dofadr[0]) :][:6]
        mass = float(self.model.body_mass[self.body])
        high = float(self.data.qpos[int(joint.qposadr[0]) + 2])
        turning = float(self.model.body_inertia[self.body] @ speed[3:] ** 2)
        return 0.5 * (mass * float(speed[:3] @ speed[:3]) + turning) + 9.81 * mass * high


def _world(step: float) -> mujoco.MjSpec:
    bare = mujoco.MjSpec()
    bare.option.timestep = step
    bare.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return empty_world(bare)


def _built(
    world: mujoco.MjSpec, thing: GraspObject, height: float, pads: tuple[str, ...]
) -> Pinched:
    """Builds the world with an object at a height [m]."""
    body = world.worldbody.add_body(name=OBJECT, pos=(0.0, 0.0, height))
    body.add_freejoint(name=OBJECT)
    thing.add_to(body)
    model = world.compile()
    soften_pads(model, model.body(OBJECT).id, [model.body(name).id for name in pads])
    return Pinched(model, mujoco.MjData(model), model.body(OBJECT).id)


def pinched(thing: GraspObject, force: float) -> Pinched:
    """Places an object at rest between two pads that each press with a force [N]."""
    world = _world(STEP_S)
    for sign, name in zip((-1.0, 1.0), _PADS, strict=True):
        away = sign * (thing.width / 2 + _RADIUS)
        pad = world.worldbody.add_body(name=name, pos=(away, 0.0, _HIGH), gravcomp=1.0)
        pad.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(-sign, 0.0, 0.0))
        pad.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(_RADIUS, _HALF, 0.0), mass=_PAD_MASS,
            quat=(0.5**0.5, 0.5**0.5, 0.0, 0.0),
        )  # fmt: skip
        motor = world.add_actuator(name=name, target=name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    state = _built(world, thing, _HIGH, _PADS)
    state.data.ctrl[:] = force
    mujoco.mj_forward(state.model, state.data)
    return state


def indentation(force: float, thing: GraspObject) -> float:
    """Depth of a pad that presses with a force [N] into an object's face, by point of contact
    [m]."""
    world = pinched(thing, force)
    world.model.opt.gravity[:] = 0.0
    world.run(_SETTLE_S)
    return world.depth


def energy_gain(thing: GraspObject) -> tuple[float, float]:
    """Drops an object on a pad from 50 mm above it.

    Returns:
        largest gain of energy, as a fraction of the energy of the fall; and the height of the
        bounce, as a fraction of the height of the fall.
    """
    world, height = _world(STEP_S), 0.05
    pad = world.worldbody.add_body(name=_PADS[0], pos=(0.0, 0.0, _HIGH))
    pad.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(_RADIUS, _HALF, 0.0))
    top = _HIGH + _RADIUS + _HALF + thing.width / 2
    state = _built(world, thing, top + height, _PADS[:1])
    mujoco.mj_forward(state.model, state.data)
    fall = thing.mass * 9.81 * height
    least = state.energy
    gain, highest, touched = 0.0, 0.0, False
    for _ in range(round(1.0 / STEP_S)):
        mujoco.mj_step(state.model, state.data)
        touched |= state.data.ncon > 0
        now = state.energy
        # What the pad stores while it is pressed comes back.
        if not state.data.ncon:
            gain, least = max(gain, now - least), min(least, now)
        if touched:
            highest = max(highest, float(state.data.qpos[2]) - top)
    return gain / fall, highest / height


def slip_ratio(force: float, thing: GraspObject) -> float:
    """Force at which an object slips between two pads, divided by friction times normal force."""
    world = pinched(thing, force)
    world.run(_SETTLE_S)
    weight = 9.81 * thing.mass
    limit = 2.0 * FRICTION * force - weight
    for pull in np.arange(0.5, 1.5, 0.01) * limit:
        world.run(0.02, pull)
        if -float(world.data.qvel[-4]) > _SLIDES:
            return float((pull + weight) / (2.0 * FRICTION * force))
    return np.inf


def creep(force: float, thing: GraspObject, seconds: float = 10.0) -> float:
    """Distance that a held object sinks between two pads [m], from 0.05 s after they press."""
    world = pinched(thing, force)
    world.run(0.05)
    before = float(world.data.xpos[world.body, 2])
    world.run(seconds)
    return before - float(world.data.xpos[world.body, 2])


def mimic_pinch(thing: GraspObject, step: float) -> GraspResult:
    """Closes the mimic hand on an object in 0.4 s, holds for 1.3 s, and opens."""
    hand = load_hand("mimic_p050")
    wide, tight = hand.full_configuration(WIDE), hand.full_configuration(TIGHT)
    stamps = np.arange(0.0, 3.0, 0.01)
    closed = np.interp(stamps, [0.0, 0.4, 1.7, 1.85], [0.0, 1.0, 1.0, 0.0])
    commands = wide + closed[:, None] * (tight - wide)
    physics = PinchPhysics(hand, thing, timestep=step)
    pinch = RobotPinch(
        finger=1, stamps=stamps, commands=commands, closing=0.0, tight=0.4, shut=1.7, opened=1.75
    )
    return try_pinch(physics, pinch)


def main() -> None:
    """Prints the tables."""
    by_name = {thing.name: thing for thing in GRASP_OBJECTS}
    rows: list[list[object]] = []
    for name in ("cube 10", "cube 30"):
        depths = [f"{1e3 * indentation(force, by_name[name]):.2f}" for force in (1.0, 2.0, 5.0)]
        rows.append(["depth of a pad at 1, 2, 5 N per pad [mm]", name, ", ".join(depths)])
    for name in ("sphere 10", "sphere 30"):
        gain, bounce = energy_gain(by_name[name])
        rows.append(["energy gained in a fall of 50 mm on a pad [fraction]", name, gain])
        rows.append(["height of the bounce [share]", name, bounce])
    for name in ("cube 10", "cube 20", "cube 30"):
        ratios = [f"{slip_ratio(force, by_name[name]):.2f}" for force in (1.0, 5.0)]
        rows.append(
            ["force at which it slips, divided by 2 mu N, at 1 and 5 N", name, ", ".join(ratios)]
        )
    rows += [
        ["creep in 10 s at 2 N per pad [mm]", name, 1e3 * creep(2.0, by_name[name])]
        for name in ("card 2", "cube 30")
    ]
    print(markdown(("check", "object", "value"), rows), end="\n\n")
    rows = []
    for thing in GRASP_OBJECTS:
        both = [mimic_pinch(thing, step) for step in (STEP_S, STEP_S / 2)]
        held, forces = ["yes" if one.held else "no" for one in both], [one.force for one in both]
        rows.append([thing.name, *held, *forces])
    steps = ("held at 2 ms", "held at 1 ms", "force at 2 ms [N]", "force at 1 ms [N]")
    print(markdown(("object", *steps), rows))


if __name__ == "__main__":
    main()

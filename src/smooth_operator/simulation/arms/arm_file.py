"""Reads a user's arm from a URDF or MJCF file: the joints from the base to a given link."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

from smooth_operator.errors import ConfigError
from smooth_operator.hands.collision import shape_capsules
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.model_assets import read_model_xml
from smooth_operator.simulation.arms.arm import (
    ArmSpec,
    Capsule,
    Link,
    Matrix,
    Place,
    Point,
    inverse,
    pose_of,
    rigid,
)

_VELOCITY: Final = 2.0  # where the file states none [rad/s]
_ACCELERATION: Final = 10.0  # model files state none [rad/s^2]
_TORQUE: Final = 100.0  # where the file states none [N m]
_TURN: Final = 2 * np.pi  # largest angle of a joint without limits [rad]
_RADIUS: Final = 0.02  # of a link without a shape [m]
_LEAST_MASS: Final = 0.05  # [kg]


def arm_from_file(path: Path, tip: str, posture: Sequence[float] | None = None) -> ArmSpec:
    """Reads an arm from a model file.

    The shapes become capsules; a link without a shape is a rod from its joint to the next one.

    Args:
        path: URDF or MJCF file.
        tip: link to which a hand is attached; its z points out of the arm.
        posture: (n,) joint positions at the start [rad]; by default the middle of each range.

    Raises:
        ConfigError: there is no such link, a joint on the way to it does not rotate, or the
            posture is not within the limits.
        HandModelError: the file can't be read.
    """
    model = load_model(path).model
    names = [model.body(body).name for body in range(1, model.nbody)]
    if tip not in names:
        raise ConfigError(
            f"arm {path}: expected tip=LINK, the link to which the hand is attached, not {tip!r}; "
            f"the links are {', '.join(names)}"
        )
    way = [int(model.body(tip).id)]
    while way[-1]:
        way.append(int(model.body_parentid[way[-1]]))
    joints = [j for b in reversed(way) for j in range(model.njnt) if model.jnt_bodyid[j] == b]
    slides = [
        model.joint(j).name for j in joints if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE
    ]
    if slides or not joints:
        raise ConfigError(
            f"arm {path}: expected only rotating joints between the base and {tip!r}, found "
            f"{', '.join(slides) or 'no joint'}; name another link in tip="
        )
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    frames = [np.eye(4), *(_joint_frame(data, j) for j in joints)]
    end = rigid(data.xmat[model.body(tip).id].reshape(3, 3), data.xpos[model.body(tip).id])
    last = [0, *(int(model.jnt_bodyid[j]) for j in joints)]
    stated = _stated(path)
    links = []
    for number, j in enumerate(joints, start=1):
        name = model.joint(j).name
        velocity, torque = stated.get(name, (0.0, 0.0))
        # A rod stands for a link without a shape.
        after = [*frames, end][number + 1]
        rod = Capsule((0.0, 0.0, 0.0), _point((inverse(frames[number]) @ after)[:3, 3]), _RADIUS)
        links.append(
            Link(
                name,
                _place(inverse(frames[number - 1]) @ frames[number]),
                tuple(model.jnt_range[j]) if model.jnt_limited[j] else (-_TURN, _TURN),
                velocity or _VELOCITY,
                _ACCELERATION,
                torque or _TORQUE,
                max(float(model.body_mass[_fixed_to(model, last[number])].sum()), _LEAST_MASS),
                _capsules(model, data, last[number], frames[number]) or (rod,),
            )
        )
    middle = [(low + high) / 2 for low, high in (link.limits for link in links)]
    return ArmSpec(
        name=path.stem,
        title=path.stem,
        links=tuple(links),
        flange=_place(inverse(frames[-1]) @ end),
        base=_capsules(model, data, 0, frames[0]),
        nominal=tuple(middle if posture is None else posture),
        reach=float(sum(np.linalg.norm(link.place[:3]) for link in links)),
        sources=(str(path),),
    )


def _joint_frame(data: mujoco.MjData, joint: int) -> Matrix:
    """Frame of a joint in the world, whose z is the axis."""
    z = np.array(data.xaxis[joint])
    x = np.eye(3)[np.argmin(np.abs(z))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return rigid(np.stack([x, np.cross(z, x), z], axis=1), data.xanchor[joint])


def _place(matrix: Matrix) -> Place:
    x, y, z, *turn = map(float, pose_of(matrix))
    return (x, y, z, turn[0], turn[1], turn[2], turn[3])


def _point(values: np.ndarray) -> Point:
    x, y, z = map(float, values)
    return x, y, z


def _fixed_to(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Mask of the bodies that are fixed to a body."""
    return np.asarray(model.body_weldid == model.body_weldid[body])


def _capsules(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, frame: Matrix
) -> tuple[Capsule, ...]:
    """Capsules of what is fixed to a body, in a frame."""
    found = []
    for geom in np.flatnonzero(_fixed_to(model, body)[model.geom_bodyid]):
        if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            continue
        for capsule in shape_capsules(model, int(geom)):
            turn, place = data.xmat[capsule.body].reshape(3, 3), data.xpos[capsule.body]
            ends = (capsule.ends @ turn.T + place - frame[:3, 3]) @ frame[:3, :3]
            found.append(Capsule(_point(ends[0]), _point(ends[1]), capsule.radius))
    return tuple(found)


def _stated(path: Path) -> dict[str, tuple[float, float]]:
    """Joint -> velocity [rad/s] and torque [N m] that a URDF states for it."""
    limits = {
        joint.get("name", ""): joint.find("limit") for joint in read_model_xml(path).iter("joint")
    }
    return {
        name: (float(limit.get("velocity", 0.0)), float(limit.get("effort", 0.0)))
        for name, limit in limits.items()
        if limit is not None
    }

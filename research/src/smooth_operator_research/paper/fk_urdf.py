"""A hand as URDF text: the form in which other libraries take a kinematic tree.

It is written from the compiled model, so that what is compared has one and the same kinematics,
whatever file the hand came from. Bodies that do not move against their parent are merged into it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand

ROOT: Final = "palm"
"""Name of the link that is the frame of all positions."""

_LIMIT: Final = 100.0  # beyond any joint's; limits are not what is compared [rad or m]

_INERTIAL: Final = (
    '<inertial><mass value="0.01"/><inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" '
    'izz="1e-5"/></inertial>'
)
"""Some readers refuse moving links without a mass."""


@dataclass(frozen=True, eq=False)
class Urdf:
    """A hand for other libraries.

    Attributes:
        text: the file.
        joints: (n,) names in it of the hand's joints, in the hand's order.
        zero: (n,) position of each joint in the hand where it is 0 here [rad].
        tips: (F,) names of the links whose origins are the fingertips, thumb first.
    """

    text: str
    joints: tuple[str, ...]
    zero: Float[np.ndarray, " n"]
    tips: tuple[str, ...]


def write_urdf(hand: Hand) -> Urdf:
    """The hand's joints below the palm; coupled ones are joints like any other.

    Args:
        hand: the robot hand.
    """
    model, parts = hand.model, [f'<link name="{ROOT}"/>']
    palm = int(model.body(hand.spec.palm).id)
    at: dict[int, tuple[str, np.ndarray]] = {palm: (ROOT, np.eye(4))}
    names: dict[int, str] = {}
    for body in np.flatnonzero(hand.bodies):
        parent = int(model.body_parentid[body])
        if body == palm or parent not in at:
            continue
        link, inside = at[parent]
        inside = inside @ _pose(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            name, moved = f"joint_{joint}", f"link_{joint}"
            anchor = _moved(model.jnt_pos[joint])
            slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
            parts += [
                f'<link name="{moved}">{_INERTIAL}</link>',
                _joint(name, "prismatic" if slides else "revolute", link, moved, inside @ anchor,
                       model.jnt_axis[joint]),
            ]  # fmt: skip
            names[joint] = name
            link, inside = moved, np.linalg.inv(anchor)
        at[int(body)] = (link, inside)
    tips = []
    for finger in hand.spec.fingers:
        tip = finger.tip.mirrored if hand.spec.mirror else finger.tip
        link, inside = at[int(model.body(tip.body).id)]
        name = f"tip_{finger.name}"
        parts += [
            f"<link name={quoteattr(name)}/>",
            _joint(f"fixed_{finger.name}", "fixed", link, name, inside @ _moved(tip.offset)),
        ]
        tips.append(name)
    joints = [int(model.joint(name).id) for name in hand.joint_names]
    zero = np.array([model.qpos0[model.jnt_qposadr[joint]] for joint in joints], float)
    text = f'<robot name="hand">{"".join(parts)}</robot>'
    return Urdf(text, tuple(names[joint] for joint in joints), zero, tuple(tips))


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    pose: Float[np.ndarray, "4 4"],
    axis: Float[np.ndarray, "3"] | None = None,
) -> str:
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")  # about fixed axes, as URDF has it
    more = "" if axis is None else (
        f'<axis xyz="{_numbers(axis)}"/>'
        f'<limit lower="{-_LIMIT}" upper="{_LIMIT}" effort="1" velocity="1"/>'
    )  # fmt: skip
    return (
        f"<joint name={quoteattr(name)} type={quoteattr(kind)}>"
        f'<origin xyz="{_numbers(pose[:3, 3])}" rpy="{_numbers(angles)}"/>'
        f"<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>{more}</joint>"
    )


def _numbers(values: Float[np.ndarray, "3"]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _pose(position: Float[np.ndarray, "3"], quat: Float[np.ndarray, "4"]) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quat, float))
    pose = _moved(position)
    pose[:3, :3] = matrix.reshape(3, 3)
    return pose


def _moved(position: Float[np.ndarray, "3"] | tuple[float, ...]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose

"""A description carried over to another model of the same hand: the vendor's, with its meshes.

Our compact models keep the vendor's joints and the frames of the links that these move. So a point
on a link of ours is the same point on the vendor's link with the same joint, whatever the two call
their bodies; and the palm is the vendor's body in whose frame the first links lie as in ours.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.spec import FingerSpec, HandSpec, Point

_SAME: Final = 1e-3  # landmarks this far apart are another hand's [m]
_POSES: Final = 32

_Frame = tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]


def on_model(hand: Hand, path: str | Path) -> Hand:
    """The same hand on another model of it.

    Args:
        hand: a hand, not a mirrored one.
        path: MJCF or URDF with the hand's joints, by their names; it may have more, such as a
            wrist's or an arm's.

    Raises:
        HandModelError: the model can't be used, lacks joints, or is not of this hand: its landmarks
            lie elsewhere.
    """
    path = Path(path)
    if hand.spec.mirror:
        raise HandModelError(
            f"the {hand.spec.side} hand {hand.name!r} is a mirror image, so there is no model that "
            "it was made from; ask for the other side"
        )
    model = load_model(path).model
    names = {model.joint(j).name for j in range(model.njnt)}
    if missing := [name for name in hand.joint_names if name not in names]:
        raise HandModelError(
            f"{path} lacks the joints {', '.join(missing)} of the {hand.spec.side} hand "
            f"{hand.name!r}; give a model of that hand and side"
        )
    other = load_hand_spec(_carried(hand, model, path))
    distance = _difference(hand, other)
    if not distance < _SAME:
        raise HandModelError(
            f"{path} is another hand than the {hand.spec.side} {hand.name!r}: at equal joint "
            f"positions their landmarks are up to {distance * 1e3:.1f} mm apart"
        )
    return other


def _carried(hand: Hand, model: mujoco.MjModel, path: Path) -> HandSpec:
    spec, palm = hand.spec, _palm(hand, model)

    def carry(point: Point) -> Point:
        body = hand.model.body(point.body).id
        link = int(hand.model.body_weldid[body])  # what it is fixed to, as a tip to its last link
        joint = int(hand.model.body_jntadr[link])
        if joint >= 0 and hand.model.joint(joint).name in hand.joint_names:
            there = int(model.jnt_bodyid[model.joint(hand.model.joint(joint).name).id])
            name = _name(model, there, path)
        else:
            link, name = hand.model.body(spec.palm).id, palm
        rotation, position = _relative(hand.model, link, body)
        x, y, z = rotation @ np.asarray(point.offset) + position
        return Point(name, (float(x), float(y), float(z)))

    fingers = []
    for finger in spec.fingers:
        a, b, c, d = (None if point is None else carry(point) for point in finger.points)
        fingers.append(FingerSpec(finger.name, (a, b, c, d)))
    return replace(spec, model=path, palm=palm, wrist=carry(spec.wrist), fingers=tuple(fingers))


def _palm(hand: Hand, model: mujoco.MjModel) -> str:
    """The body that the first links hang from as they do from our palm."""
    ours = hand.model.body(hand.spec.palm).id
    held = hand.model.body_weldid[ours]
    links = []
    for name in hand.joint_names:
        body = int(hand.model.joint(name).bodyid[0])
        if hand.model.body_weldid[hand.model.body_parentid[body]] == held:
            there = int(model.joint(name).bodyid[0])
            links.append((there, _relative(hand.model, ours, body)))

    def apart(body: int) -> float:
        frames = [(_relative(model, body, link), there) for link, there in links]
        return max(float(np.abs(R - S).max() + np.abs(p - q).max()) for (R, p), (S, q) in frames)

    # of bodies that share one frame, as a mount and the palm on it may, the innermost
    best = min(range(1, model.nbody), key=lambda body: (round(apart(body) / _SAME, 2), -body))
    if not apart(best) < _SAME or not model.body(best).name:
        raise HandModelError(
            f"no body of that model is the palm of {hand.name!r}: its fingers start elsewhere"
        )
    return str(model.body(best).name)


def _relative(model: mujoco.MjModel, base: int, body: int) -> _Frame:
    """Frame of a body in that of another, in the model's reference pose."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rotation = data.xmat.reshape(-1, 3, 3)
    return (
        rotation[base].T @ rotation[body],
        rotation[base].T @ (data.xpos[body] - data.xpos[base]),
    )


def _name(model: mujoco.MjModel, body: int, path: Path) -> str:
    if not (name := model.body(body).name):
        raise HandModelError(f"{path}: body {body} has a joint of the hand but no name; name it")
    return str(name)


def _difference(hand: Hand, other: Hand) -> float:
    """Largest distance of landmarks over poses all through the joints' ranges [m]."""
    low, high = np.clip(hand.joint_limits.T, -np.pi, np.pi)
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    theirs = np.zeros((_POSES, len(other.joint_names)))
    theirs[:, [other.joint_names.index(name) for name in hand.joint_names]] = poses
    apart = np.asarray(hand.tree.positions(poses)) - np.asarray(other.tree.positions(theirs))
    return float(np.linalg.norm(apart, axis=-1).max())

"""Handles the joints between the forearm and the palm of a robot hand.

They move no finger relative to the palm, so retargeting methods work on a hand without them. The
commands of a hand with wrist joints have them behind the joints of the fingers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import mujoco
import numpy as np

from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.transmission import Transmission

MOST_WRIST_JOINTS: Final = 2
"""Largest number of wrist joints: one that flexes the wrist and one that deviates it."""


def with_wrist_joints(hand: Hand) -> Hand:
    """Returns the hand with its wrist joints as additional actuated joints, after all others. A
    hand that has no wrist joints, or to which they were already added, is returned as it is. Raises
    HandModelError if there are more than two wrist joints, or if one of them is not a limited hinge
    above the palm."""
    names = hand.spec.wrist_joints
    check_wrist_joints(hand)
    if not names or names[0] in hand.joint_names:
        return hand
    n, m, k = len(hand.joint_names), len(hand.actuated), len(names)
    limits = np.array([hand.model.joint(name).range for name in names])
    neutral = np.clip([hand.spec.neutral.get(name, 0.0) for name in names], *limits.T)
    matrix = np.zeros((n + k, m + k))
    matrix[:n, :m], matrix[n:, m:] = hand.transmission.matrix, np.eye(k)
    offset = np.concatenate([hand.transmission.offset, np.zeros(k)])
    tree = hand.tree
    return replace(
        hand,
        joint_names=(*hand.joint_names, *names),
        actuated=(*hand.actuated, *range(n, n + k)),
        limits=np.concatenate([hand.limits, limits]),
        neutral=np.concatenate([hand.neutral, neutral]),
        tree=replace(tree, num_joints=n + k, limits=np.concatenate([tree.limits, limits])),
        transmission=Transmission(matrix, offset, hand.transmission.curves),
    )


def has_joints(hand: Hand, names: Sequence[str]) -> bool:
    """True if these joint names are those of a hand's commands, with or without its wrist
    joints."""
    own = hand.joint_names
    return tuple(names) in (own, (*own, *hand.spec.wrist_joints))


def check_wrist_joints(hand: Hand) -> None:
    """Raises HandModelError unless a hand's wrist joints can be commanded."""
    names, model = hand.spec.wrist_joints, hand.model
    above = [model.joint(j).name for j in joints_above_palm(hand)]
    movable = [name for name in above if _is_limited_hinge(model, name)]
    if len(names) > MOST_WRIST_JOINTS or list(names) != [each for each in movable if each in names]:
        raise HandModelError(
            f"hand {hand.name!r}: wrist_joints must name at most {MOST_WRIST_JOINTS} hinges with "
            f"limits between forearm and palm, in the order from the forearm, not {list(names)}; "
            f"the model has {movable or 'no such joint'} above {hand.spec.palm!r}"
        )


def joints_above_palm(hand: Hand) -> list[int]:
    """Indices of the joints between the base of the model and the palm, which move the palm."""
    model, body, joints = hand.model, hand.model.body(hand.spec.palm).id, list[int]()
    while body:
        first = int(model.body_jntadr[body])
        joints = [*range(first, first + int(model.body_jntnum[body])), *joints]
        body = int(model.body_parentid[body])
    return joints


def _is_limited_hinge(model: mujoco.MjModel, name: str) -> bool:
    joint = model.joint(name)
    return bool(joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE and model.jnt_limited[joint.id])

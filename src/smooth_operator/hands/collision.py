"""How deep the hand's own parts are inside each other, by the simple shapes of its model."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS

PALM: Final = -1
"""What ``owners`` gives for the palm, and for all that is of no finger."""


def penetration_depths(hand: Hand, joint_positions: ArrayLike) -> Float[np.ndarray, " T"] | None:
    """Deepest self-penetration in each frame.

    Looked at are pairs of shapes on two different fingers, tips included, so that a pinch that goes
    too deep counts; and a finger against the palm. Left out are shapes of one finger, bodies joined
    to each other, and pairs that touch in the neutral pose already, where shapes are drawn fatter
    than the parts they stand for. What the model itself takes out of collision stays out.

    Args:
        hand: the robot hand.
        joint_positions: (T, n) positions of all joints [rad].

    Returns:
        (T,) depth [m], 0 where nothing overlaps and NaN where a pose is not finite; None if it
        can't be measured: the hand has ``shapeless_links``, or no two shapes that could collide.

    Raises:
        HandModelError: if the positions are not (T, n).
    """
    q = np.asarray(joint_positions, np.float64)
    if q.ndim != 2 or q.shape[1] != len(hand.joint_names):
        raise HandModelError(
            f"joint positions must have shape (T, {len(hand.joint_names)}) for hand "
            f"{hand.name!r}, not {q.shape}"
        )
    counts = colliding_shapes(hand)
    if shapeless_links(hand) or not _counting_pairs(hand).any():
        return None
    data = mujoco.MjData(hand.model)
    depths = np.full(len(q), np.nan)
    for frame, pose in enumerate(q):
        if np.isfinite(pose).all():
            pairs, depth = _overlaps(hand, data, pose)
            counted = depth[counts[pairs[:, 0], pairs[:, 1]]]
            depths[frame] = max(float(counted.max(initial=0.0)), 0.0)
    return depths


def shapeless_links(hand: Hand) -> tuple[str, ...]:
    """Names of the links whose self-collision can't be measured; empty for a whole hand.

    They are the links that lost all their shapes because mesh files can't be read, and every link
    of a finger that has no shape at all.
    """
    model, part = hand.model, hand.model.body_weldid
    solid = {int(part[body]) for body in model.geom_bodyid[solid_shapes(hand)]}
    bare = {int(model.body(name).id) for name in hand.unreadable} - {
        body for body in range(model.nbody) if int(part[body]) in solid
    }
    owner = owners(hand)
    for finger in hand.fingers:
        links = np.flatnonzero(owner == FINGERS.index(finger)).tolist()
        if not any(int(part[body]) in solid for body in links):
            bare.update(links)
    return tuple(str(model.body(body).name) for body in sorted(bare))


def collision_note(hand: Hand) -> str:
    """Says why the self-collision of a hand can't be measured; empty where it can.

    Args:
        hand: the robot hand.
    """
    links = shapeless_links(hand)
    if not links:
        return ""
    more = f" and {len(links) - 3} more" if len(links) > 3 else ""
    return (
        f"self-collision of {hand.name} {hand.spec.side} is not measured: {len(links)} of its "
        f"links ({', '.join(links[:3])}{more}) have no collision shapes that can be read"
    )


def colliding_shapes(hand: Hand) -> Bool[np.ndarray, "g g"]:
    """Which pairs of the model's shapes ``penetration_depths`` looks at."""
    counts = _counting_pairs(hand)
    if counts.any():
        neutral, depth = _overlaps(
            hand, mujoco.MjData(hand.model), hand.full_configuration(hand.neutral)
        )
        touching = neutral[depth > 0]
        counts[touching[:, 0], touching[:, 1]] = counts[touching[:, 1], touching[:, 0]] = False
    return counts


def neutral_overlaps(hand: Hand) -> dict[tuple[str, str], float]:
    """What touches in the neutral pose, of the pairs that ``penetration_depths`` looks at.

    Left out are also the first two links of a finger against the palm: around a knuckle of two
    joints, shapes overlap by design.

    Returns:
        names of two bodies -> how deep they are inside each other [m].
    """
    model, counts = hand.model, _counting_pairs(hand)
    pairs, depths = _overlaps(hand, mujoco.MjData(model), hand.full_configuration(hand.neutral))
    out: dict[tuple[str, str], float] = {}
    for geoms, depth in zip(pairs, depths, strict=True):
        a, b = (int(model.body_weldid[model.geom_bodyid[g]]) for g in geoms)
        near = a in _above(model, b)[:2] or b in _above(model, a)[:2]
        if depth > 0 and counts[geoms[0], geoms[1]] and not near:
            one, other = sorted(str(model.body(model.geom_bodyid[g]).name) for g in geoms)
            out[one, other] = max(float(depth), out.get((one, other), 0.0))
    return out


def _above(model: mujoco.MjModel, part: int) -> list[int]:
    """The parts that a part hangs from, nearest first."""
    above: list[int] = []
    while part:
        part = int(model.body_weldid[model.body_parentid[part]])
        above.append(part)
    return above


def _overlaps(hand: Hand, data: mujoco.MjData, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of shapes in contact, (c, 2), and how deep each is, (c,) [m]."""
    model = hand.model
    data.qpos[:] = hand.qpos(pose)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    # copies: the next pose reuses the memory
    return np.array(data.contact.geom).reshape(-1, 2), -np.array(data.contact.dist)


def _counting_pairs(hand: Hand) -> Bool[np.ndarray, "g g"]:
    """Which pairs of shapes are of different parts of the hand and not joined to each other."""
    model = hand.model
    owner = owners(hand)[model.geom_bodyid]
    # bodies without a joint between them are one part
    part = model.body_weldid[model.geom_bodyid]
    above = model.body_weldid[model.body_parentid[part]]
    joined = (part[:, None] == above[None]) | (above[:, None] == part[None])
    solid = solid_shapes(hand)
    different = owner[:, None] != owner[None]
    return np.asarray(different & ~joined & solid[:, None] & solid[None])


def solid_shapes(hand: Hand) -> Bool[np.ndarray, " g"]:
    """Which of the model's shapes are the hand's (neither an arm's nor a second hand's) and can
    collide."""
    model = hand.model
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return np.asarray(solid & hand.bodies[model.geom_bodyid])


def owners(hand: Hand) -> Int[np.ndarray, " bodies"]:
    """Index of the finger that each body belongs to, or ``PALM``.

    A finger is the bodies between palm and fingertip that it shares with no other finger, and what
    hangs from them.
    """
    model = hand.model
    palm = model.body(hand.spec.palm).id
    chains = []
    for finger in hand.spec.fingers:
        chain, body = set(), model.body(finger.tip.body).id
        while body not in (palm, 0):
            chain.add(int(body))
            body = model.body_parentid[body]
        chains.append(chain)
    owner = np.full(model.nbody, PALM)
    for body in range(1, model.nbody):  # parents come first
        of = [
            FINGERS.index(f.name)
            for f, c in zip(hand.spec.fingers, chains, strict=True)
            if body in c
        ]
        owner[body] = (
            of[0] if len(of) == 1 else owner[model.body_parentid[body]] if not of else PALM
        )
    return owner

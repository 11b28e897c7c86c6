"""Self-penetration of a hand: its depth in poses, and the links on which it can't be measured."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.errors import HandModelError
from smooth_operator.hands.collision import (
    colliding_shapes,
    counting_pairs,
    owners,
    shape_overlaps,
    solid_shapes,
)
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS


def penetration_depths(hand: Hand, joint_positions: ArrayLike) -> Float[np.ndarray, " T"] | None:
    """Deepest self-penetration in each frame.

    Pairs of shapes on two fingers count, tips included, so that a pinch that goes too deep counts,
    and pairs of a finger and the palm. Shapes of one finger, bodies that are joined, and pairs that
    touch in the neutral pose do not count: shapes are often larger than the real parts. Pairs that
    the model itself excludes from collision do not count, either.

    Args:
        joint_positions: (T, n) positions of all joints [rad].

    Returns:
        (T,) depth [m], 0 without an overlap, NaN for a pose that is not finite. None if the hand
        has ``shapeless_links`` or no pair of shapes that counts.

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
    if shapeless_links(hand) or not counting_pairs(hand).any():
        return None
    data = mujoco.MjData(hand.model)
    depths = np.full(len(q), np.nan)
    for frame, pose in enumerate(q):
        if np.isfinite(pose).all():
            pairs, depth = shape_overlaps(hand, data, pose)
            counted = depth[counts[pairs[:, 0], pairs[:, 1]]]
            depths[frame] = max(float(counted.max(initial=0.0)), 0.0)
    return depths


def shapeless_links(hand: Hand) -> tuple[str, ...]:
    """Names of the links whose self-collision can't be measured; empty for a complete hand.

    They are the links that lost all their shapes because mesh files can't be read, and every link
    of a finger without any shape.
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
    """Reason why the self-collision of a hand can't be measured; empty if it can."""
    links = shapeless_links(hand)
    if not links:
        return ""
    more = f" and {len(links) - 3} more" if len(links) > 3 else ""
    return (
        f"self-collision of {hand.name} {hand.spec.side} is not measured: {len(links)} of its "
        f"links ({', '.join(links[:3])}{more}) have no collision shapes that can be read"
    )


def neutral_overlaps(hand: Hand) -> dict[tuple[str, str], float]:
    """Overlaps in the neutral pose of bodies of different parts of the hand.

    The first two links of a finger do not count against the palm: around a knuckle of two joints,
    shapes overlap by design.

    Returns:
        names of two bodies -> depth of their overlap [m].
    """
    model, counts = hand.model, counting_pairs(hand)
    pairs, depths = shape_overlaps(
        hand, mujoco.MjData(model), hand.full_configuration(hand.neutral)
    )
    out: dict[tuple[str, str], float] = {}
    for geoms, depth in zip(pairs, depths, strict=True):
        a, b = (int(model.body_weldid[model.geom_bodyid[g]]) for g in geoms)
        near = a in parts_above(model, b)[:2] or b in parts_above(model, a)[:2]
        if depth > 0 and counts[geoms[0], geoms[1]] and not near:
            one, other = sorted(str(model.body(model.geom_bodyid[g]).name) for g in geoms)
            out[one, other] = max(float(depth), out.get((one, other), 0.0))
    return out


def parts_above(model: mujoco.MjModel, part: int) -> list[int]:
    """Parts that a part hangs from, nearest first. A part is the first of bodies without a joint
    between them (``body_weldid``)."""
    above: list[int] = []
    while part:
        part = int(model.body_weldid[model.body_parentid[part]])
        above.append(part)
    return above

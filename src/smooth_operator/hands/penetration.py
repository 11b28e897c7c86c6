"""Self-penetration of a hand: its depth in each pose, and the links that penetrate each other."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.errors import HandModelError
from smooth_operator.hands.capsules import (
    candidate_pairs,
    chosen_pairs,
    hand_capsules,
    parts_apart,
)
from smooth_operator.hands.hand import Hand


def penetration_depths(hand: Hand, joint_positions: ArrayLike) -> Float[np.ndarray, " T"] | None:
    """Depth of the deepest self-penetration in each frame.

    The parts and pairs are those that ``smooth`` keeps apart (``parts_apart``): two fingers, tips
    included, so that a pinch that goes too deep counts, and a finger and the palm.

    Args:
        joint_positions: (T, n) positions of all joints [rad].

    Returns:
        (T,) depth [m], 0 without an overlap, NaN for a pose that is not finite. None if the hand
        has no two parts that could touch.

    Raises:
        HandModelError: if the positions are not (T, n).
    """
    q = np.asarray(joint_positions, np.float64)
    if q.ndim != 2 or q.shape[1] != len(hand.joint_names):
        raise HandModelError(
            f"joint positions must have shape (T, {len(hand.joint_names)}) for hand "
            f"{hand.name!r}, not {q.shape}"
        )
    apart = parts_apart(hand)
    if not len(apart.pairs):
        return None
    depths = np.full(len(q), np.nan)
    sound = np.isfinite(q).all(axis=1)
    for rows, found in apart.depths(q[sound]):
        depths[np.flatnonzero(sound)[rows]] = np.maximum(found.max(axis=1), 0.0)
    return depths


def crowded_links(
    hand: Hand, poses: Float[np.ndarray, "T m"], depth: float
) -> dict[tuple[str, str], float]:
    """Maps pairs of links to the share of poses in which they penetrate deeper than a depth.

    Args:
        poses: (T, m) positions of the actuated joints [rad].
        depth: least overlap that counts [m].

    Returns:
        The pairs that overlap in any of the poses, those with the largest share first.
    """
    model, apart = hand.model, parts_apart(hand)
    names = [str(model.body(c.body).name) for c in apart.capsules]
    of: dict[tuple[str, str], list[int]] = {}
    for number, (a, b) in enumerate(apart.pairs):
        one, other = sorted((names[a], names[b]))
        of.setdefault((one, other), []).append(number)
    counts = dict.fromkeys(of, 0)
    for _, found in apart.depths(hand.full_configuration(poses)):
        for links, these in of.items():
            counts[links] += int((found[:, these] > depth).any(axis=1).sum())
    order = sorted((links for links in of if counts[links]), key=lambda links: -counts[links])
    return {links: counts[links] / len(poses) for links in order}


def neutral_overlaps(hand: Hand) -> dict[tuple[str, str], float]:
    """Overlaps, in the neutral pose, between bodies of different parts of the hand.

    The first two links of a finger do not count against the palm: around a knuckle of two joints,
    shapes overlap by design.

    Returns:
        names of two bodies -> depth of their overlap [m].
    """
    model, capsules = hand.model, hand_capsules(hand)
    pairs = chosen_pairs(hand, capsules, candidate_pairs(hand, capsules))
    ((_, (depths,)),) = pairs.depths(hand.full_configuration(hand.neutral)[None])
    out: dict[tuple[str, str], float] = {}
    for number in np.flatnonzero(depths > 0):
        bodies = [pairs.capsules[c].body for c in pairs.pairs[number]]
        a, b = (int(model.body_weldid[body]) for body in bodies)
        if a in parts_above(model, b)[:2] or b in parts_above(model, a)[:2]:
            continue
        one, other = sorted(str(model.body(body).name) for body in bodies)
        out[one, other] = max(float(depths[number]), out.get((one, other), 0.0))
    return out


def parts_above(model: mujoco.MjModel, part: int) -> list[int]:
    """Parts between a part and the base of the model, nearest first. A part is the first of several
    bodies that no joint separates (``body_weldid``)."""
    above: list[int] = []
    while part:
        part = int(model.body_weldid[model.body_parentid[part]])
        above.append(part)
    return above

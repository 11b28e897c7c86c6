"""Capsules that fill a hand's collision shapes, and the pairs of them that could touch.

Most collision shapes of the built-in hands are capsules; boxes, such as palms, become a row of
parallel capsules inside them. A capsule is two points and a radius, so its distance from another
is cheap, and differentiable with respect to the points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float, Int

from smooth_operator.geometry import AnyKind, array_namespace
from smooth_operator.hands.collision import (
    PALM,
    Capsule,
    colliding_shapes,
    lacking_parts,
    owners,
    shape_capsules,
    solid_shapes,
)
from smooth_operator.hands.hand import Hand, tree_with
from smooth_operator.hands.kinematics import KinematicTree

_POSES = 4000
_MANY = 2000
"""Number of candidates above which a quarter of the poses is used."""
_SLACK = 0.004
"""Distance [m]; pairs that come no nearer in any of the random poses are left out."""
MOST: Final = 128
"""Largest number of pairs; each costs time in every frame, and more in compiling. The built-in
hands have 22 to 111; a vendor's model with ten boxes to a link has ten thousand candidates."""
_ROUNDING = 1e-5  # rounding of distances [m]
_TINY = 1e-12  # [m^2]
_PARALLEL = 1e-3  # squared sine of an angle below which segments count as parallel


@dataclass(frozen=True, eq=False)
class CapsulePairs:
    """Pairs of capsules that could touch, and the kinematics of their ends.

    Attributes:
        tree: kinematics of the hand's landmarks and of the ends of all capsules of the pairs.
        names: (2 C) keypoints of the ends in ``tree``: first and second end of each capsule.
        ends: position of each end: name -> (body, (3,) position in its frame [m]).
        pairs: (P, 2) indices of capsules.
        reach: (P,) sum of the two radii [m].
        shapes: (P, 2) indices of the model's geoms; -1 for a stand-in.
    """

    tree: KinematicTree
    names: tuple[str, ...]
    ends: Mapping[str, tuple[int, np.ndarray]]
    pairs: Int[np.ndarray, "P 2"]
    reach: Float[np.ndarray, " P"]
    shapes: Int[np.ndarray, "P 2"]


def capsule_pairs(hand: Hand) -> CapsulePairs:
    """Pairs of capsules whose contact is a self-collision and that some pose brings together.

    Candidates are the pairs of ``penetration_depths``. Of more than ``MOST``, those stay that are
    in most random poses the nearest pair of their two links, at least one for any two links that
    meet. A pair whose capsules overlap in the neutral pose is left out if its shapes do not. Links
    whose shapes can't be read have estimated capsules (``smooth_operator.hands.stand_ins``).
    """
    counts, estimated, replaced = colliding_shapes(hand), list[Capsule](), list[int]()
    if lacking_parts(hand):
        from smooth_operator.hands.stand_ins import stand_ins  # few hands need them

        own = stand_ins(hand)
        estimated, replaced = list(own.capsules), list(own.replaced)
    # without those of an arm, or of a second hand
    shapes = solid_shapes(hand) if estimated else counts.any(axis=1)
    part = hand.model.body_weldid[hand.model.geom_bodyid]
    shapes &= ~np.isin(part, replaced)
    capsules = [
        _on_palm(capsule, hand)
        for geom in np.flatnonzero(shapes)
        for capsule in shape_capsules(hand.model, int(geom))
    ]
    capsules += estimated
    owner = owners(hand)
    some = [
        (i, j)
        for i, one in enumerate(capsules)
        for j, other in enumerate(capsules[:i])
        if (
            counts[one.geom, other.geom]
            if min(one.geom, other.geom) >= 0
            else _may_meet(hand.model, owner, one, other)
        )
    ]
    pairs = np.array(some, int).reshape(-1, 2)
    if len(pairs):
        pairs = pairs[_meeting(hand, capsules, pairs)]
    used = sorted({int(c) for c in pairs.ravel()})
    chosen = [capsules[c] for c in used]
    at = {c: i for i, c in enumerate(used)}
    return CapsulePairs(
        _tree(hand, chosen),
        _names(chosen),
        _ends(chosen),
        np.array([(at[i], at[j]) for i, j in pairs], int).reshape(-1, 2),
        np.array([capsules[i].radius + capsules[j].radius for i, j in pairs], float),
        np.array([(capsules[i].geom, capsules[j].geom) for i, j in pairs], int).reshape(-1, 2),
    )


def _may_meet(
    model: mujoco.MjModel, owner: Int[np.ndarray, " bodies"], one: Capsule, other: Capsule
) -> bool:
    """True if two capsules, one of them a stand-in, are on different parts that are not joined."""
    fingers = [int(owner[capsule.body]) for capsule in (one, other)]
    if fingers[0] == fingers[1] or (PALM in fingers and (one.root or other.root)):
        return False
    parts = [int(model.body_weldid[capsule.body]) for capsule in (one, other)]
    above = [int(model.body_weldid[model.body_parentid[part]]) for part in parts]
    return parts[0] != above[1] and parts[1] != above[0]


def segment_parameters(
    first: tuple[AnyKind, AnyKind], second: tuple[AnyKind, AnyKind]
) -> tuple[AnyKind, AnyKind]:
    """Nearest points of two line segments of (..., 3) ends, as (...) shares of their lengths in [0,
    1]; NumPy or JAX. Parallel segments have many nearest points; these are two.

    Source: Ericson, "Real-Time Collision Detection" (2005), 5.1.9, without branches.
    """
    xp = array_namespace(first[0])
    along, across = first[1] - first[0], second[1] - second[0]
    between = first[0] - second[0]
    a = xp.maximum((along * along).sum(-1), _TINY)
    e = xp.maximum((across * across).sum(-1), _TINY)
    b, c, f = (along * across).sum(-1), (along * between).sum(-1), (across * between).sum(-1)
    s = xp.clip((b * f - c * e) / xp.maximum(a * e - b * b, _PARALLEL * a * e), 0.0, 1.0)
    t = xp.clip((b * s + f) / e, 0.0, 1.0)
    s = xp.clip((b * t - c) / a, 0.0, 1.0)
    return s, t


def segments_apart(
    first: tuple[AnyKind, AnyKind], second: tuple[AnyKind, AnyKind]
) -> tuple[AnyKind, AnyKind, AnyKind]:
    """(..., 3) vector between the nearest points of two line segments, from the second to the
    first, and the (...) shares of ``segment_parameters``."""
    s, t = segment_parameters(first, second)
    apart = (
        first[0]
        + s[..., None] * (first[1] - first[0])
        - second[0]
        - t[..., None] * (second[1] - second[0])
    )
    return apart, s, t


def _on_palm(capsule: Capsule, hand: Hand) -> Capsule:
    """The capsule with the palm as its body if its own body does not hang from the palm.

    Such a body is a forearm without a wrist joint, to which the palm is fixed.
    """
    model = hand.model
    palm, body = model.body(hand.spec.palm).id, capsule.body
    while body not in (0, palm):
        body = int(model.body_parentid[body])
    if body == palm:
        return capsule
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn, at = data.xmat.reshape(-1, 3, 3), data.xpos
    world = capsule.ends @ turn[capsule.body].T + at[capsule.body]
    return replace(capsule, body=palm, ends=(world - at[palm]) @ turn[palm])


def _meeting(hand: Hand, capsules: list[Capsule], pairs: np.ndarray) -> np.ndarray:
    """Indices of up to ``MOST`` pairs that random poses bring together, in order."""
    low, high = hand.limits.T
    poses = _POSES if len(pairs) <= _MANY else _POSES // 4
    q = np.random.default_rng(0).uniform(low, high, (poses, len(low)))
    q = np.concatenate([hand.neutral[None], q])
    tree = _tree(hand, capsules)
    points = np.asarray(tree.positions(hand.full_configuration(q)))
    ends = points[:, [tree.names.index(name) for name in _names(capsules)]]
    ends = ends.reshape(len(q), len(capsules), 2, 3)
    middles = ends.mean(axis=2)
    radii = np.array([capsule.radius for capsule in capsules])
    parts = np.array([hand.model.body_weldid[capsule.body] for capsule in capsules], int)
    links = np.sort(parts[pairs], axis=1)
    ranked: list[tuple[int, int, int]] = []  # rank within its links, minus its count, pair
    for two in np.unique(links, axis=0):
        these = np.flatnonzero((links == two).all(axis=1))
        clear = _clearances(ends, middles, radii, pairs[these])
        # capsules that overlap in the neutral pose, while their shapes do not, are too thick
        clear = np.where(clear[0] < -_ROUNDING, np.inf, clear[1:])
        meet = clear.min(axis=0) < _SLACK
        first = clear.argmin(axis=1)[clear.min(axis=1) < _SLACK]
        counts = np.bincount(first, minlength=len(these))
        order = [k for k in np.argsort(-counts, kind="stable") if meet[k]]
        ranked += [(rank, -int(counts[k]), int(these[k])) for rank, k in enumerate(order)]
    return np.array(sorted(which for *_, which in sorted(ranked)[:MOST]), int)


def _clearances(
    ends: Float[np.ndarray, "n C 2 3"],
    middles: Float[np.ndarray, "n C 3"],
    radii: Float[np.ndarray, " C"],
    pairs: Int[np.ndarray, "P 2"],
) -> Float[np.ndarray, "n P"]:
    """Distance of the capsules of each pair in each pose [m].

    It is infinite where already the spheres around the capsules are further apart than the slack.
    """
    one, other = pairs.T
    halves = 0.5 * np.linalg.norm(ends[0, :, 1] - ends[0, :, 0], axis=-1)
    reach = radii[one] + radii[other]
    apart = np.linalg.norm(middles[:, one] - middles[:, other], axis=-1)
    pose, pair = np.nonzero(apart - halves[one] - halves[other] - reach < _SLACK)
    a, b = ends[pose, one[pair]], ends[pose, other[pair]]
    between, _, _ = segments_apart((a[:, 0], a[:, 1]), (b[:, 0], b[:, 1]))
    out = np.full(apart.shape, np.inf)
    out[pose, pair] = np.linalg.norm(between, axis=-1) - reach[pair]
    return out


def _names(capsules: list[Capsule]) -> tuple[str, ...]:
    return tuple(f"capsule {i} {end}" for i in range(len(capsules)) for end in "ab")


def _ends(capsules: list[Capsule]) -> dict[str, tuple[int, np.ndarray]]:
    return {
        name: (capsules[i // 2].body, capsules[i // 2].ends[i % 2])
        for i, name in enumerate(_names(capsules))
    }


def _tree(hand: Hand, capsules: list[Capsule]) -> KinematicTree:
    return tree_with(hand, _ends(capsules))

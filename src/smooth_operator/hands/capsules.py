"""Capsules of a hand's parts, and the pairs of capsules that must not overlap.

A capsule is two points and a radius, so its distance from another is cheap, and differentiable with
respect to the points. Other shapes are filled with capsules (``shape_capsules``), and a link whose
shapes can't be read has estimated ones (``smooth_operator.hands.stand_ins``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float, Int

from smooth_operator.geometry import AnyKind, array_namespace
from smooth_operator.hands.collision import (
    PALM,
    Capsule,
    owners,
    shape_capsules,
    solid_shapes,
)
from smooth_operator.hands.hand import Hand, tree_with
from smooth_operator.hands.kinematics import KinematicTree
from smooth_operator.hands.stand_ins import stand_ins

_POSES = 4000
_MANY = 2000
"""Number of candidates above which a quarter of the poses is used."""
_SLACK = 0.004
"""Distance [m]; pairs that are never closer than this in random poses are left out."""
MOST: Final = 128
"""Largest number of pairs; each costs time in every frame, and more in compiling. The built-in
hands have 22 to 111; a vendor's model with ten boxes to a link has ten thousand candidates."""
_ROUNDING = 1e-5  # rounding of distances [m]
_BLOCK = 1_000_000  # distances that are computed at once
_TINY = 1e-12  # [m^2]
_PARALLEL = 1e-3  # squared sine of an angle below which segments count as parallel


@dataclass(frozen=True, eq=False)
class CapsulePairs:
    """Pairs of capsules, and the kinematics of their ends.

    Attributes:
        tree: kinematics of the hand's landmarks and of the ends of all capsules of the pairs.
        names: (2 C) keypoints of the ends in ``tree``: first and second end of each capsule.
        ends: position of each end: name -> (body, (3,) position in its frame [m]).
        capsules: the C capsules of the pairs.
        pairs: (P, 2) indices of capsules.
        reach: (P,) sum of the two radii [m].
        shapes: (P, 2) indices of the model's geoms; -1 for a stand-in.
    """

    tree: KinematicTree
    names: tuple[str, ...]
    ends: Mapping[str, tuple[int, np.ndarray]]
    capsules: tuple[Capsule, ...]
    pairs: Int[np.ndarray, "P 2"]
    reach: Float[np.ndarray, " P"]
    shapes: Int[np.ndarray, "P 2"]

    def depths(
        self, q: Float[np.ndarray, "T n"]
    ) -> Iterator[tuple[slice, Float[np.ndarray, "t P"]]]:
        """Overlap of each pair [m] at (T, n) positions of all joints [rad], for some poses at a
        time; minus infinity where two capsules are far apart."""
        at = [self.tree.names.index(name) for name in self.names]
        size = max(1, _BLOCK // max(len(self.pairs), 1))
        for start in range(0, len(q), size):
            rows = slice(start, min(start + size, len(q)))
            points = np.asarray(self.tree.positions(q[rows]))[:, at]
            yield rows, self._depths(points.reshape(len(points), len(self.capsules), 2, 3))

    def _depths(self, ends: Float[np.ndarray, "n C 2 3"]) -> Float[np.ndarray, "n P"]:
        middles, out = ends.mean(axis=2), np.full((len(ends), len(self.pairs)), -np.inf)
        radii = [capsule.radius for capsule in self.capsules]
        spread = 0.5 * np.linalg.norm(ends[0, :, 1] - ends[0, :, 0], axis=-1) + radii
        one, other = self.pairs.T
        apart = np.linalg.norm(middles[:, one] - middles[:, other], axis=-1)
        pose, pair = np.nonzero(apart < spread[one] + spread[other] + _SLACK)
        one, other = self.pairs[pair].T
        first, second = ends[pose, one], ends[pose, other]
        between, _, _ = segments_apart((first[:, 0], first[:, 1]), (second[:, 0], second[:, 1]))
        out[pose, pair] = self.reach[pair] - np.linalg.norm(between, axis=-1)
        return out


def hand_capsules(hand: Hand) -> list[Capsule]:
    """Fills all parts of a hand with capsules; see the top of this module."""
    own = stand_ins(hand)
    part = hand.model.body_weldid[hand.model.geom_bodyid]
    shapes = solid_shapes(hand) & ~np.isin(part, list(own.replaced))
    filled = [
        _on_palm(capsule, hand)
        for geom in np.flatnonzero(shapes)
        for capsule in shape_capsules(hand.model, int(geom))
    ]
    return [*filled, *own.capsules]


@lru_cache(maxsize=8)
def parts_apart(hand: Hand) -> CapsulePairs:
    """All pairs of a hand's capsules whose overlap counts as a self-collision: those of
    ``candidate_pairs`` whose shapes do not overlap in the neutral pose."""
    capsules = hand_capsules(hand)
    pairs = candidate_pairs(hand, capsules)
    shapes = np.array([capsule.geom for capsule in capsules], int)
    shapes = np.where(shapes < 0, hand.model.ngeom + np.arange(len(shapes)), shapes)
    two = np.sort(shapes[pairs], axis=1)
    every = chosen_pairs(hand, capsules, pairs)
    ((_, (neutral,)),) = every.depths(hand.full_configuration(hand.neutral)[None])
    touching = {tuple(at) for at in two[neutral > _ROUNDING].tolist()}
    return chosen_pairs(hand, capsules, pairs[[tuple(at) not in touching for at in two.tolist()]])


def candidate_pairs(hand: Hand, capsules: list[Capsule]) -> Int[np.ndarray, "P 2"]:
    """(P, 2) indices of pairs of capsules on parts of the hand that are not joined to each other,
    without the pairs that the model excludes from collision.

    A gripper has no pairs: its jaws are made to close on each other, and parts of its linkage
    overlap by design.
    """
    if hand.spec.gripper:
        return np.empty((0, 2), np.int64)
    model = hand.model
    bodies = np.array([capsule.body for capsule in capsules], int)
    owner, part = owners(hand)[bodies], model.body_weldid[bodies]
    above = model.body_weldid[model.body_parentid[part]]
    joined = (part[:, None] == above) | (above[:, None] == part)
    root = np.array([capsule.root for capsule in capsules], bool)
    palm = owner == PALM
    joined |= (palm[:, None] & root) | (root[:, None] & palm)
    geoms = np.array([capsule.geom for capsule in capsules], int)
    kinds, allowed = (
        np.append(mask, -1)[geoms]  # a stand-in, of -1, collides with everything
        for mask in (model.geom_contype, model.geom_conaffinity)
    )
    by_pairs = (kinds == 0) & (allowed == 0)  # the model has no masks for these shapes
    kinds[by_pairs] = allowed[by_pairs] = -1
    meets = (kinds[:, None] & allowed) | (allowed[:, None] & kinds)
    low, high = np.minimum(bodies[:, None], bodies), np.maximum(bodies[:, None], bodies)
    excluded = np.isin((low << 16) + high, model.exclude_signature)
    excluded |= np.isin((high << 16) + low, model.exclude_signature)
    counts = (owner[:, None] != owner) & ~joined & (meets != 0) & ~excluded
    return np.argwhere(np.tril(counts))


def capsule_pairs(hand: Hand) -> CapsulePairs:
    """Those pairs of ``parts_apart`` that come together in random poses.

    If there are more than ``MOST``, the pairs that are most often the nearest of their two links
    are kept, and at least one pair for any two links that meet.
    """
    every = parts_apart(hand)
    return chosen_pairs(hand, list(every.capsules), every.pairs[_meeting(hand, every)])


def chosen_pairs(
    hand: Hand, capsules: list[Capsule], pairs: Int[np.ndarray, "P 2"]
) -> CapsulePairs:
    """Selects some of the pairs, and only the capsules that they contain."""
    used, pairs = np.unique(pairs, return_inverse=True)
    pairs = pairs.reshape(-1, 2)
    chosen = tuple(capsules[c] for c in used)
    radii = np.array([capsule.radius for capsule in chosen])
    geoms = np.array([capsule.geom for capsule in chosen], int)
    names, ends = _names(chosen), _ends(chosen)
    return CapsulePairs(
        tree_with(hand, ends), names, ends, chosen, pairs, radii[pairs].sum(axis=1), geoms[pairs]
    )


def segments_apart(
    first: tuple[AnyKind, AnyKind], second: tuple[AnyKind, AnyKind]
) -> tuple[AnyKind, AnyKind, AnyKind]:
    """Nearest points of two line segments of (..., 3) ends: the (..., 3) vector between them, from
    the second to the first, and the (...) fractions of the segments' lengths, 0 to 1, at which they
    lie. NumPy or JAX. Parallel segments have many nearest points; one pair is returned.

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
    apart = first[0] + s[..., None] * along - second[0] - t[..., None] * across
    return apart, s, t


def _on_palm(capsule: Capsule, hand: Hand) -> Capsule:
    """The capsule with the palm as its body if its own body, such as a forearm, does not hang from
    the palm."""
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


def _meeting(hand: Hand, every: CapsulePairs) -> np.ndarray:
    """Indices of up to ``MOST`` pairs that random poses bring together, in order."""
    low, high = hand.limits.T
    poses = _POSES if len(every.pairs) <= _MANY else _POSES // 4
    q = np.random.default_rng(0).uniform(low, high, (poses, len(low)))
    parts = np.array([hand.model.body_weldid[capsule.body] for capsule in every.capsules], int)
    links = np.sort(parts[every.pairs], axis=1)
    groups = [np.flatnonzero((links == two).all(axis=1)) for two in np.unique(links, axis=0)]
    meet, counts = np.zeros(len(links), bool), np.zeros(len(links), int)
    for _, depths in every.depths(hand.full_configuration(q)):
        meet |= depths.max(axis=0) > -_SLACK
        for these in groups:
            first = depths[:, these].argmax(axis=1)[depths[:, these].max(axis=1) > -_SLACK]
            counts[these] += np.bincount(first, minlength=len(these))
    ranked: list[tuple[int, int, int]] = []  # rank within its links, minus its count, pair
    for these in groups:
        order = [k for k in these[np.argsort(-counts[these], kind="stable")] if meet[k]]
        ranked += [(rank, -int(counts[k]), int(k)) for rank, k in enumerate(order)]
    return np.array(sorted(which for *_, which in sorted(ranked)[:MOST]), int)


def _names(capsules: Sequence[Capsule]) -> tuple[str, ...]:
    return tuple(f"capsule {i} {end}" for i in range(len(capsules)) for end in "ab")


def _ends(capsules: Sequence[Capsule]) -> dict[str, tuple[int, np.ndarray]]:
    return {
        name: (capsules[i // 2].body, capsules[i // 2].ends[i % 2])
        for i, name in enumerate(_names(capsules))
    }

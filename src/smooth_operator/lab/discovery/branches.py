"""Search for a hand in a model: two to five short chains branch from its palm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.lab.discovery.skeleton import Placement, Skeleton

_LENGTHS: Final = (0.012, 0.36)  # [m] of a finger; the longest of robot hands measure 0.2
_POINT: Final = 1e-6  # [m]: shorter, it is no length at all
_SPREAD: Final = 3.0  # between finger bases, in finger lengths; a palm is smaller, two arms are not
_UNLIKE: Final = 6.0  # longest over shortest finger
_SHARED: Final = 2  # joints of the palm itself that two fingers may have in common
_STRAY: Final = 0.4  # of the median length, below which a single joint is no finger (a switch)


@dataclass(frozen=True)
class Chain:
    """A chain of links that may be a finger.

    Attributes:
        palm: body that it branches from.
        last: its last moving body.
        bodies: from below the palm to the last.
        joints: between palm and last body.
        shared: number of them, from the palm on, that move another finger as well.
        length: from first own joint over the others to the far end [m].
        base: (3,) first own joint, in the world in the reference pose [m].
    """

    palm: int
    last: int
    bodies: tuple[int, ...]
    joints: tuple[int, ...]
    shared: int
    length: float
    base: tuple[float, float, float]

    @property
    def own(self) -> tuple[int, ...]:
        """Joints that move no other finger."""
        return self.joints[self.shared :]


@dataclass(frozen=True)
class HandTree:
    """A palm and its fingers, in no order; ``left_out`` are chains that are none."""

    palm: int
    chains: tuple[Chain, ...]
    left_out: tuple[str, ...] = ()


class Branches:
    """Searches a skeleton for hands.

    Args:
        skeleton: the model.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton = skeleton
        self._rest = skeleton.place(skeleton.reference)
        self.reasons: list[str] = []
        """Why a branching body was not taken for a palm."""

    @cached_property
    def leaves(self) -> tuple[int, ...]:
        """Last moving bodies: nothing that moves hangs from them."""
        model = self._skeleton.model
        moving = [b for b in range(1, model.nbody) if model.body_jntnum[b]]
        above = {int(model.body_weldid[model.body_parentid[b]]) for b in moving}
        return tuple(b for b in moving if b not in above)

    def find(self) -> tuple[HandTree, ...]:
        """All hands of the model.

        Raises:
            HandModelError: if there is none; says what was found instead.
        """
        hands = self._below(self.leaves)
        if not hands:
            why = "; ".join(self.reasons) or (
                f"it has {len(self.leaves)} chain of joints that branches nowhere"
            )
            raise HandModelError(
                f"no fingers found: {why}. A hand is a body from which two to five chains of "
                "limited joints branch; give a model that has one, or name its palm with --palm"
            )
        return tuple(hands)

    def at(self, palm: str, fingers: tuple[str, ...] = ()) -> HandTree:
        """The hand of a palm that is given.

        Args:
            fingers: bodies or joints of fingers, to choose from more than five.

        Raises:
            UnknownNameError: no such body.
            HandModelError: fewer than two fingers hang from it, or more than five.
        """
        model = self._skeleton.model
        names = [str(model.body(b).name) for b in range(model.nbody)]
        if palm not in names:
            raise UnknownNameError("body", palm, names)
        body = names.index(palm)
        below = tuple(leaf for leaf in self.leaves if body in (0, *self._skeleton.path(leaf)[:-1]))
        hand = self._hand(body, below)
        if fingers and len(hand.chains) > 5:
            chains = tuple(
                c for c in hand.chains if any(holds(self._skeleton, c, w) for w in fingers)
            )
            hand = HandTree(body, chains, hand.left_out)
        if not 2 <= len(hand.chains) <= 5:
            raise HandModelError(
                f"{len(hand.chains)} chains of limited joints hang from the palm {palm!r}; "
                "expected two to five: name another body with --palm, or up to five fingers with "
                "--finger"
            )
        return hand

    def _below(self, leaves: tuple[int, ...]) -> list[HandTree]:
        """Hands among these leaves, the one that takes most of them first."""
        if len(leaves) < 2:
            return []
        paths = [(0, *self._skeleton.path(leaf)) for leaf in leaves]
        depth = 0
        while all(len(p) > depth + 1 for p in paths) and len({p[depth] for p in paths}) == 1:
            depth += 1
        if len({p[depth] for p in paths}) == 1:  # cannot be: two leaves part somewhere
            return []
        palm = paths[0][depth - 1]
        hand = self._hand(palm, leaves)
        fault = self._fault(hand)
        if fault is None:
            deeper = tuple(chain.last for chain in hand.chains)
            # without what is left out, the fingers may branch further down
            return self._below(deeper) if len(deeper) < len(leaves) and hand.left_out else [hand]
        groups: dict[int, list[int]] = {}
        for leaf, path in zip(leaves, paths, strict=True):
            groups.setdefault(path[depth], []).append(leaf)
        hands = [hand for group in groups.values() for hand in self._below(tuple(group))]
        if not hands:
            self.reasons.append(f"from {self._skeleton.body_name(palm)!r} branch {fault}")
        return hands

    def _hand(self, palm: int, leaves: tuple[int, ...]) -> HandTree:
        chains = [self._chain(palm, leaf, 0) for leaf in leaves]
        out, left_out = [], []
        for chain in chains:
            if self._skeleton.bounded[list(chain.joints)].any():
                out.append(chain)
            elif any(self._skeleton.joint_names[j] in self._skeleton.pinned for j in chain.joints):
                left_out.append(f"{self._name(chain)} can't move: lower = upper in the file")
            else:
                left_out.append(f"{self._name(chain)} turns without limits")
        out.sort(key=lambda c: (len(c.joints), c.length), reverse=True)
        branch: list[Chain] = []
        for chain in out:
            rival = next((k for k in branch if not self._apart(chain, k)), None)
            if rival is None:
                branch.append(chain)
            else:
                left_out.append(f"{self._name(chain)} is a bar of {self._name(rival)}")
        median = float(np.median([c.length for c in branch])) if branch else 0.0
        strays = [c for c in branch if len(c.joints) == 1 and c.length < _STRAY * median]
        if len(branch) - len(strays) >= 2:
            left_out += [f"{self._name(c)} is too short for a finger" for c in strays]
            branch = [c for c in branch if c not in strays]
        branch = [
            self._chain(
                palm,
                c.last,
                max((_common(c, other) for other in branch if other is not c), default=0),
            )
            for c in branch
        ]
        branch.sort(key=lambda c: c.joints)
        return HandTree(palm, tuple(branch), tuple(left_out))

    def _apart(self, chain: Chain, other: Chain) -> bool:
        """True if two chains are two fingers, not one finger and a bar of its linkage."""
        shared = _common(chain, other)
        if not shared:
            return True
        mine, theirs = chain.joints[shared:], other.joints[shared:]
        if shared > _SHARED:  # an arm with two fingers: the palm is further down
            return True
        if len(mine) < 2 or len(theirs) < 2:
            return False
        axis, their_axis = self._rest.axes[mine[-1]], self._rest.axes[theirs[-1]]
        offset = self._rest.anchors[mine[-1]] - self._rest.anchors[theirs[-1]]
        in_one_plane = abs(offset @ axis) < 0.08 * max(chain.length, other.length)
        return not (abs(axis @ their_axis) > 0.95 and in_one_plane)

    def _fault(self, hand: HandTree) -> str | None:
        """Reason why this is no hand; None if it may be one."""
        chains = hand.chains
        names = ", ".join(self._name(c) for c in chains[:6]) + (", …" if len(chains) > 6 else "")
        wheels, pinned = (
            sum(text in why for why in hand.left_out) for text in ("without limits", "can't move")
        )
        if len(chains) < 2:
            return (
                f"{len(chains)} chains with limited joints"
                + f" and {pinned} whose joints can't move, with lower = upper in the file"
                * bool(pinned)
                + f" and {wheels} that turn without limits (wheels? joints of fingers need their "
                "limits in the file)" * bool(wheels)
            )
        if len(chains) > 5:
            return f"{len(chains)} chains ({names}), more than the fingers of a hand"
        if any(c.shared > _SHARED for c in chains):
            return f"{len(chains)} chains ({names}) that share a limb"
        lengths = [c.length for c in chains]
        if np.median(lengths) > _LENGTHS[1]:
            return (
                f"{len(chains)} limbs of {min(lengths):.2f} to {max(lengths):.2f} m ({names}), too "
                "long for fingers: legs or arms, or a model that is not in metres"
            )
        if max(lengths) < _POINT:
            return (
                f"{len(chains)} chains whose links are all at one point ({names}): a placeholder, "
                "whose joints lack their origins"
            )
        if max(lengths) < _LENGTHS[0]:
            return (
                f"{len(chains)} chains of at most {max(lengths) * 1e3:.1f} mm ({names}), too short "
                "for fingers: wheels, or a model that is not in metres"
            )
        if max(lengths) > _UNLIKE * min(lengths):
            return (
                f"{len(chains)} chains of {min(lengths):.3f} to {max(lengths):.3f} m ({names}), "
                "too unlike for fingers"
            )
        bases = np.array([c.base for c in chains])
        apart = float(np.linalg.norm(bases[:, None] - bases[None], axis=-1).max())
        if apart > _SPREAD * float(np.median(lengths)):
            return f"{len(chains)} chains whose bases are up to {apart:.2f} m apart ({names})"
        return None

    def _chain(self, palm: int, leaf: int, shared: int) -> Chain:
        skeleton, at = self._skeleton, self._rest
        path = skeleton.path(leaf)
        bodies = path[path.index(palm) + 1 if palm in path else 0 :]
        joints = tuple(j for b in bodies for j in skeleton.joints_of(b))
        points = [at.anchors[j] for j in joints[shared:]]
        points.append(far_point(skeleton, at, leaf, points[-1]))
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if steps[-1] < 0.1 * steps.max():  # a last link without shape or frame has some length too
            steps[-1] = 0.8 * steps.max()
        length = float(steps.sum())
        x, y, z = (float(c) for c in points[0])
        return Chain(palm, leaf, bodies, joints, shared, length, (x, y, z))

    def _name(self, chain: Chain) -> str:
        return repr(self._skeleton.body_name(chain.last))


def far_point(skeleton: Skeleton, at: Placement, leaf: int, start: np.ndarray) -> np.ndarray:
    """Finds the frame, site or point of shape that is farthest from a last link's joint."""
    rigid = skeleton.rigid(leaf)
    points = [at.bodies[list(rigid)], at.sites[np.isin(skeleton.model.site_bodyid, rigid)]]
    points += [at.world(b, cloud) for b in rigid for cloud in skeleton.clouds.get(b, ())]
    together = np.concatenate(points)
    distance = np.linalg.norm(together - start, axis=1)
    # not quite the farthest of many: a shape may have stray points
    nth = len(distance) - 1 - len(distance) // 100
    far: np.ndarray = together[np.argsort(distance)[nth]]
    return far


def holds(skeleton: Skeleton, chain: Chain, name: str) -> bool:
    """True if a body or joint of that name belongs to a chain."""
    rigid = (*chain.bodies, *skeleton.rigid(chain.last))
    bodies = {skeleton.body_name(b) for b in rigid}
    return name in bodies or name in {skeleton.joint_names[j] for j in chain.own}


def _common(a: Chain, b: Chain) -> int:
    count = 0
    for x, y in zip(a.joints, b.joints, strict=False):
        if x != y:
            break
        count += 1
    return count

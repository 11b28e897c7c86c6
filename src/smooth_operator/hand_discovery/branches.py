"""Searches a model for a hand: chains of links that branch from its palm, and the fingertips at
their ends.

A fingertip is a site or a tip link. Without one, it is the far end of the last link's shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.skeleton import Placement, Skeleton, says_tip
from smooth_operator.hands.spec import Point

_LENGTHS: Final = (0.012, 0.36)  # length of a finger [m]; the longest of robot hands measure 0.2
_POINT: Final = 1e-6  # length below which the links of a chain lie at one point [m]
_SPREAD: Final = 3.0  # largest distance of finger bases in finger lengths; two arms have more
_UNLIKE: Final = 6.0  # largest ratio of the longest to the shortest finger
_SHARED: Final = 2  # largest number of joints in the palm that two fingers share
_STRAY: Final = 0.4  # length over the median below which a single joint is no finger but a switch
_BESIDE: Final = 0.08  # distance between the planes of two parallel fingers, over their length
_REACHES: Final = 0.5  # largest distance from a bar's end to its finger, over the finger's length
_FINGER_SIZE: Final = 0.5  # length over the median from which two joints may be a finger


@dataclass(frozen=True)
class Chain:
    """A chain of links that may be a finger.

    Attributes:
        palm: body from which it branches.
        last: its last moving body.
        bodies: its bodies, from below the palm to the last.
        joints: joints between palm and last body.
        shared: number of joints, counted from the palm, that also move another finger.
        length: length from its first own joint along the others to the far end [m].
        base: (3,) position of its first own joint in the world, in the reference pose [m].
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
        """Joints that move this finger and no other."""
        return self.joints[self.shared :]


@dataclass(frozen=True)
class LeftOut:
    """A chain that is not taken to be a finger.

    Attributes:
        last: its last moving body.
        why: the reason.
        doubtful: True if it has the joints and the length of a finger.
    """

    last: int
    why: str
    doubtful: bool = False


@dataclass(frozen=True)
class HandTree:
    """A palm with its fingers in any order, and the chains that are not fingers (``left_out``)."""

    palm: int
    chains: tuple[Chain, ...]
    left_out: tuple[LeftOut, ...] = ()


class Branches:
    """Searches a skeleton for hands.

    Args:
        skeleton: the model.
        fingers: bodies or joints of chains that the user declares as fingers.
    """

    def __init__(self, skeleton: Skeleton, fingers: tuple[str, ...] = ()) -> None:
        self._skeleton = skeleton
        self._fingers = fingers
        self._rest = skeleton.place(skeleton.reference)
        self.reasons: list[str] = []
        """Reasons why bodies with branches are not palms."""

    @cached_property
    def leaves(self) -> tuple[int, ...]:
        """Last moving body of each chain."""
        model = self._skeleton.model
        moving = [b for b in range(1, model.nbody) if model.body_jntnum[b]]
        above = {int(model.body_weldid[model.body_parentid[b]]) for b in moving}
        return tuple(b for b in moving if b not in above)

    def find(self) -> tuple[HandTree, ...]:
        """Finds all hands of the model; HandModelError if there is none."""
        hands = self._below(self.leaves)
        if not hands:
            why = "; ".join(self.reasons) or (
                f"it has {len(self.leaves)} chain of joints, without branches"
            )
            raise HandModelError(
                f"no fingers found: {why}. The palm must be a body from which two to five "
                "chains of limited joints branch; use a model that has one, or name the palm with "
                "--palm, or, for a gripper, name the joint of its jaw with --gripper"
            )
        return tuple(hands)

    def at(self, palm: str) -> HandTree:
        """Returns the hand with a given palm. If it has more than five chains, only declared
        fingers count.

        Raises:
            UnknownNameError: there is no such body.
            HandModelError: fewer than two or more than five fingers branch from it.
        """
        body = self._skeleton.body(palm)
        below = tuple(leaf for leaf in self.leaves if body in (0, *self._skeleton.path(leaf)[:-1]))
        hand = self._hand(body, below)
        if self._fingers and len(hand.chains) > 5:
            chains = tuple(chain for chain in hand.chains if self._given(chain))
            hand = HandTree(body, chains, hand.left_out)
        if not 2 <= len(hand.chains) <= 5:
            raise HandModelError(
                f"{len(hand.chains)} chains of limited joints branch from the palm {palm!r}; "
                "expected two to five: name another body with --palm, or up to five fingers "
                "with --finger"
            )
        return hand

    def _below(self, leaves: tuple[int, ...]) -> list[HandTree]:
        """Hands among these leaves, the one with most of them first."""
        if len(leaves) < 2:
            return []
        paths = [(0, *self._skeleton.path(leaf)) for leaf in leaves]
        depth = 0
        while all(len(p) > depth + 1 for p in paths) and len({p[depth] for p in paths}) == 1:
            depth += 1
        palm = paths[0][depth - 1]
        hand = self._hand(palm, leaves)
        fault = self._fault(hand)
        if fault is None:
            return self._inner(hand)
        groups: dict[int, list[int]] = {}
        for leaf, path in zip(leaves, paths, strict=True):
            groups.setdefault(path[depth], []).append(leaf)
        hands = [found for group in groups.values() for found in self._below(tuple(group))]
        beside = [self._beside(found, hand, hands) for found in hands]
        if not hands or any(len(b) >= len(h.chains) for b, h in zip(beside, hands, strict=True)):
            # A hand with as many chains beside it is a piece of a finger of a hand with too many.
            name = self._skeleton.body_name(palm)
            self.reasons.append(f"{name!r} can't be the palm, because it has {fault}")
            return []
        return [
            replace(found, left_out=(*found.left_out, *outside))
            for found, outside in zip(hands, beside, strict=True)
        ]

    def _inner(self, hand: HandTree) -> list[HandTree]:
        """The hand, or the one further down if its fingers branch there, behind a wrist.

        A chain that was left out may be a finger of the inner palm, so it is judged again.
        """
        paths = [self._skeleton.path(chain.last) for chain in hand.chains]
        inner = next((b for b in reversed(paths[0]) if all(b in p for p in paths)), 0)
        if inner in (0, hand.palm):
            return [hand]
        below = tuple(leaf for leaf in self.leaves if inner in self._skeleton.path(leaf)[:-1])
        outside = tuple(out for out in hand.left_out if out.last not in below)
        return [replace(h, left_out=(*outside, *h.left_out)) for h in self._below(below)]

    def _beside(self, hand: HandTree, around: HandTree, hands: list[HandTree]) -> list[LeftOut]:
        """Chains beside a hand that look like fingers and belong to no hand.

        Args:
            around: all chains of a body above the palm.
            hands: all hands among these chains.
        """
        taken = {chain.last for one in hands for chain in one.chains}
        taken |= {out.last for one in hands for out in one.left_out}
        near = _SPREAD * float(np.median([c.length for c in hand.chains]))
        bases = np.array([c.base for c in hand.chains])
        above, palm = (self._skeleton.body_name(tree.palm) for tree in (around, hand))
        return [
            LeftOut(c.last, f"{self._name(c)} is attached to {above!r}, not to the palm {palm!r}")
            for c in around.chains
            if c.last not in taken and _LENGTHS[0] <= c.length <= _LENGTHS[1]
            if np.linalg.norm(bases - c.base, axis=1).min() < near + c.length
        ]

    def _hand(self, palm: int, leaves: tuple[int, ...]) -> HandTree:
        chains = [self.chain(palm, leaf, 0) for leaf in leaves]
        # Joints that most chains share are a wrist, whose links are no part of a finger's length.
        starts = [tuple(c.joints[:k]) for c in chains for k in range(1, len(c.joints))]
        wrist = max(
            (start for start in starts if starts.count(start) > len(chains) / 2),
            key=len,
            default=(),
        )
        behind = len(wrist)
        chains = [
            replace(c, length=self.chain(palm, c.last, behind).length)
            if c.joints[:behind] == wrist
            else c
            for c in chains
        ]
        branch: list[Chain] = []
        left_out: list[LeftOut] = []
        # A chain that ends in a free joint may be a bar, so it comes after the fingers.
        chains.sort(
            key=lambda c: (not self._skeleton.turns_freely(c.joints[-1]), len(c.joints), c.length),
            reverse=True,
        )
        fixed: list[Chain] = []
        for chain in chains:
            rival = next((k for k in branch if self._is_bar(chain, k)), None)
            if self._given(chain):
                branch.append(chain)
            elif rival is not None:
                why = f"{self._name(chain)} is a linkage bar of {self._name(rival)}"
                left_out.append(LeftOut(chain.last, why))
            elif self._skeleton.bounded[list(chain.joints)].any():
                branch.append(chain)
            else:
                fixed.append(chain)
        median = float(np.median([c.length for c in branch])) if branch else 0.0
        strays = [c for c in branch if len(c.joints) == 1 and c.length < _STRAY * median]
        if len(branch) - len(strays) >= 2:
            strays = [c for c in strays if not self._given(c)]
            left_out += [
                LeftOut(c.last, f"{self._name(c)} is too short for a finger") for c in strays
            ]
            branch = [c for c in branch if c not in strays]
        for chain in fixed:
            pinned = [self._skeleton.joint_names[j] in self._skeleton.pinned for j in chain.joints]
            why = (
                "can't move, because lower = upper in the file"
                if any(pinned)
                else "rotates without limits"
            )
            like = len(chain.joints) > 1 and chain.length > _FINGER_SIZE * median > 0
            left_out.append(LeftOut(chain.last, f"{self._name(chain)} {why}", like))
        branch = [
            self.chain(
                palm,
                c.last,
                max((_common(c, other) for other in branch if other is not c), default=0),
            )
            for c in branch
        ]
        branch.sort(key=lambda c: c.joints)
        return HandTree(palm, tuple(branch), tuple(left_out))

    def _is_bar(self, chain: Chain, finger: Chain) -> bool:
        """True if a chain is a bar of a finger's linkage; lengths do not include a wrist."""
        shared = _common(chain, finger)
        mine, theirs = chain.joints[shared:], finger.joints[shared:]
        bar = self.chain(chain.palm, chain.last, shared)
        other = self.chain(finger.palm, finger.last, shared)
        axis, their_axis = self._rest.axes[mine[-1]], self._rest.axes[theirs[-1]]
        offset = self._rest.anchors[mine[-1]] - self._rest.anchors[theirs[-1]]
        parallel = abs(axis @ their_axis) > 0.95
        if parallel and abs(offset @ axis) >= _BESIDE * max(chain.length, finger.length):
            return False
        if self._gap(bar, other) > _REACHES * finger.length:
            return False
        if parallel and self._moved_by(bar, other):
            return True
        if not 0 < shared <= _SHARED:  # an arm with two fingers: the palm is further down
            return False
        return parallel or min(len(mine), len(theirs)) < 2

    def _moved_by(self, bar: Chain, finger: Chain) -> bool:
        """True if only the finger, or the joint that drives the finger, drives a chain."""
        skeleton, own = self._skeleton, bar.own
        if all(skeleton.leaders.get(j, (j,))[0] not in own for j in own):
            return len(own) < len(finger.own)
        return not self._driven(bar) and self._driven(finger)

    def _driven(self, chain: Chain) -> bool:
        """True if a chain has a hinge with limits, or one that follows another of its joints."""
        leaders = self._skeleton.leaders
        return any(
            leaders[j][0] in chain.joints
            if j in leaders
            else self._skeleton.turns[j] and not self._skeleton.turns_freely(j)
            for j in chain.own
        )

    def _gap(self, bar: Chain, finger: Chain) -> float:
        """Distance from the far end of a bar to the joints and links of a finger [m]."""
        skeleton, at = self._skeleton, self._rest
        end = far_point(skeleton, at, bar.last, at.anchors[bar.joints[-1]])
        points = np.array([at.anchors[j] for j in finger.own])
        points = np.vstack([points, far_point(skeleton, at, finger.last, points[-1])])
        starts, steps = points[:-1], np.diff(points, axis=0)
        squares = np.maximum((steps**2).sum(axis=1), 1e-12)
        share = np.clip(((end - starts) * steps).sum(axis=1) / squares, 0, 1)
        return float(np.linalg.norm(starts + share[:, None] * steps - end, axis=1).min())

    def _given(self, chain: Chain) -> bool:
        return any(holds(self._skeleton, chain, name) for name in self._fingers)

    def _fault(self, hand: HandTree) -> str | None:
        """Reason why this is not a hand; None if it may be one."""
        chains = hand.chains
        names = ", ".join(self._name(c) for c in chains[:6]) + (", …" if len(chains) > 6 else "")
        wheels, pinned = (
            sum(text in out.why for out in hand.left_out)
            for text in ("without limits", "can't move")
        )
        if len(chains) < 2:
            return (
                f"{len(chains)} chains with limited joints"
                + f" and {pinned} whose joints can't move, because lower = upper in the file"
                * bool(pinned)
                + f" and {wheels} that rotate without limits (wheels? finger joints need "
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
                f"{len(chains)} chains whose links are all at one point ({names}): the model "
                "is a placeholder, whose joints have no origins"
            )
        if max(lengths) < _LENGTHS[0]:
            return (
                f"{len(chains)} chains of at most {max(lengths) * 1e3:.1f} mm ({names}), too short "
                "for fingers: wheels, or a model that is not in metres"
            )
        if max(lengths) > _UNLIKE * min(lengths):
            return (
                f"{len(chains)} chains of {min(lengths):.3f} to {max(lengths):.3f} m "
                f"({names}), too different in length for fingers"
            )
        bases = np.array([c.base for c in chains])
        apart = float(np.linalg.norm(bases[:, None] - bases[None], axis=-1).max())
        if apart > _SPREAD * float(np.median(lengths)):
            return f"{len(chains)} chains whose bases are up to {apart:.2f} m apart ({names})"
        return None

    def chain(self, palm: int, leaf: int, shared: int = 0) -> Chain:
        """Returns the chain of links from a palm to a last moving body."""
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
    """Finds the frame, site or shape point that is farthest from the last link's joint."""
    rigid = skeleton.rigid(leaf)
    points = [at.bodies[list(rigid)], at.sites[np.isin(skeleton.model.site_bodyid, rigid)]]
    points += [at.world(b, cloud) for b in rigid for cloud in skeleton.clouds.get(b, ())]
    together = np.concatenate(points)
    distance = np.linalg.norm(together - start, axis=1)
    # Of many points not quite the farthest, since a shape may have stray points.
    nth = len(distance) - 1 - len(distance) // 100
    far: np.ndarray = together[np.argsort(distance)[nth]]
    return far


def holds(skeleton: Skeleton, chain: Chain, name: str) -> bool:
    """True if a body or joint with that name belongs to a chain."""
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


_NAMED: Final = 0.3  # least place along the last link of a frame whose name denotes a tip
_UNNAMED: Final = 0.65  # least place along the last link of another frame
_WEIGHS: Final = 1e-5  # least mass of a link with an own inertia [kg]; the loader adds less
_AGREE: Final = 0.012  # largest distance of a frame from the shape's end if both are the tip [m]


@dataclass(frozen=True)
class Tip:
    """A fingertip with its confidence and the evidence."""

    point: Point
    confidence: float
    evidence: tuple[str, ...]
    position: tuple[float, float, float]  # world, reference pose [m]


def find_tip(skeleton: Skeleton, chain: Chain, at: Placement) -> Tip:
    """Finds the fingertip of a chain.

    A frame on the last link (a site, or a link without joints) is the tip if it lies well along the
    link. A frame at the joint, such as the last link's own origin, is never the tip.
    """
    rigid = skeleton.rigid(chain.last)
    joint = chain.joints[-1]
    anchor, axis = at.anchors[joint], at.axes[joint]
    reach = np.linalg.norm(np.diff([at.anchors[j] for j in chain.own], axis=0), axis=1)
    clouds = [at.world(b, cloud) for b in rigid for cloud in skeleton.clouds.get(b, ())]
    end = far_end(clouds, anchor, axis, float(max(reach.sum(), 0.02)))

    frames: list[tuple[str, str, np.ndarray, int, np.ndarray]] = []
    for s in np.flatnonzero(np.isin(skeleton.model.site_bodyid, rigid)):
        body = int(skeleton.model.site_bodyid[s])
        local = np.asarray(skeleton.model.site_pos[s], float)
        frames.append(("site", str(skeleton.model.site(int(s)).name), local, body, at.sites[s]))
    leaves = set(rigid) - {int(skeleton.model.body_parentid[b]) for b in rigid} - {chain.last}
    frames += [
        ("link", skeleton.body_name(b), np.zeros(3), b, at.bodies[b]) for b in sorted(leaves)
    ]

    def along(point: np.ndarray) -> float:
        if end is None:
            return float(np.linalg.norm(point - anchor))
        far = end.far - anchor
        return float((point - anchor) @ far / np.linalg.norm(far))

    length = along(end.far) if end is not None else max((along(f[4]) for f in frames), default=0.0)
    fit = [
        (kind, name, local, body, world)
        for kind, name, local, body, world in frames
        if length > 1e-4 and along(world) > (_NAMED if says_tip(name) else _UNNAMED) * length
        if np.linalg.norm(world - anchor) < 1.2 * chain.length + 0.01
        if np.linalg.norm(world - anchor) > 1e-3
    ]
    if fit:
        # The name comes first, then the distance, then a site, which is more exact than a link.
        kind, name, local, body, world = max(
            fit, key=lambda f: (says_tip(f[1]), round(along(f[4]), 4), f[0] == "site")
        )
        evidence = [f"{kind} {name!r} fixed to the last link"]
        confidence = 0.8
        if says_tip(name):
            confidence += 0.1
            evidence.append("by its name")
        if end is not None:
            apart = float(np.linalg.norm(world - end.far))
            evidence.append(f"{apart * 1e3:.1f} mm from the far end of the shape")
            confidence += 0.08 if apart < _AGREE else -0.05
        else:
            evidence.append("the last link has no shape to compare with")
        return _tip(skeleton.point(body, local), confidence, evidence, world)
    if end is not None:
        body = _outermost(skeleton, rigid, at, end.far)
        evidence = ["far end of the last link's shape, on its centre line"]
        confidence = 0.75
        if end.nail:
            evidence.append(
                "slightly behind that end: the shape protrudes at the back, like a fingernail, "
                "but the tip should be on the pad"
            )
            confidence = 0.6
        if frames:
            evidence.append(
                f"{frames[0][1]!r} is not used, because it lies at the joint or in the middle of "
                "the link"
            )
        point = skeleton.point(body, at.local(body, end.tip))
        return _tip(point, confidence, evidence, end.tip)
    guess, confidence, why = _extrapolated(skeleton, chain, at)
    evidence = ["the end of the finger has no site, tip link or shape", why]
    return _tip(
        skeleton.point(chain.last, at.local(chain.last, guess)), confidence, evidence, guess
    )


def _tip(point: Point, confidence: float, evidence: list[str], world: np.ndarray) -> Tip:
    u, v, w = (float(c) for c in world)
    return Tip(point, round(confidence, 2), tuple(evidence), (u, v, w))


def _outermost(skeleton: Skeleton, rigid: tuple[int, ...], at: Placement, far: np.ndarray) -> int:
    """Selects the body of the last link whose shape reaches the far end."""
    best, nearest = rigid[0], np.inf
    for body in rigid:
        for cloud in skeleton.clouds.get(body, ()):
            distance = float(np.linalg.norm(at.world(body, cloud) - far, axis=1).min())
            if distance < nearest - 1e-6:
                best, nearest = body, distance
    return best


def _extrapolated(skeleton: Skeleton, chain: Chain, at: Placement) -> tuple[np.ndarray, float, str]:
    """A guess without a frame or shape at the end: position, confidence and evidence."""
    joint = chain.joints[-1]
    anchor, axis = at.anchors[joint], at.axes[joint]
    step = np.zeros(3)
    for earlier in reversed(chain.own[:-1]):
        step = anchor - at.anchors[earlier]
        step = step - (step @ axis) * axis
        if np.linalg.norm(step) > 5e-3:
            break
    before = float(np.linalg.norm(step))
    # The centre of mass of a rod is half-way. A link without its own inertia has none.
    mass = at.world(chain.last, np.asarray(skeleton.model.body_ipos[chain.last], float)) - anchor
    mass = mass - (mass @ axis) * axis
    reach = 2 * float(np.linalg.norm(mass))
    weighs = float(skeleton.model.body_mass[chain.last]) > _WEIGHS
    if weighs and reach > 5e-3 and 0.25 * before < reach < 2.5 * max(before, 0.02):
        return (
            anchor + 2 * mass,
            0.35,
            "guessed: twice as far from the joint as the last link's centre of mass",
        )
    if before > 5e-3:
        return (
            anchor + 0.8 * step,
            0.2,
            "guessed in line with the previous link, at 0.8 of its length",
        )
    out = anchor - at.bodies[chain.palm]
    if np.linalg.norm(out) < 5e-3:
        return (
            anchor,
            0.1,
            "there is no previous link from which to guess, so the last joint is used",
        )
    return (
        anchor + 0.5 * out,
        0.1,
        "guessed on the line from the palm through the last joint, beyond the joint by half of the "
        "distance between the two",
    )


_NAIL: Final = 0.06  # shift of a shape's end that is a nail, over its thickness
_PAD: Final = 0.8  # distance from a nail's end to the pad, over half the thickness
_ELSEWHERE: Final = 0.5  # distance of a shape that is not the link's, over the finger's length
_ROUNDS: Final = 4


@dataclass(frozen=True)
class End:
    """Far end of a link, in the world frame.

    Attributes:
        tip: (3,) end of its pad [m]: the far end, or a point a little behind a nail.
        far: (3,) far end on the middle line [m].
        nail: True if the back extends beyond the pad.
    """

    tip: Float[np.ndarray, "3"]
    far: Float[np.ndarray, "3"]
    nail: bool


def far_end(
    clouds: Sequence[Float[np.ndarray, "p 3"]],
    anchor: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    scale: float,
) -> End | None:
    """Finds the far end of a link, on the centre line of its shapes.

    The middle line runs through the centres of two sections, one near the joint and one near the
    end. Line and end are computed in turns.

    Args:
        clouds: points on each shape in the world [m].
        anchor: a point of the joint's axis [m].
        scale: length of the rest of the finger [m], the unit of small and large distances.

    Returns:
        The end; None without shapes, or if they surround the joint and have no direction.
    """
    parts = [part for part in clouds if len(part)]
    if not parts:
        return None
    gaps = [float(np.linalg.norm(part - anchor, axis=1).min()) for part in parts]
    near = [part for part, gap in zip(parts, gaps, strict=True) if gap < _ELSEWHERE * scale]
    points = np.concatenate(near or parts) - anchor
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    middle = middle - (middle @ axis) * axis  # the place along the hinge does not matter
    if np.linalg.norm(middle) < 1e-4:
        return None
    along = middle / np.linalg.norm(middle)
    tip = far = np.zeros(3)
    nail = False
    for _ in range(_ROUNDS):
        lateral = axis - (axis @ along) * along
        if np.linalg.norm(lateral) < 1e-6:
            return None  # a link along its own axis twists, and has no bending plane
        lateral = lateral / np.linalg.norm(lateral)
        across = np.cross(along, lateral)
        run = points @ along
        top = _top(run)
        if top < min(0.15 * scale, 0.008):
            return None
        share = run / top
        flat = points @ np.stack([across, lateral], axis=1)
        upper = (
            _section(flat, share, 0.6, 0.92)
            or _section(flat, share, 0.5, 1.0)
            or _section(flat, share, -np.inf, 1.0)
        )
        if upper is None:
            return None
        centre, half = upper
        far = top * along + centre[0] * across + centre[1] * lateral
        nail = _has_nail(flat[(share > 0.975) & (share <= 1.0)][:, 0], float(centre[0]), half)
        tip = far - (_PAD * half * along if nail else 0.0)
        lower = _section(flat, share, 0.1, 0.4)
        if lower is None:
            break
        start = 0.25 * top * along + lower[0][0] * across + lower[0][1] * lateral
        end = 0.76 * top * along + centre[0] * across + centre[1] * lateral
        along = (end - start) / np.linalg.norm(end - start)
    return End(anchor + tip, anchor + far, nail)


def _section(
    flat: np.ndarray, share: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, float] | None:
    """(2,) centre and half thickness of a section of the link; None with too few points."""
    inside = flat[(share >= low) & (share <= high)]
    if len(inside) < 6:
        return None
    least, most = inside.min(axis=0), inside.max(axis=0)
    return (least + most) / 2, float(most[0] - least[0]) / 2


def _has_nail(cap: np.ndarray, centre: float, half: float) -> bool:
    """True if a link is round and its end is at one side; a straight cut has no nail."""
    if len(cap) < 5:
        return False
    shift = abs(float(cap.min() + cap.max()) / 2 - centre)
    return 2 * _NAIL * half < shift and float(np.ptp(cap)) < 1.7 * half


def _top(run: np.ndarray) -> float:
    """Position of a shape's last point, without a few stray points beyond a gap."""
    order = np.sort(run)
    few = max(len(order) // 50, 1)
    if len(order) > 100:
        gaps = np.diff(order[-few - 1 :])
        jumps = np.flatnonzero(gaps > 0.08 * max(order[-few - 1], 1e-6))
        if len(jumps):
            return float(order[-few - 1 + jumps[0]])
    return float(order[-1])

"""Motion of fingers: the joints that bend them, the thumb, the side, and a neutral pose."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from smooth_operator.hand_discovery.branches import Chain, Tip
from smooth_operator.hand_discovery.skeleton import Placement, Skeleton
from smooth_operator.landmarks import FINGERS
from smooth_operator.types import Side

_PARALLEL: Final = 0.8  # least |cosine| of two axes that bend a finger in one plane
_SAMPLES: Final = 240
_STEPS: Final = 9
_NEAR: Final = 0.25  # distance over a finger's length at which tips could touch
_FACING: Final = 0.3  # least cosine between a pad's normal and the direction to the other tip
_MANY: Final = 0.1  # share of facing pairs of poses at which fingers oppose each other fully


@dataclass(frozen=True)
class Bending:
    """How one finger bends.

    Attributes:
        joints: hinges that bend it, base to tip; empty for a finger that only slides.
        senses: sign of the motion of each hinge that closes the finger, +1 or -1.
        axis: (3,) unit vector of the right-handed rotation that closes the straight finger, in the
            world; for a sliding finger, the cross product of ``along`` and the closing motion.
        along: (3,) unit vector from base to tip of the straight finger.
        clear: certainty of the closing direction, 0 to 1.
        straight: (n,) positions of all joints in which this finger is straight.
    """

    joints: tuple[int, ...]
    senses: tuple[int, ...]
    axis: Float[np.ndarray, "3"]
    along: Float[np.ndarray, "3"]
    clear: float
    straight: Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Reach:
    """Random poses of all fingers. The poses of different fingers are independent.

    Attributes:
        poses: (s, n) positions of all joints [rad].
        tips: (s, f, 3) fingertips, world [m].
        pads: (s, f, 3) unit vectors out of the pads.
        axes: (s, f, 3) unit axes about which the last links close.
    """

    poses: Float[np.ndarray, "s n"]
    tips: Float[np.ndarray, "s f 3"]
    pads: Float[np.ndarray, "s f 3"]
    axes: Float[np.ndarray, "s f 3"]

    def facing(self, i: int, j: int, length: float) -> Float[np.ndarray, "s s"]:
        """Measures how much two fingers close towards each other, for each pair of poses.

        Returns:
            (a, b) for pose a of finger i and pose b of finger j, the smaller of the two cosines
            between a pad's normal and the direction to the other tip; -1 if the tips are not close.
        """
        gaps = self.gaps(i, j)
        ours, theirs = self.tips[:, i], self.tips[:, j]
        # dot product of the pad's normal and the vector to the other tip, for all pairs of poses
        mine = self.pads[:, i] @ theirs.T - np.einsum("ad,ad->a", self.pads[:, i], ours)[:, None]
        other = ours @ self.pads[:, j].T - np.einsum("bd,bd->b", self.pads[:, j], theirs)
        cosine = np.minimum(mine, other) / np.maximum(gaps, 1e-9)
        return np.where(gaps < _NEAR * length, cosine, -1.0)

    def gaps(self, i: int, j: int) -> Float[np.ndarray, "s s"]:
        """Distances (a, b) between the tips of finger i in pose a and finger j in pose b [m]."""
        ours, theirs = self.tips[:, i], self.tips[:, j]
        squared = (ours**2).sum(axis=1)[:, None] + (theirs**2).sum(axis=1) - 2 * ours @ theirs.T
        gaps: np.ndarray = np.sqrt(np.maximum(squared, 0.0))
        return gaps

    def opposition(self, i: int, j: int, length: float) -> float:
        """Scores how well two fingers meet pad to pad, 0 (not at all) to 1.

        The score is the share of facing pairs among the pairs of poses with close tips. It is large
        for a thumb and a finger, and almost 0 for two neighbours, which close side by side.

        Args:
            length: length of a finger [m].
        """
        gaps = self.gaps(i, j)
        near = gaps < _NEAR * length
        if near.sum() < 10:
            return 0.0
        share = float((self.facing(i, j, length)[near] > _FACING).mean())
        closest = float(np.partition(gaps, 20, axis=None)[:20].mean())
        return min(share / _MANY, 1.0) * float(np.exp(-closest / (_NEAR * length)))


def find_bending(
    skeleton: Skeleton, chains: tuple[Chain, ...], tips: tuple[Tip, ...]
) -> tuple[Bending, ...]:
    """Finds how each finger bends. If the direction is ambiguous, the other fingers decide it."""
    rest = skeleton.place(skeleton.reference)
    ends = np.array([tip.position for tip in tips])
    return tuple(_bending(skeleton, chain, rest, ends, i) for i, chain in enumerate(chains))


def _bending(
    skeleton: Skeleton, chain: Chain, rest: Placement, ends: np.ndarray, i: int
) -> Bending:
    tip = ends[i]
    local = rest.local(chain.last, tip)
    hinges = [j for j in chain.own if skeleton.turns[j]]
    centre = np.delete(ends, i, axis=0).mean(axis=0)
    if not hinges:
        return _sliding(skeleton, chain, rest, tip, centre)
    last = rest.axes[hinges[-1]]
    joints = [j for j in hinges if abs(rest.axes[j] @ last) > _PARALLEL]
    along = [int(np.sign(rest.axes[j] @ last)) for j in joints]

    # The finger closes in the direction in which its tip comes nearer to its base.
    def folded(sense: int) -> float:
        q = skeleton.reference.copy()
        for j, sign in zip(joints, along, strict=True):
            leader, curve = skeleton.leaders.get(j, (j, Polynomial((0.0, 1.0))))
            if skeleton.bounded[leader]:
                ends = skeleton.limits[leader]
                q[leader] = ends[int(sign * sense * np.sign(np.diff(curve(ends))[0]) > 0)]
        at = skeleton.place(skeleton.coupled(q))
        return float(np.linalg.norm(at.world(chain.last, local) - at.anchors[joints[0]]))

    plus, minus = folded(1), folded(-1)
    clear = abs(plus - minus) / max(plus, minus, 1e-9)
    sense = 1 if plus < minus else -1
    if len(joints) == 1 or clear < 0.02:
        # A single hinge closes in the direction with more range that moves the tip to the others.
        ends, here = skeleton.limits[joints], skeleton.reference[joints][:, None]
        low, high = np.where(np.isfinite(ends), ends - here, 0.0).T  # a follower may have none
        up = np.where(np.array(along) > 0, high, -low)
        down = np.where(np.array(along) > 0, -low, high)
        room = float((up - down).sum() / max((up + down).sum(), 1e-9))
        step = np.cross(last, tip - rest.anchors[joints[-1]])
        toward = float(
            step @ (centre - tip) / max(np.linalg.norm(step) * np.linalg.norm(centre - tip), 1e-9)
        )
        score = (room if np.isfinite(room) else 0.0) + 0.6 * toward
        sense = 1 if score >= 0 else -1
        clear = min(0.3, 0.3 * abs(score))
    straight = _straightened(skeleton, chain, joints, local)
    at = skeleton.place(straight)
    axis = sense * at.axes[hinges[-1]]
    reach = at.world(chain.last, local) - at.anchors[joints[0]]
    reach = reach - (reach @ axis) * axis
    norm = float(np.linalg.norm(reach))
    direction = reach / norm if norm > 1e-9 else _any_across(axis)
    senses = tuple(sense * sign for sign in along)
    return Bending(tuple(joints), senses, axis, direction, min(clear, 1.0), straight)


def _straightened(
    skeleton: Skeleton, chain: Chain, joints: list[int], local: np.ndarray
) -> np.ndarray:
    """Pose in which the tip is farthest from the first joint that bends the finger."""
    q = skeleton.reference.copy()
    deciding = [j for j in skeleton.free(tuple(joints[1:])) if skeleton.bounded[j]]

    def stretch(pose: np.ndarray) -> float:
        at = skeleton.place(skeleton.coupled(pose))
        return float(np.linalg.norm(at.world(chain.last, local) - at.anchors[joints[0]]))

    for _ in range(2):
        for j in deciding:
            trial = q.copy()
            best = stretch(q) + 1e-6  # rounding: an equal pose is not better
            for value in np.linspace(skeleton.limits[j, 0], skeleton.limits[j, 1], _STEPS):
                trial[j] = value
                if (length := stretch(trial)) > best:
                    best, q[j] = length, value
    return skeleton.coupled(q)


def _sliding(
    skeleton: Skeleton, chain: Chain, rest: Placement, tip: np.ndarray, centre: np.ndarray
) -> Bending:
    """Bending of a finger without hinges, which closes towards the others."""
    slide = rest.axes[chain.own[-1]]
    closing = slide if slide @ (centre - tip) >= 0 else -slide
    reach = tip - rest.anchors[chain.own[0]]
    along = reach - (reach @ closing) * closing
    norm = float(np.linalg.norm(along))
    along = along / norm if norm > 1e-4 else _any_across(closing)
    axis = np.cross(along, closing)  # a hinge with this axis would move the tip alike
    return Bending((), (), axis, along, 0.3, skeleton.reference)


def _any_across(axis: np.ndarray) -> np.ndarray:
    other = np.eye(3)[int(np.argmin(abs(axis)))]
    across = np.cross(axis, other)
    unit: np.ndarray = across / np.linalg.norm(across)
    return unit


def sample_reach(
    skeleton: Skeleton, chains: tuple[Chain, ...], tips: tuple[Tip, ...], bends: tuple[Bending, ...]
) -> Reach:
    """Draws random poses within the limits. Equal models give equal poses."""
    rng = np.random.default_rng(0)
    joints = skeleton.free(tuple(dict.fromkeys(j for c in chains for j in c.joints)))
    joints = tuple(j for j in joints if skeleton.bounded[j])
    low, high = skeleton.limits[list(joints)].T
    last, local, pads, axes = [], [], [], []
    for chain, tip, bend in zip(chains, tips, bends, strict=True):
        at = skeleton.place(bend.straight)
        end = at.world(int(skeleton.model.body(tip.point.body).id), np.array(tip.point.offset))
        axis = bend.axis
        out = end - at.anchors[chain.joints[-1]]
        out = out - (out @ axis) * axis
        pad = np.cross(axis, out if np.linalg.norm(out) > 1e-6 else bend.along)
        frame = at.frames[chain.last]
        last.append(chain.last)
        local.append(at.local(chain.last, end))
        pads.append(frame.T @ (pad / np.linalg.norm(pad)))
        axes.append(frame.T @ axis)
    poses, out_tips, out_pads, out_axes = [], [], [], []
    q = skeleton.reference.copy()
    for _ in range(_SAMPLES):
        q[list(joints)] = rng.uniform(low, high)
        poses.append(skeleton.coupled(q))
        at = skeleton.place(poses[-1])
        frames = at.frames[last]
        out_tips.append(np.einsum("fij,fj->fi", frames, np.array(local)) + at.bodies[last])
        out_pads.append(np.einsum("fij,fj->fi", frames, np.array(pads)))
        out_axes.append(np.einsum("fij,fj->fi", frames, np.array(axes)))
    return Reach(np.array(poses), np.array(out_tips), np.array(out_pads), np.array(out_axes))


@dataclass(frozen=True)
class Thumb:
    """Which chain is the thumb, with confidence and evidence."""

    index: int
    confidence: float
    evidence: tuple[str, ...]


def find_thumb(
    chains: tuple[Chain, ...], bends: tuple[Bending, ...], reach: Reach, labels: list[str | None]
) -> Thumb:
    """Finds the thumb by its opposition to the others, its closing direction and its base.

    Args:
        reach: random poses of the fingers.
        labels: human finger in the names of each chain, which is weak evidence; None without one.
    """
    count = len(chains)
    length = float(np.median([chain.length for chain in chains]))
    opposed = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            opposed[i, j] = opposed[j, i] = reach.opposition(i, j, length)
    closing = reach.axes.mean(axis=0)
    straight = np.array([bend.axis for bend in bends])
    bases = np.array([chain.base for chain in chains])
    along = np.array([bend.along for bend in bends])

    scores, parts = np.zeros(count), []
    for t in range(count):
        others = [i for i in range(count) if i != t]
        rest = opposed[np.ix_(others, others)]
        pairs = len(others) * (len(others) - 1)
        opposition = opposed[t, others].mean() - (rest.sum() / pairs if pairs else 0.0)
        moving, cosine = _apart(closing, t)
        resting, _ = _apart(straight, t)
        across = (moving + resting) / 2 if count > 2 else 0.0
        forward = along[others].mean(axis=0)
        behind = float((bases[others].mean(axis=0) - bases[t]) @ forward) / length
        # A name counts only if it is the only one of its kind.
        named = float(labels[t] == "thumb" and labels.count("thumb") == 1)
        scores[t] = (
            1.2 * opposition + across + 0.5 * float(np.clip(behind, -0.5, 0.6)) + 0.35 * named
        )
        parts.append((opposed[t, others].max(), cosine, behind, named))

    best = int(np.argmax(scores))
    margin = float(scores[best] - np.delete(scores, best).max())
    meets, cosine, behind, named = parts[best]
    evidence = []
    if count > 2:
        if meets > 0.05:
            met = sum(opposed[best, i] > 0.05 for i in range(count) if i != best)
            evidence.append(f"the thumb meets {met} of {count - 1} fingertips pad to pad")
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        evidence.append(
            f"it closes about an axis that is {angle:.0f}° away from those of the others"
        )
    if behind > 0.1:
        evidence.append(
            f"its base is {behind * length * 1e3:.0f} mm behind the bases of the others"
        )
    if named:
        evidence.append("the names in the model say so, too (weak evidence)")
    if labels.count("thumb") == 1 and not named:
        evidence.append("although the names say that another finger is the thumb")
        margin -= 0.2
    if count == 2:
        evidence.append("with only two fingers, either can be called the thumb")
        confidence = 0.35 + 0.35 * float(np.clip(margin, 0, 1))
    else:
        confidence = 0.4 + 0.8 * float(np.clip(margin, 0, 0.72))
    return Thumb(best, round(float(np.clip(confidence, 0.05, 0.98)), 2), tuple(evidence))


def _apart(axes: np.ndarray, finger: int) -> tuple[float, float]:
    """Measures how much one finger's closing direction differs from that of the others.

    Returns:
        1 if all others close about one axis and this finger about the opposite one, 0 if it closes
        like them or they do not agree; and the cosine between its axis and their mean.
    """
    together = np.delete(axes, finger, axis=0).mean(axis=0)
    agree, own = float(np.linalg.norm(together)), float(np.linalg.norm(axes[finger]))
    cosine = float(axes[finger] @ together) / max(agree * own, 1e-9)
    return agree * (1 - cosine) / 2, cosine


_CLEAR: Final = 0.12  # distance of the thumb from the palm's middle for a clear side, over a finger
_BASE: Final = 0.04  # least distance of its base to the side of its reach; hands have 0.1 to 0.5
_UNCLEAR: Final = 0.3  # confidence of a side that is not clear


@dataclass(frozen=True, eq=False)
class Layout:
    """Directions of a hand in the world, with its side and the order of its fingers.

    Attributes:
        forward: direction from wrist to fingers.
        lateral: axis of the right-handed rotation that closes the fingers; it points to the thumb
            of a right hand.
        sided: True if base and reach of the thumb are clearly on one side of the palm.
        side: right or left.
        side_confidence: confidence of the side, 0 to 1.
        side_evidence: reasons for the side.
        order: indices of the chains, thumb first, then from the thumb's side.
        order_confidence: confidence of the order, 0 to 1.
        order_evidence: reasons for the order.
        names: human fingers, in that order.
        names_confidence: confidence of the names, 0 to 1.
    """

    forward: Float[np.ndarray, "3"]
    lateral: Float[np.ndarray, "3"]
    sided: bool
    side: Side
    side_confidence: float
    side_evidence: tuple[str, ...]
    order: tuple[int, ...]
    order_confidence: float
    order_evidence: tuple[str, ...]
    names: tuple[str, ...]
    names_confidence: float


def find_layout(
    chains: tuple[Chain, ...],
    bends: tuple[Bending, ...],
    reach: Reach,
    thumb: int,
    labels: list[str | None],
    side_said: Side | None,
    side_given: Side | None,
) -> Layout:
    """Finds the side and the order of the fingers from the directions in which the fingers point
    and close.

    If the fingers point along f and close about w, the palm faces w x f, and a right hand has its
    thumb on the side of w.

    Args:
        reach: random poses of the fingers.
        labels: human finger in the names of each chain; None without one.
        side_said: side in the names of the model; None without one.
        side_given: side that the user set; None without one.
    """
    others = [i for i in range(len(chains)) if i != thumb]
    length = float(np.median([chain.length for chain in chains]))
    lateral = _unit(np.mean([bends[i].axis for i in others], axis=0), bends[others[0]].axis)
    forward = np.mean([bends[i].along for i in others], axis=0)
    forward = _unit(forward - (forward @ lateral) * lateral, bends[others[0]].along)

    bases = np.array([chain.base for chain in chains])
    middle = reach.tips.mean(axis=0)
    by_base = float((bases[thumb] - bases[others].mean(axis=0)) @ lateral) / length
    by_reach = float((middle[thumb] - middle[others].mean(axis=0)) @ lateral) / length
    sideways = 0.5 * by_base + 0.5 * by_reach
    side: Side = "right" if sideways >= 0 else "left"
    clear = min(abs(sideways) / _CLEAR, 1.0)
    evidence = [
        "seen with the fingers up and the palm towards you, the thumb is "
        f"{abs(sideways) * length * 1e3:.0f} mm to the {side}: its base "
        f"{by_base * length * 1e3:+.0f} mm, its reach {by_reach * length * 1e3:+.0f} mm"
    ]
    sure = min(bends[i].clear for i in others)
    confidence = 0.4 + 0.45 * clear + 0.13 * min(sure / 0.2, 1.0)
    sided = bool(by_base * np.sign(by_reach) >= _BASE and clear >= 0.3)
    if by_base * np.sign(by_reach) < _BASE:
        confidence = _UNCLEAR
        evidence.append(
            "base and reach disagree: the fingers are arranged around the middle, so it may be a "
            "gripper without a side"
        )
    if clear < 0.3:
        confidence = _UNCLEAR
        evidence = [
            (
                "the thumb is opposite the middle of the palm, so the hand can serve as a right "
                "or a left hand"
            )
        ]
        if side_said is not None:
            side = side_said
        elif side_given is None:
            side = "right"
            evidence.append("right is assumed")
    if side_said == side:
        confidence = min(confidence + (0.3 if clear < 0.3 else 0.05), 0.98)
        evidence.append(f"names indicate {side} (weak evidence)")
    elif side_said is not None:
        confidence = max(confidence - 0.25, 0.1)
        evidence.append(f"although names indicate {side_said}")
    if side_given is not None:
        if side_given != side and clear >= 0.3:
            evidence.append(f"set to {side_given}, although the shape indicates {side}")
            confidence = 0.4
        else:
            evidence.append("set with --side")
            confidence = max(confidence, 0.95)
        side = side_given

    # If the thumb has no clear side, the side of the hand tells where the index finger is.
    towards = 1.0 if (sideways >= 0 if clear >= 0.3 else side == "right") else -1.0
    place = {i: towards * float((0.7 * bases[i] + 0.3 * middle[i]) @ lateral) for i in others}
    ranked = sorted(others, key=lambda i: place[i], reverse=True)
    gaps = [place[a] - place[b] for a, b in pairwise(ranked)]
    gap = min(gaps, default=length)
    ordered = 0.5 + 0.47 * min(gap / (0.1 * length), 1.0)
    reasons = [
        "from the thumb's side across the palm, "
        + (f"at least {gap * 1e3:.0f} mm apart" if gaps else "one finger besides the thumb")
    ]
    if clear < 0.3 and len(others) > 1 and side_given is None:
        ordered = min(ordered, 0.4)
        reasons.append("which end is the thumb's depends on the side, which is not certain")
    if clear < 0.3 and _spoken([labels[i] for i in others]):
        # Names decide what the shape leaves open.
        ranked = sorted(others, key=lambda i: FINGERS.index(labels[i] or ""))
        ordered = 0.6
        reasons[1:] = [
            "only the fingers' names tell at which end the index finger is (weak evidence)"
        ]
        if side_said is None and side_given is None and len(ranked) > 1:
            across = bases @ lateral
            side = "right" if across[ranked[0]] > across[ranked[-1]] else "left"
            evidence[-1] = f"{side}, assuming that the finger names in the model are correct"
    names, how_sure, why = _names([labels[i] for i in ranked])
    return Layout(
        forward=forward,
        lateral=lateral,
        sided=sided,
        side=side,
        side_confidence=round(confidence, 2),
        side_evidence=tuple(evidence),
        order=(thumb, *ranked),
        order_confidence=round(min(ordered, how_sure), 2),
        order_evidence=(*reasons, *why),
        names=("thumb", *names),
        names_confidence=round(how_sure, 2),
    )


def _names(labels: list[str | None]) -> tuple[tuple[str, ...], float, list[str]]:
    """Human fingers of the robot's fingers, with confidence and evidence.

    The names of the model are used only if they fit the order.
    """
    count = len(labels)
    named = _spoken(labels)
    if named and list(named) == sorted(named, key=FINGERS.index):
        return named, 0.95, ["the names are those in the model"]
    names = FINGERS[1 : 1 + count]
    if count == 4:
        return names, 0.95, []
    drives = f"driven by {', '.join(names)}; other human fingers can drive them as well"
    return names, 0.85 if count == 3 else 0.75, [drives]


def _spoken(labels: list[str | None]) -> tuple[str, ...]:
    """Finger names of the chains other than the thumb; empty unless each has one."""
    named = tuple(name for name in labels if name is not None and name != "thumb")
    return named if len(set(named)) == len(labels) else ()


def _unit(vector: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    norm = float(np.linalg.norm(vector))
    return vector / norm if norm > 1e-6 else otherwise


_BENT: Final = 0.22  # share of its closing range by which a joint is bent
_TURNED: Final = 0.7  # share of the way to its pinches by which the thumb is turned
_BEST: Final = 40  # number of pairs of poses that count as pinches
_DEEP: Final = 3e-3  # overlap above which knuckles are opened [m]
_OPENED: Final = (0.2, 0.4, 0.6)  # shares of the way to an open knuckle that are tried


def find_neutral(
    skeleton: Skeleton,
    chains: tuple[Chain, ...],
    bends: tuple[Bending, ...],
    reach: Reach,
    order: tuple[int, ...],
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Finds a neutral pose within the limits.

    Fingers that would overlap, as in a hand whose fingers stand in a ring, are opened at their
    knuckles.

    Args:
        order: indices of the chains, thumb first, then from the thumb's side.

    Returns:
        Joint name -> position [rad] of the hand's joints that follow no other; and a description of
        the pose.
    """
    q = skeleton.reference.copy()
    named: list[int] = []
    for chain, bend in zip(chains, bends, strict=True):
        for j in chain.joints:
            if j in skeleton.leaders or not skeleton.bounded[j] or j in named:
                continue
            named.append(j)
            low, high = skeleton.limits[j]
            if j in bend.joints:
                closed = high if bend.senses[bend.joints.index(j)] > 0 else low
                q[j] += _BENT * (closed - q[j])
            elif not low < q[j] < high:  # at a limit it could move in one direction only
                q[j] += 0.2 * ((high if q[j] <= low else low) - q[j])
    thumb = order[0]
    turning = [j for j in chains[thumb].own if j in named and j not in bends[thumb].joints]
    turned = _pinching(chains, reach, order)
    if turned is not None:
        for j in turning:
            start = skeleton.reference[j]
            q[j] = start + _TURNED * (turned[j] - start)
    notes = ["fingers are bent by a fifth of their range, and the thumb is turned towards them"]
    depth = finger_overlap(skeleton, chains, skeleton.coupled(q))
    if depth > _DEEP:
        knuckles = {bend.joints[0]: bend.senses[0] for bend in bends if bend.joints}
        q, less = _opened(skeleton, chains, {j: s for j, s in knuckles.items() if j in named}, q)
        notes.append(
            f"fingers would overlap by {1e3 * depth:.0f} mm in this pose; with the knuckles bent "
            f"less, they overlap by only {1e3 * less:.0f} mm"
        )
    return {skeleton.joint_names[j]: round(float(q[j]), 4) for j in sorted(named)}, tuple(notes)


def _opened(
    skeleton: Skeleton, chains: tuple[Chain, ...], knuckles: dict[int, int], q: np.ndarray
) -> tuple[np.ndarray, float]:
    """The pose with knuckles opened as little as possible, and the overlap that remains [m].

    Args:
        knuckles: joint -> sign of the motion that closes its finger.
    """
    best, least = q, finger_overlap(skeleton, chains, skeleton.coupled(q))
    for share in _OPENED:
        trial = q.copy()
        for j, sense in knuckles.items():
            low, high = skeleton.limits[j]
            trial[j] += share * ((low if sense > 0 else high) - q[j])
        depth = finger_overlap(skeleton, chains, skeleton.coupled(trial))
        if depth < least:
            best, least = trial, depth
        if least < _DEEP:
            break
    return best, least


def _pinching(chains: tuple[Chain, ...], reach: Reach, order: tuple[int, ...]) -> np.ndarray | None:
    """Mean pose in the best pinches of the thumb with the next two fingers; None without one."""
    length = float(np.median([chain.length for chain in chains]))
    poses = []
    for finger in order[1:3]:
        facing = reach.facing(order[0], finger, length)
        best = np.argpartition(facing, -_BEST, axis=None)[-_BEST:]
        thumb_poses = np.unravel_index(best, facing.shape)[0]
        poses += [
            reach.poses[a] for a, i in zip(thumb_poses, best, strict=True) if facing.flat[i] > 0
        ]
    return np.mean(poses, axis=0) if poses else None


def finger_overlap(
    skeleton: Skeleton, chains: tuple[Chain, ...], q: Float[np.ndarray, " n"]
) -> float:
    """Deepest overlap between the shapes of two fingers in a pose [m]; 0 if no two fingers touch.

    Meshes count as their convex hulls. Pairs that the model excludes from collision do not count.

    Args:
        q: positions of all joints [rad].
    """
    model = skeleton.model
    owner = np.full(model.nbody, -1)
    for i, chain in enumerate(chains):
        moved = [int(model.jnt_bodyid[j]) for j in chain.own]
        for body in (b for first in moved for b in skeleton.rigid(first)):
            owner[body] = i
    finger = owner[model.geom_bodyid]
    data = skeleton.posed_data(q)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    pairs = finger[np.array(data.contact.geom).reshape(-1, 2)]
    between = (pairs >= 0).all(axis=1) & (pairs[:, 0] != pairs[:, 1])
    return max(float(np.max(-data.contact.dist[between], initial=0.0)), 0.0)

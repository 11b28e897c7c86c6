"""Motion of fingers: the joints that bend them, which is the thumb, and what two can reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.lab.discovery.branches import Chain
from smooth_operator.lab.discovery.skeleton import Placement, Skeleton
from smooth_operator.lab.discovery.tips import Tip

_PARALLEL: Final = 0.8  # |cosine| of two axes that bend a finger in one plane
_SAMPLES: Final = 240
_STEPS: Final = 9
_NEAR: Final = 0.25  # of a finger's length: tips this close could touch
_FACING: Final = 0.3  # cosine of pad and direction to the other tip
_MANY: Final = 0.1  # share of near pairs of poses that makes a full opposition


@dataclass(frozen=True)
class Bending:
    """Bending of one finger.

    Attributes:
        joints: hinges that bend it, base to tip; empty for a finger that only slides.
        senses: +1 or -1 for each: the sign of the motion that closes the finger.
        axis: (3,) unit vector, right-handed about which it closes; world, straightened pose. Of a
            sliding finger: direction of sliding x finger direction.
        along: (3,) unit vector, base to tip, straightened.
        clear: 0..1 how clearly one way is closing and the other opening.
        straight: (n,) pose of all joints in which this finger is straight.
        reason: in words.
    """

    joints: tuple[int, ...]
    senses: tuple[int, ...]
    axis: Float[np.ndarray, "3"]
    along: Float[np.ndarray, "3"]
    clear: float
    straight: Float[np.ndarray, " n"]
    reason: str


@dataclass(frozen=True, eq=False)
class Reach:
    """Random poses of all fingers, each finger's independent of the others'.

    Attributes:
        poses: (s, n) positions of all joints [rad].
        tips: (s, f, 3) fingertips, world [m].
        pads: (s, f, 3) unit vectors out of the pads.
        axes: (s, f, 3) unit vectors about which the last links close.
    """

    poses: Float[np.ndarray, "s n"]
    tips: Float[np.ndarray, "s f 3"]
    pads: Float[np.ndarray, "s f 3"]
    axes: Float[np.ndarray, "s f 3"]

    def facing(self, i: int, j: int, length: float) -> Float[np.ndarray, "s s"]:
        """Measures how much two fingers close towards each other, pose by pose.

        Returns:
            smaller of the two cosines between pad and direction to the other tip; -1 where the
            tips are not close, for pose a of finger i and pose b of finger j.
        """
        gaps = self.gaps(i, j)
        ours, theirs = self.tips[:, i], self.tips[:, j]
        # pad . (other tip - own tip), for all pairs of poses
        mine = self.pads[:, i] @ theirs.T - np.einsum("ad,ad->a", self.pads[:, i], ours)[:, None]
        other = ours @ self.pads[:, j].T - np.einsum("bd,bd->b", self.pads[:, j], theirs)
        cosine = np.minimum(mine, other) / np.maximum(gaps, 1e-9)
        return np.where(gaps < _NEAR * length, cosine, -1.0)

    def gaps(self, i: int, j: int) -> Float[np.ndarray, "s s"]:
        """Distances of two tips, pose a of finger i and pose b of finger j [m]."""
        ours, theirs = self.tips[:, i], self.tips[:, j]
        squared = (ours**2).sum(axis=1)[:, None] + (theirs**2).sum(axis=1) - 2 * ours @ theirs.T
        gaps: np.ndarray = np.sqrt(np.maximum(squared, 0.0))
        return gaps

    def opposition(self, i: int, j: int, length: float) -> float:
        """Scores how well two fingers meet pad to pad, 0 (not at all) to 1.

        Of the pairs of poses whose tips are close, in some each finger closes towards the other:
        many for a thumb and a finger, next to none for two neighbours, which close side by side.

        Args:
            length: length of a finger [m], the unit of near and far.
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
    """Finds the bending of each finger; the others decide where one alone is ambiguous."""
    rest = skeleton.place(skeleton.reference)
    ends = np.array([tip.position for tip in tips])
    return tuple(_bending(skeleton, chain, rest, ends, i) for i, chain in enumerate(chains))


def tip_in(skeleton: Skeleton, tip: Tip, at: Placement) -> np.ndarray:
    """A fingertip in some pose, world [m]."""
    body = int(skeleton.model.body(tip.point.body).id)
    return at.world(body, np.array(tip.point.offset))


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

    # Folded one way or the other, tip and base come nearer: that way is closing.
    def folded(sense: int) -> float:
        q = skeleton.reference.copy()
        for j, sign in zip(joints, along, strict=True):
            leader, gain, _ = skeleton.leaders.get(j, (j, 1.0, 0.0))
            if skeleton.bounded[leader]:
                q[leader] = skeleton.limits[leader][int(sign * sense * np.sign(gain) > 0)]
        at = skeleton.place(skeleton.coupled(q))
        return float(np.linalg.norm(at.world(chain.last, local) - at.anchors[joints[0]]))

    plus, minus = folded(1), folded(-1)
    clear = abs(plus - minus) / max(plus, minus, 1e-9)
    sense = 1 if plus < minus else -1
    reason = "bending this way brings the tip nearer to the base"
    if len(joints) == 1 or clear < 0.02:
        # A single hinge: what it has more room for, and what brings the tip to the others.
        low, high = (
            np.array([skeleton.limits[j] for j in joints]) - skeleton.reference[joints][:, None]
        ).T
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
        reason = "a single hinge: by its limits, and by what brings the tip to the others"
    straight = _straightened(skeleton, chain, joints, local)
    at = skeleton.place(straight)
    axis = sense * at.axes[hinges[-1]]
    reach = at.world(chain.last, local) - at.anchors[joints[0]]
    reach = reach - (reach @ axis) * axis
    norm = float(np.linalg.norm(reach))
    direction = reach / norm if norm > 1e-9 else _any_across(axis)
    senses = tuple(sense * sign for sign in along)
    return Bending(tuple(joints), senses, axis, direction, min(clear, 1.0), straight, reason)


def _straightened(
    skeleton: Skeleton, chain: Chain, joints: list[int], local: np.ndarray
) -> np.ndarray:
    """The pose in which the tip is farthest from the first joint that bends the finger."""
    q = skeleton.reference.copy()
    deciding = [j for j in skeleton.free(tuple(joints[1:])) if skeleton.bounded[j]]

    def stretch(pose: np.ndarray) -> float:
        at = skeleton.place(skeleton.coupled(pose))
        return float(np.linalg.norm(at.world(chain.last, local) - at.anchors[joints[0]]))

    for _ in range(2):
        for j in deciding:
            trial = q.copy()
            best = stretch(q) + 1e-6  # as it is, unless another is better
            for value in np.linspace(skeleton.limits[j, 0], skeleton.limits[j, 1], _STEPS):
                trial[j] = value
                if (length := stretch(trial)) > best:
                    best, q[j] = length, value
    return skeleton.coupled(q)


def _sliding(
    skeleton: Skeleton, chain: Chain, rest: Placement, tip: np.ndarray, centre: np.ndarray
) -> Bending:
    """A finger of slides: it closes towards the others."""
    slide = rest.axes[chain.own[-1]]
    closing = slide if slide @ (centre - tip) >= 0 else -slide
    reach = tip - rest.anchors[chain.own[0]]
    along = reach - (reach @ closing) * closing
    norm = float(np.linalg.norm(along))
    along = along / norm if norm > 1e-4 else _any_across(closing)
    axis = np.cross(along, closing)  # about it, the tip of a hinge would move the same way
    return Bending((), (), axis, along, 0.3, skeleton.reference, "slides towards the others")


def _any_across(axis: np.ndarray) -> np.ndarray:
    other = np.eye(3)[int(np.argmin(abs(axis)))]
    across = np.cross(axis, other)
    unit: np.ndarray = across / np.linalg.norm(across)
    return unit


def sample_reach(
    skeleton: Skeleton, chains: tuple[Chain, ...], tips: tuple[Tip, ...], bends: tuple[Bending, ...]
) -> Reach:
    """Random poses within limits, the same for the same model."""
    rng = np.random.default_rng(0)
    joints = skeleton.free(tuple(dict.fromkeys(j for c in chains for j in c.joints)))
    joints = tuple(j for j in joints if skeleton.bounded[j])
    low, high = skeleton.limits[list(joints)].T
    last, local, pads, axes = [], [], [], []
    for chain, tip, bend in zip(chains, tips, bends, strict=True):
        at = skeleton.place(bend.straight)
        end = tip_in(skeleton, tip, at)
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
    """The thumb's index among the chains, how sure, why."""

    index: int
    confidence: float
    evidence: tuple[str, ...]


def find_thumb(
    chains: tuple[Chain, ...],
    bends: tuple[Bending, ...],
    reach: Reach,
    labels: list[str | None],
) -> Thumb:
    """Finds the thumb by opposition, by the direction in which it closes, by where its base is.

    Args:
        reach: places that they can reach together.
        labels: the human finger that each one's names speak of; weak evidence.
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
        # a name counts against the others' silence only
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
            evidence.append(f"it meets {met} of {count - 1} fingertips pad to pad")
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        evidence.append(f"it closes about an axis {angle:.0f}° from the others'")
    if behind > 0.1:
        evidence.append(f"its base is {behind * length * 1e3:.0f} mm behind the others'")
    if named:
        evidence.append("its names say so (weak evidence)")
    if labels.count("thumb") == 1 and not named:
        evidence.append("though names call another finger the thumb")
        margin -= 0.2
    if count == 2:
        evidence.append("of two fingers, which is the thumb is a matter of taste")
        confidence = 0.35 + 0.35 * float(np.clip(margin, 0, 1))
    else:
        confidence = 0.4 + 0.8 * float(np.clip(margin, 0, 0.72))
    return Thumb(best, round(float(np.clip(confidence, 0.05, 0.98)), 2), tuple(evidence))


def _apart(axes: np.ndarray, finger: int) -> tuple[float, float]:
    """Measures how much one finger's closing direction differs from the others'.

    Returns:
        1 where all others close about one axis and it about the opposite one, 0 where it closes
        as they do or they do not agree; and the cosine of its axis and their mean.
    """
    together = np.delete(axes, finger, axis=0).mean(axis=0)
    agree, own = float(np.linalg.norm(together)), float(np.linalg.norm(axes[finger]))
    cosine = float(axes[finger] @ together) / max(agree * own, 1e-9)
    return agree * (1 - cosine) / 2, cosine

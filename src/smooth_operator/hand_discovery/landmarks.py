"""Findings about a model, each with its confidence and evidence, and the landmarks of the fingers,
finger bases and wrist."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.branches import Chain
from smooth_operator.hand_discovery.motion import Bending, Layout, Reach
from smooth_operator.hand_discovery.skeleton import Placement, Skeleton, says_wrist
from smooth_operator.hands.spec import Coupling, FingerSpec, HandSpec, Point
from smooth_operator.landmarks import FINGERS

SURE: Final = 0.8
"""Smallest confidence of a finding that the user does not need to check."""
UNSURE: Final = 0.5
"""Confidence below which a finding is little better than a guess, which the checklist marks.
``smooth-operator hands add`` writes no hand with such a side, palm, thumb, order or wrist."""
_COUPLING: Final = ("joint", "follows", "multiplier", "offset", "higher")


@dataclass(frozen=True)
class Finding:
    """A property of the hand that was derived from the model.

    Attributes:
        subject: the property: ``side``, ``palm``, ``thumb``, ``order``, ``tip of index``...
        value: its value as text.
        confidence: confidence from 0 (a guess) to 1 (stated in the model).
        evidence: reasons for the value.
        overrule: option of ``smooth-operator hands add`` that sets another value.
    """

    subject: str
    value: str
    confidence: float
    evidence: tuple[str, ...]
    overrule: str


@dataclass(frozen=True)
class FoundFinger:
    """A finger in the model.

    Attributes:
        name: the human finger that drives it.
        tip_body: body to which the fingertip is fixed.
        tip_offset: (3,) fingertip in that body's frame [m].
        joints: all joints that move the tip, from palm to tip, including coupled ones.
        confidence: the lower of the confidences of name and tip.
    """

    name: str
    tip_body: str
    tip_offset: tuple[float, float, float]
    joints: tuple[str, ...]
    confidence: float


@dataclass(frozen=True)
class FoundCoupling:
    """A coupled joint in the model, with its confidence."""

    coupling: Coupling
    confidence: float


@dataclass(frozen=True)
class Discovery:
    """Description of the hand in a model, with all findings about it.

    Attributes:
        spec: the description, ready for ``load_hand_spec``.
        findings: findings with confidence and evidence, in the order of the checklist.
        fingers: fingers, thumb first, then from the thumb's side across the palm.
        coupled: joints of the hand that follow another.
        notes: other facts for the user, such as missing meshes.
    """

    spec: HandSpec
    findings: tuple[Finding, ...]
    fingers: tuple[FoundFinger, ...]
    coupled: tuple[FoundCoupling, ...]
    notes: tuple[str, ...] = ()

    @property
    def unsure(self) -> tuple[Finding, ...]:
        """Findings that the user should check, least certain first."""
        doubtful = [finding for finding in self.findings if finding.confidence < SURE]
        return tuple(sorted(doubtful, key=lambda finding: finding.confidence))

    @property
    def guesses(self) -> tuple[Finding, ...]:
        """Findings that are little better than a guess, and that make the hand unusable if they are
        wrong: side, palm, thumb, order of the fingers and wrist. The user must set them."""
        deciding = ("side", "palm", "thumb", "order", "wrist")
        return tuple(f for f in self.unsure if f.subject in deciding and f.confidence < UNSURE)

    def to_json(self) -> dict[str, Any]:
        """The description and the findings as one object of plain values.

        Returns:
            ``side`` and ``palm`` (strings), ``fingers`` (``name``, ``tip_body``, ``tip_offset``
            [m], ``joints``, ``confidence``), ``coupled`` (``joint``, ``follows``, ``multiplier``,
            ``offset`` [rad], ``higher``, ``confidence``), ``confidence`` (subject -> number),
            ``evidence`` (subject -> reasons), and the other entries of the description.
        """
        spec = self.spec
        return {
            "name": spec.name,
            "model": str(spec.model),
            "side": spec.side,
            "palm": spec.palm,
            "fingers": [asdict(finger) for finger in self.fingers],
            "coupled": [
                {name: getattr(one.coupling, name) for name in _COUPLING}
                | {"confidence": one.confidence}
                for one in self.coupled
            ],
            "wrist": {"body": spec.wrist.body, "offset": list(spec.wrist.offset)},
            "wrist_joints": list(spec.wrist_joints),
            "align": list(spec.align),
            "neutral": dict(spec.neutral),
            "confidence": {f.subject: f.confidence for f in self.findings},
            "evidence": {f.subject: list(f.evidence) for f in self.findings},
            "unsure": [finding.subject for finding in self.unsure],
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Overrules:
    """Properties of the hand that the user sets.

    Attributes:
        palm: body from which the fingers branch.
        thumb: a body or joint of the thumb.
        fingers: pairs of a human finger and a body or joint of the robot finger that it drives. If
            a model has more than five fingers, only these are used.
        tips: pairs of a human finger and the fingertip.
        wrist: the wrist point.
        couplings: joints that follow another one.
        gripper: joint of a gripper's jaw; the body that carries it is the palm.

    Raises:
        HandModelError: a finger is not a human one, or is named twice.
    """

    palm: str | None = None
    thumb: str | None = None
    fingers: tuple[tuple[str, str], ...] = ()
    tips: tuple[tuple[str, Point], ...] = ()
    wrist: Point | None = None
    couplings: tuple[Coupling, ...] = ()
    gripper: str | None = None

    def __post_init__(self) -> None:
        for what, pairs in (("finger", self.fingers), ("tip", self.tips)):
            names = [name for name, _ in pairs]
            for name in names:
                if name not in FINGERS:
                    raise HandModelError(
                        f"--{what} names the finger {name!r}; expected one of {', '.join(FINGERS)}"
                    )
                if names.count(name) > 1:
                    raise HandModelError(
                        f"--{what} names {name!r} twice; set one {what} per finger"
                    )


# Distances over a finger's length:
_BESIDE: Final = 0.09  # from the knuckle up to which a joint is part of it
_APART: Final = 0.06  # least distance between two landmarks of a finger
_ACROSS: Final = 0.3  # largest cosine between a hinge across the finger and the way to the tip
_CLEAR: Final = 0.2  # from a finger's base up to which a frame is that base
_WRIST: Final = 0.95  # from wrist to knuckles of a human hand


def finger_points(
    skeleton: Skeleton, chain: Chain, bend: Bending, tip: Point, is_thumb: bool, at: Placement
) -> tuple[Point, Point | None, Point | None, Point]:
    """Points of the robot's finger that correspond to the four landmarks of a human finger.

    A joint's origin may lie anywhere on its axis. If it lies beside the finger, the landmark is the
    point of the axis that is level with the tip.

    Args:
        is_thumb: True for a thumb, whose first landmark is its first joint; that of another finger
            is its knuckle.
    """
    body = int(skeleton.model.body(tip.body).id)
    end = at.world(body, np.array(tip.offset))
    if not bend.joints:  # slides only: the start of the finger, level with the tip
        first = chain.own[0]
        start = at.anchors[first]
        offset = end - start
        start = start + offset - (offset @ bend.along) * bend.along
        return _point(skeleton, at, first, start), None, None, tip
    joints = list(bend.joints)
    knuckle = joints[0]
    base = next(
        j
        for j in chain.own
        if is_thumb
        or j == knuckle
        or np.linalg.norm(at.anchors[j] - at.anchors[knuckle]) < _BESIDE * chain.length
    )
    apart = _APART * chain.length
    where = at.anchors[base]
    if base == knuckle and not is_thumb:
        where = _level(at, base, knuckle, end, chain.length)
    points: list[tuple[int, np.ndarray]] = []
    for j in joints:
        place = _level(at, j, knuckle, end, chain.length)
        before = points[-1][1] if points else where
        if np.linalg.norm(place - before) > apart and np.linalg.norm(place - end) > apart:
            points.append((j, place))
    middle = [_point(skeleton, at, j, place) for j, place in points[-2:]]
    if len(middle) == 1:  # one rigid last link is the counterpart of two human ones
        half = (points[-1][1] + end) / 2
        middle.append(_fixed(skeleton, at, int(skeleton.model.jnt_bodyid[points[-1][0]]), half))
    first_point = _point(skeleton, at, base, where)
    mcp, pip = (middle[0], middle[1]) if middle else (None, None)
    return first_point, mcp, pip, tip


def _level(at: Placement, joint: int, knuckle: int, end: np.ndarray, length: float) -> np.ndarray:
    """A joint's origin; if that is beside the finger, the point of its axis level with the tip."""
    anchor: np.ndarray = at.anchors[joint]
    axis = at.axes[joint]
    shift = float((end - anchor) @ axis)
    # Only for a hinge across the finger: the axis of a twist runs towards the tip. The origin of a
    # short last link may be further aside than its tip is away, so the whole finger counts as well.
    slopes = [
        abs(float(way @ axis)) / max(float(np.linalg.norm(way)), 1e-9)
        for way in (end - anchor, end - at.anchors[knuckle])
    ]
    if min(slopes) < _ACROSS and 0.03 * length < abs(shift):
        anchor = anchor + shift * axis
    return anchor


def _point(skeleton: Skeleton, at: Placement, joint: int, place: np.ndarray) -> Point:
    return _fixed(skeleton, at, int(skeleton.model.jnt_bodyid[joint]), place)


def _fixed(skeleton: Skeleton, at: Placement, body: int, place: np.ndarray) -> Point:
    return skeleton.point(body, at.local(body, place))


def find_wrist(
    skeleton: Skeleton, palm: int, chains: tuple[Chain, ...], layout: Layout, at: Placement
) -> tuple[Point, float, tuple[str, ...]]:
    """Finds the wrist: a joint or frame on the palm behind the knuckles, or the palm's heel.

    Returns:
        The point, its confidence and the reasons.
    """
    others = [chains[i] for i in layout.order[1:]]
    knuckles = np.mean([c.base for c in others], axis=0)
    length = float(np.median([c.length for c in others]))

    def behind(place: np.ndarray) -> float:
        return float((knuckles - place) @ layout.forward)

    rigid = skeleton.rigid(palm) if palm else (0,)
    for body in rigid:
        for j in skeleton.joints_of(body):
            if skeleton.turns[j] and 0.2 * length < behind(at.anchors[j]) < 2 * length:
                why = f"joint {skeleton.joint_names[j]!r} moves the whole palm"
                return _fixed(skeleton, at, palm, at.anchors[j]), 0.9, (why,)
    frames = [(skeleton.body_name(b), at.bodies[b]) for b in rigid]
    frames += [
        (str(skeleton.model.site(int(s)).name), at.sites[s])
        for s in np.flatnonzero(np.isin(skeleton.model.site_bodyid, rigid))
    ]
    for name, place in frames:
        if says_wrist(name) and 0.2 * length < behind(place) < 2.5 * length:
            why = f"{name!r} fixed to the palm behind the knuckles, with a matching name"
            return _fixed(skeleton, at, palm, place), 0.85, (why,)
    expected = knuckles - _WRIST * length * layout.forward
    clouds = [at.world(b, cloud) for b in rigid for cloud in skeleton.clouds.get(b, ())]
    if clouds:
        points = np.concatenate(clouds)
        back = (knuckles - points) @ layout.forward
        heel = float(np.quantile(back, 0.995))
        if 0.4 * length < heel < 2.2 * length:
            near = points[back > heel - 0.15 * length]
            place = (near.min(axis=0) + near.max(axis=0)) / 2
            why = "the heel of the palm's shape, on the side opposite to the fingers"
            return _fixed(skeleton, at, palm, place), 0.65, (why,)
    starts = np.array([at.anchors[c.own[0]] for c in chains])
    for body in (b for b in reversed(skeleton.path(palm) or (palm,)) if b in rigid):
        origin = at.bodies[body]
        clear = float(np.linalg.norm(starts - origin, axis=1).min())
        if clear > _CLEAR * length and 0.5 * length < behind(origin) < 2.2 * length:
            what = "the palm"
            if body != palm:
                what = f"{skeleton.body_name(body)!r}, on which the palm is mounted"
            why = f"origin of {what}, about as far behind the knuckles as a human wrist"
            return _fixed(skeleton, at, palm, origin), 0.6, (why,)
    why = (
        "the model does not mark the wrist, so it is placed as far behind the knuckles as a human "
        "wrist"
    )
    return _fixed(skeleton, at, palm, expected), 0.35, (why,)


_STILL: Final = 1e-4  # travel up to which a base lies on its joints' axes, up to rounding [m]


def fix_bases(
    skeleton: Skeleton, palm: int, fingers: tuple[FingerSpec, ...], reach: Reach, neutral: Placement
) -> tuple[tuple[FingerSpec, ...], dict[str, float]]:
    """Fixes finger bases that joints move to the palm, at their positions in the neutral pose.

    A human's knuckles don't move in the palm, and the alignment uses them: if a base moved with its
    finger, spreading the fingers would turn the whole hand.

    Args:
        reach: random poses, which show the travel of each base.

    Returns:
        The fingers; and human finger -> travel of its base [m], for each base that was fixed.
    """
    bodies = [int(skeleton.model.body(finger.base.body).id) for finger in fingers]
    offsets = [np.array(finger.base.offset) for finger in fingers]

    def places(at: Placement) -> np.ndarray:
        points = [at.world(b, offset) for b, offset in zip(bodies, offsets, strict=True)]
        return at.local(palm, np.array(points))

    placed = np.array([places(skeleton.place(q)) for q in reach.poses])  # (s, f, 3)
    travel = np.linalg.norm(placed[:, None] - placed[None], axis=-1).max(axis=(0, 1))
    out, moved = [], {}
    for finger, place, path in zip(fingers, places(neutral), travel, strict=True):
        if path > _STILL:
            finger = replace(finger, points=(skeleton.point(palm, place), *finger.points[1:]))
            moved[finger.name] = float(path)
        out.append(finger)
    return tuple(out), moved


def bases_finding(moved: dict[str, float]) -> Finding:
    """Finding about the finger bases and whether joints move them.

    Args:
        moved: human finger -> travel of its base [m], as from ``fix_bases``.
    """
    why = "no joint moves them"
    if moved:
        why = (
            f"joints move the finger {'base' if len(moved) == 1 else 'bases'} of "
            f"{', '.join(moved)}, by up to {max(moved.values()) * 1e3:.0f} mm; finger bases are "
            "fixed at their positions in the neutral pose, because human knuckles don't move "
            "relative to the palm"
        )
    return Finding(
        "bases",
        "fixed to the palm",
        0.85 if moved else 0.9,
        (why,),
        "edit the first point of the finger in the spec file",
    )

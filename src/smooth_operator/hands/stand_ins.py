"""Makes capsules along a hand's bones for links whose collision shapes can't be read.

Their radius is estimated from the hand's lengths; a palm becomes parallel capsules from heel to
knuckles. Self-collision needs them: the term of ``smooth`` and the measure.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hands.collision import Capsule, lacking_parts, shape_capsules, solid_shapes
from smooth_operator.hands.hand import Hand, landmark_points
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, WRIST

LENGTH_SHARE: Final = 0.095
"""Radius of a finger over its length, base to tip. The built-in hands have 0.073 to 0.144, with a
median of 0.094."""
SPACING_SHARE: Final = 0.42
"""Largest radius of a finger over the distance of neighbouring knuckles. The built-in hands have
0.26 to 0.44."""
_THUMB: Final = 1.1  # radius of a thumb over a finger's
_PALM: Final = 1.3  # half the thickness of a palm over a finger's radius
_TIP: Final = 0.9  # distance of a tip landmark from the end of the capsule's axis, over the radius
_SHORTEST: Final = 0.003  # length of the shortest bone that gets a capsule [m]
Piece: TypeAlias = tuple[int, np.ndarray, np.ndarray]
"""A stretch of a bone: the body that carries it, and its two ends in the world [m]."""

_SAMPLES: Final = 33  # points on a bone
_LEAST: Final = 0.12  # smallest share of a bone that counts as bare
_TINY: Final = 1e-12  # [m^2]
_OVERLAP: Final = 1.5  # largest distance of a palm's parallel capsules over their radius


@dataclass(frozen=True)
class StandIns:
    """Estimated collision shapes of a hand.

    Attributes:
        capsules: the estimated capsules; their ``geom`` is -1.
        replaced: parts (see ``parts_above``) whose own shapes must not be used.
    """

    capsules: tuple[Capsule, ...] = ()
    replaced: frozenset[int] = frozenset()


def stand_in_links(hand: Hand) -> tuple[str, ...]:
    """Names of the links with estimated shapes, in the model's order; empty for most hands."""
    bodies = sorted({capsule.body for capsule in stand_ins(hand).capsules})
    return tuple(str(hand.model.body(body).name) for body in bodies)


def stand_in_note(hand: Hand) -> str:
    """Message about a hand's estimated shapes; empty if it has none."""
    links = stand_in_links(hand)
    if not links:
        return ""
    shown = ", ".join(links[:3]) + (f" and {len(links) - 3} more" if len(links) > 3 else "")
    remedy = hand.why or "add collision shapes to the model file, which has none"
    return (
        f"{hand.name}: the collision shapes of {len(links)} links ({shown}) could not be "
        "read; estimated capsules along their bones replace them, in 'smooth' and in the "
        f"self-collision metrics. To use the real shapes: {remedy}"
    )


def stand_ins(hand: Hand) -> StandIns:
    """Makes capsules for links that lost shapes and whose other shapes do not cover the bone.

    If at least half of the fingers have such a link, stand-ins replace the shapes of all finger
    links, which is better than a mix (docs/how-to/hands.md). A hand without any colliding shape
    gets stand-ins for the palm and for all links from it to a fingertip.
    """
    lacking = lacking_parts(hand)
    if not lacking:
        return StandIns()
    model, data = hand.model, mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
    mujoco.mj_kinematics(model, data)
    bones = finger_bones(hand, data)
    radius = finger_radius(hand, bones)
    part = model.body_weldid
    links = {
        finger: {int(part[body]) for bone in own for body, _, _ in bone}
        for finger, own in bones.items()
    }
    replaced = frozenset[int]()
    if 2 * sum(bool(own & lacking) for own in links.values()) >= len(links):
        replaced = frozenset().union(*links.values()) - {_palm_part(hand)}
        lacking |= replaced
    covers = _covers(hand, replaced)
    out = []
    for finger, own in bones.items():
        thick = radius * (_THUMB if finger == "thumb" else 1.0)
        for k, bone in enumerate(own):
            for body, start, end in bone:
                along = float(np.linalg.norm(end - start))
                if along < _SHORTEST or int(part[body]) not in lacking:
                    continue
                if k == len(own) - 1:
                    end = end - (end - start) * min(_TIP * thick / along, 0.9)
                segment = _uncovered(data, np.stack([start, end]), covers.get(int(part[body]), []))
                if segment is not None:
                    out.append(Capsule(-1, body, _local(data, body, segment), thick, root=k == 0))
    palm = model.body(hand.spec.palm).id
    if _palm_part(hand) in lacking:
        for row in _palm_segments(hand, data, _PALM * radius):
            segment = _uncovered(data, row, covers.get(_palm_part(hand), []))
            if segment is not None:
                out.append(Capsule(-1, palm, _local(data, palm, segment), _PALM * radius))
    return StandIns(tuple(out), replaced)


def _palm_part(hand: Hand) -> int:
    return int(hand.model.body_weldid[hand.model.body(hand.spec.palm).id])


def _covers(hand: Hand, replaced: frozenset[int]) -> dict[int, list[Capsule]]:
    """Part -> its own shapes that stay in use, as capsules."""
    out: dict[int, list[Capsule]] = defaultdict(list)
    for geom in np.flatnonzero(solid_shapes(hand)):
        part = int(hand.model.body_weldid[hand.model.geom_bodyid[geom]])
        if part not in replaced:
            out[part] += shape_capsules(hand.model, int(geom))
    return out


def _uncovered(
    data: mujoco.MjData, segment: Float[np.ndarray, "2 3"], covers: list[Capsule]
) -> Float[np.ndarray, "2 3"] | None:
    """Stretch of a segment outside all capsules; None if its share is below ``_LEAST``."""
    share = np.linspace(0, 1, _SAMPLES)
    points = segment[0] + share[:, None] * (segment[1] - segment[0])
    bare = np.ones(_SAMPLES, bool)
    for capsule in covers:
        turn, at = data.xmat[capsule.body].reshape(3, 3), data.xpos[capsule.body]
        start, end = capsule.ends @ turn.T + at
        axis = end - start
        along = np.clip((points - start) @ axis / max(float(axis @ axis), _TINY), 0, 1)
        distance = np.linalg.norm(points - start - along[:, None] * axis, axis=1)
        bare &= distance > capsule.radius
    if bare.mean() < _LEAST:
        return None
    first, last = np.flatnonzero(bare)[[0, -1]]
    stretch: np.ndarray = points[[first, last]]
    return stretch


def finger_bones(hand: Hand, data: mujoco.MjData) -> dict[str, list[list[Piece]]]:
    """Maps each finger to its bones, from base to tip, in the world frame and the pose of ``data``
    [m]. Each bone is cut into one piece per body that carries a part of it. Bones run between
    landmarks, or between joint origins in a finger that has no landmarks between base and tip."""
    placed = landmark_points(hand.model, hand.spec)
    out = {}
    for finger in hand.spec.fingers:
        first = BASES[FINGERS.index(finger.name)]
        names = [LANDMARKS[first + i] for i in range(4)]
        points = [
            (body, data.xpos[body] + data.xmat[body].reshape(3, 3) @ local)
            for body, local in (placed[name] for name in names if name in placed)
        ]
        if len(points) == 2:
            points[1:1] = _joint_origins(hand, data, points[1][0])
        out[finger.name] = [_pieces(hand, data, *ends) for ends in pairwise(points)]
    return out


def _pieces(
    hand: Hand, data: mujoco.MjData, before: tuple[int, np.ndarray], after: tuple[int, np.ndarray]
) -> list[Piece]:
    """Pieces of a bone between two landmarks, cut at the joints between them. A landmark lies on
    the axis of the joint that moves its body, so the bone before it ends with the link above."""
    model, (start, end) = hand.model, (before[1], after[1])
    part = [int(p) for p in model.body_weldid]
    first, last = part[before[0]], part[after[0]]
    if first == last:
        return [(after[0], start, end)]
    carriers: list[int] = []
    body = part[model.body_parentid[last]]
    while body not in (0, _palm_part(hand)):
        carriers.insert(0, body)
        if body == first:
            break
        body = part[model.body_parentid[body]]
    if not carriers:
        return [(int(model.body_parentid[last]), start, end)]
    along, at = end - start, [0.0]
    for body in carriers[1:]:
        anchor = data.xanchor[model.body_jntadr[body]]
        share = float((anchor - start) @ along) / max(float(along @ along), _TINY)
        at.append(float(np.clip(share, at[-1], 1.0)))
    return [
        (body, start + a * along, start + b * along)
        for body, a, b in zip(carriers, at, [*at[1:], 1.0], strict=True)
    ]


def _joint_origins(hand: Hand, data: mujoco.MjData, tip: int) -> list[tuple[int, np.ndarray]]:
    """Body and origin of the joints from palm to tip, without the first."""
    model, palm = hand.model, hand.model.body(hand.spec.palm).id
    origins, body = [], tip
    while body not in (palm, 0):
        if model.body_jntnum[body]:
            origins.append((int(body), np.array(data.xanchor[model.body_jntadr[body]])))
        body = int(model.body_parentid[body])
    return origins[::-1][1:]


def finger_radius(hand: Hand, bones: dict[str, list[list[Piece]]]) -> float:
    """Radius of the long fingers [m]."""
    long = [own for finger, own in bones.items() if finger != "thumb"]
    lengths = [
        sum(float(np.linalg.norm(end - start)) for bone in own for _, start, end in bone)
        for own in long
    ]
    radius = LENGTH_SHARE * float(np.median(lengths))
    knuckles = [own[0][0][1] for own in long]
    gaps = [float(np.linalg.norm(a - b)) for a, b in pairwise(knuckles)]
    return min([radius, *(SPACING_SHARE * gap for gap in gaps if gap > _SHORTEST)])


def _palm_segments(
    hand: Hand, data: mujoco.MjData, radius: float
) -> list[Float[np.ndarray, "2 3"]]:
    """Parallel segments from the heel of the palm to its knuckles, in the world [m]."""
    placed = landmark_points(hand.model, hand.spec)

    def world(name: str) -> np.ndarray:
        body, local = placed[name]
        at: np.ndarray = data.xpos[body] + data.xmat[body].reshape(3, 3) @ local
        return at

    wrist = world(LANDMARKS[WRIST])
    knuckles = [world(LANDMARKS[BASES[FINGERS.index(f)]]) for f in hand.fingers[1:]]
    rows = [knuckles[0]]
    for a, b in pairwise(knuckles):
        steps = max(1, int(np.ceil(np.linalg.norm(b - a) / (_OVERLAP * radius))))
        rows += [a + (b - a) * k / steps for k in range(1, steps + 1)]
    back = wrist - np.mean(knuckles, axis=0)
    length = float(np.linalg.norm(back))
    if length < 2 * radius:
        return []
    unit = back / length
    # The rounded ends must not reach into the fingers' first links or beyond the wrist.
    return [
        np.stack([row + unit * radius, row + unit * max(length - radius, radius)]) for row in rows
    ]


def _local(
    data: mujoco.MjData, body: int, points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    local: np.ndarray = (points - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
    return local

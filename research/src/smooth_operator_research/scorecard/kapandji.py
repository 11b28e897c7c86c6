"""Kapandji's test of a thumb: which places of the hand can the tip of the thumb touch?

Source: A. Kapandji, "Cotation clinique de l'opposition et de la contre-opposition du pouce",
Annales de Chirurgie de la Main 5(1), 1986. The clinical form has ten stages; here, the side of the
index finger counts as three places, as in tests of robot hands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.collision import PALM, owners
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS
from smooth_operator.retargeting.palm import human_palm_axes, unit_vectors
from smooth_operator_research.scorecard.link_surfaces import PosedBodies, SurfacePoints
from smooth_operator_research.scorecard.pose_search import (
    TIP,
    best_pose,
    excess_overlap,
    finger_tip,
    straight_surface,
)

PLACES: Final = (
    "side of the index's proximal phalanx",
    "side of the index's middle phalanx",
    "side of the index's distal phalanx",
    "tip of the index",
    "tip of the middle finger",
    "tip of the ring finger",
    "tip of the little finger",
    "DIP crease of the little finger",
    "PIP crease of the little finger",
    "MCP crease of the little finger",
    "distal crease of the palm",
)
"""Kapandji's places by stage, 0 to 10. On a hand without a little finger, the last finger takes its
part in stages 7 to 10."""
TOUCHED: Final = 0.002
"""Largest distance of the thumb's surface from a place that it touches [m]."""
PATCH: Final = 0.005
"""Radius of a place [m]."""
_AROUND: Final = 0.003  # distance from a ray at which the surface is sought [m]
_STARTS: Final = 6
_FACING: Final = -0.2  # largest cosine between the normals of two surfaces that touch


class Place(NamedTuple):
    """A place that the thumb has to touch.

    Attributes:
        stage: Kapandji's stage, 0 to 10.
        finger: name of the finger that carries it.
        surface: the one point, with its outward normal.
    """

    stage: int
    finger: str
    surface: SurfacePoints


@dataclass(frozen=True)
class Touch:
    """Attempt of the thumb to touch a place.

    Attributes:
        stage: Kapandji's stage, 0 to 10.
        distance: distance of the thumb's tip from the place in the best pose [m], and ten times
            the overlap of parts beyond what is allowed, which such a pose seldom has.
        pose: (m,) that pose of the actuated joints [rad].
        point: (3,) the place in that pose, in the palm frame [m].
        normal: (3,) its outward normal.
    """

    stage: int
    distance: float
    pose: Float[np.ndarray, " m"]
    point: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]

    @property
    def touched(self) -> bool:
        """True if the thumb touches the place."""
        return self.distance <= TOUCHED


def kapandji_touches(
    hand: Hand, track: Callable[[list[Place]], Iterable[Place]] = iter
) -> tuple[list[Touch], list[Touch]]:
    """For each place of the test, the pose in which the thumb comes nearest.

    All poses are within the joint limits and keep the couplings. The tip of the thumb touches if
    its surface is within ``TOUCHED`` of the place and faces it, and no other two parts overlap by
    more than ``OVERLAP``. The same hand gives the same result in each run.

    Args:
        hand: a hand with a thumb; not a gripper.
        track: wraps the iteration over places, for a progress bar.

    Returns:
        the touches while the touched finger bends too, and those with all fingers straight.
    """
    free, straight = list[Touch](), list[Touch]()
    for place in track(kapandji_places(hand)):
        stiff = _best_touch(hand, place, straight=True)
        bent = stiff if stiff.touched else _best_touch(hand, place, straight=False)
        straight.append(stiff)
        free.append(min(stiff, bent, key=lambda touch: touch.distance))
    return free, straight


def highest_stage(touches: Sequence[Touch]) -> int | None:
    """Highest stage up to which the thumb touches every place that the hand has; None if it misses
    the first one."""
    stage = None
    for touch in touches:
        if not touch.touched:
            break
        stage = touch.stage
    return stage


def kapandji_places(hand: Hand) -> list[Place]:
    """The places of a hand, on the surfaces of its links."""
    q, last = hand.straight_pose.q, hand.fingers[-1]
    surface, points, normals, of = straight_surface(hand)
    axes = human_palm_axes(hand)
    marks = dict(zip(hand.tree.names, hand.landmark_positions(q), strict=True))

    def place(stage: int, finger: str, at: np.ndarray, way: np.ndarray, palm: bool) -> Place:
        own = of == FINGERS.index(finger)
        if palm:
            own |= of == PALM
        off = points - at
        along = off @ way
        aside = np.linalg.norm(off - along[:, None] * way, axis=1)
        aside = np.where(own & (normals @ way > 0.3), aside, np.inf)
        near = aside <= max(float(aside.min()), _AROUND)
        nearest = int(np.argmax(np.where(near, along, -np.inf)))
        return Place(stage, finger, surface.only(np.array([nearest])))

    def joint(finger: str, k: int) -> np.ndarray:
        return np.asarray(marks[LANDMARKS[BASES[FINGERS.index(finger)] + k]])

    places = []
    for k in range(3):
        start, end = joint("index", k), joint("index", k + 1)
        bone = unit_vectors(end - start, np)
        side = unit_vectors(axes.radial - bone * (bone @ axes.radial), np)
        places.append(place(k, "index", (start + end) / 2, side, False))
    for finger in hand.fingers[1:]:
        tip = joint(finger, 3)
        way = unit_vectors(unit_vectors(tip - joint(finger, 2), np) + axes.palmar, np)
        places.append(place(2 + FINGERS.index(finger), finger, tip, way, False))
    for stage, k in ((7, 2), (8, 1), (9, 0)):
        places.append(place(stage, last, joint(last, k), axes.palmar, k == 0))
    crease = joint(last, 0) + 0.2 * (hand.wrist - joint(last, 0))
    return [*places, place(10, last, crease, axes.palmar, True)]


def _best_touch(hand: Hand, place: Place, straight: bool) -> Touch:
    """The pose in which the thumb comes nearest to a place."""
    moving = ["thumb"] if straight or place.stage == 10 else ["thumb", place.finger]
    tip, part = finger_tip(hand, "thumb"), hand.model.body_weldid
    posed = PosedBodies(hand, [*tip.bodies, *place.surface.bodies])
    touched = FINGERS.index(place.finger), owners(hand)[place.surface.bodies[0]]
    near = {int(part[b]) for b in np.flatnonzero(np.isin(owners(hand), touched))}
    touching = [(int(part[tip.bodies[0]]), other) for other in near]

    def distance(q: Float[np.ndarray, "T m"]) -> Float[np.ndarray, " T"]:
        every = hand.full_configuration(q)
        points, normals = posed(every, tip)
        at, out = posed(every, place.surface)
        off = points - at
        height = (off * out).sum(axis=-1)
        aside = np.linalg.norm(off - height[..., None] * out, axis=-1)
        away = np.hypot(height, np.maximum(aside - PATCH, 0.0))
        facing = np.maximum((normals * out).sum(axis=-1) - _FACING, 0.0)
        return np.asarray((away + TIP * facing).min(axis=1))

    overlap = excess_overlap(hand, moving, touching, TOUCHED)
    pose, cost = best_pose(hand, moving, distance, overlap, TOUCHED / 2, _STARTS)
    point, normal = posed(hand.full_configuration(pose)[None], place.surface)
    return Touch(place.stage, cost, pose, point[0, 0], normal[0, 0])

"""Smallest and largest object that a hand can hold in a pinch, a tripod and a power grasp.

The object is a ball, in a power grasp a cylinder across the palm. It touches two opposed surfaces:
the thumb's tip and the tips of one or two fingers, or the palm and the tips of two fingers. The
contact normals are within ``ANTIPODAL`` of the line through the object's centre; two fingers act
as one (the virtual finger of Arbib, Iberall and Lyons, "Coordinated Control Programs for Movements
of the Hand", Experimental Brain Research Supplement 10, 1985).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.capsules import parts_apart, segments_apart
from smooth_operator.hands.collision import PALM
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.palm import human_palm_axes, unit_vectors
from smooth_operator_research.scorecard.link_surfaces import PosedBodies, SurfacePoints
from smooth_operator_research.scorecard.pose_search import (
    OVERLAP,
    TIP,
    best_pose,
    excess_overlap,
    finger_tip,
    straight_surface,
)

ANTIPODAL: Final = np.deg2rad(20.0)
"""Largest angle between a contact's normal and the line through the object [rad]."""
_ROUGH: Final = 0.001  # error of a contact, from the spacing of points [m]
_UNEQUAL: Final = 0.0015  # largest difference of two fingers' distances from the centre [m]
_HELD: Final = 0.0005  # largest violation of all conditions together in a grasp [m]
_LARGE: Final = 0.3  # size of no object that a hand can hold [m]
_STEPS: Final = 3
_LONG: Final = 0.1  # half a cylinder's length [m]


class Grasp(NamedTuple):
    """A grasp: two opposed groups of surfaces.

    Attributes:
        moving: fingers that move.
        first: points on the one surface.
        others: points on each of the opposed fingers.
        axis: (3,) axis of the cylinder in the palm frame; zero for a ball.
    """

    moving: Sequence[str]
    first: SurfacePoints
    others: Sequence[SurfacePoints]
    axis: Float[np.ndarray, "3"]


def pinch(hand: Hand, *fingers: str) -> Grasp:
    """Thumb against one finger (a pinch) or two (a tripod)."""
    thumb, *others = (finger_tip(hand, name) for name in ("thumb", *fingers))
    return Grasp(("thumb", *fingers), thumb, others, np.zeros(3))


def power(hand: Hand, *fingers: str) -> Grasp:
    """A cylinder in the palm, under fingers."""
    every, axes = straight_surface(hand), human_palm_axes(hand)
    knuckles = hand.landmark_positions(hand.straight_pose.q) @ axes.distal
    heights = every.points @ axes.distal
    inner = (every.owners == PALM) & (every.normals @ axes.palmar > np.cos(np.pi / 4))
    inner &= (heights > hand.wrist @ axes.distal) & (heights < knuckles.max())
    others = [finger_tip(hand, name) for name in fingers]
    return Grasp(fingers, every.surface.only(np.flatnonzero(inner)[::5]), others, axes.radial)


def object_size(hand: Hand, grasp: Grasp, *, largest: bool) -> float | None:
    """Diameter of the smallest or largest object of a grasp [m]; None if the hand can't hold any.

    The poses are within the limits and without collisions of the hand's parts with each other and
    with the object; 0 if the surfaces touch. The same hand gives the same result in each run.
    """
    part = hand.model.body_weldid
    ends = [int(part[s.bodies[0]]) for s in grasp.others]
    first = {int(p) for p in part[grasp.first.bodies]}
    held = _held(hand, grasp, first | set(ends))
    sign = -1.0 if largest else 1.0

    def cost(q: Float[np.ndarray, "T m"]) -> Float[np.ndarray, " T"]:
        size, fault = held(q)
        return np.asarray(sign * size + _LARGE * largest + 40 * fault)

    touching = [(a, b) for a in first for b in ends]
    overlap = excess_overlap(hand, grasp.moving, touching, 2 * OVERLAP)
    pose, _ = best_pose(hand, grasp.moving, cost, overlap, 0.0 if largest else OVERLAP)
    (size,), (fault,) = held(pose[None])
    if fault + overlap(pose[None])[0] > _HELD:
        return None
    return float(size) if size > OVERLAP else 0.0


_Holding = Callable[[Float[np.ndarray, "T m"]], tuple[np.ndarray, np.ndarray]]


def _held(hand: Hand, grasp: Grasp, ends: set[int]) -> _Holding:
    """Function of poses: diameter of the object, and violation of the conditions of a grasp [m]."""
    pads = [grasp.first, *grasp.others]
    posed = PosedBodies(hand, [int(b) for pad in pads for b in pad.bodies])
    flat = np.eye(3) - np.outer(grasp.axis, grasp.axis)
    every, part = parts_apart(hand), hand.model.body_weldid
    own = np.array([int(part[c.body]) in ends for c in every.capsules])
    at = np.array([every.tree.names.index(name) for name in every.names])
    at = at.reshape(-1, 2)[~own]
    radii = np.array([c.radius for c in every.capsules])[~own]

    def held(q: Float[np.ndarray, "T m"]) -> tuple[np.ndarray, np.ndarray]:
        full = hand.full_configuration(q)
        points, normals = zip(*((p, n) for p, n in (posed(full, pad) for pad in pads)), strict=True)
        middle = (points[0].mean(axis=1) + np.mean([p.mean(axis=1) for p in points[1:]], 0)) / 2
        for _ in range(_STEPS):
            touch = [_nearest(p, n, middle, flat) for p, n in zip(points, normals, strict=True)]
            (a, _), *others = touch
            way = unit_vectors((np.mean([b for b, _ in others], axis=0) - a) @ flat, np)
            reach = [(b - a) @ flat for b, _ in others]
            each = np.stack(
                [(d * d).sum(-1) / np.maximum(2 * (d * way).sum(-1), 1e-6) for d in reach]
            )
            radius = np.minimum(each.mean(axis=0), _LARGE)
            middle = a + way * radius[:, None]
        fault = np.maximum(np.ptp(each, axis=0) - _UNEQUAL, 0.0)
        for x, n in touch:
            lean = radius * np.cos(ANTIPODAL) - (n * ((middle - x) @ flat)).sum(-1)
            fault = fault + np.maximum(lean - _ROUGH, 0.0)
        facing = np.mean([(touch[0][1] * n).sum(-1) for _, n in others], axis=0)
        fault = fault + TIP * np.maximum(facing + np.cos(2 * ANTIPODAL), 0.0)
        links = np.asarray(every.tree.positions(full))[:, at]
        object_ = middle[:, None] + _LONG * np.outer((-1, 1), grasp.axis)[:, None, None]
        apart, _, _ = segments_apart((links[:, :, 0], links[:, :, 1]), (object_[0], object_[1]))
        room = (np.linalg.norm(apart, axis=-1) - radii).min(axis=1)
        return 2 * radius, fault + np.maximum(radius - OVERLAP - room, 0.0)

    return held


def _nearest(
    points: Float[np.ndarray, "T N 3"],
    normals: Float[np.ndarray, "T N 3"],
    middle: Float[np.ndarray, "T 3"],
    flat: Float[np.ndarray, "3 3"],
) -> tuple[Float[np.ndarray, "T 3"], Float[np.ndarray, "T 3"]]:
    """The point of a surface that is nearest to an object's centre, and its normal."""
    off = (points - middle[:, None]) @ flat
    rows, best = np.arange(len(points)), (off * off).sum(-1).argmin(axis=1)
    return points[rows, best], normals[rows, best]

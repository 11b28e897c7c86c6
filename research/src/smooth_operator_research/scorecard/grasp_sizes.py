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
_TOLERANCE: Final = 0.0005  # largest violation of all conditions together in a grasp [m]
_LARGE: Final = 0.3  # size of no object that a hand can hold [m]
_STEPS: Final = 3  # of the object's centre toward the middle of its contacts
_STARTS: Final = 8
_WEIGHT: Final = 40.0  # cost of a violation, over the size
_TINY: Final = 1e-6  # [m]
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
    ends = [int(part[surface.bodies[0]]) for surface in grasp.others]
    first = {int(body) for body in part[grasp.first.bodies]}
    fit = _fit(hand, grasp, first | set(ends))
    sign = -1.0 if largest else 1.0

    def cost(q: Float[np.ndarray, "T m"]) -> Float[np.ndarray, " T"]:
        size, fault = fit(q)
        return np.asarray(sign * size + _LARGE * largest + _WEIGHT * fault)

    touching = [(a, b) for a in first for b in ends]
    overlap = excess_overlap(hand, grasp.moving, touching, 2 * OVERLAP)
    pose, _ = best_pose(hand, grasp.moving, cost, overlap, 0.0 if largest else OVERLAP, _STARTS)
    (size,), (fault,) = fit(pose[None])
    if fault + overlap(pose[None])[0] > _TOLERANCE:
        return None
    return float(size) if size > OVERLAP else 0.0


_Fit = Callable[[Float[np.ndarray, "T m"]], tuple[np.ndarray, np.ndarray]]


def _fit(hand: Hand, grasp: Grasp, ends: set[int]) -> _Fit:
    """Function of (T, m) poses [rad]: (T,) diameter of the object between the surfaces [m], and
    (T,) violation of the conditions of a grasp [m].

    Args:
        ends: parts that touch the object.
    """
    pads = [grasp.first, *grasp.others]
    posed = PosedBodies(hand, [int(body) for pad in pads for body in pad.bodies])
    flat = np.eye(3) - np.outer(grasp.axis, grasp.axis)  # a cylinder is a circle across its axis
    every, part = parts_apart(hand), hand.model.body_weldid
    obstacles = np.array([int(part[capsule.body]) not in ends for capsule in every.capsules])
    at = np.array([every.tree.names.index(name) for name in every.names]).reshape(-1, 2)[obstacles]
    radii = np.array([capsule.radius for capsule in every.capsules])[obstacles]

    def fit(q: Float[np.ndarray, "T m"]) -> tuple[np.ndarray, np.ndarray]:
        joints = hand.full_configuration(q)
        surfaces = [posed(joints, pad) for pad in pads]
        centres = [points.mean(axis=1) for points, _ in surfaces]
        middle = (centres[0] + np.mean(centres[1:], axis=0)) / 2
        for _ in range(_STEPS):
            contacts = [_nearest(*surface, middle, flat) for surface in surfaces]
            (start, first_normal), *others = contacts
            reach = np.stack([(point - start) @ flat for point, _ in others])
            way = unit_vectors(reach.mean(axis=0), np)
            # radius of the circle through both contacts whose centre is on the way
            each = (reach**2).sum(-1) / np.maximum(2 * (reach * way).sum(-1), _TINY)
            radius = np.minimum(each.mean(axis=0), _LARGE)
            middle = start + way * radius[:, None]
        fault = np.maximum(np.ptp(each, axis=0) - _UNEQUAL, 0.0)
        for point, normal in contacts:
            inward = (normal * ((middle - point) @ flat)).sum(-1)
            fault = fault + np.maximum(radius * np.cos(ANTIPODAL) - inward - _ROUGH, 0.0)
        facing = np.mean([(first_normal * normal).sum(-1) for _, normal in others], axis=0)
        fault = fault + TIP * np.maximum(facing + np.cos(2 * ANTIPODAL), 0.0)
        links = np.asarray(every.tree.positions(joints))[:, at]
        ends_of_axis = middle[:, None] + _LONG * np.outer((-1, 1), grasp.axis)[:, None, None]
        between, _, _ = segments_apart(
            (links[:, :, 0], links[:, :, 1]), (ends_of_axis[0], ends_of_axis[1])
        )
        room = (np.linalg.norm(between, axis=-1) - radii).min(axis=1)
        return 2 * radius, fault + np.maximum(radius - OVERLAP - room, 0.0)

    return fit


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

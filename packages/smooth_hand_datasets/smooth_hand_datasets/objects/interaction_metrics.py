"""Metrics of hands at objects: which contacts are kept, and how deep the hand is in an object.

A fingertip, human or robot, is in contact where its surface is within ``CONTACT_M`` of the
object's; a fingertip that is deeper inside than that is not. Pairs of frame and finger are counted.
*Precision* is the share of the robot's contacts that the human also has, *recall* the share of the
human's contacts that the robot also has. The *contact error* is the distance between the robot's
fingertip and the object where the human has contact: the contact precision error of TopoRetarget
(arXiv 2606.16272, Eq. 10) for fingertips. Penetration is the depth of the deepest of the points of
the hand's surface, ``SPACING_M`` apart (its Eq. 12).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from smooth_hand_datasets.objects.contacts import Contacts, Scene
from smooth_hand_datasets.objects.hand_surface import Fixed, HandSurface
from smooth_hand_datasets.objects.placement import apply
from smooth_hand_datasets.objects.signed_distance import FAR_M, Grid, Solid, signed_distance
from smooth_operator import poses
from smooth_operator.landmarks import FINGERS

CONTACT_M: Final = 0.005
"""Clearance within which a fingertip is in contact [m]."""

_CHUNK: Final = 32  # frames measured together
_NEAR_M: Final = 0.03
"""Distance from the objects beyond which a body's spheres need no measurement [m]."""
_SURE_M: Final = 0.004
"""Distance, by a mesh's grid, beyond which points outside are not measured exactly [m]."""


class Depths(NamedTuple):
    """Depths of a robot hand's surface in objects.

    Attributes:
        deepest: (T,) depth of the surface's deepest point inside an object [m]; 0 where no point is
            inside, NaN where no object or no palm is known.
        clearance: (T, F) clearance between each fingertip and the nearest object [m], negative
            inside.
        place: (T, F, 3) the point of the fingertip that is nearest to the object, in the world [m].
    """

    deepest: Float[np.ndarray, " T"]
    clearance: Float[np.ndarray, "T F"]
    place: Float[np.ndarray, "T F 3"]


def hand_depths(
    surface: HandSurface,
    joint_positions: Float[np.ndarray, "T n"],
    T_world_palm: Float[np.ndarray, "T 7"],
    scene: Scene,
) -> Depths:
    """Measures a hand against objects, by points of its surface and the objects' exact shapes.

    Args:
        surface: surface of the robot hand.
        joint_positions: (T, n) of all joints [rad].
        T_world_palm: (T, 7) its palm.
        scene: the objects.
    """
    points, count = surface.surface, len(joint_positions)
    tips = surface.fingertips(points)
    deepest = np.full(count, np.nan)
    clearance = np.full((count, len(tips)), np.nan)
    place = np.full((count, len(tips), 3), np.nan)
    frames = surface.frames(joint_positions)
    tip_points = np.isin(np.arange(len(points.body)), np.concatenate(tips))
    for start in range(0, count, _CHUNK):
        part = slice(start, min(start + _CHUNK, count))
        rough = _least(surface.spheres, frames[part], T_world_palm[part], scene, part, exact=False)
        near = (rough - surface.spheres.radius < _NEAR_M).any(axis=0)
        chosen_points = np.isin(points.body, surface.spheres.body[near]) | tip_points
        least = np.full((len(rough), len(points.body)), FAR_M)
        some = points.of(chosen_points)
        least[:, chosen_points] = _least(some, frames[part], T_world_palm[part], scene, part)
        finite = np.isfinite(least).all(axis=1)
        deepest[part] = np.where(finite, np.maximum(-least.min(axis=1), 0.0), np.nan)
        for f, chosen in enumerate(tips):
            world = apply(T_world_palm[part], points.of(chosen).at(frames[part]))
            nearest = least[:, chosen].argmin(axis=1)
            row = np.arange(len(nearest))
            clearance[part, f] = np.where(finite, least[row, chosen[nearest]], np.nan)
            place[part, f] = np.where(finite[:, None], world[row, nearest], np.nan)
    return Depths(deepest, clearance, place)


def _least(
    points: Fixed,
    frames: Float[np.ndarray, "t B 4 3"],
    T_world_palm: Float[np.ndarray, "t 7"],
    scene: Scene,
    part: slice,
    exact: bool = True,
) -> Float[np.ndarray, "t K"]:
    """Signed distance of points of the hand from the nearest object [m]; infinite if unknown."""
    world = apply(T_world_palm, points.at(frames))
    least = np.full(world.shape[:2], np.inf)
    for solid, track in zip(scene.solids, scene.T_world_object, strict=True):
        local = apply(poses.invert(track[part]), world)
        finite = np.isfinite(local).all(axis=-1)
        distance = np.full(finite.shape, np.inf)
        near = local[finite]
        distance[finite] = _distances(solid, near) if exact else signed_distance(solid.shape, near)
        least = np.minimum(least, distance)
    return least


def _distances(solid: Solid, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Distances that are exact near the surface; far outside, those of the grid."""
    if not isinstance(solid.shape, Grid):
        return solid.distance(points)
    rough = np.asarray(signed_distance(solid.shape, points))
    near = rough < _SURE_M + CONTACT_M + 2 * float(np.max(solid.shape.step))
    rough[near] = solid.distance(points[near])
    return rough


def touching(clearance: Float[np.ndarray, "T F"]) -> Bool[np.ndarray, "T F"]:
    """Mask of fingertips that are in contact by ``CONTACT_M``; False where the clearance is NaN."""
    return np.asarray(np.abs(clearance) <= CONTACT_M)


def interaction_tracks(
    surface: HandSurface,
    joint_positions: Float[np.ndarray, "T n"],
    T_world_palm: Float[np.ndarray, "T 7"],
    scene: Scene,
    contacts: Contacts,
) -> dict[str, Float[np.ndarray, " T"]]:
    """Measures the contacts and depth of one hand at the objects of a clip, frame by frame.

    Args:
        surface: surface of the robot hand.
        joint_positions: (T, n) of all joints [rad].
        T_world_palm: (T, 7) its palm.
        scene: the objects.
        contacts: the human's contacts, of which the clearances are used.

    Returns:
        ``human_contacts``, ``robot_contacts`` and ``shared_contacts``, numbers of fingertips;
        ``contact_error`` and ``contact_place`` [m], sums over the human's contacts of the robot
        fingertip's distance from the object and from the point that the human touches;
        ``object_depth`` [m], the depth of the hand's deepest point, NaN where unknown.
    """
    measured = hand_depths(surface, joint_positions, T_world_palm, scene)
    rows = [FINGERS.index(finger) for finger in surface.hand.fingers]
    usable = np.isfinite(measured.clearance) & np.isfinite(contacts.clearance[:, rows])
    human = touching(contacts.clearance[:, rows]) & usable
    robot = touching(measured.clearance) & usable
    which, local = contacts.which[:, rows], contacts.place[:, rows]
    track = np.moveaxis(scene.T_world_object, 0, 1)[np.arange(len(which))[:, None], which]
    there = poses.rotate(track[..., 3:], local) + track[..., :3]
    off = np.linalg.norm(measured.place - there, axis=-1)
    return {
        "human_contacts": human.sum(axis=1).astype(np.float64),
        "robot_contacts": robot.sum(axis=1).astype(np.float64),
        "shared_contacts": (human & robot).sum(axis=1).astype(np.float64),
        "contact_error": np.where(human, np.abs(measured.clearance), 0.0).sum(axis=1),
        "contact_place": np.where(human, off, 0.0).sum(axis=1),
        "object_depth": measured.deepest,
    }


def interaction_figures(tracks: Mapping[str, Float[np.ndarray, " T"]]) -> dict[str, float]:
    """Computes metrics of one hand over frames of a clip; NaN for an unknown metric.

    Args:
        tracks: result of ``interaction_tracks``, whole or a part.

    Returns:
        ``contact_precision``, ``contact_recall``, ``contact_f1``; ``contact_error_mm``, the mean
        distance of the robot's fingertip from the object where the human has contact;
        ``contact_place_mm``, its mean distance there from the point that the human touches;
        ``penetration_max_mm`` and ``penetration_mean_mm``, the maximum and the mean over the
        frames of the deepest point; ``contacts``, the number of the human's contacts.
    """
    names = ("shared_contacts", "robot_contacts", "human_contacts")
    shared, robot, human = (int(tracks[name].sum()) for name in names)
    deep = tracks["object_depth"][np.isfinite(tracks["object_depth"])]

    def share(part: float, whole: float) -> float:
        return part / whole if whole else float("nan")

    return {
        "contact_precision": share(shared, robot),
        "contact_recall": share(shared, human),
        "contact_f1": share(2 * shared, robot + human),
        "contact_error_mm": share(1e3 * float(tracks["contact_error"].sum()), human),
        "contact_place_mm": share(1e3 * float(tracks["contact_place"].sum()), human),
        "penetration_max_mm": 1e3 * float(deep.max()) if len(deep) else float("nan"),
        "penetration_mean_mm": share(1e3 * float(deep.sum()), len(deep)),
        "contacts": float(human),
    }

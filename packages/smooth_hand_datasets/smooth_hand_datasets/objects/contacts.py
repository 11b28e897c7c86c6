"""Finds contacts of human fingertips with objects, frame by frame.

A fingertip is modelled as a sphere, the pad, that ends at the tip landmark: its centre is one
radius before the landmark along the last bone. Its clearance is the signed distance of the centre
from the object, minus the radius. A contact begins where the clearance falls below one threshold
and ends where it rises above another; short contacts and short interruptions do not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_hand_datasets.objects.placement import apply, landmarks_in_world
from smooth_hand_datasets.objects.signed_distance import FAR_M, Solid, read_solid
from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import Clip, ObjectTrack
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.settings import check_numbers
from smooth_operator.types import Side

_DISTAL: Final = tuple(tip - 1 for tip in TIPS)


@dataclass(frozen=True)
class ContactSettings:
    """Thresholds that decide when a human fingertip touches an object.

    Attributes:
        pad_radius: radius of the sphere that stands for a fingertip [m].
        begin: clearance below which a contact begins [m].
        end: clearance above which it ends [m].
        shortest: duration below which contacts and interruptions do not count [s].
    """

    pad_radius: float = 0.0075
    begin: float = 0.004
    end: float = 0.007
    shortest: float = 0.06

    def __post_init__(self) -> None:
        check_numbers(self, "contacts.", positive=("pad_radius",), not_negative=("shortest",))
        check_numbers(self, "contacts.", positive=("end",), not_negative=())


DEFAULT: Final = ContactSettings()
"""Thresholds for a tracker with an accuracy of a few millimetres."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The objects of a clip whose shape is known.

    Attributes:
        names: names of the O objects.
        solids: their shapes.
        T_world_object: (O, T, 7) their poses, NaN where unknown.
    """

    names: tuple[str, ...]
    solids: tuple[Solid, ...]
    T_world_object: Float[np.ndarray, "O T 7"]

    def __len__(self) -> int:
        """Number of objects."""
        return len(self.solids)


def clip_scene(clip: Clip, solids: dict[str, Solid] | None = None) -> Scene:
    """Collects the objects of a clip whose shapes are known.

    Args:
        clip: clip with objects.
        solids: object's name -> shape, used in place of its mesh.

    Raises:
        RecordingError: no object has a shape, or a mesh can't be read.
    """
    solids = solids or {}
    tracks: list[tuple[ObjectTrack, Solid]] = []
    for track in clip.objects:
        if track.name in solids:
            tracks.append((track, solids[track.name]))
        elif track.mesh is not None:
            tracks.append((track, read_solid(track.mesh, track.scale)))
    if not tracks:
        raise RecordingError(
            f"{clip.name}: no object has a mesh, so there is nothing to touch: retarget it without "
            "objects, or name the folder of the meshes"
        )
    return Scene(
        tuple(track.name for track, _ in tracks),
        tuple(solid for _, solid in tracks),
        np.stack([track.T_world_object for track, _ in tracks]),
    )


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of fingertips with objects; fingers in the order of ``FINGERS``, F of them.

    Attributes:
        clearance: (T, F) clearance between a fingertip and the nearest object [m], negative inside;
            NaN where either is unknown.
        touching: (T, F) whether there is a contact.
        which: (T, F) index of the nearest object.
        place: (T, F, 3) the object's point nearest to the fingertip, in the object's frame [m].
        normal: (T, F, 3) the outward normal at that point.
    """

    clearance: Float[np.ndarray, "T F"]
    touching: Bool[np.ndarray, "T F"]
    which: Int[np.ndarray, "T F"]
    place: Float[np.ndarray, "T F 3"]
    normal: Float[np.ndarray, "T F 3"]


def pad_centres(
    landmarks: Float[np.ndarray, "T 21 3"], radius: float
) -> Float[np.ndarray, "T 5 3"]:
    """Centres of the spheres that stand for the fingertips [m].

    Args:
        landmarks: (T, 21, 3) [m].
        radius: radius of the spheres [m].
    """
    tips, before = landmarks[:, list(TIPS)], landmarks[:, list(_DISTAL)]
    bone = tips - before
    length = np.linalg.norm(bone, axis=-1, keepdims=True)
    return np.asarray(tips - radius * bone / np.maximum(length, 1e-6))


def find_contacts(
    clip: Clip, side: Side, scene: Scene, settings: ContactSettings = DEFAULT
) -> Contacts:
    """Finds the contacts of a human hand's fingertips.

    Args:
        clip: the hands.
        side: side of the hand.
        scene: the objects.
        settings: thresholds.

    Raises:
        RecordingError: the hand has no wrist poses.
    """
    landmarks = landmarks_in_world(clip.hands[side])
    centres = pad_centres(landmarks, settings.pad_radius)
    clearance, which, place, normal = nearest_object(centres, scene)
    clearance = clearance - settings.pad_radius
    touching = np.stack(
        [_contact(clearance[:, f], clip.stamps, settings) for f in range(len(FINGERS))], axis=1
    )
    return Contacts(clearance, touching, which, place, normal)


def nearest_object(
    points: Float[np.ndarray, "T F 3"], scene: Scene
) -> tuple[
    Float[np.ndarray, "T F"],
    Int[np.ndarray, "T F"],
    Float[np.ndarray, "T F 3"],
    Float[np.ndarray, "T F 3"],
]:
    """Finds the nearest object of points: signed distance, index, nearest point and its normal.

    Args:
        points: (T, F, 3) in the world [m].
        scene: the objects.

    Returns:
        distance (T, F) [m], NaN where unknown; index (T, F); nearest point and normal
        (T, F, 3) in that object's frame [m].
    """
    shape = points.shape[:2]
    best = np.full(shape, np.inf)
    which = np.zeros(shape, int)
    place, normal = np.zeros((*shape, 3)), np.zeros((*shape, 3))
    for index, (solid, track) in enumerate(zip(scene.solids, scene.T_world_object, strict=True)):
        local = apply(poses.invert(track), points)
        finite = np.isfinite(local).all(axis=-1)
        distance = np.full(shape, np.inf)
        near, at = np.zeros((*shape, 3)), np.zeros((*shape, 3))
        distance[finite], near[finite], at[finite] = solid.nearest(local[finite])
        closer = distance < best
        best, which = np.where(closer, distance, best), np.where(closer, index, which)
        place = np.where(closer[..., None], near, place)
        normal = np.where(closer[..., None], at, normal)
    return np.where(best < FAR_M, best, np.nan), which, place, normal


def _contact(
    clearance: Float[np.ndarray, " T"], stamps: Float[np.ndarray, " T"], settings: ContactSettings
) -> Bool[np.ndarray, " T"]:
    """Applies hysteresis, then removes interruptions and contacts that are too short."""
    on = np.zeros(len(clearance), bool)
    now = False
    for t, gap in enumerate(clearance):
        limit = max(settings.begin, settings.end) if now else settings.begin
        now = bool(gap < limit)  # False for NaN
        on[t] = now
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    for value in (False, True):
        for first, past in _runs(on == value):
            inside = value or (first > 0 and past < len(on))  # a pause lies between two contacts
            if inside and stamps[past - 1] - stamps[first] + period < settings.shortest:
                on[first:past] = not value
    return on


def _runs(where: Sequence[bool] | np.ndarray) -> list[tuple[int, int]]:
    """First index and past-the-end index of each run of true values."""
    padded = np.concatenate([[0], np.asarray(where, int), [0]])
    edges = np.flatnonzero(np.diff(padded))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]

"""Clips of a human hand that pinches an object of known geometry, lifts it and lets it go.

A hand of published anatomy closes thumb and index finger on an object whose width is the gap
between their pads. The contacts of record follow from the shapes alone.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from smooth_hand_datasets.objects.contacts import Contacts, Scene, nearest_object, pad_centres
from smooth_hand_datasets.objects.placement import landmarks_in_world
from smooth_hand_datasets.objects.signed_distance import Box, Cylinder, Mesh, Solid
from smooth_operator import poses
from smooth_operator.formats.clip import Clip, ObjectTrack
from smooth_operator.synthetic.hand_anatomy import couple, draw_anatomy, mirror, pose_hand
from smooth_operator.types import HandRecording, Side

PAD_M = 0.0075
"""Radius of a fingertip."""
TRUE_M = 0.001
"""Clearance of a fingertip that touches, in the contacts of record."""

# Free joints: four of the thumb, three of each finger. The fingers that touch nothing are straight.
_CLOSED = np.radians([12.0, 20.0, 12.0, 15.0, 2.0, 45.0, 40.0, *(0.0, 12.0, 12.0) * 3])
_OPEN = np.radians([0.0, 5.0, -5.0, 0.0, 2.0, 10.0, 20.0, *(0.0, 12.0, 12.0) * 3])
_AWAY_M = np.array([0.01, 0.0, 0.07])  # palmar and distal of the grip, before and after it
_TWIST = np.radians(12.0)  # of a cylinder in the grip


@dataclass(frozen=True, eq=False)
class PinchClip:
    """A clip, its object's shape, and the contacts of record."""

    clip: Clip
    scene: Scene
    truth: Contacts

    @property
    def solids(self) -> dict[str, Solid]:
        return dict(zip(self.scene.names, self.scene.solids, strict=True))


def pinch_clip(
    form: Literal["box", "cylinder"] = "box", side: Side = "right", rate: float = 20.0
) -> PinchClip:
    """Makes a clip of 3 s: approach to 0.8 s, hold, lift and twist from 1.2 s, release at 2.4 s."""
    stamps = np.arange(round(3.0 * rate)) / rate
    opening = 1.0 - _minimum_jerk(stamps / 0.8) + _minimum_jerk((stamps - 2.4) / 0.6)
    lift = _minimum_jerk((stamps - 0.8) / 1.6)
    anatomy = draw_anatomy(0.19, 0)
    angles = _CLOSED + opening[:, None] * (_OPEN - _CLOSED)
    shape = pose_hand(anatomy, couple(angles))

    # The object fills the gap between the pads of the closed hand, with its x axis along it.
    grip = pad_centres(pose_hand(anatomy, couple(_CLOSED[None])).landmarks, PAD_M)[0]
    across = grip[1] - grip[0]
    half = 0.5 * float(np.linalg.norm(across)) - PAD_M
    x = across / np.linalg.norm(across)
    z = np.array([0.0, 1.0, 0.0]) - x[1] * x
    z /= np.linalg.norm(z)
    solid = Solid(
        Box(np.array([half, 1.2 * half, 2.2 * half]))
        if form == "box"
        else Cylinder(half, 5.0 * half)
    )
    middle = 0.5 * (grip[0] + grip[1]) + opening[:, None] * _AWAY_M
    frame = np.tile(poses.quaternions(np.stack([x, np.cross(z, x), z], axis=-1)), (len(stamps), 1))
    turn = _TWIST * np.sin(2 * np.pi * lift) * (form == "cylinder")
    about = poses.from_rotation_vectors(turn[:, None] * np.array([0.0, 0.0, 1.0]))
    inside = np.concatenate([middle, poses.multiply(frame, about)], axis=1)
    if side == "left":  # the objects are their own mirror images in y
        shape = mirror(shape)
        inside = inside * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])

    place = np.stack([0.3 + 0 * lift, 0.05 * lift, 0.9 + 0.08 * lift], axis=-1)
    tilt = poses.from_rotation_vectors(0.4 * lift[:, None] * np.array([0.6, 0.0, 0.8]))
    world = np.concatenate([place, tilt], axis=1)
    own = poses.wrist_from_landmarks(shape.landmarks, side)
    wrist = poses.compose(poses.compose(world, poses.invert(inside)), own)
    hand = HandRecording(shape.landmarks, stamps, side, T_world_wrist=wrist, world="scene")
    clip = Clip(f"{form}-{side}", {side: hand}, "scene", objects=(ObjectTrack(form, world),))
    scene = Scene((form,), (solid,), world[None])
    centres = pad_centres(landmarks_in_world(hand), PAD_M)
    distance, which, near, normal = nearest_object(centres, scene)
    clearance = distance - PAD_M
    return PinchClip(clip, scene, Contacts(clearance, clearance <= TRUE_M, which, near, normal))


def _minimum_jerk(share: np.ndarray) -> np.ndarray:
    s = np.clip(share, 0.0, 1.0)
    return 10 * s**3 - 15 * s**4 + 6 * s**5


def bumpy_mesh(radius: float, half: float, around: int = 64, rows: int = 48) -> Mesh:
    """A closed surface about z with a waist and three bulges, which is not convex."""
    z = np.linspace(-1.0, 1.0, rows)
    angle = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    profile = (1.0 - 0.14 * np.cos(np.pi * z)) * np.clip(1.0 - np.abs(z) ** 8, 0.3, None)
    size = radius * profile[:, None] * (1.0 + 0.07 * np.cos(3 * angle))
    ring = np.stack([size * np.cos(angle), size * np.sin(angle)], axis=-1)
    height = np.broadcast_to((half * z)[:, None, None], (rows, around, 1))
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    k = np.arange(around)
    bottom, last = rows * around, (rows - 1) * around
    faces = [
        np.stack([a, b, b + around], -1).reshape(-1, 3),
        np.stack([a, b + around, a + around], -1).reshape(-1, 3),
        np.stack([np.full(around, bottom), (k + 1) % around, k], axis=-1),
        np.stack([np.full(around, bottom + 1), last + k, last + (k + 1) % around], axis=-1),
    ]
    poles = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
    vertices = np.concatenate([ring, height], axis=-1).reshape(-1, 3)
    return Mesh(np.concatenate([vertices, poles]), np.concatenate(faces))

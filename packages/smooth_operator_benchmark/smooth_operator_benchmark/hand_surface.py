"""Draws pictures of hands without a GPU: shaded triangles with a depth buffer, in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float, Int, UInt8

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, LANDMARKS, NUM_LANDMARKS, WRIST
from smooth_operator.teleop.pages.hand_view import FINGER_COLORS

PALM_COLOR: Final = (190, 194, 200)
PAPER: Final = 255
_INK: Final = 0.45  # brightness of an outline, of 1
_STEP: Final = 0.07  # depth that counts as an outline, of half the picture's width
_FINE: Final = 2  # pixels per pixel of the picture, in both directions
_LIGHT: Final = np.array([0.35, 0.45, 0.82])
_ROUND: Final = 14  # sides of a rod
_THICK: Final = 0.085  # radius of a drawn finger, of the middle finger's length
_DENSE: Final = 1.3  # samples per pixel along a line
_LARGEST: Final = 1024  # samples along a line


class Surface(NamedTuple):
    """Triangles of a posed hand.

    Attributes:
        triangles: (N, 3, 3) corners [m].
        colors: (N, 3) sRGB, 0 to 255.
    """

    triangles: Float[np.ndarray, "N 3 3"]
    colors: UInt8[np.ndarray, "N 3"]


class HandShape(Protocol):
    """A robot hand that can be posed and drawn; positions are in its palm frame [m]."""

    @property
    def view(self) -> Float[np.ndarray, "3 3"]:
        """Matrix whose rows point right, up and towards a viewer who looks at the palm with the
        fingers up."""

    @property
    def wrist(self) -> Float[np.ndarray, "3"]:
        """Position of the wrist."""

    def surface(self, joints: Float[np.ndarray, " n"]) -> Surface:
        """Surface of the hand in a pose.

        Args:
            joints: (n,) all joint positions, in the order of the hand's ``joint_names`` [rad].
        """


class SkeletonShape:
    """A robot hand that is drawn as rods between its landmarks, which works for any model.

    Args:
        hand: the robot hand.
        view: rows right, up and toward the viewer.
    """

    def __init__(self, hand: Hand, view: Float[np.ndarray, "3 3"]) -> None:
        self._hand, self.view = hand, view
        self.wrist = np.asarray(hand.wrist, float)

    def surface(self, joints: Float[np.ndarray, " n"]) -> Surface:
        """Returns the surface of the rods in a pose."""
        points = np.full((NUM_LANDMARKS, 3), np.nan)
        at = [LANDMARKS.index(name) for name in self._hand.tree.names]
        points[at] = self._hand.tree.positions(np.asarray(joints, float)[None])[0]
        return landmark_surface(points)


def landmark_surface(points: Float[np.ndarray, "21 3"]) -> Surface:
    """Makes the surface of a hand from landmarks: rods along the fingers, and a palm between the
    wrist and the finger bases.

    Args:
        points: (21, 3) landmarks [m]; NaN for a missing one.
    """
    bases = [base for base in BASES if np.isfinite(points[base]).all()]
    chains = []
    for base in BASES:
        chain = [i for i in range(base, base + 4) if np.isfinite(points[i]).all()]
        chains.append(chain)
    middle = max((_length(points[chain]) for chain in chains[1:]), default=0.0)
    radius = max(_THICK * middle, 1e-4)
    pieces, colors = [], []
    for chain, color in zip(chains, FINGER_COLORS, strict=True):
        for a, b in pairwise(chain):
            pieces.append(rod(points[a], points[b], radius))
            colors.append(color)
    rim = [WRIST, *bases]
    for a, b in zip(rim, [*bases, WRIST], strict=True):
        pieces.append(rod(points[a], points[b], 0.9 * radius))
        colors.append(PALM_COLOR)
    for a, b in pairwise(bases):
        pieces.append(points[[WRIST, a, b]][None])
        colors.append(PALM_COLOR)
    kept = [
        (piece, color)
        for piece, color in zip(pieces, colors, strict=True)
        if np.isfinite(piece).all()
    ]
    if not kept:
        return Surface(np.empty((0, 3, 3)), np.empty((0, 3), np.uint8))
    return Surface(
        np.concatenate([piece for piece, _ in kept]),
        np.concatenate([np.tile(np.array(color, np.uint8), (len(p), 1)) for p, color in kept]),
    )


def rod(
    start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], radius: float
) -> Float[np.ndarray, "N 3 3"]:
    """Triangles of a rod with round ends [m]."""
    axis = end - start
    length = float(np.linalg.norm(axis))
    z = axis / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    turn = np.linspace(0, 2 * np.pi, _ROUND + 1)
    around = np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * np.cross(z, x)
    rise = np.linspace(0, np.pi / 2, 4)
    low = [(-radius * np.cos(a), radius * np.sin(a)) for a in rise]
    high = [(length + radius * np.sin(a), radius * np.cos(a)) for a in rise]
    rings = np.array([start + along * z + out * around for along, out in low + high])
    a, b, c, d = rings[:-1, :-1], rings[:-1, 1:], rings[1:, 1:], rings[1:, :-1]
    quads = np.stack([a, b, c, a, c, d], axis=2)
    return np.asarray(quads.reshape(-1, 3, 3))


def paint(
    surface: Surface,
    view: Float[np.ndarray, "3 3"],
    centre: Sequence[float],
    half: float,
    size: int,
) -> UInt8[np.ndarray, "S S 3"]:
    """Draws a surface on white as a square parallel projection with outlines.

    Args:
        view: rows right, up and toward the viewer.
        centre: right and up of the picture's middle [m].
        half: half the width of the picture [m].
        size: width and height [px].
    """
    fine = _FINE * size
    corners = surface.triangles @ np.asarray(view).T
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)  # users' meshes are not all wound outward
    light = 0.5 + 0.5 * np.clip(normals @ (_LIGHT / np.linalg.norm(_LIGHT)), 0, 1)
    shades = light[:, None] * surface.colors
    scale = fine / (2 * half)
    places = (corners[:, :, :2] - np.asarray(centre)) * [scale, -scale] + fine / 2
    at, depths, owners = _samples(np.concatenate([places, corners[:, :, 2:]], axis=2))
    picture = np.full((fine * fine, 3), float(PAPER))
    depth = np.full(fine * fine, -np.inf)
    pixels = np.floor(at).astype(int)
    inside = np.flatnonzero(((pixels >= 0) & (pixels < fine)).all(axis=1))
    inside = inside[np.argsort(depths[inside])]  # the nearest is written last
    where = pixels[inside, 1] * fine + pixels[inside, 0]
    picture[where], depth[where] = shades[owners[inside]], depths[inside]
    picture[_outline(depth.reshape(fine, fine), _STEP * half).ravel()] *= _INK
    small = picture.reshape(size, _FINE, size, _FINE, 3).mean(axis=(1, 3))
    return np.asarray(np.clip(small, 0, 255), np.uint8)


def _samples(
    corners: Float[np.ndarray, "N 3 3"],
) -> tuple[Float[np.ndarray, "S 2"], Float[np.ndarray, " S"], Int[np.ndarray, " S"]]:
    """Samples triangles at points less than a pixel apart; returns their pixels, depths and
    triangles.

    Args:
        corners: (N, 3, 3) corners: right and down [px], and depth.
    """
    edges = np.linalg.norm((np.roll(corners, -1, axis=1) - corners)[:, :, :2], axis=-1)
    longest = edges.argmax(axis=1)
    turn = (longest[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turn[:, :, None], axis=1)  # the longest edge comes first
    a, b, c = (corners[:, k] for k in range(3))
    along, up = (b - a)[:, :2], (c - a)[:, :2]
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-9)
    height = np.abs(along[:, 0] * up[:, 1] - along[:, 1] * up[:, 0]) / length
    counts = np.stack([length, height], axis=1) * _DENSE
    counts = np.minimum(2 ** np.ceil(np.log2(np.maximum(counts, 1))), _LARGEST).astype(int)
    points, owners = [np.empty((0, 3))], [np.empty(0, int)]
    for across, rise in np.unique(counts, axis=0):
        own = np.flatnonzero((counts == (across, rise)).all(axis=1))
        u = np.tile((np.arange(across) + 0.5) / across, rise)
        v = np.repeat((np.arange(rise) + 0.5) / rise, across)
        weights = np.stack([(1 - v) * (1 - u), (1 - v) * u, v], axis=1)
        points.append((weights @ corners[own]).reshape(-1, 3))
        owners.append(np.repeat(own, len(weights)))
    every = np.concatenate(points)
    return every[:, :2], every[:, 2], np.concatenate(owners)


def _outline(depth: Float[np.ndarray, "H W"], step: float) -> np.ndarray:
    """Pixels of a hand that are in front of a neighbouring pixel by more than a step."""
    filled = np.maximum(depth, -1e3)
    edge = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        for shift in (1, -1):
            edge |= filled - np.roll(filled, shift, axis=axis) > step
    return np.asarray(edge & np.isfinite(depth))


def _length(points: Float[np.ndarray, "k 3"]) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=-1).sum())

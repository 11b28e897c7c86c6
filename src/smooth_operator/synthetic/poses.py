"""Postures of the human hand, and pinches whose fingertips meet.

A posture is 16 free joint angles (see ``FREE``): the thumb's CMC flexion, CMC abduction, MCP and
IP, then MCP abduction, MCP and PIP of index .. pinky.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import TIPS
from smooth_operator.synthetic.hand_anatomy import FREE, LOWER, UPPER, couple, draw_anatomy
from smooth_operator.synthetic.human_kinematics import dorsal, pose_hand

FREE_LOWER: Float[np.ndarray, "16"] = LOWER[list(FREE)]
FREE_UPPER: Float[np.ndarray, "16"] = UPPER[list(FREE)]
FREE_LOWER.setflags(write=False)
FREE_UPPER.setflags(write=False)

PINCHES: Final = ("pinch_index", "pinch_middle", "pinch_ring", "pinch_pinky")
"""Names of the four pinches, in the order of ``pinch_postures``."""

Posture = Float[np.ndarray, "16"]


def _posture(thumb: tuple[float, ...], *fingers: tuple[float, float, float]) -> Posture:
    posture = np.deg2rad([*thumb, *(angle for finger in fingers for angle in finger)])
    posture.setflags(write=False)
    return posture


# Chosen by eye and against recordings of real hands; degrees.
FLAT = _posture((-13, -9, 3, 2), (-2, 4, 6), (0, 4, 6), (3, 4, 7), (6, 5, 8))
RELAXED = _posture((0, 4, 12, 14), (2, 22, 26), (0, 26, 30), (0, 28, 32), (-2, 28, 30))
SPREAD = _posture((-18, 6, 0, -4), (15, -4, 4), (1, -6, 4), (-11, -5, 5), (-24, -4, 5))
CURLED = _posture((-8, 12, 10, 12), (-4, 74, 92), (0, 78, 96), (2, 80, 96), (4, 80, 94))
"""All four fingers curled, the thumb out of their way."""
FIST = _posture((-14, 13, 40, 63), (-4, 78, 96), (0, 82, 98), (2, 84, 98), (4, 84, 96))
"""The thumb closed over the curled fingers."""

# Natural posture in each pinch, from which the solution deviates as little as possible: the thumb,
# then the pinching finger.
_PINCH_THUMB = np.deg2rad([[4, 18, 18, 22], [14, 22, 20, 24], [23, 25, 24, 28], [30, 28, 30, 34]])
_PINCH_FINGER = np.deg2rad([[4, 46, 50], [2, 50, 50], [2, 52, 50], [6, 50, 48]])
_PINCH_SPREAD = np.deg2rad([10.0, 10.0, 14.0, 16.0, 5.0, 14.0, 14.0])
# Pulp of the fingertips between the two tip landmarks, over hand length: 1.5 mm on a 0.19 m hand.
_PINCH_GAP = 0.008
_CONTACT_SPREAD = 0.0005
_FACING_SPREAD = 0.9
_LIMIT_MARGIN = np.deg2rad(1.0)


@lru_cache(maxsize=64)
def pinch_postures(seed: int) -> Float[np.ndarray, "4 16"]:
    """Postures in which the thumb's tip meets that of index, middle, ring and pinky.

    Inverse kinematics of the person's own hand within the joint ranges: the finger's tip lies on
    the thumb's pad, 0.8 % of the hand length (1.5 mm) from the thumb's tip, the pads face each
    other, and the joints stay near a natural pinch. The other fingers are relaxed, and neighbours
    follow in part. The angles don't depend on the hand's length.

    Args:
        seed: seed of the person, as for ``draw_anatomy``.

    Returns:
        (4, 16) read-only postures [rad].
    """
    anatomy = draw_anatomy(1.0, seed)
    which = np.arange(4)
    moving = np.concatenate(
        [np.tile(np.arange(4), (4, 1)), 4 + 3 * which[:, None] + np.arange(3)], 1
    )
    natural = np.concatenate([_PINCH_THUMB, _PINCH_FINGER], 1)
    lower = FREE_LOWER[moving] + _LIMIT_MARGIN
    upper = FREE_UPPER[moving] - _LIMIT_MARGIN
    postures = np.array([_around(finger) for finger in range(4)])

    def residual(x: Float[np.ndarray, "n 4 7"]) -> Float[np.ndarray, "n 4 11"]:
        free = np.broadcast_to(postures, (*x.shape[:2], 16)).copy()
        np.put_along_axis(free, np.broadcast_to(moving, x.shape), x, -1)
        poses = pose_hand(anatomy, couple(free.reshape(-1, 16)))
        tips = poses.landmarks[:, TIPS].reshape(-1, 4, 5, 3)
        nails = dorsal(poses.orientations[:, TIPS]).reshape(-1, 4, 5, 3)
        thumb, finger = nails[:, :, 0], nails[:, which, which + 1]
        gap = tips[:, which, which + 1] - (tips[:, :, 0] - _PINCH_GAP * thumb)
        facing = 1.0 + (thumb * finger).sum(-1, keepdims=True)
        return np.concatenate(
            [gap / _CONTACT_SPREAD, (x - natural) / _PINCH_SPREAD, facing / _FACING_SPREAD], -1
        )

    solution = _least_squares(residual, np.clip(natural, lower, upper), lower, upper)
    np.put_along_axis(postures, moving, solution, -1)
    postures.setflags(write=False)
    return postures


def _around(finger: int) -> Posture:
    """Posture of the other fingers while one pinches: its neighbours are more flexed."""
    posture = RELAXED.copy()
    for other in range(4):
        follow = 1.0 if abs(other - finger) == 1 else 0.7
        posture[5 + 3 * other : 7 + 3 * other] *= follow
    return posture


def _least_squares(
    residual: Callable[[Float[np.ndarray, "n P K"]], Float[np.ndarray, "n P R"]],
    x: Float[np.ndarray, "P K"],
    lower: Float[np.ndarray, "P K"],
    upper: Float[np.ndarray, "P K"],
    steps: int = 40,
) -> Float[np.ndarray, "P K"]:
    """Levenberg-Marquardt within bounds, for P problems in parallel.

    SciPy's ``least_squares`` does the same for one problem, but its import takes longer than all
    other work of the synthetic operator.
    """
    n = x.shape[-1]
    nudge = 1e-6
    damping = np.full((len(x), 1, 1), 1e-2)
    nudges = nudge * np.eye(n)[:, None]
    for _ in range(steps):
        values = residual(np.concatenate([x[None], x[None] + nudges]))
        r = values[0]
        jacobian = np.moveaxis((values[1:] - r) / nudge, 0, -1)
        gradient = np.einsum("pri,pr->pi", jacobian, r)
        # a joint at its limit with a step beyond the limit is held
        free = ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0)))
        jacobian = jacobian * free[:, None]
        hessian = np.einsum("pri,prj->pij", jacobian, jacobian)
        hessian += (damping + ~free[:, None]) * np.eye(n)
        step = np.linalg.solve(hessian, -(gradient * free)[..., None])[..., 0]
        trial = np.clip(x + step, lower, upper)
        better = (residual(trial[None])[0] ** 2).sum(-1) < (r**2).sum(-1)
        if np.abs(trial - x).max() < 1e-9:
            break
        x = np.where(better[:, None], trial, x)
        damping = np.where(better[:, None, None], damping / 5.0, damping * 5.0)
    return x

"""A human hand that puts its fingertips on an object: inverse kinematics for made clips."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.objects.contacts import pad_centres
from smooth_hand_datasets.objects.signed_distance import Solid, Sphere, signed_distance
from smooth_operator import poses
from smooth_operator.landmarks import TIPS
from smooth_operator.synthetic.hand_anatomy import (
    FREE,
    LOWER,
    UPPER,
    HandAnatomy,
    couple,
    pose_hand,
)

FREE_M: Final = 0.012
"""Clearance that fingertips keep that do not touch [m]."""

_PRIOR: Final = np.radians(
    [12.0, 20.0, 12.0, 15.0, 2.0, 45.0, 40.0, 0.0, 48.0, 42.0, 0.0, 50.0, 42.0, -2.0, 48.0, 40.0]
)
_FREE_FINGER: Final = np.radians([0.0, 12.0, 12.0])  # one that touches nothing
_ROUNDS: Final = 25
_NUDGE: Final = 1e-5
_FIT_M: Final = 0.0005  # a fingertip's error counts in units of this
_POSTURE: Final = 1.2  # and an angle's distance from the prior in units of this [rad]


class GraspingHand:
    """A human hand at an object, for inverse kinematics; the hand's own frame."""

    def __init__(
        self, anatomy: HandAnatomy, pad: float, solid: Solid, used: tuple[int, ...]
    ) -> None:
        self.anatomy, self.pad, self.solid, self.used = anatomy, pad, solid, used
        self.low, self.high = LOWER[list(FREE)], UPPER[list(FREE)]
        self.prior = _PRIOR.copy()
        for finger in set(range(5)) - set(used):
            self.prior[4 + 3 * (finger - 1) : 7 + 3 * (finger - 1)] = _FREE_FINGER
        self.idle = [f for f in range(5) if f not in used]

    def landmarks(self, angles: Float[np.ndarray, "n 16"]) -> Float[np.ndarray, "n 21 3"]:
        """[m]."""
        return pose_hand(self.anatomy, couple(angles)).landmarks

    def contact_points(self, heights: Float[np.ndarray, "5"]) -> Float[np.ndarray, "5 3"]:
        """Where fingertips touch: fingers from +x, the thumb from -x, at heights along z [m]."""
        points = np.zeros((5, 3))
        for finger, height in enumerate(heights):
            way = np.array([-1.0 if finger == 0 else 1.0, 0.0, 0.0])
            start = np.array([0.0, 0.0, height])
            if isinstance(self.solid.shape, Sphere):  # towards the middle
                angle = height / float(self.solid.shape.radius)
                way = way * np.cos(angle) + np.array([0.0, 0.0, np.sin(angle)])
                start = np.zeros(3)
            at = start + 0.3 * way
            for _ in range(60):  # sphere tracing
                at = at - way * float(self.solid.distance(at[None])[0])
            points[finger] = at
        return points

    def grip(
        self, touch: Float[np.ndarray, "5 3"]
    ) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "16"]]:
        """Pose of the object in the hand, and angles, so that fingertips touch."""
        first = self.landmarks(self.prior[None])[0][list(TIPS)]
        across = first[[f for f in self.used if f]].mean(axis=0) - first[0]
        x = across / np.linalg.norm(across)
        z = np.array([0.0, 1.0, 0.0]) - x[1] * x
        z /= np.linalg.norm(z)
        start = np.stack([x, np.cross(z, x), z], axis=-1)
        middle = 0.5 * (first[0] + first[[f for f in self.used if f]].mean(axis=0))
        pose = np.concatenate([middle, poses.quaternions(start)])

        def placed(rest: np.ndarray) -> np.ndarray:
            turn = poses.multiply(
                np.broadcast_to(pose[3:], (len(rest), 4)), poses.from_rotation_vectors(rest[:, 3:])
            )
            return np.concatenate([pose[:3] + rest[:, :3], turn], axis=-1)

        def residuals(x: np.ndarray) -> np.ndarray:
            angles, rest = x[:, :16], x[:, 16:]
            inside = placed(rest)
            many = np.broadcast_to(touch, (len(x), 5, 3))
            own = self._residuals(angles, inside, many, np.zeros((len(x), 5)))
            return np.concatenate([own, rest[:, 3:] / 0.5], axis=1)

        low = np.concatenate([self.low, np.full(3, -0.1), np.full(3, -0.8)])
        begin = np.concatenate([self.prior, np.zeros(6)])[None]
        solution = _least_squares(residuals, begin, low, np.concatenate([self.high, -low[16:]]), 60)
        return placed(solution[:, 16:])[0], solution[0, :16]

    def follow(
        self,
        inside: Float[np.ndarray, "T 7"],
        places: Float[np.ndarray, "T 5 3"],
        gaps: Float[np.ndarray, "T 5"],
        start: Float[np.ndarray, "16"],
    ) -> Float[np.ndarray, "T 16"]:
        """Angles of all frames, each for itself."""
        extra = [inside, places, gaps]

        def residuals(x: np.ndarray) -> np.ndarray:
            times = len(x) // len(inside)
            return self._residuals(x, *(np.concatenate([e] * times) for e in extra))

        begin = np.tile(start, (len(inside), 1))
        return _least_squares(residuals, begin, self.low, self.high, _ROUNDS)

    def _residuals(
        self,
        angles: Float[np.ndarray, "n 16"],
        inside: Float[np.ndarray, "n 7"],
        places: Float[np.ndarray, "n 5 3"],
        gaps: Float[np.ndarray, "n 5"],
    ) -> Float[np.ndarray, "n R"]:
        landmarks = self.landmarks(angles)
        centres = pad_centres(landmarks, self.pad)
        back = poses.invert(inside)

        def local(points: np.ndarray) -> np.ndarray:
            return np.asarray(poses.rotate(back[:, None, 3:], points) + back[:, None, :3])

        at = local(centres)
        used = list(self.used)
        normal = self._normals(places[:, used])
        goals = places[:, used] + (self.pad + gaps[:, used])[..., None] * normal
        reach = (at[:, used] - goals) / np.where(gaps[:, used] > 1e-6, 4.0, 1.0)[..., None] / _FIT_M
        posture = (angles - self.prior) / _POSTURE
        parts = [reach.reshape(len(at), -1), posture]
        if self.idle:
            free = signed_distance(self.solid.shape, at[:, self.idle]) - self.pad - FREE_M
            parts.append(np.minimum(free, 0.0) / 0.002)
        # The bones but the last, and the palm, stay out of the object
        bones = [f for first in (2, 6, 10, 14, 18) for f in (first, first + 1)]
        ends = landmarks[:, bones]
        middles = 0.5 * (landmarks[:, bones] + landmarks[:, [b - 1 for b in bones]])
        solid = local(np.concatenate([ends, middles], axis=1))
        depth = signed_distance(self.solid.shape, solid) - self.pad
        parts.append(np.minimum(depth, 0.0) / 0.002)
        return np.concatenate(parts, axis=1)

    def _normals(self, places: np.ndarray) -> np.ndarray:
        """Outward normals at points of the surface, from a little outside."""
        step = 1e-5
        slopes = [
            signed_distance(self.solid.shape, places + step * e)
            - signed_distance(self.solid.shape, places - step * e)
            for e in np.eye(3)
        ]
        normal = np.stack(slopes, axis=-1)
        unit: np.ndarray = normal / np.maximum(
            np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12
        )
        return unit


def _least_squares(
    residuals: Callable[[np.ndarray], np.ndarray],
    start: Float[np.ndarray, "n v"],
    low: Float[np.ndarray, " v"],
    high: Float[np.ndarray, " v"],
    rounds: int,
) -> Float[np.ndarray, "n v"]:
    """Levenberg and Marquardt's steps for many problems of one form, within bounds."""
    x = np.clip(start, low, high)
    count, size = x.shape
    damping = np.full(count, 1e-2)
    error = residuals(x)
    cost = (error**2).sum(axis=1)
    for _ in range(rounds):
        nudged = np.concatenate([x + _NUDGE * e for e in np.eye(size)])
        slopes = (residuals(nudged).reshape(size, count, -1) - error) / _NUDGE
        jacobian = np.moveaxis(slopes, 0, -1)  # (n, R, v)
        pull = -np.einsum("nrv,nr->nv", jacobian, error)
        stuck = ((x <= low) & (pull < 0)) | ((x >= high) & (pull > 0))
        jacobian = jacobian * ~stuck[:, None]
        hessian = np.swapaxes(jacobian, 1, 2) @ jacobian
        scale = damping[:, None] * (1.0 + np.einsum("nvv->nv", hessian))
        hessian += (scale + stuck)[:, :, None] * np.eye(size)
        step = np.linalg.solve(hessian, (pull * ~stuck)[..., None])[..., 0]
        new = np.clip(x + np.clip(step, -0.3, 0.3), low, high)
        trial = residuals(new)
        value = (trial**2).sum(axis=1)
        better = value < cost
        x, cost = np.where(better[:, None], new, x), np.where(better, value, cost)
        error = np.where(better[:, None], trial, error)
        damping = np.clip(np.where(better, damping / 5, damping * 5), 1e-9, 1e6)
    return np.asarray(x)

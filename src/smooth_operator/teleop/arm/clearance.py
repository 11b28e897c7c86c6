"""Velocity limits of an arm from the distances between its parts, its hand, table and wall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import mink
import mujoco
import numpy as np
from jaxtyping import Float, Int

from smooth_operator.simulation.arms.arm import BASE, FLANGE, ArmSpec, HandCapsules

_POSES: Final = 400
"""Number of random poses that determine which parts can meet."""

_ROWS: Final = 16
"""Number of nearest pairs that limit a step; each one costs time."""

_BRAKING: Final = 0.3
"""Share of the joints' effect on a distance that is used to stop before its end."""

_FATTER: Final = 0.04
"""Width by which capsules exceed two links [m]."""

_LEEWAY: Final = 0.02
"""Share of a step's effect on a distance that is left to other distances."""

_TINY: Final = 1e-12
_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


@dataclass(frozen=True)
class ClearanceConfig:
    """Distances that parts keep.

    Attributes:
        parts: smallest distance between parts of the arm, and between arm and hand [m].
        table: smallest distance between the table and the arm or the palm [m].
        fingers: smallest distance between the table and the fingers, which may touch it [m].
        wall: smallest distance between the wall and any part [m].
        horizon: distance from which on pairs are not limited [m].
        approach: largest speed at which a pair approaches, as a share per second of its distance
            above the smallest one [1/s].
    """

    parts: float = 0.02
    table: float = 0.02
    fingers: float = 0.0
    wall: float = 0.02
    horizon: float = 0.3
    approach: float = 4.0


class Clearance(mink.Limit):
    """Velocity limits that keep capsules of arm and hand apart, and away from table and wall.

    The time of a step does not depend on the pose: all distances follow from a few array
    operations, and the nearest pairs become rows of the program.

    Args:
        arm: the arm; its base frame is the world.
        model: model of the arm, with a body ``FLANGE``.
        hand: capsules of the hand; None without a hand.
        rest: (n,) pose without contacts [rad]; pairs that overlap in it are left out.
        table: height of the table [m]; None without a table.
        wall: y of a wall that the arm does not cross, in the base frame [m]; None without a wall.
        config: the distances.

    Attributes:
        nearest: smallest distance at the last step [m], except that of fingers and table.
        low: (n,) lowest velocity of the joints in the next step [rad/s].
        high: (n,) highest velocity of the joints in the next step [rad/s].
    """

    def __init__(
        self,
        arm: ArmSpec,
        model: mujoco.MjModel,
        hand: HandCapsules | None,
        rest: Float[np.ndarray, " n"],
        table: float | None,
        wall: float | None,
        config: ClearanceConfig,
    ) -> None:
        self.config = config
        self.nearest = np.inf
        self.low = self.high = np.zeros(len(arm.links))
        self._hand = hand
        self._arm = arm
        self._joints = len(arm.links)
        groups = [(arm.base, BASE), *((link.capsules, f"link{i}") for i, link in
                                      enumerate(arm.links, start=1))]  # fmt: skip
        shapes = [(capsule, level) for level, (own, _) in enumerate(groups) for capsule in own]
        bodies = [model.body(name).id for _, name in groups]
        starts = np.array([capsule.start for capsule, _ in shapes])
        ends = np.array([capsule.end for capsule, _ in shapes])
        self._middle = (starts + ends) / 2
        half = (ends - starts) / 2
        self._half = half
        self._own = len(shapes)
        self._body = np.array([bodies[level] for _, level in shapes])
        self._flange = model.body(FLANGE).id
        count = 0 if hand is None else len(hand)
        self._level: Int[np.ndarray, " c"] = np.array(
            [level for _, level in shapes] + [self._joints] * count
        )
        radii = np.array([capsule.radius for capsule, _ in shapes])
        halves = np.linalg.norm(half, axis=1)
        finger = np.zeros(self._own, bool)
        if hand is not None:
            radii, halves = np.concatenate([radii, hand.radii]), np.concatenate(
                [halves, hand.halves]
            )  # fmt: skip
            finger = np.concatenate([finger, hand.fingers])
        self._radius, self._length, self._finger = radii, halves, finger
        self._placed = np.zeros((count, 2, 3))
        # joint j moves a part of level l if j <= l
        self._moves = np.arange(1, self._joints + 1) <= self._level[:, None]
        self._joint_ids = [model.joint(name).id for name in arm.joint_names]
        self._planes: list[tuple[np.ndarray, float]] = []
        if table is not None:
            self._planes.append((np.array([0.0, 0.0, 1.0]), table))
        if wall is not None:
            self._planes.append((np.array([0.0, -np.sign(wall), 0.0]), -abs(wall)))
        self._table = table is not None
        self._pairs = self._meeting(model, rest)
        # the base and what turns on the spot above it stand on the table for good
        high = self._level >= 3
        self._free = [np.flatnonzero(high if axis[2] else self._level >= 1) for axis, _ in
                      self._planes]  # fmt: skip

    def place_hand(self, middles: Float[np.ndarray, "c 3"], axes: Float[np.ndarray, "c 3"]) -> None:
        """Places the hand's capsules on the flange; see ``HandCapsules.at``."""
        self._placed[:, 0], self._placed[:, 1] = middles, axes

    def distances(self, data: mujoco.MjData) -> tuple[np.ndarray, ...]:
        """Near pairs, for a model whose kinematics are up to date.

        Returns:
            (k,) distance above the smallest allowed one [m], (k, n) its derivative with respect to
            the joints [m/rad], and (k,) the distance itself [m].
        """
        middle, half = self._world(data)
        first, second = self._pairs.T
        reach = self._radius[first] + self._radius[second]
        apart = np.linalg.norm(middle[first] - middle[second], axis=1)
        near = apart - self._length[first] - self._length[second] - reach < self.config.horizon
        first, second, reach = first[near], second[near], reach[near]
        one, other = _nearest_points(middle[first], half[first], middle[second], half[second])
        line = other - one
        length = np.linalg.norm(line, axis=1)
        parts, no = np.full(len(first), self.config.parts), np.zeros(len(first), bool)
        parts_near = [(length - reach, parts, no, one, first, other, second,
                  line / np.maximum(length, _TINY)[:, None])]  # fmt: skip
        for (normal, offset), free in zip(self._planes, self._free, strict=True):
            along = half[free] @ normal
            point = middle[free] - np.sign(along)[:, None] * half[free]
            gap = point @ normal - offset - self._radius[free]
            least = np.full(len(free), self.config.wall)
            touches = self._finger[free] & bool(normal[2])
            if normal[2]:
                least = np.where(touches, self.config.fingers, self.config.table)
            none = np.zeros(len(free), int)  # the base, which nothing moves
            normals = np.tile(normal, (len(free), 1))
            parts_near.append((gap, least, touches, point, none, point, free, normals))
        distance, least, may_touch, one, a, other, b, normal = (
            np.concatenate(part) for part in zip(*parts_near, strict=True)
        )
        spare = distance - least
        nearest = np.flatnonzero(spare < self.config.horizon)
        if len(nearest) > _ROWS:
            nearest = nearest[np.argpartition(spare[nearest], _ROWS)[:_ROWS]]
        axis = data.xaxis[self._joint_ids]
        anchor = data.xanchor[self._joint_ids]
        normal = normal[nearest]

        # n . (z x (p - o)) = z . (p x n) - n . (z x o), for joints with axes z through points o
        fixed = normal @ _cross(axis, anchor).T

        def speed(point: np.ndarray, part: np.ndarray) -> np.ndarray:
            out: np.ndarray = (_cross(point, normal) @ axis.T - fixed) * self._moves[part]
            return out

        slope = speed(other[nearest], b[nearest]) - speed(one[nearest], a[nearest])
        self.nearest = float(distance[~may_touch].min(initial=np.inf))
        return spare[nearest], slope, distance[nearest]

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.limits.Constraint:
        """Rows G and bounds h of G dq <= h; see ``mink.Limit``."""
        spare, slope, _ = self.distances(configuration.data)
        if not len(spare):
            return mink.limits.Constraint()
        room = np.maximum(spare, 0.0)
        braking = _BRAKING * (np.abs(slope) @ self._arm.acceleration)
        bound = dt * np.minimum(
            min(self.config.approach, 0.5 / dt) * room, np.sqrt(2.0 * braking * room)
        )
        # If no velocity within the joints' bounds keeps a distance, the arm brakes at its limits.
        least = np.minimum(-slope * self.low, -slope * self.high).sum(axis=1) * dt
        most = np.maximum(-slope * self.low, -slope * self.high).sum(axis=1) * dt
        return mink.limits.Constraint(
            G=-slope, h=np.maximum(bound, least + _LEEWAY * (most - least))
        )

    def _world(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        """Middles and half segments of all capsules in the base frame [m]."""
        turn = data.xmat.reshape(-1, 3, 3)
        rotation = turn[self._body]
        middle = np.einsum("cij,cj->ci", rotation, self._middle) + data.xpos[self._body]
        half = np.einsum("cij,cj->ci", rotation, self._half)
        if self._hand is None:
            return middle, half
        flange = turn[self._flange]
        at = self._placed[:, 0] @ flange.T + data.xpos[self._flange]
        along = self._placed[:, 1] @ flange.T * self._hand.halves[:, None]
        return np.concatenate([middle, at]), np.concatenate([half, along])

    def _meeting(self, model: mujoco.MjModel, rest: np.ndarray) -> Int[np.ndarray, "p 2"]:
        """Pairs of capsules that can come near each other within the limits.

        Pairs that touch at rest, and those of links that a joint connects, are left out."""
        level = self._level
        first, second = np.triu_indices(len(level), 1)
        # what is on one link, or on the next, is shaped not to collide; a wrist's three axes meet
        some = np.abs(level[first] - level[second]) >= 2
        some &= ~((level[first] >= self._joints - 2) & (level[second] >= self._joints - 2))
        first, second = first[some], second[some]
        data = mujoco.MjData(model)
        low, high = self._arm.limits.T
        rng = np.random.default_rng(0)
        reach = self._radius[first] + self._radius[second]
        least = np.full(len(first), np.inf)
        for number in range(_POSES + 1):
            data.qpos[:] = rest if number == 0 else rng.uniform(low, high)
            mujoco.mj_kinematics(model, data)
            middle, half = self._world(data)
            one, other = _nearest_points(middle[first], half[first], middle[second], half[second])
            gap = np.linalg.norm(one - other, axis=1) - reach
            if number == 0:
                touching = gap < self.config.parts
            least = np.minimum(least, gap)
        meet = (least < 2 * self.config.parts) & ~touching
        # The maker's joint limits keep links apart that are two joints from each other; where the
        # capsules, which are fatter, overlap by little, that is no collision.
        near = (np.abs(level[first] - level[second]) == 2) & (second < self._own)
        meet &= ~(near & (least > -_FATTER))
        return np.stack([first[meet], second[meet]], axis=1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of rows; a fifth of the time that NumPy's takes."""
    product: np.ndarray = a[:, _NEXT] * b[:, _AFTER] - a[:, _AFTER] * b[:, _NEXT]
    return product


def _nearest_points(
    a: np.ndarray, u: np.ndarray, b: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest points of segments a + s u and b + t v, s and t from -1 to 1; (p, 3) each [m].

    As in Ericson, Real-Time Collision Detection, 5.1.9, for all pairs in one go.
    """
    r = a - b
    uu, vv, uv = (u * u).sum(1), (v * v).sum(1), (u * v).sum(1)
    ur, vr = (u * r).sum(1), (v * r).sum(1)
    determinant = uu * vv - uv * uv
    parallel = determinant < 1e-9 * uu * vv + _TINY**2
    s = np.where(parallel, 0.0, (uv * vr - vv * ur) / np.where(parallel, 1.0, determinant))
    s = np.clip(s, -1.0, 1.0)
    t = np.clip((uv * s + vr) / np.maximum(vv, _TINY), -1.0, 1.0)
    s = np.clip((uv * t - ur) / np.maximum(uu, _TINY), -1.0, 1.0)
    return a + s[:, None] * u, b + t[:, None] * v

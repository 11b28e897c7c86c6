"""Random smooth motions of a robot hand that a real hand could make, with pinches in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.collision import penetration_depths
from smooth_operator.hands.hand import Hand

KNOT_S: Final = 0.4
"""Time between two knots of the spline [s]; half of its inverse, 1.25 Hz, bounds the band."""
PINCH_SHARE: Final = 1 / 3
"""Share of the key poses in which the thumb meets a finger."""
PINCH_GAP: Final = 0.02
"""Tips closer than this are a pinch [m]."""
TOUCH: Final = 1e-3
"""Deepest overlap of a pose that a real hand could take [m]."""

_DRAWS: Final = 30  # key poses that are tried in turn where the way to one collides
_NARROWING: Final = 15  # of them, the last, come nearer and nearer to the pose before
_MOST_FINGERS: Final = 12  # a multiple of 2, 3 and 4: no finger is drawn more often
_STARTS: Final = 12  # random poses from which a pinch is searched
_STEPS: Final = 60
_NEAR: Final = 3e-3  # most that a step of the search closes a pinch [m]
_TURN: Final = 0.15  # most that a joint turns in a step of the search [rad]
_DAMPING: Final = 1e-6  # of the search [m^2]
_PROBE: Final = 1e-5  # of finite differences [rad]
_HALVINGS: Final = 8

# Uniform cubic B-spline: position in a segment -> weights of its four control points.
_BASIS: Final = (
    np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1, 3, -3, 1]])
    / 6.0
)


@dataclass(frozen=True, eq=False)
class JointMotion:
    """A motion of a hand's actuated joints.

    Attributes:
        stamps: (T,) from 0 [s].
        joints: (T, m) positions of the actuated joints [rad].
        pinches: how many key poses are pinches.
        deepest: deepest self-penetration [m]; None where the model has no shapes that collide.
    """

    stamps: Float[np.ndarray, " T"]
    joints: Float[np.ndarray, "T m"]
    pinches: int
    deepest: float | None

    @property
    def peak_speed(self) -> float:
        """Highest speed of a joint [rad/s]."""
        return float(np.abs(np.gradient(self.joints, self.stamps, axis=0)).max())


def joint_motion(
    hand: Hand, seed: int, *, duration: float = 8.0, rate_hz: float = 100.0
) -> JointMotion:
    """A random motion from the neutral pose, within the limits and free of self-collision.

    A uniform cubic B-spline with a knot each 0.4 s: twice continuously differentiable, within the
    limits since its control points are, and faster than 1.25 Hz in nothing. A third of the key
    poses are pinches of the thumb with each finger in turn, which the motion reaches exactly and
    holds for up to 0.4 s; the others are uniform within the limits. A key pose is drawn again
    where it or the way to it has parts of the hand more than a millimetre inside each other, as
    far as the model has shapes that collide.

    Args:
        hand: the robot hand.
        seed: of the random numbers.
        duration: length [s].
        rate_hz: frames a second [Hz].
    """
    rng = np.random.default_rng(seed)
    per_knot = round(KNOT_S * rate_hz)
    count = round(duration * rate_hz)
    segments = -(-count // per_knot)
    poses = _KeyPoses(hand, rng)
    control = [hand.neutral] * 4  # still for one segment
    pinches, deepest = 0, 0.0
    while len(control) < segments + 3:
        pinch = rng.random() < PINCH_SHARE and poses.can_pinch
        turn = int(rng.integers(_MOST_FINGERS))
        for draw in range(_DRAWS):
            key = poses.pinch(turn + draw) if pinch else poses.free()[0]
            # The last draws stay near the pose before, from where the way is free.
            share = min(1.0, (_DRAWS - 1 - draw) / _NARROWING)
            pinch = pinch and share == 1.0
            group = [control[-1] + share * (key - control[-1])]
            group *= int(rng.integers(3, 5) if pinch else rng.integers(1, 3))
            # And two more: that the motion can always rest where it is, so the last draw is free.
            depth = depth_of(hand, spline([*control[-3:], *group, group[-1], group[-1]], per_knot))
            if depth <= TOUCH:
                break
        control += group
        pinches += pinch
        deepest = max(deepest, depth)
    joints = spline(control, per_knot)[:count]
    seen = penetration_depths(hand, hand.full_configuration(joints[:1])) is not None
    return JointMotion(np.arange(count) / rate_hz, joints, pinches, deepest if seen else None)


def spline(control: list[np.ndarray], per_knot: int) -> Float[np.ndarray, "T m"]:
    """A uniform cubic B-spline.

    Args:
        control: control points, four at least; a segment for each four neighbours.
        per_knot: frames of each segment.

    Returns:
        (segments * per_knot, m) without the end of the last segment.
    """
    points = np.asarray(control)
    u = np.arange(per_knot) / per_knot
    weights = np.stack([np.ones_like(u), u, u**2, u**3], axis=1) @ _BASIS
    return np.concatenate([weights @ points[i : i + 4] for i in range(len(points) - 3)])


def depth_of(hand: Hand, joints: Float[np.ndarray, "T m"]) -> float:
    """Deepest self-penetration of some poses [m]; 0 where the model has no shapes that collide."""
    depths = penetration_depths(hand, hand.full_configuration(joints))
    return 0.0 if depths is None else float(depths.max())


class _KeyPoses:
    """Random poses of a hand that do not collide, and such in which the thumb meets a finger."""

    def __init__(self, hand: Hand, rng: np.random.Generator) -> None:
        self.hand, self._rng = hand, rng
        self._low, self._high = hand.limits.T
        found = [self._pinches(finger) for finger in range(1, len(hand.fingers))]
        self._found = [poses for poses in found if len(poses)]

    @property
    def can_pinch(self) -> bool:
        """Whether the thumb reaches a finger."""
        return bool(self._found)

    def free(self, count: int = 1) -> Float[np.ndarray, "k m"]:
        """Poses that do not collide, or the least bad of some."""
        poses = self._rng.uniform(self._low, self._high, (_DRAWS // 3 * count, len(self._low)))
        depths = penetration_depths(self.hand, self.hand.full_configuration(poses))
        worse = np.zeros(len(poses)) if depths is None else np.maximum(depths, TOUCH)
        chosen: np.ndarray = poses[np.argsort(worse, kind="stable")[:count]]
        return chosen

    def pinch(self, turn: int) -> Float[np.ndarray, " m"]:
        """A pose in which the thumb touches a finger, or comes as near as the hand lets it.

        Args:
            turn: which finger: those that the thumb reaches take turns.
        """
        poses = self._found[turn % len(self._found)]
        pose: np.ndarray = poses[self._rng.integers(len(poses))]
        return pose

    def _pinches(self, finger: int) -> Float[np.ndarray, "k m"]:
        """Poses in which the thumb pinches a finger; none where it stays 20 mm away.

        From random poses, damped Gauss-Newton steps bring the two tips together. The pose just
        before the first collision is taken: where it is that of the two pads, they touch. Kept is
        the half with the smallest gaps.

        Args:
            finger: index into ``hand.fingers``.
        """
        pose = self.free(_STARTS)
        path = [pose]
        for _ in range(_STEPS):
            apart, jacobian = self._gap(pose, finger)
            gap = np.linalg.norm(apart, axis=1, keepdims=True)
            wanted = -apart * np.minimum(1.0, _NEAR / np.maximum(gap, 1e-9))
            square = jacobian @ jacobian.transpose(0, 2, 1) + _DAMPING * np.eye(3)
            solved = np.linalg.solve(square, wanted[..., None])
            step = (jacobian.transpose(0, 2, 1) @ solved)[..., 0]
            step *= np.minimum(1.0, _TURN / np.maximum(np.abs(step).max(1, keepdims=True), 1e-9))
            pose = np.clip(pose + step, self._low, self._high)
            path.append(pose)
        found = self._touching(np.stack(path, axis=1))
        gaps = np.linalg.norm(self._gap(found, finger)[0], axis=1)
        order = np.argsort(gaps, kind="stable")[: _STARTS // 2]
        chosen: np.ndarray = found[order[gaps[order] < PINCH_GAP]]
        return chosen

    def _gap(self, pose: np.ndarray, finger: int) -> tuple[np.ndarray, np.ndarray]:
        """From the thumb's tip to the finger's, (b, 3) [m], and how joints move it, (b, 3, m)."""
        size = pose.shape[1]
        probes = np.concatenate([np.zeros((1, size)), _PROBE * np.eye(size)])
        tips = self.hand.tips(self.hand.full_configuration(pose[:, None] + probes))
        apart = tips[..., finger, :] - tips[..., 0, :]
        jacobian = (apart[:, 1:] - apart[:, :1]).transpose(0, 2, 1) / _PROBE
        return apart[:, 0], jacobian

    def _touching(self, paths: Float[np.ndarray, "k s m"]) -> Float[np.ndarray, "k m"]:
        """The last pose of each path before it collides; a path begins free of collision."""
        every = self.hand.full_configuration(paths.reshape(-1, paths.shape[-1]))
        depths = penetration_depths(self.hand, every)
        if depths is None:
            last: np.ndarray = paths[:, -1]
            return last
        collides = depths.reshape(paths.shape[:2]) > TOUCH
        first = np.where(collides.any(axis=1), collides.argmax(axis=1), paths.shape[1] - 1)
        row = np.arange(len(paths))
        free, inside = paths[row, np.maximum(first - 1, 0)], paths[row, first]
        for _ in range(_HALVINGS):
            middle = (free + inside) / 2
            depth = penetration_depths(self.hand, self.hand.full_configuration(middle))
            assert depth is not None  # it was not
            good = (depth <= TOUCH)[:, None]
            free, inside = np.where(good, middle, free), np.where(good, inside, middle)
        touching: np.ndarray = free
        return touching

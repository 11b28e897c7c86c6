"""The first stage: an answer to a frame without a compiled program, in NumPy.

It stands in for any method while that method's program compiles. What it minimises is a part of the
objective of ``smooth``: the keyvectors of the human hand with the weights of ``CloseTargets``,
fingertips where the human's are, direction and length of the thumb's, a pull to the neutral pose
and one to the last answer. Collisions, filters and latches are left to the method.

The derivatives are analytic and float64, and nothing here is traced, so the first frame takes as
long as any other. Figures: docs/reference/benchmarks.md, *Start*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.kinematics import KinematicTree
from smooth_operator.human.alignment import (
    MIN_CONDITION,
    AlignmentConfig,
    palm_alignment,
    palm_range,
)
from smooth_operator.human.palm_axes import human_palm_axes
from smooth_operator.io.anatomy import implausible
from smooth_operator.landmarks import FINGERS, TIPS, WRIST
from smooth_operator.objective.close_targets import CloseTargets
from smooth_operator.objective.keyvectors import KeyvectorLayout
from smooth_operator.objective.targets import base_weights
from smooth_operator.objective.terms.direction_length import DirectionLengthConfig
from smooth_operator.types import Status

_TARGETS: Final = CloseTargets()
_TRANSITION: Final = 0.02
"""Where smooth-L1 turns from quadratic to linear [m], as in ``ObjectiveConfig``."""
_PINCH: Final = DirectionLengthConfig()
_SHORT, _LEAST = 0.002, 0.25
"""Length by which a thumb vector is rounded [m], and the share of its curvature that is kept where
it points away, as in that term."""
_PLACE, _WIDTH = 40.0, 0.004
"""Weight and width [m] of the bounded cost of fingertips, as in ``FingertipPositionConfig``."""
_POSE: Final = 0.026
"""Weight of the pull to the neutral pose, that of ``smooth``."""
_VELOCITY: Final = 0.27
"""Weight of a change since the last answer, over 10 ms, that of ``smooth``."""
_REFERENCE: Final = 0.01
_SHORTEST, _LONGEST = 1e-3, 0.25
"""Times between frames that count as such [s]; outside, the last answer does not hold."""

_FIRST, _LATER = 40, 2
"""Trials of a frame without one before it, and of others."""
_ENOUGH: Final = 1e-4
"""A step that changes no joint by more ends the iteration [rad]."""
_TINY: Final = 1e-12


class StageAnswer(NamedTuple):
    """What the first stage says of a frame.

    Attributes:
        q: (m,) command of the actuated joints within their limits [rad]; None unless it is OK.
        status: whether the frame could be used.
        loss: weighted keyvector loss at q.
        scale: robot size over human size in this frame's alignment.
    """

    q: Float[np.ndarray, " m"] | None
    status: Status
    loss: float
    scale: float


class _Motion(NamedTuple):
    """(P, 3) points [m], and their (P, 3, m) derivatives by the actuated joints."""

    points: Float[np.ndarray, "P 3"]
    jacobian: Float[np.ndarray, "P 3 m"]


class _Goal(NamedTuple):
    """What a frame asks: (K, 3) vectors, (K,) weights, the last answer, the weight of a change."""

    vectors: Float[np.ndarray, "K 3"]
    weights: Float[np.ndarray, " K"]
    last: Float[np.ndarray, " m"]
    velocity: float


class _Near(NamedTuple):
    """Cost, gradient and Gauss-Newton Hessian at a pose; ``loss`` is that of the keyvectors."""

    cost: float
    loss: float
    gradient: Float[np.ndarray, " m"]
    hessian: Float[np.ndarray, "m m"]


@dataclass(frozen=True, eq=False)
class FirstStage:
    """The first stage for one hand; immutable.

    Attributes:
        hand: the robot hand.
        alignment: how landmarks reach the palm frame.
        needs: landmarks without which the method gives no command.
    """

    hand: Hand
    alignment: AlignmentConfig
    needs: tuple[int, ...]

    def __call__(
        self,
        landmarks: Float[np.ndarray, "21 3"],
        valid: Bool[np.ndarray, "21"],
        last: Float[np.ndarray, " m"] | None,
        dt: float,
    ) -> StageAnswer:
        """The answer to one frame.

        Args:
            landmarks: (21, 3) [m].
            valid: (21,) which of them are known.
            last: (m,) the answer before it [rad]; None where there is none.
            dt: time since then [s].
        """
        known = np.isfinite(landmarks).all(axis=1) & valid
        if not known[self._wanted].all():
            return StageAnswer(None, Status.INVALID_LANDMARKS, np.nan, np.nan)
        with np.errstate(all="ignore"):
            seen = np.where(known[:, None], landmarks, np.nan)
            palm = palm_alignment(seen, self.hand, self.alignment)
            if not float(palm.condition) >= MIN_CONDITION:
                return StageAnswer(None, Status.DEGENERATE_PALM, np.nan, float(palm.scale))
            if implausible(landmarks, known, self._palms):
                return StageAnswer(None, Status.IMPLAUSIBLE_HAND, np.nan, float(palm.scale))
            aligned = palm.apply(seen)
            operator = self.alignment.operator
            if operator is not None:
                axes = human_palm_axes(self.hand)
                aligned = operator.correct(aligned, palm.scale, self.hand, axes)
            q, loss = self._solved(self._goal(aligned, last, dt), first=last is None)
        if not np.isfinite(q).all():
            return StageAnswer(None, Status.SOLVER_FAILED, np.nan, float(palm.scale))
        return StageAnswer(q, Status.OK, loss, float(palm.scale))

    @cached_property
    def _palms(self) -> tuple[float, float]:
        return palm_range(self.hand)

    @cached_property
    def _wanted(self) -> list[int]:
        operator = self.alignment.operator
        corrected = () if operator is None else operator.needs(self.hand)
        return sorted({WRIST, *self._tips, *self.needs, *self.hand.align_indices, *corrected})

    @cached_property
    def _tips(self) -> list[int]:
        return [TIPS[FINGERS.index(name)] for name in self.hand.fingers]

    @cached_property
    def _layout(self) -> KeyvectorLayout:
        return KeyvectorLayout(self.hand.fingers)

    @cached_property
    def _incidence(self) -> Float[np.ndarray, "K F"]:
        """Keyvectors as sums of fingertips; the wrist is fixed."""
        rows = np.zeros((len(self._layout.pairs), len(self.hand.fingers) + 1))
        for k, (begin, end) in enumerate(self._layout.pairs):
            rows[k, end], rows[k, begin] = 1.0, -1.0
        return rows[:, 1:]

    @cached_property
    def _from_wrist(self) -> Float[np.ndarray, "K 3"]:
        begins = np.array([begin == 0 for begin, _ in self._layout.pairs])
        return np.where(begins[:, None], self.hand.wrist, 0.0)

    @cached_property
    def _kinematics(self) -> _Levels:
        return _Levels(self.hand.tree, self.hand.tip_names, self.hand.coupling_matrix)

    @cached_property
    def _base(self) -> list[Float[np.ndarray, " K"]]:
        return [base_weights(self._layout, *kind) for kind in np.eye(3).tolist()]

    def _goal(
        self,
        aligned: Float[np.ndarray, "21 3"],
        last: Float[np.ndarray, " m"] | None,
        dt: float,
    ) -> _Goal:
        human, policy = self._layout.human(aligned), _TARGETS
        length = np.sqrt((human * human).sum(-1) + _TINY)
        ratio = (policy.at**2 + policy.floor**2) / (length**2 + policy.floor**2)
        wrist, thumb, between = self._base
        weights = policy.w_wrist * wrist + policy.w_thumb * thumb * ratio ** (policy.focus / 2)
        weights = weights + policy.w_between * between * ratio ** (policy.focus_between / 2)
        pinches = self._layout.thumb
        longer = (length[pinches] ** 4 + policy.apart**4) ** 0.25 / length[pinches]
        vectors = human.copy()
        vectors[pinches] *= longer[:, None]
        holds = last is not None and dt <= _LONGEST
        velocity = _VELOCITY * _REFERENCE / max(dt, _SHORTEST) if holds else 0.0
        return _Goal(vectors, weights, self.hand.neutral if last is None else last, velocity)

    def _solved(self, goal: _Goal, first: bool) -> tuple[Float[np.ndarray, " m"], float]:
        """The pose of least cost near the last answer, by damped Gauss-Newton steps within the
        limits, and its keyvector loss."""
        low, high = self.hand.limits.T
        q = np.clip(goal.last, low, high)
        near, damping = self._near(q, goal), 0.0
        for _ in range(_FIRST if first else _LATER):
            at_end = ((q <= low) & (near.gradient > 0)) | ((q >= high) & (near.gradient < 0))
            free = np.flatnonzero(~at_end)
            if not len(free):
                break
            inner = near.hessian[np.ix_(free, free)]
            inner = inner + damping * np.diag(np.diag(inner)) + 1e-9 * np.eye(len(free))
            trial = q.copy()
            trial[free] -= np.linalg.solve(inner, near.gradient[free])
            trial = np.clip(trial, low, high)
            there = self._near(trial, goal)
            if there.cost <= near.cost:
                moved = np.abs(trial - q).max()
                q, near, damping = trial, there, damping / 10 if damping > 1e-3 else 0.0
                if moved < _ENOUGH:
                    break
            else:
                damping = max(10 * damping, 0.1)
        return q, near.loss

    def _near(self, q: Float[np.ndarray, " m"], goal: _Goal) -> _Near:
        """The objective at a pose."""
        motion, fingers = self._kinematics(self.hand.full_configuration(q)), len(self._tips)
        size = len(q)
        errors = self._incidence @ motion.points - self._from_wrist - goal.vectors
        slopes = np.tensordot(self._incidence, motion.jacobian, axes=1)
        weights = goal.weights[:, None]
        far = np.abs(errors)
        quadratic = far <= _TRANSITION
        each = np.where(quadratic, errors**2 / (2 * _TRANSITION), far - _TRANSITION / 2)
        loss = float((weights * each).sum())
        stiffness = weights / np.maximum(far, _TRANSITION)
        # fingertips, which are the first keyvectors
        squared = (errors[:fingers] ** 2).sum(-1)
        share = 1 / (1 + squared / _WIDTH**2)
        placed = _PLACE / _TRANSITION
        cost = loss + 0.5 * placed * float((squared * share).sum())
        stiffness[:fingers] += placed * (share**2)[:, None]
        rows = slopes.reshape(-1, size)
        weighted = rows * stiffness.reshape(-1, 1)
        gradient = weighted.T @ errors.reshape(-1)
        hessian = weighted.T @ rows
        thumb = self._layout.thumb
        pinch = _pinches(errors[thumb] + goal.vectors[thumb], goal.vectors[thumb])
        rows = slopes[thumb]
        cost += pinch.cost
        gradient = gradient + np.tensordot(pinch.gradient, rows, axes=2)
        weighted = pinch.hessian @ rows
        hessian = hessian + np.tensordot(rows, weighted, axes=((0, 1), (0, 1)))
        pull, change = q - self.hand.neutral, q - goal.last
        cost += _POSE * float(pull @ pull) + goal.velocity * float(change @ change)
        gradient = gradient + 2 * (_POSE * pull + goal.velocity * change)
        hessian = hessian + 2 * (_POSE + goal.velocity) * np.eye(size)
        return _Near(cost, loss, gradient, hessian)


class _Pinches(NamedTuple):
    """Cost of P vectors, (P, 3) gradient and (P, 3, 3) Hessian by them."""

    cost: float
    gradient: Float[np.ndarray, "P 3"]
    hessian: Float[np.ndarray, "P 3 3"]


def _pinches(vectors: Float[np.ndarray, "P 3"], targets: Float[np.ndarray, "P 3"]) -> _Pinches:
    """``direction_length_cost`` of ``smooth``, in NumPy."""
    wanted = np.sqrt((targets**2).sum(-1) + _TINY)
    size = np.sqrt((vectors**2).sum(-1) + _SHORT**2)
    goal, unit = targets / wanted[:, None], vectors / size[:, None]
    cosine = (goal * unit).sum(-1)
    turn = -(_PINCH.direction / size)[:, None] * (goal - cosine[:, None] * unit)
    along = unit[:, :, None] * unit[:, None, :]
    turn_weight = _PINCH.direction * np.maximum(cosine, _LEAST) / size**2
    slope = _PINCH.length / (1 + (wanted / _PINCH.near) ** 4)
    longer = size - wanted
    rounded = np.sqrt(longer**2 + _PINCH.huber_width**2)
    length_weight = slope / rounded
    return _Pinches(
        float((_PINCH.direction * (1 - cosine) + slope * (rounded - _PINCH.huber_width)).sum()),
        turn + (length_weight * longer)[:, None] * unit,
        turn_weight[:, None, None] * (np.eye(3) - along) + length_weight[:, None, None] * along,
    )


class _Levels:
    """Points of a tree and their derivatives, joints of one depth in one NumPy operation.

    Args:
        tree: the hand's joints.
        names: keypoints.
        coupling: (n, m) positions of all joints per position of the actuated ones.
    """

    def __init__(
        self, tree: KinematicTree, names: Sequence[str], coupling: Float[np.ndarray, "n m"]
    ) -> None:
        joints = tree.joints
        depth: list[int] = []
        for joint in joints:
            depth.append(0 if joint.parent < 0 else depth[joint.parent] + 1)
        levels = (np.flatnonzero(np.array(depth) == d) for d in range(max(depth, default=-1) + 1))
        self._levels = [
            (
                level + 1,
                np.array([joints[i].parent + 1 for i in level]),
                np.stack([joints[i].rotation for i in level]),
                np.stack([joints[i].translation for i in level]),
            )
            for level in levels
        ]
        self._offset = np.array([joint.offset for joint in joints])
        self._source = np.array([joint.source for joint in joints], int)
        self._slide = np.array([joint.slide for joint in joints], bool)
        points = [tree.keypoints[name] for name in names]
        self._at = np.array([point.joint + 1 for point in points])
        self._position = np.stack([point.position for point in points])
        moves = np.zeros((len(points), len(joints)))
        for row, point in zip(moves, points, strict=True):
            above = point.joint
            while above >= 0:
                row[above] = 1.0
                above = joints[above].parent
        self._turns = moves * ~self._slide
        self._slides = moves * self._slide
        self._coupling = coupling[self._source]

    def __call__(self, q_all: Float[np.ndarray, " n"]) -> _Motion:
        """Points and derivatives at a pose of all joints."""
        given = q_all[self._source]
        angle = np.where(self._slide, 0.0, given + self._offset)
        along = np.where(self._slide, given, 0.0)
        sine, cosine = np.sin(angle), np.cos(angle)
        turned = np.empty((len(given) + 1, 3, 3))  # the palm, then the joints
        place = np.empty((len(given) + 1, 3))
        turned[0], place[0] = np.eye(3), 0.0
        for level, parent, rotation, translation in self._levels:
            above = turned[parent]
            frame = above @ rotation
            s, c = sine[level - 1, None], cosine[level - 1, None]
            turned[level, :, 0] = c * frame[:, :, 0] + s * frame[:, :, 1]
            turned[level, :, 1] = c * frame[:, :, 1] - s * frame[:, :, 0]
            turned[level, :, 2] = frame[:, :, 2]
            place[level] = (
                place[parent]
                + (above @ translation[:, :, None])[:, :, 0]
                + frame[:, :, 2] * along[level - 1, None]
            )
        points = place[self._at] + (turned[self._at] @ self._position[:, :, None])[:, :, 0]
        axes = turned[1:, :, 2]
        arms = points[:, None] - place[None, 1:]
        ax, ay, az = axes.T
        x, y, z = np.moveaxis(arms, -1, 0)
        crossed = np.stack([ay * z - az * y, az * x - ax * z, ax * y - ay * x], axis=1)
        slopes = crossed * self._turns[:, None] + axes.T[None] * self._slides[:, None]
        return _Motion(points, slopes @ self._coupling)

"""The joint-angle method: a linear map from human joint angles to robot joints.

It has no search and no memory, so no lag and no wrong minima, but fingertip positions can differ
from the human's. Commands are clipped to the limits.

*The angles* are those of 21 landmarks, of a human hand or of a robot hand. They are signed, in
radians, and equal for a left hand and its mirror image. The palm has three directions: *distal* (to
the fingers), *radial* (to the thumb's side) and *palmar*.

Long fingers, from the three bones MCP-PIP, PIP-DIP, DIP-tip:

- ``*_mcp_abduction``: direction of the plane in which the finger bends, seen along *palmar*, from
  *distal* towards *radial*. The bones, projected along *palmar*, lie close to a line, whose
  direction follows from their second moments. If nearly all bones point along *palmar*, there is no
  line, and the angle goes smoothly to zero.
- ``*_mcp``: angle of the first bone from *distal*, in that plane, towards *palmar* (flexion).
- ``*_pip``, ``*_dip``: angle between a bone and the previous one, in that plane (flexion).

Thumb, from the three bones CMC-MCP, MCP-IP, IP-tip:

- ``thumb_flexion``, ``thumb_abduction``: direction from the CMC joint to the tip, as the rotation
  vector from *distal*: flexion towards the little finger's side about *palmar*, abduction away
  from the palm about *radial*. The direction to the tip is used, not that of the metacarpal,
  because human and robot thumbs differ most in the relative lengths of their bones.
- ``thumb_mcp``, ``thumb_ip``: angle between a bone and the previous one, in the plane of the
  metacarpal and the direction to the base of the little finger, 27 degrees distal of ulnar, in
  which a thumb flexes (Kapandji 1986).

*The map* has a row for each joint: position = offset + sum of gain x angle. Rows that are not in a
hand's description are measured on the robot: its landmarks have the same angles as a human hand, so
the map is fitted to give equal angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import ModuleType
from typing import Any, Final, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.geometry import AnyArray, AnyKind, array_namespace
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.spec import JointMap
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, NUM_LANDMARKS, WRIST
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.method import Method, MethodConfig, MethodOutput
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator.retargeting.palm import PalmAxes, human_palm_axes, unit_vectors
from smooth_operator.retargeting.sbr.published import ObjectiveConfig, PlainTargets
from smooth_operator.retargeting.sbr.sampled import SampledObjective


class JointAngleMap:
    """Map from aligned landmarks to joint positions, for one robot hand.

    Attributes:
        hand: the robot hand.
        rows: the map, a row for each actuated joint; ``str()`` of this object prints it.
        axes: axes of the human palm in the palm frame.
        needs: human landmarks that the map uses.

    Raises:
        HandModelError: a finger lacks landmarks, and its joints have no rows in the hand's
            description.
        UnknownNameError: such a row names an unknown joint or angle.
    """

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        self.rows: tuple[JointMap, ...] = joint_map(hand)
        self.axes: PalmAxes[np.ndarray] = human_palm_axes(hand)
        self._gains, self._offsets = map_matrix(self.rows)
        used = np.abs(self._gains).reshape(len(self.rows), len(BASES), 4).sum(axis=(0, 2)) > 0
        self.needs: tuple[int, ...] = tuple(
            base + i for base, use in zip(BASES, used, strict=True) if use for i in range(4)
        )

    def positions(self, aligned: Float[AnyKind, "*batch 21 3"]) -> Float[AnyKind, "*batch m"]:
        """Computes (..., m) positions of the actuated joints within their limits [rad] from (...,
        21, 3) landmarks in the palm frame [m]. The landmarks in ``needs`` must be finite. For NumPy
        and JAX."""
        xp = array_namespace(aligned)
        angles = joint_angles(aligned, self.axes)
        # Landmarks outside ``needs`` may be NaN, and 0 x NaN is NaN.
        angles = xp.where(xp.isfinite(angles), angles, 0)
        gains, offsets, low, high = (
            xp.asarray(a, angles.dtype) for a in (self._gains.T, self._offsets, *self.hand.limits.T)
        )
        q: AnyKind = xp.clip(angles @ gains + offsets, low, high)
        return q


@dataclass(frozen=True)
class JointAngleConfig(MethodConfig):
    """Settings of the joint-angle method. The map itself is part of the hand's description.

    Attributes:
        alignment: alignment of human landmarks to the palm frame; its scale changes no angle.
    """

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)

    def build(self, hand: Hand) -> JointAngle:
        """Builds the method for one hand. Raises the same errors as ``JointAngleMap``."""
        method = JointAngle(hand, self)
        _ = method.map  # raises its errors here
        return method


class JointAngleState(NamedTuple):
    """State of the joint-angle method: the (m,) last command [rad], which is held while the hand is
    lost. The next command does not depend on it."""

    q: Float[Array, " m"]


@dataclass(frozen=True, eq=False)
class JointAngle(Method):
    """The joint-angle method for one hand."""

    hand: Hand
    config: JointAngleConfig

    @cached_property
    def map(self) -> JointAngleMap:
        """The map from human joint angles to joint positions of this hand."""
        return JointAngleMap(self.hand)

    @cached_property
    def objective(self) -> SampledObjective:
        """Objective from which only the tracking loss is computed; the method minimises nothing."""
        return SampledObjective(self.hand, ObjectiveConfig(targets=PlainTargets()))

    @cached_property
    def needs(self) -> tuple[int, ...]:
        """Indices of the landmarks of the mapped fingers, and of the landmarks of the
        keyvectors."""
        return tuple(sorted({*self.map.needs, *self.objective.layout.landmarks}))

    def init(self, seed: int) -> JointAngleState:
        """State with the neutral pose; the method uses no random numbers."""
        return JointAngleState(jnp.asarray(self.hand.neutral, jnp.float32))

    def step(
        self, state: JointAngleState, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[JointAngleState, MethodOutput]:
        """Computes one frame; see ``Method.step``."""
        del ticks
        q = self.map.positions(aligned)
        layout = self.objective.layout
        policy = self.objective.config.targets
        targets, _ = policy(policy.init(layout), layout, layout.human(aligned))
        goal = FrameGoal(targets.vectors, targets.weights, state.q, 0.0)
        return JointAngleState(q), MethodOutput(q, self.objective.tracking(list(q), goal))


JOINT_ANGLE_PRESETS: Final = {"default": JointAngleConfig()}


_POSES = 128  # number of poses for the median effect of a joint on the angles
_STEP = 1e-5  # finite difference, relative to a joint's range
_UNSEEN = 0.05  # smallest singular value that counts, relative to the largest
_SLIGHT = 0.1  # smallest gain that counts, relative to the largest of its row


def joint_map(hand: Hand) -> tuple[JointMap, ...]:
    """Rows of the joint-angle map for all actuated joints, in the order of the joints.

    Rows of the hand's description are used unchanged. The others are derived: the effects of each
    joint on each angle, as medians over poses across the joints' ranges, form a matrix, and its
    pseudo-inverse gives the gains. Joints that move the same angles, as at a thumb's base, share
    them; a joint that bends two phalanges follows both by least squares. The offset maps the
    neutral pose's angles to that pose. A joint that moves no angle stays neutral.

    Raises:
        HandModelError: a joint without a row moves a finger without all four landmarks.
        UnknownNameError: a row names an unknown joint or angle.
    """
    rows = {row.joint: row for row in hand.spec.joint_map}
    for name, row in rows.items():
        if name not in hand.actuated_names:
            raise UnknownNameError("actuated joint", name, hand.actuated_names)
        for angle in row.gains:
            if angle not in JOINT_ANGLES:
                raise UnknownNameError("joint angle", angle, JOINT_ANGLES)
    _check_landmarks(hand, set(rows))
    if len(rows) == len(hand.actuated_names):
        return tuple(rows[name] for name in hand.actuated_names)
    gains, offsets = _derived(hand)
    return tuple(
        rows.get(name)
        or JointMap(
            name,
            offset=round(float(offset), 4),
            gains={a: round(float(g), 4) for a, g in zip(JOINT_ANGLES, row, strict=True) if g},
        )
        for name, offset, row in zip(hand.actuated_names, offsets, gains, strict=True)
    )


def robot_joint_angles(
    hand: Hand, q: Float[np.ndarray, "*batch m"], axes: PalmAxes[np.ndarray]
) -> Float[np.ndarray, "*batch 20"]:
    """(..., 20) angles ``JOINT_ANGLES`` of a robot hand [rad], for positions of its actuated joints
    [rad] and the axes of ``human_palm_axes``; NaN for fingers without all four landmarks."""
    landmarks = np.full((*q.shape[:-1], NUM_LANDMARKS, 3), np.nan)
    landmarks[..., [LANDMARKS.index(n) for n in hand.tree.names], :] = hand.landmark_positions(q)
    return joint_angles(landmarks, axes)


def map_matrix(
    rows: Sequence[JointMap],
) -> tuple[Float[np.ndarray, "m 20"], Float[np.ndarray, " m"]]:
    """Converts the rows of a map to arrays of gains and offsets."""
    gains = [[row.gains.get(angle, 0.0) for angle in JOINT_ANGLES] for row in rows]
    return np.array(gains), np.array([row.offset for row in rows])


def _derived(hand: Hand) -> tuple[Float[np.ndarray, "m 20"], Float[np.ndarray, " m"]]:
    """Measures the gains and offsets of a hand; see ``joint_map``."""
    axes, (low, high) = human_palm_axes(hand), hand.limits.T
    half = (high - low) / 2  # scales slides [m] and hinges [rad] alike
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    steps = _STEP * np.diag(half)[:, None]
    turns = robot_joint_angles(hand, poses + steps, axes) - robot_joint_angles(
        hand, poses - steps, axes
    )
    turns -= 2 * np.pi * np.round(turns / (2 * np.pi))
    effect = np.median(turns, axis=1) / (2 * _STEP)
    effect = np.nan_to_num(effect)  # NaN for fingers without landmarks, whose joints have rows
    gains = half[:, None] * np.linalg.pinv(effect.T, rcond=_UNSEEN)
    greatest = np.abs(gains).max(axis=1, keepdims=True)
    gains = np.where(np.abs(gains) > _SLIGHT * greatest, gains, 0.0)
    at_neutral = np.nan_to_num(robot_joint_angles(hand, hand.neutral, axes))
    return gains, hand.neutral - gains @ at_neutral


def _check_landmarks(hand: Hand, joints_mapped: set[str]) -> None:
    lacking = {
        finger.name: [
            LANDMARKS[BASES[FINGERS.index(finger.name)] + i]
            for i, point in enumerate(finger.points)
            if point is None
        ]
        for finger in hand.spec.fingers
    }
    for finger, points in lacking.items():
        joints = [name for name in _joints_of(hand, finger) if name not in joints_mapped]
        if points and joints:
            raise HandModelError(
                f"hand {hand.name!r}: joint angles of the {finger} can't be measured without "
                f"the points {points}, so they can't be mapped to its joints {joints}; add "
                "all four points of the finger to the description, or a JointMap row for "
                "each of these joints to HandSpec.joint_map"
            )


def _joints_of(hand: Hand, finger: str) -> list[str]:
    """Actuated joints that move some landmark of a finger."""
    moving: set[int] = set()
    for i in range(4):
        keypoint = hand.tree.keypoints.get(LANDMARKS[BASES[FINGERS.index(finger)] + i])
        joint = -1 if keypoint is None else keypoint.joint
        while joint >= 0:
            moving.add(hand.tree.joints[joint].source)
            joint = hand.tree.joints[joint].parent
    drives = np.abs(hand.transmission.matrix[sorted(moving)]).sum(axis=0) > 0
    return [name for name, drive in zip(hand.actuated_names, drives, strict=True) if drive]


JOINT_ANGLES: Final = (
    "thumb_flexion",
    "thumb_abduction",
    "thumb_mcp",
    "thumb_ip",
    *(
        f"{finger}_{angle}"
        for finger in FINGERS[1:]
        for angle in ("mcp_abduction", "mcp", "pip", "dip")
    ),
)
"""Names of the 20 angles, four to a finger, thumb first. Flexion is positive, and so are finger
abduction towards the thumb and thumb abduction away from the palm."""

NUM_JOINT_ANGLES: Final = len(JOINT_ANGLES)

_THUMB_FLEXES_TOWARDS = np.array([0.5, -1.0, 0.0])  # distal, radial, palmar
_PRIOR = 1.5  # sum of squared projected bones (at most 3) below which abduction goes to zero


def joint_angles(landmarks: AnyKind, axes: PalmAxes[Any]) -> Float[AnyKind, "*batch 20"]:
    """(..., 20) angles ``JOINT_ANGLES`` of a hand in (-pi, pi] [rad]; NaN for fingers with a NaN.

    Args:
        landmarks: (..., 21, 3) landmarks [m]; the wrist is not used.
        axes: axes of the palm: its own (``palm_axes``), or constant axes of the frame to which the
            landmarks are aligned.
    """
    xp = array_namespace(landmarks)
    batch = landmarks.shape[:-2]
    fingers = landmarks[..., 1:, :].reshape(*batch, 5, 4, 3)
    basis = xp.stack([xp.asarray(axis, landmarks.dtype) for axis in axes], axis=-1)
    rays = xp.concatenate(
        [fingers[..., 1:, :] - fingers[..., :-1, :], fingers[..., 3:, :] - fingers[..., :1, :]],
        axis=-2,
    )  # (..., 5, 3 bones and base to tip, 3)
    components = unit_vectors(xp.einsum("...fbi,...ic->...fbc", rays, basis), xp)
    thumb = _thumb(components[..., 0, :, :], xp)
    angles = xp.concatenate([thumb[..., None, :], _long(components[..., 1:, :3, :], xp)], axis=-2)
    return angles.reshape(*batch, NUM_JOINT_ANGLES)  # type: ignore[no-any-return]


def _long(bones: AnyArray, xp: ModuleType) -> AnyArray:
    """(..., 4, 4) angles of the long fingers, from (..., 4, 3 bones, 3 directions) unit vectors."""
    distal, radial, palmar = (bones[..., i] for i in range(3))
    along, across = distal * distal, radial * radial
    prior = xp.maximum(_PRIOR - (along + across).sum(axis=-1), 0)
    # Principal axis of the projected bones. Half of a double angle does not change if a bone points
    # back, as in a fist.
    abduction = 0.5 * xp.arctan2(
        2 * (distal * radial).sum(axis=-1), (along - across).sum(axis=-1) + prior
    )
    ahead = distal * xp.cos(abduction)[..., None] + radial * xp.sin(abduction)[..., None]
    slope = xp.arctan2(palmar, ahead)
    bends = _wrapped(slope[..., 1:] - slope[..., :-1], xp)
    out: AnyArray = xp.concatenate([abduction[..., None], slope[..., :1], bends], axis=-1)
    return out


def _thumb(rays: AnyArray, xp: ModuleType) -> AnyArray:
    """(..., 4) angles of the thumb, from (..., 3 bones and base to tip, 3 directions) unit
    vectors."""
    distal, radial, palmar = (rays[..., 3, i] for i in range(3))
    sine = xp.sqrt(radial * radial + palmar * palmar)
    small = sine < 1e-6  # angle / sine is 1 there, not 0 / 0
    stretch = xp.where(small, 1.0, xp.arctan2(sine, distal) / xp.where(small, 1.0, sine))
    towards = xp.asarray(_THUMB_FLEXES_TOWARDS, rays.dtype)
    axis = unit_vectors(
        xp.cross(rays[..., 0, :], xp.broadcast_to(towards, rays[..., 0, :].shape)), xp
    )
    before, after = rays[..., :2, :], rays[..., 1:3, :]
    bends = xp.arctan2(
        (axis[..., None, :] * xp.cross(before, after)).sum(axis=-1), (before * after).sum(axis=-1)
    )
    ray = xp.stack([-radial * stretch, palmar * stretch], axis=-1)
    out: AnyArray = xp.concatenate([ray, bends], axis=-1)
    return out


def _wrapped(angle: AnyArray, xp: ModuleType) -> AnyArray:
    turns: AnyArray = xp.round(angle / (2 * np.pi))
    return angle - 2 * np.pi * turns


_TURN: Final = np.pi / 8 - np.pi / 2
"""Rotation of the palm frame about its normal [rad]: from the index finger's ray to its y axis."""

_MAP: Final = {
    "thumb_base2cmc": ("thumb", 1, "z", -1.0),
    "thumb_cmc2mcp": ("thumb", 1, "x", -1.0),
    "thumb_mcp2pp": ("thumb", 2, "z", -1.0),
    "thumb_pp2dp_actuated": ("thumb", 3, "z", -1.0),
    "index_base2mcp": ("index", 1, "z", -1.0),
    "index_mcp2pp": ("index", 1, "x", -1.0),
    "index_pp2mp": ("index", 2, "x", -0.5),
    "middle_base2mcp": ("middle", 1, "z", -1.0),
    "middle_mcp2pp": ("middle", 1, "x", -1.0),
    "middle_pp2mp": ("middle", 2, "x", -0.5),
    "ring_base2mcp": ("ring", 1, "z", 1.0),
    "ring_mcp2pp": ("ring", 1, "x", -1.0),
    "ring_pp2mp": ("ring", 2, "x", -0.5),
    "pinky_base2mcp": ("pinky", 1, "z", 1.0),
    "pinky_mcp2pp": ("pinky", 1, "x", -1.0),
    "pinky_pp2mp": ("pinky", 2, "x", -0.5),
}
"""Maps actuated joints to finger, bone (0 from the wrist to the finger's base), Euler angle, and
gain."""


class PublishedAngles:
    """Joint-angle map of the authors of the Smooth Operator paper, which provides the starting
    point of their hybrid baseline.

    Each finger is a chain of frames from the wrist, with y axes along the bones and x axes as close
    as possible to those of the parent. A joint of the mimic P0.50 hand follows one Euler angle of
    one frame; a joint that drives another one takes half of the angle.

    Attributes:
        needs: human landmarks that the map uses: all 21.

    Args:
        hand: the robot hand, for which ``fits`` is True.
    """

    needs: tuple[int, ...] = tuple(range(NUM_LANDMARKS))

    def __init__(self, hand: Hand) -> None:
        self.hand = hand

    @staticmethod
    def fits(hand: Hand) -> bool:
        """True if the hand's actuated joints are those of the map."""
        return set(hand.actuated_names) == set(_MAP)

    def positions(self, aligned: Float[Array, "21 3"]) -> Float[Array, " m"]:
        """(m,) positions of the actuated joints within their limits [rad], for (21, 3) finite
        landmarks in any frame [m]; traceable."""
        angles = _chain_angles(aligned)
        rows = [_MAP[name] for name in self.hand.actuated_names]
        picked = [
            gain * angles[axis][FINGERS.index(finger), bone] for finger, bone, axis, gain in rows
        ]
        low, high = (jnp.asarray(side, aligned.dtype) for side in self.hand.limits.T)
        return jnp.clip(jnp.stack(picked), low, high)


def _chain_angles(landmarks: Float[Array, "21 3"]) -> dict[str, Float[Array, "5 4"]]:
    """Euler angles (about fixed x, y, z, in this order) of each bone's frame in its parent's."""
    points = landmarks - landmarks[WRIST]
    ray = unit_vectors(points[BASES[1]], jnp)
    normal = unit_vectors(jnp.cross(ray, points[BASES[4]]), jnp)
    palm = jnp.stack([ray, jnp.cross(normal, ray), normal], axis=-1)
    cosine, sine = np.cos(_TURN), np.sin(_TURN)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]) @ np.diag([-1, 1, -1])
    points = points @ palm @ jnp.asarray(turn, landmarks.dtype)
    chain = jnp.asarray([[base + i for i in range(4)] for base in BASES])
    before = jnp.concatenate([jnp.zeros_like(chain[:, :1]), chain[:, :-1]], axis=1)
    bones = points[chain] - points[before]  # (5, 4, 3)
    frame = jnp.broadcast_to(jnp.eye(3, dtype=landmarks.dtype), (len(BASES), 3, 3))
    turns = []
    for i in range(4):
        y = unit_vectors(jnp.einsum("fij,fi->fj", frame, bones[:, i]), jnp)
        z = jnp.stack([jnp.zeros_like(y[:, 0]), -y[:, 2], y[:, 1]], axis=-1)  # x cross y
        z = unit_vectors(z, jnp)
        local = jnp.stack([jnp.cross(y, z), y, z], axis=-1)
        frame = frame @ local
        turns.append(local)
    local = jnp.stack(turns, axis=1)  # (5, 4, 3, 3)
    return {
        "x": jnp.arctan2(local[..., 2, 1], local[..., 2, 2]),
        "z": jnp.arctan2(local[..., 1, 0], local[..., 0, 0]),
    }

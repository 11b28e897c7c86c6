"""A loaded robot hand: joints, limits, couplings, neutral pose, landmarks, kinematics."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hands.kinematics import KinematicTree, build_tree
from smooth_operator.hands.loading import driven_joints, load_model, merged_couplings
from smooth_operator.hands.spec import Coupling, HandSpec, Point
from smooth_operator.hands.transmission import (
    Transmission,
    build_transmission,
    leader_range,
)
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, TIPS, WRIST

_SHAPES: Final = (
    "body_parentid",
    "body_pos",
    "body_quat",
    "geom_bodyid",
    "geom_type",
    "geom_size",
    "geom_pos",
    "geom_quat",
    "geom_aabb",
    "geom_margin",
    "geom_contype",
    "geom_conaffinity",
    "mesh_vert",
    "exclude_signature",
)
"""Arrays of a model that determine its possible contacts."""


@dataclass(frozen=True, eq=False)
class Hand:
    """A robot hand, ready for retargeting.

    Attributes:
        spec: description of the hand.
        model: compiled MuJoCo model; it may hold more than the hand, such as an arm.
        joint_names: (n,) names of all joints below the palm, in the model's order.
        actuated: (m,) indices of the commanded joints in ``joint_names``, in the model's order.
        couplings: joints that follow another joint of the hand.
        limits: (m, 2) limits of the actuated joints [rad], within which coupled joints keep theirs.
        neutral: (m,) neutral pose of the actuated joints [rad].
        tree: kinematics of the hand's landmarks in the palm frame.
        transmission: positions of all joints as a function of the actuated ones.
        unreadable: names of bodies whose colliding shapes could not be read.
        why: problem of the meshes that were left out, with advice; empty if there are none.
    """

    spec: HandSpec
    model: mujoco.MjModel
    joint_names: tuple[str, ...]
    actuated: tuple[int, ...]
    couplings: tuple[Coupling, ...]
    limits: Float[np.ndarray, "m 2"]
    neutral: Float[np.ndarray, " m"]
    tree: KinematicTree
    transmission: Transmission
    unreadable: tuple[str, ...] = ()
    why: str = ""

    def __repr__(self) -> str:
        return (
            f"<Hand {self.name!r}: {self.spec.side}, {len(self.fingers)} fingers, "
            f"{len(self.joint_names)} joints, {len(self.actuated)} actuated>"
        )

    @property
    def name(self) -> str:
        """Name of the hand, as in ``hands list``."""
        return self.spec.name

    @property
    def fingers(self) -> tuple[str, ...]:
        """Human finger names, thumb first."""
        return tuple(finger.name for finger in self.spec.fingers)

    @property
    def actuated_names(self) -> tuple[str, ...]:
        """Names of the commanded joints."""
        return tuple(self.joint_names[i] for i in self.actuated)

    @property
    def tip_names(self) -> tuple[str, ...]:
        """Keypoint names of the fingertips, thumb first."""
        return tuple(LANDMARKS[TIPS[FINGERS.index(finger)]] for finger in self.fingers)

    @cached_property
    def bodies(self) -> Bool[np.ndarray, " nbody"]:
        """(nbody,) mask of the hand's bodies in the model."""
        return own_bodies(self.model, self.model.body(self.spec.palm).id)

    def qpos(self, q_all: ArrayLike) -> Float[np.ndarray, "*batch nq"]:
        """Converts (..., n) positions of all joints of the hand [rad] to positions of the whole
        model. Joints that are not part of the hand stay at their reference positions."""
        q_all = np.asarray(q_all, float)
        qpos = np.tile(np.asarray(self.model.qpos0, float), (*q_all.shape[:-1], 1))
        qpos[..., self._addresses] = q_all
        return qpos

    @cached_property
    def _addresses(self) -> list[int]:
        return [int(self.model.joint(name).qposadr[0]) for name in self.joint_names]

    @property
    def torques(self) -> Float[np.ndarray, " m"]:
        """(m,) torque limits of the actuated joints' motors [N m]; NaN if unknown."""
        limits = self.spec.torque
        if not isinstance(limits, Mapping):
            return np.full(len(self.actuated), np.nan if limits is None else limits)
        return np.array([limits.get(name, np.nan) for name in self.actuated_names])

    @cached_property
    def wrist(self) -> Float[np.ndarray, "3"]:
        """The wrist landmark in the palm frame [m]."""
        return self._fixed(LANDMARKS[WRIST])

    @cached_property
    def straight_pose(self) -> StraightPose:
        """The pose nearest to neutral in which all fingers reach furthest from their bases, found
        by coordinate searches. Joints that do not extend the reach, or that move a knuckle
        (``knuckle_joints``), stay at neutral."""
        q = self.neutral.copy()
        extending = np.flatnonzero(~knuckle_joints(self))
        for _ in range(_ROUNDS):
            for joint in extending:
                low, high = self.limits[joint]
                trial = np.tile(q, (_STEPS + 1, 1))
                trial[1:, joint] = np.linspace(low, high, _STEPS)
                total = np.linalg.norm(finger_rays(self, trial), axis=-1).sum(axis=-1)
                best = int(np.argmax(total))
                if total[best] > total[0] + _GAIN:
                    q = trial[best]
        directions = finger_rays(self, q)
        return StraightPose(q, np.linalg.norm(directions, axis=-1), directions)

    @cached_property
    def align_indices(self) -> tuple[int, ...]:
        """Indices of the human landmarks that the alignment uses."""
        return tuple(
            WRIST if name == "wrist" else BASES[FINGERS.index(name)] for name in self.spec.align
        )

    @cached_property
    def align_points(self) -> Float[np.ndarray, "a 3"]:
        """The robot's counterparts of ``align_indices`` in the neutral pose, palm frame [m]."""
        at = dict(zip(self.tree.names, self.landmark_positions(self.neutral), strict=True))
        return np.stack([at[LANDMARKS[i]] for i in self.align_indices])

    @cached_property
    def joint_limits(self) -> Float[np.ndarray, "n 2"]:
        """(n, 2) limits of all joints [rad], coupled ones included; infinite if unlimited."""
        return self.tree.limits

    def full_configuration(self, q: ArrayLike) -> Float[np.ndarray, "*batch n"]:
        """(..., n) positions of all joints [rad] in the order of ``joint_names``, from (..., m)
        positions of the actuated joints [rad]."""
        return self.transmission.positions(q)

    def full_configuration_rows(self, q: Sequence[Array]) -> list[Array]:
        """``full_configuration`` from m arrays of one shape (batch last), in a compiled program."""
        return self.transmission.rows(q)

    def landmark_positions(self, q: ArrayLike) -> Float[np.ndarray, "*batch k 3"]:
        """(..., k, 3) landmarks in the palm frame [m] in the order of ``tree.names``, at (..., m)
        positions of the actuated joints [rad]; on the host in float64."""
        return np.asarray(self.tree.positions(self.full_configuration(q)))

    def tips(self, q_all: ArrayLike) -> Float[np.ndarray, "*batch f 3"]:
        """(..., f, 3) fingertips in the palm frame [m], thumb first, at (..., n) positions of all
        joints [rad]."""
        points = np.asarray(self.tree.positions(np.asarray(q_all, float)))
        return points[..., [self.tree.names.index(name) for name in self.tip_names], :]

    def _fixed(self, name: str) -> Float[np.ndarray, "3"]:
        keypoint = self.tree.keypoints[name]
        if keypoint.joint >= 0:
            raise HandModelError(
                f"landmark {name!r} of hand {self.name!r} must be fixed to the palm"
            )
        return keypoint.position


def load_hand_spec(spec: HandSpec) -> Hand:
    """Loads a hand from its description.

    Raises:
        HandModelError: the model can't be used, or the description does not match it.
        UnknownNameError: the description names a body or joint that the model lacks.
    """
    loaded = load_model(spec.model, mirror=spec.mirror)
    model = loaded.model
    couplings = merged_couplings(loaded.couplings, spec.couplings)
    palm = _body(model, spec.palm)
    own = own_joints(model, palm)
    tree = build_tree(model, palm, landmark_points(model, spec), own)
    every = tuple(model.joint(j).name for j in range(model.njnt))
    torques = spec.torque if isinstance(spec.torque, Mapping) else {}
    coupled = [name for one in couplings for name in (one.joint, one.follows)]
    for name in [*spec.neutral, *torques, *coupled, *spec.wrist_joints]:
        if name not in every:
            raise UnknownNameError("joint", name, every)
    names = tuple(every[j] for j in own)
    couplings = tuple(coupling for coupling in couplings if coupling.joint in names)
    followers = {coupling.joint for coupling in couplings}
    commanded = _commanded(model, own, tree)
    actuated = tuple(i for i, j in enumerate(own) if j in commanded and names[i] not in followers)
    if not actuated:
        raise HandModelError(f"hand {spec.name!r} has no joint that can be commanded")
    held = {name: float(model.joint(name).qpos0[0]) for name in every if name not in names}
    transmission = build_transmission(names, actuated, couplings, held)
    limits = _limits(names, actuated, transmission, tree.limits)
    neutral = np.clip(
        [spec.neutral.get(names[j], 0.0) for j in actuated], limits[:, 0], limits[:, 1]
    )
    within = tuple(coupling for coupling in couplings if coupling.follows in names)
    return Hand(
        spec,
        model,
        names,
        actuated,
        within,
        limits,
        neutral,
        tree,
        transmission,
        loaded.unreadable,
        loaded.why,
    )


def fingerprint(hand: Hand) -> str:
    """Digest of the hand's data that a compiled program depends on; the name is not part of it."""
    tree = hand.tree
    digest = hashlib.sha256()
    parts: list[object] = [
        hand.spec.side,
        hand.fingers,
        hand.align_indices,
        hand.actuated_names,
        hand.joint_names,
        hand.unreadable,
        tuple(tree.names),
        [(j.parent, j.offset, j.source, j.slide) for j in tree.joints],
        [(name, point.joint) for name, point in tree.keypoints.items()],
        [(m.joint, m.offset, sorted(m.gains.items())) for m in hand.spec.joint_map],
    ]
    arrays = [
        hand.limits,
        hand.neutral,
        hand.transmission.matrix,
        hand.transmission.offset,
        *(np.array([i, *curve]) for i, curve in sorted(hand.transmission.curves.items())),
        tree.limits,
        hand.align_points,
        *(j.rotation for j in tree.joints),
        *(j.translation for j in tree.joints),
        *(point.position for point in tree.keypoints.values()),
        # hands of equal kinematics may differ in their shapes, and so in self-collision
        *(getattr(hand.model, name) for name in _SHAPES),
    ]
    digest.update(repr(parts).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array, np.float64).tobytes())
    return digest.hexdigest()


def tree_with(hand: Hand, points: Mapping[str, tuple[int, np.ndarray]]) -> KinematicTree:
    """Kinematics of a hand's landmarks and of additional points, which are given as name -> (body
    of the model, (3,) position in it [m])."""
    palm = _body(hand.model, hand.spec.palm)
    every = {**points, **landmark_points(hand.model, hand.spec)}
    return build_tree(hand.model, palm, every, own_joints(hand.model, palm))


def landmark_points(model: mujoco.MjModel, spec: HandSpec) -> dict[str, tuple[int, np.ndarray]]:
    """Landmarks of a hand's description, as name -> (body, (3,) position in its frame [m]). Raises
    UnknownNameError if the model lacks the body of a landmark."""
    points = {LANDMARKS[WRIST]: spec.wrist}
    for finger in spec.fingers:
        first = BASES[FINGERS.index(finger.name)]
        points |= {LANDMARKS[first + i]: p for i, p in enumerate(finger.points) if p is not None}
    return {
        name: _at(model, point.mirrored if spec.mirror else point) for name, point in points.items()
    }


def _commanded(model: mujoco.MjModel, own: tuple[int, ...], tree: KinematicTree) -> set[int]:
    """The hand's joints with an actuator, or all joints of a hand without actuators; without joints
    that turn endlessly and move no landmark, such as a knob."""
    moving = {own[joint.source] for joint in tree.joints}
    endless = {j for j in own if not model.jnt_limited[j]} - moving
    return (driven_joints(model) & set(own) or set(own)) - endless


def _limits(
    names: tuple[str, ...],
    actuated: tuple[int, ...],
    transmission: Transmission,
    all_limits: np.ndarray,
) -> np.ndarray:
    """Limits of the actuated joints, narrowed so that no follower leaves its own."""
    matrix, offset = transmission.matrix, transmission.offset
    limits = all_limits[list(actuated)].copy()
    for i, (weights, constant) in enumerate(zip(matrix, offset, strict=True)):
        (used,) = np.nonzero(weights)
        if i in transmission.curves:
            (k,) = used
            limits[k] = leader_range(transmission.curves[i], limits[k], all_limits[i])
        elif len(used) == 1:
            k = used[0]
            ends = np.sort((all_limits[i] - constant) / weights[k])
            limits[k] = max(limits[k, 0], ends[0]), min(limits[k, 1], ends[1])
    for j, (low, high) in zip(actuated, limits, strict=True):
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise HandModelError(
                f"joint '{names[j]}' has the limits [{low:g}, {high:g}]; expected a finite "
                "range, lower limit first (check the model's range and its coupled joints)"
            )
    return limits


def _body(model: mujoco.MjModel, name: str) -> int:
    try:
        return int(model.body(name).id)
    except KeyError:
        bodies = [model.body(i).name for i in range(1, model.nbody)]
        raise UnknownNameError("body", name, bodies) from None


def _at(model: mujoco.MjModel, point: Point) -> tuple[int, np.ndarray]:
    return _body(model, point.body), np.asarray(point.offset, float)


def own_joints(model: mujoco.MjModel, palm: int) -> tuple[int, ...]:
    """Hinges and slides below the palm, in the model's own order; wrist joints are left out."""
    own = _below(model, palm)
    own[palm] = False
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    fit = own[model.jnt_bodyid] & np.isin(model.jnt_type, kinds)
    return tuple(int(j) for j in np.flatnonzero(fit))


def own_bodies(model: mujoco.MjModel, palm: int) -> Bool[np.ndarray, " nbody"]:
    """(nbody,) mask of the hand's bodies: the palm, all bodies below it, and those to which the
    palm is fixed. Bodies that carry other joints, such as those of a second hand, are not included.
    """
    below = _below(model, palm)
    rigid = np.asarray(model.body_weldid == model.body_weldid[palm])
    carries = np.zeros(model.nbody, bool)  # a joint, on it or further out
    above = np.zeros(model.nbody, bool)
    for body in range(model.nbody - 1, 0, -1):  # children come last
        carries[body] |= bool(model.body_jntnum[body])
        carries[model.body_parentid[body]] |= carries[body]
    body = palm
    while body:
        body = int(model.body_parentid[body])
        above[body] = True
    own: np.ndarray = below | (rigid & (above | ~carries))
    return own


def _below(model: mujoco.MjModel, top: int) -> Bool[np.ndarray, " nbody"]:
    """Mask of a body and all that hang from it."""
    below = np.zeros(model.nbody, bool)
    below[top] = True
    for body in range(top + 1, model.nbody):  # parents come first
        below[body] |= below[model.body_parentid[body]]
    return below


_STEPS: Final = 33
_ROUNDS: Final = 3
_GAIN: Final = 1e-6  # smallest gain in reach that moves a joint off neutral [m]


class StraightPose(NamedTuple):
    """Pose of a hand with its fingers straight.

    Attributes:
        q: (m,) the pose [rad].
        reach: (F,) distances from base to tip [m].
        rays: (F, 3) vectors from base to tip, palm frame [m].
    """

    q: Float[np.ndarray, " m"]
    reach: Float[np.ndarray, " F"]
    rays: Float[np.ndarray, "F 3"]


def knuckle_joints(hand: Hand) -> Bool[np.ndarray, " m"]:
    """(m,) mask of the actuated joints that move the knuckle of a long finger itself: on each
    finger, those after the base landmark and before the joint whose axis passes nearest to it."""
    q, tree, data = np.clip(0.0, *hand.limits.T), hand.tree, mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(q))
    mujoco.mj_kinematics(hand.model, data)
    palm, mask = data.body(hand.spec.palm), np.zeros(len(q), bool)
    points = palm.xpos + hand.landmark_positions(q) @ palm.xmat.reshape(3, 3).T
    for i in (FINGERS.index(finger) for finger in hand.fingers if finger != "thumb"):
        base, tip = (tree.keypoints[LANDMARKS[at[i]]].joint for at in (BASES, TIPS))
        at, joints, off = points[tree.names.index(LANDMARKS[BASES[i]])], list[int](), list[float]()
        while tip not in (-1, base):  # toward the palm
            joints.append(tree.joints[tip].source)
            axis = data.joint(hand.joint_names[joints[-1]])
            off.append(float(np.linalg.norm(np.cross(at - axis.xanchor, axis.xaxis))))
            tip = tree.joints[tip].parent
        before = joints[int(np.argmin(np.array([*off, np.inf]))) + 1 :]
        mask |= (hand.transmission.matrix[before] != 0).any(axis=0)
    return mask


def finger_rays(hand: Hand, q: Float[np.ndarray, "*n m"]) -> Float[np.ndarray, "*n F 3"]:
    """(..., F, 3) vectors [m] from base to tip of each finger, at (..., m) joint positions."""
    names, points = hand.tree.names, hand.landmark_positions(q)
    fingers = [FINGERS.index(name) for name in hand.fingers]
    tips = [names.index(LANDMARKS[TIPS[i]]) for i in fingers]
    bases = [names.index(LANDMARKS[BASES[i]]) for i in fingers]
    return np.asarray(points[..., tips, :] - points[..., bases, :])

"""Anatomy of the synthetic hand (bone lengths, layout, joint ranges) and its forward kinematics.

Lengths [mm], means of 66 adults by radiography: A. Buryanov and V. Kotiuk, "Proportions of Hand
Segments", International Journal of Morphology 28(3), 2010, pp. 755-758; metacarpals, phalanges and
the soft tissue beyond the bony fingertip. The wrist landmark is the head of the capitate: carpal
height is 0.54 of the third metacarpal (Y. Youm et al., "Kinematics of the Wrist", Journal of Bone
and Joint Surgery 60-A, 1978) and 1.57 of the capitate's length (G. R. Nattrass et al., "An
Alternative Method for Determination of the Carpal Height Ratio", same journal 76-A, 1994), so the
capitate is 0.344 of the third metacarpal.

Joint ranges: fingers and thumb from the reference values of the Electronic Textbook of Hand Surgery
(e-hand.com), finger abduction 20 deg as the AAOS gives it; the total motion of the thumb's
trapeziometacarpal joint, 53 deg flexion-extension, 42 deg abduction-adduction and 17 deg pronation,
from W. P. Cooney et al., "The Kinesiology of the Thumb Trapeziometacarpal Joint", Journal of Bone
and Joint Surgery 63-A, 1981. DIP = 2/3 PIP: H. Rijpkema and M. Girard, "Computer Animation of
Knowledge-Based Human Grasping", SIGGRAPH 1991.

No table gives the layout of the carpus, the fan of the metacarpals, the transverse arch and the
thumb's neutral direction in one frame; those figures are ours, compared with recordings of real
hands (the palm's shape) and with pictures.

The kinematics describes a hand in the same form as a glove does. The wrist is the origin; x is
palmar, y towards the thumb of a right hand, z distal. A joint's own frame has x along its bone and
z dorsal, so flexion turns about its y. A fingertip has the orientation of its last joint, as in a
MANUS stream.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import FINGERS

# Buryanov & Kotiuk 2010, [mm]: metacarpal, proximal, middle, distal phalanx with its soft tissue.
_THUMB_MM = (46.22, 31.57, 21.67 + 5.67)
_FINGERS_MM = (
    (68.12, 39.78, 22.38, 15.82 + 3.84),
    (64.60, 44.63, 26.33, 17.40 + 3.95),
    (58.00, 41.37, 25.65, 17.30 + 3.95),
    (53.69, 32.74, 18.11, 15.96 + 3.73),
)
_CAPITATE = 0.54 / 1.57  # Youm 1978, Nattrass 1994: capitate over third metacarpal

# Ours: (palmar, radial, distal) of the joints at the carpus [mm], at the size of the table above.
# The distal figure of the middle finger follows from the capitate's length.
_CARPUS_MM = ((2.0, 14.5, 18.5), (0.0, 2.0, np.nan), (0.5, -8.5, 20.5), (2.0, -18.0, 18.0))
_THUMB_CMC_MM = (14.5, 19.5, 17.0)
# Ours, degrees, index .. pinky: fan of the metacarpals (radial +), their palmar tilt (the
# transverse arch), the fan of the fingers at zero abduction, and the roll that makes flexing
# fingers converge (palmar side towards the thumb +).
_METACARPAL_FAN = (7.0, -1.5, -10.5, -18.5)
_METACARPAL_TILT = (3.0, 0.0, 2.0, 5.0)
_FINGER_FAN = (3.0, 0.0, -4.0, -9.0)
_FINGER_ROLL = (-3.0, 1.0, 4.0, 9.0)

_LENGTH_SPREAD = 0.02  # relative standard deviation of a bone's length
_LENGTH_LIMIT = 0.05


@dataclass(frozen=True)
class Joint:
    """A joint angle of the human hand and its active range.

    Attributes:
        name: name, such as ``index_pip``.
        lower: least angle [rad].
        upper: greatest angle [rad].
    """

    name: str
    lower: float
    upper: float


def _joint(name: str, lower_deg: float, upper_deg: float) -> Joint:
    return Joint(name, float(np.deg2rad(lower_deg)), float(np.deg2rad(upper_deg)))


def _finger(name: str) -> tuple[Joint, ...]:
    # The little finger's own abductor takes it further: 32 deg from the ring finger at most
    # spread (G. N. Chatzioglou et al., Anatomy & Cell Biology 57(2), 2024).
    ulnar = -30.0 if name == "pinky" else -20.0
    return (
        _joint(f"{name}_mcp_abduction", ulnar, 20.0),
        _joint(f"{name}_mcp", -20.0, 90.0),
        _joint(f"{name}_pip", 0.0, 100.0),
        _joint(f"{name}_dip", 0.0, 80.0),
    )


JOINTS: tuple[Joint, ...] = (
    _joint("thumb_cmc_flexion", -20.0, 33.0),
    _joint("thumb_cmc_abduction", -12.0, 30.0),
    _joint("thumb_mcp", -10.0, 55.0),
    _joint("thumb_ip", -15.0, 80.0),
    *(joint for name in FINGERS[1:] for joint in _finger(name)),
)
"""The 20 joint angles, thumb first. Flexion is positive; MCP abduction is positive towards the
thumb, thumb CMC flexion towards the little finger, thumb CMC abduction away from the palm."""

NUM_JOINTS = len(JOINTS)
DIP_PER_PIP = 2.0 / 3.0
_DIPS = (7, 11, 15, 19)
FREE = tuple(i for i in range(NUM_JOINTS) if i not in _DIPS)
"""Indices of the 16 independent joints; a DIP follows its PIP."""
LOWER: Float[np.ndarray, "20"] = np.array([joint.lower for joint in JOINTS])
UPPER: Float[np.ndarray, "20"] = np.array([joint.upper for joint in JOINTS])


def couple(free: Float[np.ndarray, "*batch 16"]) -> Float[np.ndarray, "*batch 20"]:
    """All 20 joint angles [rad] from the 16 free ones: each DIP angle is 2/3 of the PIP angle."""
    angles = np.zeros((*free.shape[:-1], NUM_JOINTS))
    angles[..., FREE] = free
    angles[..., _DIPS] = DIP_PER_PIP * angles[..., np.subtract(_DIPS, 1)]
    return angles


@dataclass(frozen=True, eq=False)
class HandAnatomy:
    """Bone lengths and layout of one right hand; positions are (palmar, radial, distal) from the
    wrist.

    Attributes:
        hand_length: distance from wrist to middle fingertip along the straight finger [m].
        metacarpal_bases: (4, 3) bases of the metacarpals of index .. pinky [m].
        knuckles: (4, 3) MCP joints of index .. pinky [m].
        phalanges: (4, 3) proximal, middle and distal lengths of index .. pinky [m].
        thumb_base: (3,) trapeziometacarpal joint [m].
        thumb_bones: (3,) metacarpal, proximal and distal lengths [m].
        finger_fan: (4,) direction of each finger at zero abduction, radial positive [rad].
        finger_roll: (4,) roll of each finger about itself [rad].
    """

    hand_length: float
    metacarpal_bases: Float[np.ndarray, "4 3"]
    knuckles: Float[np.ndarray, "4 3"]
    phalanges: Float[np.ndarray, "4 3"]
    thumb_base: Float[np.ndarray, "3"]
    thumb_bones: Float[np.ndarray, "3"]
    finger_fan: Float[np.ndarray, "4"]
    finger_roll: Float[np.ndarray, "4"]


def draw_anatomy(hand_length: float, seed: int) -> HandAnatomy:
    """Draws a person's hand, given by a seed, with a given length from wrist to middle fingertip
    [m].

    The published proportions are varied by a few percent per bone, independently of the length."""
    unit = _unit_anatomy(seed)
    return HandAnatomy(
        hand_length,
        unit.metacarpal_bases * hand_length,
        unit.knuckles * hand_length,
        unit.phalanges * hand_length,
        unit.thumb_base * hand_length,
        unit.thumb_bones * hand_length,
        unit.finger_fan,
        unit.finger_roll,
    )


@lru_cache(maxsize=64)
def _unit_anatomy(seed: int) -> HandAnatomy:
    rng = np.random.default_rng([seed, 0xA7])

    def vary(lengths: tuple[object, ...]) -> Float[np.ndarray, "..."]:
        mean = np.array(lengths, float)
        spread = rng.normal(0.0, _LENGTH_SPREAD, mean.shape)
        return mean * (1.0 + np.clip(spread, -_LENGTH_LIMIT, _LENGTH_LIMIT))

    thumb, fingers = vary(_THUMB_MM), vary(_FINGERS_MM)
    bases = np.array(_CARPUS_MM)
    capitate = _CAPITATE * fingers[1, 0]
    bases[1, 2] = np.sqrt(capitate**2 - bases[1, 0] ** 2 - bases[1, 1] ** 2)
    fan, tilt = np.deg2rad(_METACARPAL_FAN), np.deg2rad(_METACARPAL_TILT)
    direction = np.stack([np.sin(tilt), np.cos(tilt) * np.sin(fan), np.cos(tilt) * np.cos(fan)], -1)
    knuckles = bases + fingers[:, :1] * direction
    length = np.linalg.norm(knuckles[1]) + fingers[1, 1:].sum()
    return HandAnatomy(
        1.0,
        bases / length,
        knuckles / length,
        fingers[:, 1:] / length,
        np.array(_THUMB_CMC_MM) / length,
        thumb / length,
        np.deg2rad(_FINGER_FAN),
        np.deg2rad(_FINGER_ROLL),
    )


# Orientation of the hand itself (x distal, z dorsal) in the frame of the landmarks.
_HAND = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0])

# The thumb's metacarpal at zero angles, ours (see ``hand_anatomy``): its bone points 18 deg radial
# and 24 deg palmar of distal, its nail 60 deg from dorsal towards radial.
_THUMB_RADIAL, _THUMB_PALMAR, _THUMB_ROLL = np.deg2rad([18.0, 24.0, 60.0])
# Cooney 1981: 17 deg of pronation accompany the motion from extended and adducted to opposed.
_THUMB_PRONATION = np.deg2rad(17.0)


@dataclass(frozen=True, eq=False)
class HandPoses:
    """A batch of T poses of one hand.

    Attributes:
        landmarks: (T, 21, 3) landmarks [m].
        metacarpals: (T, 4, 3) bases of the metacarpals of index .. pinky [m].
        orientations: (T, 21, 4) quaternions wxyz.
    """

    landmarks: Float[np.ndarray, "T 21 3"]
    metacarpals: Float[np.ndarray, "T 4 3"]
    orientations: Float[np.ndarray, "T 21 4"]


def pose_hand(anatomy: HandAnatomy, angles: Float[np.ndarray, "T 20"]) -> HandPoses:
    """Computes poses of a right hand with its wrist at the origin, from (T, 20) joint angles [rad]
    in the order of ``JOINTS``."""
    count = len(angles)
    landmarks = np.zeros((count, 21, 3))
    orientations = np.empty((count, 21, 4))
    orientations[:, 0] = _HAND

    flexion, abduction, mcp, ip = np.moveaxis(angles[:, :4], -1, 0)
    span = (UPPER - LOWER)[:2]
    opposed = ((flexion - LOWER[0]) / span[0] + (abduction - LOWER[1]) / span[1]) / 2.0
    frame = _mul(
        _mul(_HAND, _about(2, _THUMB_RADIAL - flexion)), _about(1, _THUMB_PALMAR + abduction)
    )
    frame = _mul(frame, _about(0, -(_THUMB_ROLL + _THUMB_PRONATION * opposed)))
    _chain(
        landmarks[:, 1:5],
        orientations[:, 1:5],
        anatomy.thumb_base,
        anatomy.thumb_bones,
        (frame, mcp, ip),
    )

    fan, roll = anatomy.finger_fan, anatomy.finger_roll
    base = _mul(_mul(_HAND, _about(2, fan)), _about(0, roll))
    fingers = angles[:, 4:].reshape(count, 4, 4)
    frame = _mul(_mul(base, _about(2, fingers[..., 0])), _about(1, fingers[..., 1]))
    _chain(
        landmarks[:, 5:].reshape(count, 4, 4, 3),  # views: reshape splits one axis
        orientations[:, 5:].reshape(count, 4, 4, 4),
        anatomy.knuckles,
        anatomy.phalanges,
        (frame, fingers[..., 2], fingers[..., 3]),
    )

    metacarpals = np.broadcast_to(anatomy.metacarpal_bases, (count, 4, 3)).copy()
    return HandPoses(landmarks, metacarpals, orientations)


def mirror(poses: HandPoses) -> HandPoses:
    """Mirrors poses to the other hand: y changes sign; joint frames keep x along the bone and z
    dorsal."""
    points, quaternions = np.array([1.0, -1.0, 1.0]), np.array([1.0, -1.0, 1.0, -1.0])
    return HandPoses(
        poses.landmarks * points, poses.metacarpals * points, poses.orientations * quaternions
    )


def move(
    poses: HandPoses,
    translation: Float[np.ndarray, "T 3"],
    rotation_vector: Float[np.ndarray, "T 3"],
) -> HandPoses:
    """Moves whole hands by (T, 3) rotations about the wrist (axis times angle [rad]) and by
    translations [m].

    The hands have the wrist at the origin."""
    angle = np.linalg.norm(rotation_vector, axis=-1, keepdims=True)
    # sinc keeps the limit at no rotation: sin(a/2)/a = sinc(a/2pi)/2
    quaternion = np.concatenate(
        [np.cos(angle / 2.0), 0.5 * np.sinc(angle / (2.0 * np.pi)) * rotation_vector], -1
    )[:, None]

    def carry(points: Float[np.ndarray, "T n 3"]) -> Float[np.ndarray, "T n 3"]:
        w, v = quaternion[..., :1], quaternion[..., 1:]
        turn = 2.0 * np.cross(v, points)
        carried: np.ndarray = points + w * turn + np.cross(v, turn) + translation[:, None]
        return carried

    return HandPoses(
        carry(poses.landmarks), carry(poses.metacarpals), _mul(quaternion, poses.orientations)
    )


def _chain(
    points: Float[np.ndarray, "*batch 4 3"],
    orientations: Float[np.ndarray, "*batch 4 4"],
    base: Float[np.ndarray, "*digit 3"],
    lengths: Float[np.ndarray, "*digit 3"],
    joints: tuple[Float[np.ndarray, "*batch 4"], np.ndarray, np.ndarray],
) -> None:
    """Fill one digit's (or four digits') points and orientations from base to tip, in place."""
    frame = joints[0]
    points[..., 0, :] = base
    for k in range(3):
        if k:
            frame = _mul(frame, _about(1, joints[k]))
        orientations[..., k, :] = frame
        points[..., k + 1, :] = points[..., k, :] + lengths[..., k, None] * _bone(frame)
    orientations[..., 3, :] = frame


def _about(axis: int, angle: float | np.ndarray) -> np.ndarray:
    """Quaternion of a rotation about coordinate axis 0, 1 or 2."""
    half = np.asarray(angle) / 2.0
    quaternion = np.zeros((*half.shape, 4))
    quaternion[..., 0] = np.cos(half)
    quaternion[..., 1 + axis] = np.sin(half)
    return quaternion


def _mul(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Product of quaternions wxyz, with broadcasting."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def _bone(q: np.ndarray) -> np.ndarray:
    """The x axis of a frame."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)], -1)


def dorsal(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3"]:
    """The z axis of a joint frame, which points away from the pad, to the side of the nail."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], -1)

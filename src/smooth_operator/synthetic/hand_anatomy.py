"""Anatomy of the synthetic hand: bone lengths, layout and joint ranges from the literature.

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
    """A joint angle of the human hand with its active range.

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
    """All 20 joint angles [rad] from the 16 free ones: each DIP is 2/3 of its PIP."""
    angles = np.zeros((*free.shape[:-1], NUM_JOINTS))
    angles[..., FREE] = free
    angles[..., _DIPS] = DIP_PER_PIP * angles[..., np.subtract(_DIPS, 1)]
    return angles


@dataclass(frozen=True, eq=False)
class HandAnatomy:
    """Lengths and layout of one right hand; positions are (palmar, radial, distal) from the wrist.

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
    """The hand of a person of some length, wrist to middle fingertip [m]: the published
    proportions, varied by a few percent per bone by the seed, whatever the length."""
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

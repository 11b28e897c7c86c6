"""Description of a robot hand (palm, fingers, landmarks, neutral pose); selection of fingers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from numpy.polynomial.polynomial import polyval

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.landmarks import FINGERS
from smooth_operator.types import Side

MOST_DEGREE: Final = 4
"""Highest degree of a coupling."""
_MOST_TORQUE = 100.0  # [N m]; URDFs have 1000 for an unknown torque


@dataclass(frozen=True)
class Point:
    """A point fixed to a body of the robot.

    Attributes:
        body: body name in the model.
        offset: (3,) position in the body's frame [m].
    """

    body: str
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def mirrored(self) -> Point:
        """Returns the same point on the mirrored model."""
        x, y, z = self.offset
        return Point(self.body, (-x, y, z))


@dataclass(frozen=True)
class FingerSpec:
    """One robot finger and the human finger that drives it.

    Attributes:
        name: the human finger, one of ``FINGERS``.
        points: counterparts of that finger's four landmarks, base to tip; None for a missing one
            between them.
    """

    name: str
    points: tuple[Point | None, Point | None, Point | None, Point | None]

    def __post_init__(self) -> None:
        if self.name not in FINGERS:
            raise HandModelError(
                f"a finger must have the name of a human finger {FINGERS}, not {self.name!r}"
            )
        if self.points[0] is None or self.points[3] is None:
            raise HandModelError(f"finger {self.name!r} needs a base point and a tip point")

    @property
    def base(self) -> Point:
        """Point that corresponds to the finger's first landmark (thumb CMC or MCP)."""
        assert self.points[0] is not None  # checked on construction
        return self.points[0]

    @property
    def tip(self) -> Point:
        """Point that corresponds to the fingertip landmark."""
        assert self.points[3] is not None  # checked on construction
        return self.points[3]


@dataclass(frozen=True)
class Coupling:
    """Makes a joint follow another joint by a polynomial: q[joint] = p(q[follows]), in radians.

    Attributes:
        joint: the joint that follows.
        follows: its leader.
        multiplier: coefficient of q[follows].
        offset: constant coefficient.
        higher: coefficients of the square, cube and fourth power; empty for a line. MuJoCo's
            ``polycoef`` has the same highest degree.
        turned: True if the sign was changed, since the joints' limits rule out that of the file.
        error: largest error of a polynomial that was fitted to a closed loop [rad].
    """

    joint: str
    follows: str
    multiplier: float
    offset: float
    turned: bool = False
    error: float = field(default=0.0, compare=False)
    higher: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not (len(self.higher) <= MOST_DEGREE - 1 and np.isfinite(self.coefficients).all()):
            raise HandModelError(
                f"coupling of {self.joint!r}: expected one to {MOST_DEGREE + 1} finite "
                f"coefficients, constant first, not {list(self.coefficients)}"
            )

    @classmethod
    def of(cls, joint: str, follows: str, coefficients: Sequence[float]) -> Coupling:
        """Makes a coupling from its coefficients, constant first; zeros at the end are dropped."""
        offset, *powers = map(float, coefficients)
        while powers and not powers[-1]:
            powers.pop()
        multiplier, *higher = powers or [0.0]
        return cls(joint, follows, multiplier, offset, higher=tuple(higher))

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients of the polynomial, constant first."""
        return (self.offset, self.multiplier, *self.higher)

    @property
    def formula(self) -> str:
        """The polynomial as text, such as ``1.06 index_1 - 0.05``."""
        text = ""
        for power, c in reversed(tuple(enumerate(self.coefficients))):
            if not c:
                continue
            size = "" if c == 1 and power else f"{abs(c):.4g}"
            name = "" if not power else self.follows + (f"^{power}" if power > 1 else "")
            sign = " - " if c < 0 else " + "
            text += (sign if text else sign.strip(" +")) + " ".join(filter(None, [size, name]))
        return text or "0"

    def at(self, leader: float) -> float:
        """Position of the joint at a position of its leader [rad]."""
        return float(polyval(leader, self.coefficients))


@dataclass(frozen=True)
class JointMap:
    """Map from human joint angles to one joint: position = offset + sum of gain * angle.

    Attributes:
        joint: name of an actuated joint.
        offset: position with all angles at zero, a straight finger [rad].
        gains: name of an angle, one of ``JOINT_ANGLES`` -> gain with sign.
    """

    joint: str
    offset: float = 0.0
    gains: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not all(math.isfinite(number) for number in (self.offset, *self.gains.values())):
            raise HandModelError(
                f"joint map of {self.joint!r}: offset and gains must be finite numbers, not "
                f"{self.offset} and {dict(self.gains)}"
            )


@dataclass(frozen=True)
class HandSpec:
    """Description of a robot hand for retargeting: a model file, and the parts of the hand in it.

    Attributes:
        name: catalogue name.
        side: side of the hand, after mirroring.
        model: path of an MJCF or URDF file.
        palm: body whose frame is the palm frame.
        wrist: counterpart of the human wrist, fixed to the palm.
        fingers: two to five fingers, thumb first.
        align: three or more landmarks that fix the alignment of human hand to palm: ``wrist``, or
            a finger's name for its base.
        neutral: joint name -> neutral position [rad]; 0 (or the nearest limit) for other joints.
        wrist_joints: names of the joints from forearm to palm; see ``with_wrist_joints``.
        mirror: True if the file holds the other side and is to be mirrored on loading.
        gripper: True for a gripper of two jaws, which either human hand drives.
        joint_map: maps from human joint angles to joints. Other joints get a map by measuring the
            hand, which needs all four points of their finger.
        torque: torque limit of the motors [N m] by their maker: one number for all joints, or
            joint name -> torque; unknown for the other joints. None if all are unknown.
        couplings: joints that follow another one; they replace the model file's couplings.
        source: where the numbers come from, as free text.
    """

    name: str
    side: Side
    model: Path
    palm: str
    wrist: Point
    fingers: tuple[FingerSpec, ...]
    align: tuple[str, ...] = ("thumb", "index", "pinky")
    neutral: Mapping[str, float] = field(default_factory=dict)
    mirror: bool = False
    gripper: bool = False
    joint_map: tuple[JointMap, ...] = ()
    torque: float | Mapping[str, float] | None = None
    couplings: tuple[Coupling, ...] = ()
    source: str = ""
    wrist_joints: tuple[str, ...] = ()

    @property
    def mirrored(self) -> HandSpec:
        """Returns the mirror image of the hand: equal joint positions give mirrored poses. A
        gripper has no side, so its model stays the same."""
        side: Side = "left" if self.side == "right" else "right"
        return replace(self, side=side, mirror=self.mirror if self.gripper else not self.mirror)

    def __post_init__(self) -> None:
        names = [finger.name for finger in self.fingers]
        if not 2 <= len(names) <= 5:
            raise HandModelError(
                f"hand {self.name!r} has {len(names)} fingers; expected two to five"
            )
        if len(set(names)) != len(names):
            raise HandModelError(f"hand {self.name!r} names a finger twice: {names}")
        if self.gripper and len(names) != 2:
            raise HandModelError(
                f"hand {self.name!r} is called a gripper, but has {len(names)} fingers; expected "
                "two: thumb and index"
            )
        if names[0] != "thumb":
            raise HandModelError(
                f"hand {self.name!r}: the first finger must be the thumb, not {names[0]!r}"
            )
        missing = [name for name in self.align if name not in (*names, "wrist")]
        if missing:
            raise HandModelError(
                f"hand {self.name!r}: align names {missing}, but the fingers are {names}; "
                "name three of them, or two and 'wrist'"
            )
        if len(set(self.align)) < 3:
            raise HandModelError(
                f"hand {self.name!r}: align needs three different landmarks to fix a rotation, not "
                f"{self.align}; choose three of {names} and 'wrist'"
            )
        torques = self.torque if isinstance(self.torque, Mapping) else {"all": self.torque}
        for joint, torque in torques.items():
            if torque is not None and not 0.0 < torque < _MOST_TORQUE:
                raise HandModelError(
                    f"hand {self.name!r}: the torque of {joint!r} must be above 0 and below "
                    f"{_MOST_TORQUE:g} N m, not {torque}"
                )
        for table, rows in (("joint_map", self.joint_map), ("couplings", self.couplings)):
            named = [row.joint for row in rows]
            if twice := sorted({joint for joint in named if named.count(joint) > 1}):
                raise HandModelError(
                    f"hand {self.name!r}: {table} has more than one row for {twice}; keep one "
                    "row per joint"
                )


FingerChoice: TypeAlias = Mapping[str, str] | Sequence[str]
"""Robot finger -> human finger that drives it; or names of fingers driven by their own."""


def select_fingers(spec: HandSpec, fingers: FingerChoice) -> HandSpec:
    """Returns a hand's description with only some of its fingers; the other joints stay at neutral.

    The alignment keeps its landmarks if all remain. Otherwise it uses the thumb and the first
    and last of the other fingers, or, with two fingers, these and the wrist.

    Raises:
        UnknownNameError: the hand, or a human, has no such finger.
        HandModelError: fewer than two fingers, no thumb, or one human finger drives two.
    """
    choice = dict(fingers) if isinstance(fingers, Mapping) else {name: name for name in fingers}
    own = {finger.name: finger for finger in spec.fingers}
    for robot, human in choice.items():
        if robot not in own:
            raise UnknownNameError("finger", robot, own)
        if human not in FINGERS:
            raise UnknownNameError("human finger", human, FINGERS)
    if choice.get("thumb") != "thumb":
        raise HandModelError(
            f"hand {spec.name!r}: the thumb must be among the fingers, driven by the human thumb, "
            f"not {choice}"
        )
    chosen = sorted(
        (replace(own[robot], name=human) for robot, human in choice.items()),
        key=lambda finger: FINGERS.index(finger.name),
    )
    names = [finger.name for finger in chosen]
    if all(name == "wrist" or name in choice for name in spec.align):
        align = tuple(choice.get(name, name) for name in spec.align)
    elif len(names) > 2:
        align = (names[0], names[1], names[-1])
    else:
        align = ("wrist", *names)
    return replace(
        spec,
        fingers=tuple(chosen),
        align=align,
        joint_map=tuple(row for old in spec.joint_map for row in _renamed(old, choice)),
    )


def _renamed(row: JointMap, choice: Mapping[str, str]) -> list[JointMap]:
    """The map with the angles of the new driver; empty if its finger is left out."""
    gains: dict[str, float] = {}
    for angle, gain in row.gains.items():
        finger, _, rest = angle.partition("_")
        if finger not in choice:
            return []
        gains[f"{choice[finger]}_{rest}"] = gain
    return [replace(row, gains=gains)]

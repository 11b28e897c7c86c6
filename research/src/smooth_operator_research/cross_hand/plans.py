"""Plans of the scripted human: places and openings of the hand, one after the other.

The plans were tuned with the method ``smooth`` and the glove. ``relocate``: on ``mimic_p050``,
``wuji_hand`` and ``leap_hand`` in worlds 1000 to 1011, the height of the grip on the cylinder also
on ``orca_v2`` and ``schunk_svh``. ``hammer``: on ``mimic_p050``, ``shadow_hand`` and
``inspire_hand`` in worlds 1000 and 1001; the posture of the open hand, its depth and its tilt by
whether all 17 hands lift the hammer in its nominal place. ``tongs``: size, balance and plan on
``mimic_p050``, ``shadow_hand`` and ``inspire_hand`` in worlds 1000 and 1001. Other methods,
trackers and worlds had no part in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator import poses
from smooth_operator.simulation.scenes.relocate import RelocateScene
from smooth_operator.simulation.scenes.tools import (
    HEAD,
    HEAD_AT,
    NAIL,
    RAISED,
    HammerScene,
    TongsScene,
)
from smooth_operator.simulation.tasks.tools import SQUEEZES

SQUEEZE_M: Final = 0.015
"""Depth below the object's surface to which thumb and fingers close, each [m]."""


class Waypoint(NamedTuple):
    """One step of a human's plan; the moves between steps are minimum-jerk.

    Attributes:
        seconds: duration of the move to this waypoint [s].
        centre: (3,) place of the middle between thumb and fingers in the frame of the object at its
            start [m].
        turn: (4,) rotation of the wrist frame in that frame, wxyz.
        gap: distance between thumb and fingers [m].
    """

    seconds: float
    centre: Float[np.ndarray, "3"]
    turn: Float[np.ndarray, "4"]
    gap: float


class Plan(NamedTuple):
    """Waypoints of a human, from the start.

    Attributes:
        waypoints: the waypoints; the first one is the start, and its duration is a wait.
        width: thickness of the object between thumb and fingers [m].
        synergy: how the hand closes: to a pinch, or to a fist, with the wrist at rest.
    """

    waypoints: Sequence[Waypoint]
    width: float
    synergy: Literal["pinch", "fist"] = "pinch"


def pitched(angle: float) -> Float[np.ndarray, "4"]:
    """Returns the (4,) rotation wxyz of a wrist frame with the palm down, and the fingers forward
    and down by an angle [rad]."""
    return poses.from_rotation_vectors(np.array([0.0, angle, 0.0]))


_WIDTHS: Final = {"ball": 0.070, "cylinder": 0.050, "cube": 0.040}
_LIFT: Final = {"ball": 0.0, "cylinder": 0.022, "cube": 0.0}  # grip above the object's centre [m]
_PITCH: Final = np.radians(25.0)
_WIDE: Final = 0.045  # opening beyond the object's width [m]
_ABOVE: Final = 0.08  # height from which the hand goes down [m]


def relocate_plan(scene: RelocateScene) -> Plan:
    """Plan for ``relocate``: from above, close, lift, carry to the mark, and stay."""
    width = _WIDTHS[scene.shape] * scene.scale
    up = np.array([0.0, 0.0, 1.0])
    turn = pitched(_PITCH)
    grasp = _LIFT[scene.shape] * up
    start = np.concatenate(scene.start)
    there = poses.rotate(poses.conjugate(start[3:]), scene.target - start[:3]) + grasp
    wide, tight = min(width + _WIDE, 0.115), width - 2 * SQUEEZE_M
    return Plan(
        (
            Waypoint(0.5, grasp + 0.16 * up, turn, wide),
            Waypoint(1.2, grasp + _ABOVE * up, turn, wide),
            Waypoint(1.0, grasp, turn, wide),
            Waypoint(1.2, grasp, turn, tight),
            Waypoint(0.3, grasp, turn, tight),
            Waypoint(1.0, grasp + 0.10 * up, turn, tight),
            Waypoint(1.5, there, turn, tight),
            Waypoint(2.0, there, turn, tight),
        ),
        width,
    )


FIST_GAPS: Final = (0.125, 0.079, 0.068)
"""Distances of thumb and fingers in a hand that is open, around a handle, and a fist [m]."""
_OPEN_FIST, _AROUND, _FIST = FIST_GAPS
_HAMMER_PITCH: Final = np.radians(15.0)
_INSIDE: Final = np.array([0.0, 0.0, -0.04])  # from the handle to the open hand's grasp centre [m]
_BLOWS: Final = 8
_TOO_DEEP: Final = 0.03  # way of the wrist beyond the nail's: the hammer gives way in the hand [m]
_SWING: Final = (0.03, 0.4)  # height [m] and tilt of the hammer [rad] before a blow


def hammer_plan(scene: HammerScene) -> Plan:
    """Plan for ``hammer``: fingers around the handle, lift, go over the nail, strike, lift."""
    start = np.concatenate(scene.start)
    nail = poses.rotate(poses.conjugate(start[3:]), scene.target - start[:3])
    over = nail + scene.scale * np.array([0.0, -HEAD_AT, NAIL + HEAD[1] / 2])

    def at(seconds: float, place: ArrayLike, gap: float, tilt: float = 0.0) -> Waypoint:
        swing = poses.from_rotation_vectors(np.array([tilt, 0.0, 0.0]))
        turn = poses.multiply(swing, pitched(_HAMMER_PITCH))
        return Waypoint(seconds, np.asarray(place) + poses.rotate(swing, _INSIDE), turn, gap)

    def above(height: float) -> Float[np.ndarray, "3"]:
        return np.asarray(over + height * np.array([0.0, 0.0, 1.0]))

    origin = np.zeros(3)
    waypoints = [
        at(0.5, (0.0, 0.0, 0.14), _OPEN_FIST),
        at(1.0, origin, _OPEN_FIST),
        at(1.0, origin, _AROUND),
        at(0.8, origin, _FIST),
        at(0.2, origin, _FIST),
        at(0.6, (0.0, 0.0, 0.06), _FIST),
        at(1.2, above(0.08), _FIST),
    ]
    for depth in scene.scale * NAIL * np.arange(_BLOWS) / _BLOWS:
        deep = above(-depth - scene.scale * NAIL / _BLOWS - _TOO_DEEP)
        waypoints += [
            at(0.5, above(_SWING[0] - depth), _FIST, _SWING[1]),
            at(0.25, deep, _FIST),
            at(0.1, deep, _FIST),
        ]
    waypoints += [at(0.6, above(0.05), _FIST), at(1.0, above(0.05), _FIST)]
    return Plan(waypoints, _OPEN_FIST - 0.002, "fist")  # touches as soon as it closes


_TONGS_PITCH: Final = np.radians(40.0)
_TONGS_WIDTH: Final = 0.056  # of open tongs at the grip [m]
_BELOW: Final = 0.012  # depth of the fingertips below the middle of the tongs [m]
_WIDE_OPEN, _FIRM, _SHUT, _HALF_OPEN = 0.105, 0.015, 0.005, 0.072  # gaps of the hand [m]


def tongs_plan(scene: TongsScene) -> Plan:
    """Plan for ``tongs``: from above, shut them, lift; open them half and shut them again."""
    turn = pitched(_TONGS_PITCH)

    def at(seconds: float, height: float, gap: float) -> Waypoint:
        return Waypoint(seconds, np.array([0.0, 0.0, height - _BELOW]), turn, gap)

    high = RAISED * scene.scale + 0.04
    waypoints = [
        at(0.5, high, _WIDE_OPEN),
        at(1.2, 0.0, _WIDE_OPEN),
        at(1.0, 0.0, _FIRM),
        at(0.3, 0.0, _FIRM),
        at(1.2, high, _FIRM),
        at(0.3, high, _FIRM),
    ]
    for _ in range(SQUEEZES):
        waypoints += [at(0.7, high, _SHUT), at(0.4, high, _SHUT)]
        waypoints += [at(0.7, high, _HALF_OPEN), at(0.4, high, _HALF_OPEN)]
    return Plan(waypoints, _TONGS_WIDTH * scene.scale)


PLANS: Final[dict[str, Callable[[Any], Plan]]] = {
    "relocate": relocate_plan,
    "hammer": hammer_plan,
    "tongs": tongs_plan,
}
"""Task -> plan of the human in a scene."""

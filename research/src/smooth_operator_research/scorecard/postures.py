"""Human postures that a hand takes or does not take, when they are retargeted to it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.metrics.posture import direction_errors, human_extensions, robot_extensions
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.synthetic.gestures import (
    CURLED,
    FIST,
    FLAT,
    PINCHES,
    RELAXED,
    SPREAD,
    pinch_postures,
)
from smooth_operator.synthetic.hand_anatomy import couple, draw_anatomy, mirror, pose_hand
from smooth_operator.types import HandRecording

LARGEST_ANGLE: Final = 20.0
"""Largest angle between a human finger and the robot's, base to tip, in a posture that the robot
takes [degrees]."""
LARGEST_BEND: Final = 0.2
"""Largest difference of their extensions (``smooth_operator.metrics.posture``)."""
LARGEST_GAP: Final = 0.005
"""Largest distance between the robot's thumb and finger where the human's touch [m]."""
_SEED, _LENGTH = 0, 0.19  # the built-in operator
_MOVE, _HOLD, _PERIOD_S = 20, 15, 0.01  # frames to a posture and in it; time of a frame [s]


def standard_postures() -> dict[str, Float[np.ndarray, "16"]]:
    """The built-in operator's postures: name -> joint angles [rad]."""
    plain = {"flat": FLAT, "relaxed": RELAXED, "spread": SPREAD, "curled": CURLED, "fist": FIST}
    return plain | {
        name.replace("_", " "): posture
        for name, posture in zip(PINCHES, pinch_postures(_SEED), strict=True)
    }


def grasp_postures() -> dict[str, Float[np.ndarray, "16"]]:
    """The 33 grasps of the GRASP taxonomy: number and name -> joint angles [rad]."""
    text = files(__package__).joinpath("postures.csv").read_text(encoding="utf-8")
    rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    return {name: np.deg2rad([float(angle) for angle in angles]) for name, *angles in rows}


def posture_faults(hand: Hand, postures: Mapping[str, Float[np.ndarray, "16"]]) -> dict[str, str]:
    """Retargets postures with the default method; name -> fault of each that the hand can't take.

    The synthetic human moves from posture to posture and rests in each. The hand takes a posture if
    each of its fingers points within ``LARGEST_ANGLE`` of the human's and is as extended within
    ``LARGEST_BEND``, and thumb and finger are within ``LARGEST_GAP`` where the human's touch.
    """
    rests = np.repeat(np.stack([FLAT, *postures.values()]), _HOLD + _MOVE, axis=0)
    share = np.append(np.linspace(0, 1, _MOVE), np.ones(_HOLD))
    before = np.concatenate([rests[: len(share)], rests[: -len(share)]])
    joints = before + np.tile(share, len(postures) + 1)[:, None] * (rests - before)
    poses = pose_hand(draw_anatomy(_LENGTH, _SEED), couple(joints))
    if hand.spec.side == "left":
        poses = mirror(poses)
    stamps = _PERIOD_S * np.arange(len(joints))
    recording = HandRecording(poses.landmarks, stamps, hand.spec.side, name="postures")
    commands, _ = Retargeter(hand).run(recording)
    trace = assemble_trace(recording, commands, hand, reach_samples=0)
    ends = (np.arange(len(postures)) + 2) * len(share) - 1
    human, robot = trace.human_fingers[ends], trace.robot_fingers[ends]
    bends = human_extensions(human) - robot_extensions(robot, hand.straight_pose.reach)
    angles, gaps = direction_errors(human, robot), trace.pinch_distances
    assert gaps is not None  # assemble_trace measures them
    faults = {}
    for i, name in enumerate(postures):
        turned, bent = int(np.argmax(angles[i])), int(np.argmax(np.abs(bends[i])))
        apart = np.nan_to_num(gaps[ends[i]])
        if angles[i, turned] > LARGEST_ANGLE:
            faults[name] = f"{hand.fingers[turned]} {angles[i, turned]:.0f}° off"
        elif abs(bends[i, bent]) > LARGEST_BEND:
            faults[name] = (
                f"{hand.fingers[bent]} too {'bent' if bends[i, bent] > 0 else 'straight'}"
            )
        elif apart.max() > LARGEST_GAP:
            finger = hand.fingers[1 + int(np.argmax(apart))]
            faults[name] = f"thumb and {finger} {1e3 * apart.max():.0f} mm apart"
    return faults

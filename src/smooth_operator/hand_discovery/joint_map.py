"""Checks a hand's map from human joint angles to joints, by the direction of the thumb.

Gains that are measured joint by joint fail on a thumb unlike a human's, such as LEAP's. The spec
file of such a hand has its own rows ([joint_map], ``smooth_operator.baselines.joint_angle``).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from smooth_operator.baselines.joint_angle import JointAngleMap
from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.checks import Check
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, LANDMARKS, TIPS
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.synthetic import SyntheticOperator

_SECONDS: Final = 20.0  # length of the operator's motion, which has all its gestures [s]
_RATE_HZ: Final = 20.0
_AWAY_DEG: Final = 60.0
"""Largest angle of a sound map. DEX-EE has the largest of the built-in hands, 49: its three
fingers are arranged around its palm."""


def mapped_thumb_error(hand: Hand) -> float | None:
    """Median angle between the synthetic operator's thumb and the thumb of the robot hand that
    follows it with ``joint_angle`` [deg]; None for a hand without a thumb or without a joint-angle
    map."""
    base, tip = LANDMARKS[BASES[0]], LANDMARKS[TIPS[0]]
    names = hand.tree.names
    if base not in names or tip not in names:
        return None
    try:
        mapped = JointAngleMap(hand)
    except HandModelError:
        return None
    recording = SyntheticOperator(side=hand.spec.side, rate_hz=_RATE_HZ).record(_SECONDS)
    human = align_recording(recording, hand)
    q = np.clip(mapped.positions(human), *hand.limits.T)
    landmarks = hand.landmark_positions(q)
    robot = landmarks[:, names.index(tip)] - landmarks[:, names.index(base)]
    thumb = human[:, TIPS[0]] - human[:, BASES[0]]
    lengths = np.linalg.norm(robot, axis=-1) * np.linalg.norm(thumb, axis=-1)
    cosine = (robot * thumb).sum(axis=-1) / np.maximum(lengths, 1e-9)
    return float(np.degrees(np.nanmedian(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def check_joint_map(hand: Hand) -> Check:
    """Checks that ``joint_angle`` points the robot's thumb in roughly the direction of the human's
    thumb."""
    away = mapped_thumb_error(hand)
    if away is None:
        return Check("joint map", "skipped", "not checked: there is no joint map for the thumb")
    text = f"with joint_angle, the thumb points {away:.0f}° away from the human's (median)"
    figures = {"thumb_deg": round(away, 1)}
    if away <= _AWAY_DEG:
        return Check("joint map", "ok", text, figures=figures)
    advice = (
        "add [joint_map] rows for the thumb's joints to the spec file, or use another "
        "method: only joint_angle uses this map"
    )
    return Check("joint map", "failed", text, advice, figures)

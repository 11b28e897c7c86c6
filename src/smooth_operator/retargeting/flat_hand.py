"""A flat human hand, and its directions on a robot's palm."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand, finger_rays
from smooth_operator.retargeting.alignment import palm_alignment
from smooth_operator.retargeting.palm import PalmAxes, palm_axes

FLAT_HAND: Final[Float[np.ndarray, "21 3"]] = np.array(
    [
        (0.0, 0.0, 0.0),
        (0.015691350946666485, 0.02110216161793079, 0.018396756282298636),
        (0.03623553717662707, 0.03536113209792626, 0.06228135498564862),
        (0.050412315445496764, 0.0452007169115829, 0.09256448317927932),
        (0.06263877916788257, 0.05368665952039701, 0.11868152904384052),
        (0.00583320378775326, 0.024222983924825827, 0.08950457405414024),
        (0.00583320378775325, 0.02644102008550057, 0.1318272252142989),
        (0.005833203787753245, 0.027695749186056096, 0.15576888268806915),
        (0.005833203787753241, 0.028799303385959398, 0.17682595121874062),
        (0.0, 0.0003800817860811673, 0.09148120480340395),
        (-2.0742201449919996e-17, 0.0003800817860811673, 0.1381884901637557),
        (-3.3605968049228164e-17, 0.0003800817860811673, 0.16715511739536837),
        (-4.375078327493525e-17, 0.0003800817860811673, 0.18999921043048687),
        (0.002701313344051838, -0.02047164244489354, 0.08300941491367449),
        (0.0027013133440518186, -0.023542937506252283, 0.12693098056205346),
        (0.0027013133440518065, -0.025434966509654197, 0.1539882558877235),
        (0.002701313344051796, -0.027051906524956423, 0.17711157540368333),
        (0.00726898794934918, -0.037992557670323376, 0.07481035365994607),
        (0.007268987949349172, -0.043564866808219305, 0.10999252891957408),
        (0.007268987949349168, -0.04659557075715049, 0.12912764056766995),
        (0.007268987949349164, -0.04982021448684558, 0.1494872398003197),
    ]
)
"""Landmarks of a flat right hand, 0.19 m long: palmar, radial, distal from the wrist [m].

It is the hand of the built-in operator, ``pose_hand(draw_anatomy(0.19, 0), zeros)`` of
``smooth_operator.synthetic``; a test compares the two. No hand model is needed.
"""


def human_palm_axes(hand: Hand) -> PalmAxes[np.ndarray]:
    """Axes of a human palm in the robot's palm frame, after the alignment.

    A robot's own wrist and knuckles seldom span a palm like a human's (the wrist of the mimic hand
    lies 3 cm in front of the plane of the knuckles). The directions are therefore those of the
    built-in operator's hand, aligned like every frame.
    """
    mirrored = hand.spec.side == "left"
    landmarks = FLAT_HAND * (1.0, -1.0, 1.0) if mirrored else FLAT_HAND
    return palm_axes(palm_alignment(landmarks, hand).apply(landmarks), hand.spec.side)


def palm_tilt_deg(hand: Hand) -> float:
    """Angle by which a flat human hand, once aligned, bends the long fingers at their bases [deg].

    Three landmarks of the palm align the hands; the fingers of a flat human hand and of a flat
    robot hand (``open_rays``) then point in different directions. Above 0 a flat human hand asks
    the robot's fingers to bend towards the palm, below 0 to the back of the hand.
    """
    axes = human_palm_axes(hand)
    rays = open_rays(hand)[1:]
    fingers = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).mean(axis=0)
    return float(np.degrees(np.arctan2(-(fingers @ axes.palmar), fingers @ axes.distal)))


def open_rays(hand: Hand) -> Float[np.ndarray, "F 3"]:
    """(F, 3) vectors from base to tip of the open hand, palm frame [m].

    Its joints are at zero, or as close to zero as their limits allow, because vendors define the
    open hand there. At the neutral pose, as at ``Hand.straight_pose``, knuckles are often bent.
    """
    return finger_rays(hand, np.clip(0.0, *hand.limits.T))

"""The palm's landmarks, and the size of the hand."""

from __future__ import annotations

from typing import Final

import numpy as np

from smooth_operator.human.alignment import MIN_CONDITION, palm_alignment, reference_landmarks
from smooth_operator.human.palm_axes import palm_tilt_deg
from smooth_operator.lab.validation.checks import Check
from smooth_operator.lab.validation.samples import Samples
from smooth_operator.landmarks import LANDMARKS

_POOR: Final = 0.08  # condition of the palm that noise turns; built-in hands have 0.16 and more
_MOVES: Final = 2e-3  # of a landmark that aligns: more is seen in the round trip [m]
_USUAL: Final = (0.10, 0.40)  # wrist to farthest fingertip [m]; built-in hands: 0.166 to 0.251
_POSSIBLE: Final = (0.05, 0.80)  # [m]


def check_palm(samples: Samples) -> Check:
    """Checks that the landmarks of the palm span a frame and do not move."""
    hand = samples.hand
    condition = float(palm_alignment(reference_landmarks(hand), hand).condition)
    used = [hand.tree.names.index(name) for name in _align_names(samples)]
    travel = float(np.ptp(samples.landmarks[:, used], axis=0).max())
    figures = {"condition": round(condition, 3), "travel_mm": round(1e3 * travel, 2)}
    align = ", ".join(hand.spec.align)
    text = f"{align}: condition {condition:.2f} (0 is a line, human palms 0.5)"
    if condition < MIN_CONDITION:
        return Check(
            "palm frame",
            "failed",
            text,
            "these landmarks lie on a line, so they fix no direction: name others in align, or "
            "give the finger bases and the wrist their places",
            figures,
        )
    if travel > _MOVES:
        return Check(
            "palm frame",
            "warning",
            f"{text}; they move by {1e3 * travel:.0f} mm with the joints",
            "put the bases that align onto a body fixed to the palm, at their place in the "
            "neutral pose: a human's knuckles don't move in the palm",
            figures,
        )
    if condition < _POOR:
        return Check(
            "palm frame",
            "warning",
            text,
            "nearly a line: noise of the tracker will turn the hand; name landmarks in align that "
            "are further apart",
            figures,
        )
    return Check("palm frame", "ok", text, "", figures)


def check_tilt(samples: Samples) -> Check:
    """Measures the angle between the fingers of a flat human hand and the robot's straight ones."""
    tilt = palm_tilt_deg(samples.hand)
    way = "towards the palm" if tilt > 0 else "to the back of the hand"
    text = f"a flat human hand bends the straight fingers by {abs(tilt):.0f}° {way}"
    return Check("palm tilt", "unjudged", text, "", {"tilt_deg": round(tilt, 1)})


def check_size(samples: Samples) -> Check:
    """Checks the size of the hand: millimetres read as metres show here."""
    hand = samples.hand
    reach = float(np.linalg.norm(samples.tips - hand.wrist, axis=-1).max())
    figures = {"reach_mm": round(1e3 * reach, 1)}
    text = f"{1e3 * reach:.0f} mm from the wrist to the farthest fingertip"
    if not _POSSIBLE[0] < reach < _POSSIBLE[1]:
        return Check(
            "size",
            "failed",
            text,
            "no hand is of that size: model and offsets are in metres (a mesh's scale, or a wrist "
            "on the wrong body, can also do it)",
            figures,
        )
    if not _USUAL[0] < reach < _USUAL[1]:
        return Check(
            "size",
            "warning",
            text,
            "unusual: look at the wrist and the units of the model",
            figures,
        )
    return Check("size", "ok", text, "", figures)


def _align_names(samples: Samples) -> list[str]:
    return [LANDMARKS[i] for i in samples.hand.align_indices]

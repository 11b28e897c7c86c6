"""Poses of a human hand that stand for the controllers of a headset: power grasp, pinch and
tripod."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import FINGERS, FROM_WEBXR_25, METACARPALS_WEBXR_25
from smooth_operator.synthetic.gestures import CURLED, FIST, FLAT, pinch_postures
from smooth_operator.synthetic.hand_anatomy import couple, draw_anatomy, pose_hand

_HAND_LENGTH_M: Final = 0.19
_STEPS: Final = 16
"""Number of poses from open to closed, apart from the open one; the page interpolates between
them."""

_TO_WEBXR: Final = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Axes of WebXR's wrist joint (-z to the fingers, y out of the back; WebXR Hand Input) in those of
the synthetic right hand (x palmar, y to the thumb, z distal)."""


def controller_poses() -> dict[str, Any]:
    """Poses of a right hand, in the frame of WebXR's wrist joint, as JSON values.

    Returns:
        ``grip``: the middle of the curled fingers, which is the origin of the grip space of a
        controller [m]; ``presets``: name -> ``trigger``, the fingers that the trigger closes (the
        grip button closes the others), and ``poses``, (steps, 25, 3) joints from open to closed in
        WebXR's order [m].
    """
    pinch, middle = pinch_postures(0)[:2]
    closed = CURLED.copy()
    closed[:7] = pinch[:7]  # thumb and index
    tripod = closed.copy()
    tripod[:4] = (pinch[:4] + middle[:4]) / 2.0
    tripod[7:10] = middle[7:10]
    presets = {
        "power": (FIST, FINGERS[1:2]),
        "pinch": (closed, FINGERS[:2]),
        "tripod": (tripod, FINGERS[:3]),
    }
    bent = _joints(FIST[None])[0, 5:].reshape(4, 5, 3)[:, 2:]  # all but metacarpals and bases
    shares = np.linspace(0.0, 1.0, _STEPS + 1)[:, None]
    return {
        "grip": bent.mean(axis=(0, 1)).tolist(),
        "presets": {
            name: {
                "trigger": list(fingers),
                "poses": np.round(_joints(FLAT + shares * (end - FLAT)), 5).tolist(),
            }
            for name, (end, fingers) in presets.items()
        },
    }


def _joints(postures: Float[np.ndarray, "T 16"]) -> Float[np.ndarray, "T 25 3"]:
    hands = pose_hand(draw_anatomy(_HAND_LENGTH_M, 0), couple(postures))
    joints = np.empty((len(postures), 25, 3))
    joints[:, list(FROM_WEBXR_25)] = hands.landmarks
    joints[:, list(METACARPALS_WEBXR_25)] = hands.metacarpals
    return np.asarray(joints @ _TO_WEBXR.T)

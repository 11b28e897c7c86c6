"""Parts of the live page's scene: its background, and an operator's profile from JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from jaxtyping import UInt8

from smooth_operator.human.operator import FingerProfile, OperatorProfile
from smooth_operator.teleop.pages.palette import Rgb

_SKY: Final[Rgb] = (72, 80, 92)
_GROUND: Final[Rgb] = (44, 49, 57)


def background() -> UInt8[np.ndarray, "h w 3"]:
    """A grey that is lighter above: dark bodies and the finger colours stand out on it."""
    shade = np.linspace(_SKY, _GROUND, 64).round().astype(np.uint8)
    return np.repeat(shade[:, None], 2, axis=1)


def operator_of(content: Mapping[str, Any]) -> OperatorProfile:
    """A profile that came as JSON."""
    fingers = tuple(
        FingerProfile(**{**finger, "bones": tuple(finger["bones"])})
        for finger in content["fingers"]
    )
    return OperatorProfile(
        **{
            **content,
            "fingers": fingers,
            "palm_rotation": tuple(content["palm_rotation"]),
            "apply": tuple(content["apply"]),
        }
    )

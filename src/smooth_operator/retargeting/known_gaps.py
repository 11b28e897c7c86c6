"""Known distances that trackers report between thumb and finger when the two touch.

They are separate from their estimation (``pinch_gaps.py``), which needs JAX.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.landmarks import FINGERS

NO_GAPS: Final[Mapping[str, float]] = MappingProxyType({})
"""Gaps of an unknown tracker: none are known, so they are estimated during use."""
MEDIAPIPE: Final[Mapping[str, float]] = MappingProxyType(
    {"index": 0.33, "middle": 0.36, "ring": 0.20, "pinky": 0.145}
)
"""Gaps of MediaPipe's hand landmarks, in palm lengths: medians over four photographs of pinches of
one person, each tracked while it is moved and zoomed a little."""


def known_gaps(name: str | None) -> Mapping[str, float]:
    """Known pinch gaps of a simulated tracker. For a camera, they are those of a webcam, measured
    on a different person from the one that the simulation imitates."""
    return MEDIAPIPE if name == "camera" else NO_GAPS


def check_gaps(gaps: Mapping[str, float]) -> None:
    """Checks known gaps, which are a mapping from finger to gap [palm lengths].

    Raises:
        UnknownNameError: a finger has no such name, or is the thumb.
        ConfigError: a gap is not between 0 and 1 palm length.
    """
    for finger, gap in gaps.items():
        if finger not in FINGERS[1:]:
            raise UnknownNameError("finger that pinches", finger, FINGERS[1:])
        if not 0 <= gap < 1:  # NaN too
            raise ConfigError(
                f"the pinch gap of the {finger} finger must be 0 to 1 palm length, not {gap}"
            )

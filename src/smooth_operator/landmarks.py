"""The one landmark schema of a human hand (21 points) and the maps onto it.

Order: wrist, then per finger from base to tip. It is the order of MediaPipe's hand landmarker, and
``docs/conventions.md`` draws it. Trackers with more nodes (MANUS 25, WebXR 25, OpenXR 26) are
mapped by index; what the maps leave out are the metacarpal bases of the long fingers, which
:data:`METACARPALS_MANUS_25` and its siblings pick.
"""

from __future__ import annotations

from typing import Final

FINGERS: Final = ("thumb", "index", "middle", "ring", "pinky")
"""Human finger names, thumb first."""

LANDMARKS: Final = (
    "wrist",
    "thumb_cmc", "thumb_mcp", "thumb_ip", "thumb_tip",
    "index_mcp", "index_pip", "index_dip", "index_tip",
    "middle_mcp", "middle_pip", "middle_dip", "middle_tip",
    "ring_mcp", "ring_pip", "ring_dip", "ring_tip",
    "pinky_mcp", "pinky_pip", "pinky_dip", "pinky_tip",
)  # fmt: skip
"""Names of the 21 landmarks, in order."""

NUM_LANDMARKS: Final = len(LANDMARKS)
WRIST: Final = 0
TIPS: Final = (4, 8, 12, 16, 20)
"""Indices of the five fingertips, thumb first."""
BASES: Final = (1, 5, 9, 13, 17)
"""Indices of the finger bases: thumb CMC, then the four MCPs."""

BONES: Final = tuple(
    (parent, child)
    for base in BASES
    for parent, child in ((0, base), (base, base + 1), (base + 1, base + 2), (base + 2, base + 3))
)
"""(parent, child) index pairs of the landmark skeleton: 20 bones, five chains from the wrist."""

# A MANUS glove publishes 25 nodes: 0 wrist; 1-4 thumb; 5-9 index .. 20-24 pinky, the first node
# of a long finger being its metacarpal base. WebXR's XRHand has the same joints in the same order.
FROM_MANUS_25: Final = (0, 1, 2, 3, 4, 6, 7, 8, 9, 11, 12, 13, 14, 16, 17, 18, 19, 21, 22, 23, 24)
METACARPALS_MANUS_25: Final = (5, 10, 15, 20)
FROM_WEBXR_25: Final = FROM_MANUS_25
METACARPALS_WEBXR_25: Final = METACARPALS_MANUS_25

# OpenXR's XrHandJointEXT starts with the palm, then the wrist; the rest is one further than WebXR.
FROM_OPENXR_26: Final = tuple(i + 1 for i in FROM_WEBXR_25)
METACARPALS_OPENXR_26: Final = tuple(i + 1 for i in METACARPALS_WEBXR_25)

FINGER_COLORS: Final = ("#d55e00", "#56b4e9", "#009e73", "#cc79a7", "#0072b2")
"""One colour for a finger in every picture and on every page, thumb first: vermillion, sky blue,
bluish green, reddish purple, blue. Source: Okabe and Ito's palette, which stays apart under the
common forms of colour blindness."""


def index(name: str) -> int:
    """Index of a landmark by name.

    Raises:
        UnknownNameError: if there is no landmark of that name.
    """
    from smooth_operator.errors import UnknownNameError

    try:
        return LANDMARKS.index(name)
    except ValueError:
        raise UnknownNameError("landmark", name, LANDMARKS) from None

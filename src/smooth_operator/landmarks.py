"""The 21 landmarks of a human hand, and the maps from other trackers' points to them.

Order: wrist, then per finger from base to tip. It is the order of MediaPipe's hand landmarker, and
``docs/reference/conventions.md`` draws it. Trackers with more nodes (MANUS 25, WebXR 25, OpenXR
26) are mapped by index; the maps leave out the metacarpal bases of the long fingers, which
``METACARPALS_MANUS_25`` and similar constants select.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

__all__ = (
    "FROM_MANUS_25",
    "FROM_OPENXR_26",
    "FROM_WEBXR_25",
    "LANDMARKS",
    "LAYOUTS",
    "METACARPALS_MANUS_25",
    "METACARPALS_OPENXR_26",
    "METACARPALS_WEBXR_25",
)
"""Public names; all other names are for use inside this package."""

FINGERS: Final = ("thumb", "index", "middle", "ring", "pinky")
"""Human finger names, thumb first."""

LANDMARKS: Final = (
    "wrist",
    *(f"thumb_{joint}" for joint in ("cmc", "mcp", "ip", "tip")),
    *(f"{finger}_{joint}" for finger in FINGERS[1:] for joint in ("mcp", "pip", "dip", "tip")),
)
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

NODE_LAYOUTS: Final[dict[int, tuple[tuple[int, ...], tuple[int, ...] | None]]] = {
    21: (tuple(range(21)), None),
    25: (FROM_MANUS_25, METACARPALS_MANUS_25),
    26: (FROM_OPENXR_26, METACARPALS_OPENXR_26),
    27: (FROM_WEBXR_25, METACARPALS_WEBXR_25),
}
"""Number of a tracker's nodes -> indices of the 21 landmarks and the metacarpal bases in them.
25 nodes are MANUS's or WebXR's, 26 OpenXR's, 27 WebXR's and two forearm nodes (avp_stream)."""

FINGER_COLORS: Final = ("#d55e00", "#56b4e9", "#009e73", "#cc79a7", "#0072b2")
"""Colour of each finger in all pictures and on all pages, thumb first: vermillion, sky blue,
bluish green, reddish purple, blue. Source: Okabe and Ito's palette, whose colours remain
distinguishable with the common forms of colour blindness."""

LAYOUTS: Final[dict[str, tuple[int, ...]]] = {
    "mediapipe": tuple(range(21)),
    "openpose": tuple(range(21)),
    "mano": (0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20),
    "minimal_ik": (0, 13, 14, 15, 20, 1, 2, 3, 16, 4, 5, 6, 17, 10, 11, 12, 19, 7, 8, 9, 18),
    "mano_fingers": (0, *(f + k for f in (17, 1, 5, 13, 9) for k in range(4))),
    "rhd": (0, *(f + k for f in BASES for k in (3, 2, 1, 0))),
    "interhand": (20, *(f - 1 + k for f in BASES for k in (3, 2, 1, 0))),
    "fpha": (0, *(i for f in range(5) for i in (1 + f, 6 + 3 * f, 7 + 3 * f, 8 + 3 * f))),
    "pinky_first": (0, *(f + k for f in reversed(BASES) for k in range(4))),
    "aria": (
        5,
        20,
        6,
        7,
        0,
        *(i for f in range(4) for i in (8 + 3 * f, 9 + 3 * f, 10 + 3 * f, 1 + f)),
    ),
}
"""Orders of 21 points: name -> index of each of our landmarks in that order.

``mediapipe`` (the same as ``openpose``) is the order of this project. ``mano`` is MANO's 16 joints
(wrist, index, middle, pinky, ring, thumb) followed by the five tips, thumb to pinky, as in HO-3D;
``minimal_ik`` is the same with the tips in MANO's order of fingers; ``mano_fingers`` has MANO's
order of fingers, with each tip after its joints. ``rhd`` goes from tip to base; so does
``interhand`` (InterHand2.6M), which has the wrist last; ``fpha`` has the five bases first.
``pinky_first`` is our order with the fingers reversed. ``aria`` (Project Aria, UmeTrack, HOT3D,
Assembly101) has the tips, the wrist, two joints of the thumb, three of each finger, and last the
centre of the palm, which takes the place of the thumb's CMC, because that is missing
(``smooth_operator.io.landmark_order.in_our_order`` estimates it).
"""


def finger_landmarks(fingers: Iterable[str]) -> list[list[int]]:
    """Indices of the four landmarks of each finger, base to tip."""
    bases = [BASES[FINGERS.index(finger)] for finger in fingers]
    return [list(range(base, base + 4)) for base in bases]


def index(name: str) -> int:
    """Index of a landmark by name; UnknownNameError if there is no landmark with that name."""
    from smooth_operator.errors import UnknownNameError

    try:
        return LANDMARKS.index(name)
    except ValueError:
        raise UnknownNameError("landmark", name, LANDMARKS) from None

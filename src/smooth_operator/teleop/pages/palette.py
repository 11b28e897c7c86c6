"""Colours of the page: the same finger has the same colour on human, robot and plot.

The finger colours are from Okabe and Ito's palette, which stays apart under the common forms of
colour blindness; the pinch highlight is its yellow, and also changes size, so it never stands on
colour alone.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import UInt8

from smooth_operator import landmarks

Rgb = tuple[int, int, int]

FINGER_COLORS: Final[tuple[Rgb, ...]] = tuple(
    (int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)) for code in landmarks.FINGER_COLORS
)
"""One colour per finger, thumb first."""
RUN_COLORS: Final[tuple[Rgb, ...]] = (
    (255, 255, 255),
    (178, 150, 255),
    (188, 220, 90),
    (255, 150, 170),
    (120, 230, 220),
)
"""Of runs that are compared, in plots and tables; no finger has any of them."""
HIGHLIGHT: Final[Rgb] = (240, 228, 66)
"""A pinching fingertip."""
SIMULATED: Final[Rgb] = (240, 228, 66)
"""Of two robot hands in one place, the one that is seen only where it differs."""
PALM: Final[Rgb] = (205, 205, 212)
"""Palm, wrist and whatever belongs to no finger."""


def finger_colors(count: int) -> UInt8[np.ndarray, "F 3"]:
    """(F, 3) colours of the first ``count`` fingers, repeating after five."""
    return np.array([FINGER_COLORS[i % len(FINGER_COLORS)] for i in range(count)], np.uint8)


def linear(colors: UInt8[np.ndarray, "*n 3"]) -> UInt8[np.ndarray, "*n 3"]:
    """sRGB colours [0..255] in linear light, also [0..255].

    viser's browser side takes per-instance and per-vertex colours for linear and per-node colours
    for sRGB; only with this do both show the same colour.
    """
    value = np.asarray(colors, np.float64) / 255
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(255 * light), np.uint8)  # IEC 61966-2-1


def css(color: Rgb | UInt8[np.ndarray, "3"]) -> str:
    """A colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*(int(channel) for channel in color))

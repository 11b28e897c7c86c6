"""Alignment of human landmarks to the robot's palm, by Kabsch-Umeyama on the palm landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.geometry import AnyKind, Similarity, umeyama
from smooth_operator.hands.hand import Hand
from smooth_operator.io.anatomy import PALM_RANGE_M
from smooth_operator.landmarks import BASES, LANDMARKS
from smooth_operator.settings import check_range

MIN_CONDITION = 0.02
"""Smallest condition number of a palm triangle that has a usable orientation.

Real palms (thumb CMC, index MCP, pinky MCP) measure 0.45 to 0.53; 0.02 is a triangle about 2 mm
high, whose orientation is dominated by tracker noise.
"""


@dataclass(frozen=True)
class AlignmentConfig:
    """Settings of the alignment of a human hand to a robot's palm.

    Attributes:
        scale: ratio of robot size to human size. None estimates it in every frame, as published; a
            number fixes it, for example to the result of ``calibrate_scale`` for an operator.
    """

    scale: float | None = None

    def __post_init__(self) -> None:
        check_range("alignment scale", self.scale, 0.1, 10, "(robot size over human size)")


def palm_alignment(
    landmarks: AnyKind, hand: Hand, config: AlignmentConfig = AlignmentConfig()
) -> Similarity[AnyKind]:
    """Similarity from (..., 21, 3) human landmarks [m] to the robot's palm; NumPy or JAX. A
    ``condition`` below ``MIN_CONDITION`` means that the palm is degenerate."""
    source = landmarks[..., list(hand.align_indices), :]
    target = hand.align_points.astype(source.dtype)
    return umeyama(source, np.broadcast_to(target, source.shape), config.scale)


def palm_range(hand: Hand) -> tuple[float, float]:
    """Plausible range [m] of the distance from wrist to middle MCP in a frame: that of human hands
    and of the robot's own palm, with a margin of a quarter for the scatter of frames."""
    knuckles = reference_landmarks(hand)[list(BASES[1:])] - hand.wrist
    own = float(np.linalg.norm(knuckles, axis=1).max())
    return 0.8 * min(PALM_RANGE_M[0], own), 1.25 * max(PALM_RANGE_M[1], own)


def reference_landmarks(hand: Hand) -> Float[np.ndarray, "21 3"]:
    """Valid placeholder landmarks: those of the robot in its neutral pose [m].

    They replace the landmarks of a frame that can't be used, so that all arithmetic stays finite.
    Fingers that the robot lacks are placed at its wrist.
    """
    at = dict(zip(hand.tree.names, hand.landmark_positions(hand.neutral), strict=True))
    return np.stack([at.get(name, hand.wrist) for name in LANDMARKS])

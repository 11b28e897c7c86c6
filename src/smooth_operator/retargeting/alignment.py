"""Human landmarks into the robot's palm frame, by Kabsch-Umeyama on the palm landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.geometry import AnyKind, Similarity, umeyama
from smooth_operator.hands.hand import Hand
from smooth_operator.io.anatomy import PALM_RANGE_M
from smooth_operator.landmarks import BASES, LANDMARKS

MIN_CONDITION = 0.02
"""Palm triangles flatter than this have no usable orientation.

Real palms (thumb CMC, index MCP, pinky MCP) measure 0.45 to 0.53; 0.02 is a triangle about 2 mm
high, which tracker noise turns at will.
"""


@dataclass(frozen=True)
class AlignmentConfig:
    """Settings of the alignment of a human hand to a robot's palm.

    Attributes:
        scale: robot size over human size. None estimates it in every frame, as published; a number
            holds it fixed, as measured once for an operator by ``calibrate_scale``.
    """

    scale: float | None = None

    def __post_init__(self) -> None:
        if self.scale is not None and not 0.1 < self.scale < 10:
            raise ConfigError(
                f"alignment scale must be between 0.1 and 10 (robot size over human size), "
                f"not {self.scale}"
            )


def palm_alignment(
    landmarks: AnyKind, hand: Hand, config: AlignmentConfig = AlignmentConfig()
) -> Similarity[AnyKind]:
    """The similarity that takes (..., 21, 3) human landmarks [m] onto the robot's palm; NumPy or
    JAX. Its ``condition`` shows a degenerate palm (below ``MIN_CONDITION``)."""
    source = landmarks[..., list(hand.align_indices), :]
    target = hand.align_points.astype(source.dtype)
    return umeyama(source, np.broadcast_to(target, source.shape), config.scale)


def palm_range(hand: Hand) -> tuple[float, float]:
    """Least and greatest length [m] from wrist to middle MCP in a frame that may drive a hand:
    those of people and the robot's own, and a quarter more, since single frames scatter."""
    knuckles = reference_landmarks(hand)[list(BASES[1:])] - hand.wrist
    own = float(np.linalg.norm(knuckles, axis=1).max())
    return 0.8 * min(PALM_RANGE_M[0], own), 1.25 * max(PALM_RANGE_M[1], own)


def reference_landmarks(hand: Hand) -> Float[np.ndarray, "21 3"]:
    """A harmless well-posed set of landmarks: the robot's own at its neutral pose [m].

    Stands in for a frame that can't be used, so that the arithmetic around it stays finite. Fingers
    that the robot lacks sit at its wrist.
    """
    at = dict(zip(hand.tree.names, hand.landmark_positions(hand.neutral), strict=True))
    return np.stack([at.get(name, hand.wrist) for name in LANDMARKS])

"""Human landmarks into the robot's palm frame, by Kabsch-Umeyama on the palm landmarks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.geometry import AnyKind, PalmAxes, Similarity, palm_axes, umeyama
from smooth_operator.hands.hand import Hand, open_rays
from smooth_operator.io.anatomy import PALM_RANGE_M
from smooth_operator.landmarks import BASES, LANDMARKS
from smooth_operator.types import HandRecording

if TYPE_CHECKING:
    from smooth_operator.human.operator import OperatorProfile

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
            holds it fixed, as calibrated once for an operator by ``calibrate_scale``.
        operator: the calibrated operator, whose landmarks are corrected after the alignment. Its
            own scale holds where ``scale`` is None. None changes nothing.
    """

    scale: float | None = None
    operator: OperatorProfile | None = None

    def __post_init__(self) -> None:
        if self.scale is not None and not 0.1 < self.scale < 10:
            raise ConfigError(
                f"alignment scale must be between 0.1 and 10 (robot size over human size), "
                f"not {self.scale}"
            )

    @property
    def fixed_scale(self) -> float | None:
        """The scale that is held; None where each frame has its own."""
        if self.scale is None and self.operator is not None and self.operator.has("scale"):
            return self.operator.scale
        return self.scale


def palm_alignment(
    landmarks: AnyKind, hand: Hand, config: AlignmentConfig = AlignmentConfig()
) -> Similarity[AnyKind]:
    """The similarity that takes (..., 21, 3) human landmarks [m] onto the robot's palm; NumPy or
    JAX. Its ``condition`` shows a degenerate palm (below ``MIN_CONDITION``)."""
    source = landmarks[..., list(hand.align_indices), :]
    target = hand.align_points.astype(source.dtype)
    return umeyama(source, np.broadcast_to(target, source.shape), config.fixed_scale)


def align_recording(
    recording: HandRecording, hand: Hand, config: AlignmentConfig = AlignmentConfig()
) -> Float[np.ndarray, "T 21 3"]:
    """All frames of a recording in the palm frame, as they were tracked.

    An operator in ``config`` is left out, its scale and its corrections: what is measured is
    measured against the hand that was tracked, and not against one that was corrected.

    Returns:
        (T, 21, 3) landmarks [m]; NaN where a landmark is invalid, and everywhere in frames whose
        palm is invalid or degenerate.
    """
    valid = _validity(recording)
    landmarks = np.where(valid[..., None], recording.landmarks, np.nan)
    palm = np.all(valid[:, list(hand.align_indices)], axis=1)  # a valid landmark is finite
    safe = np.where(palm[:, None, None], landmarks, reference_landmarks(hand))
    fit = palm_alignment(safe, hand, replace(config, operator=None))
    usable = palm & (np.asarray(fit.condition) >= MIN_CONDITION)
    aligned: np.ndarray = np.where(usable[:, None, None], fit.apply(safe), np.nan)
    return aligned


def calibrate_scale(recording: HandRecording, hand: Hand) -> float:
    """The one scale of an operator: median of the per-frame estimates.

    Raises:
        RecordingError: if no frame has a usable palm.
    """
    valid = np.all(_validity(recording)[:, list(hand.align_indices)], axis=1)
    if valid.any():
        fit = palm_alignment(recording.landmarks[valid], hand)
        usable = np.asarray(fit.condition) >= MIN_CONDITION
        if usable.any():
            return float(np.median(np.asarray(fit.scale)[usable]))
    raise RecordingError(
        f"{recording.name}: no frame has valid, non-collinear palm landmarks "
        "to calibrate a scale on"
    )


def _validity(recording: HandRecording) -> Bool[np.ndarray, "T 21"]:
    assert recording.valid is not None  # filled in on construction
    return recording.valid


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
``smooth_operator.synthetic``; a test compares the two. As figures, they need no model of a hand.
"""


def human_palm_axes(hand: Hand) -> PalmAxes[np.ndarray]:
    """Axes of a human palm in the robot's palm frame, after the alignment.

    A robot's own wrist and knuckles seldom span a palm as a human's do (of the mimic hand the wrist
    lies 3 cm in front of the knuckles' plane), so the directions are those of the built-in
    operator's hand, aligned as every frame is.
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

"""Settings of GeoRT's training, and what it departs in from the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from smooth_operator.errors import ConfigError
from smooth_operator.human.alignment import AlignmentConfig

VOXEL: Final = 1e-3
"""Size of the cells that keep one point each, for the losses without pairs [m]."""
STEP_RANGE: Final = (1e-3, 11e-3)
"""Lengths of the human steps whose direction the robot's are to keep [m]."""
BEND: Final = 2e-3
"""Half the length of the straight path whose bend is the curvature [m]."""


@dataclass(frozen=True)
class GeortTraining:
    """Settings of GeoRT's training.

    Losses, the networks' sizes and the weights of direction, coverage and curvature are published
    (Yin et al., "Geometric Retargeting"). Named departures, so that two CPU cores finish in minutes
    and end in a useful optimum:

    - the networks have SiLU between their layers and no normalisation; published are LeakyReLU and
      batch normalisation. SiLU has no kink that the robot would follow;
    - steps are many and small: a batch of 512 instead of 2048, and a learning rate that rises to
      3e-3 and falls along a cosine, instead of 1e-4 held;
    - ``ramp``: coverage sets in slowly. From the first step on, it pulls random networks on to the
      robot's reach in any order, and direction can't undo the tangle;
    - ``margin``: the robot is to cover what the operator does, not all that it can reach;
    - ``surround``: direction is also kept around the points, where another operator's may be;
    - ``pinch``: published without a scale; 200 /m^2 makes a gap of 10 mm cost 0.02;
    - curvature is relative to the length of the path, where its square in metres would be nothing.

    Attributes:
        epochs: passes over the points.
        batch: points per finger in a step.
        reach: reachable robot fingertips that a batch is compared with.
        learning_rate: highest learning rate of AdamW.
        weight_decay: weight decay of AdamW.
        direction: weight of the motion's direction.
        coverage: weight of the Chamfer distance to the robot's reachable fingertips [1/m^2].
        curvature: weight of the bend of straight paths.
        pinch: weight of the squared distance of the robot's tips while the human pinches [1/m^2].
        pinch_distance: human thumb tip to fingertip distance, after alignment, below which it is a
            pinch [m].
        margin: only those reachable fingertips count for coverage that are at most this far from
            where some aligned human fingertip was [m]; None for all of them, as published.
        surround: standard deviation of the displacement from recorded points to those where
            direction and curvature are asked for [m]; 0 for the points themselves, as published.
        ramp: share of the epochs over which the weight of coverage rises to its full value; 0 for
            none, as published.
        validation: share of each recording, its end, that is kept out of training.
        seed: seed of all random numbers.
        alignment: alignment of human landmarks to the palm frame.
    """

    epochs: int = 120
    batch: int = 512
    reach: int = 512
    learning_rate: float = 3e-3
    weight_decay: float = 1e-2
    direction: float = 1.0
    coverage: float = 80.0
    curvature: float = 0.1
    pinch: float = 200.0
    pinch_distance: float = 0.015
    margin: float | None = 0.01
    surround: float = 0.01
    ramp: float = 0.4
    validation: float = 0.1
    seed: int = 0
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)

    def __post_init__(self) -> None:
        for name, least in (("epochs", 1), ("batch", 1), ("reach", 1), ("seed", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ConfigError(f"{name} must be a whole number from {least} on, not {value!r}")
        for name in ("weight_decay", "direction", "coverage", "curvature", "pinch", "surround"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ConfigError(f"{name} must be finite and not negative, not {value!r}")
        for name, most in (("learning_rate", 1.0), ("pinch_distance", 0.1)):
            value = getattr(self, name)
            if not 0 < value <= most:
                raise ConfigError(f"{name} must be above 0 and at most {most:g}, not {value!r}")
        if self.margin is not None and not 0 < self.margin <= 1:
            raise ConfigError(
                f"margin must be above 0 and at most 1 m, or None for the whole reach, not "
                f"{self.margin!r}"
            )
        for name in ("ramp", "validation"):
            value = getattr(self, name)
            if not 0 <= value < 1:
                raise ConfigError(f"{name} must be a share from 0 to below 1, not {value!r}")

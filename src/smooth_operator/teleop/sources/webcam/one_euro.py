"""A filter that is strong while a hand rests and weak while it moves: One Euro.

Source: Casiez, Roussel and Vogel, "1 Euro Filter: A Simple Speed-based Low-pass Filter for Noisy
Input in Interactive Systems", CHI 2012. A first-order low-pass whose cutoff rises with speed; here
the speed is that of each landmark as a point, so that no axis is preferred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError


@dataclass(frozen=True)
class OneEuroConfig:
    """How strongly is filtered.

    Attributes:
        cutoff: of a point at rest [Hz]; lower is smoother, and later.
        gain: by how much the cutoff rises with speed [Hz per m/s].
        speed_cutoff: of the low-pass on the speed itself [Hz].
        gap: after a longer gap in the stamps the filter restarts [s].
    """

    cutoff: float = 4.0
    gain: float = 20.0
    speed_cutoff: float = 1.0
    gap: float = 0.25

    def __post_init__(self) -> None:
        for name in ("cutoff", "speed_cutoff", "gap"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(f"One Euro: {name} must be positive, not {getattr(self, name)}")
        if not 0.0 <= self.gain < math.inf:
            raise ConfigError(f"One Euro: gain must not be negative, not {self.gain}")


@dataclass(frozen=True, eq=False)
class OneEuroState:
    """What the filter remembers.

    Attributes:
        points: (N, 3) filtered points [m].
        velocity: (N, 3) their filtered velocity [m/s].
        stamp: of the last frame [s].
    """

    points: Float[np.ndarray, "N 3"]
    velocity: Float[np.ndarray, "N 3"]
    stamp: float


def one_euro(
    state: OneEuroState | None,
    points: Float[np.ndarray, "N 3"],
    stamp: float,
    config: OneEuroConfig = OneEuroConfig(),
) -> OneEuroState:
    """Filter one frame.

    Args:
        state: of the last frame; None at the start.
        points: (N, 3) [m]; one that is not finite stays so, and restarts when it is back.
        stamp: time of the frame [s]; if it stands or goes back, the filter restarts.
        config: how strongly.

    Returns:
        the new state; its ``points`` are the answer.
    """
    step = math.inf if state is None else stamp - state.stamp
    if state is None or not 0.0 < step <= config.gap:
        return OneEuroState(points, np.zeros_like(points), stamp)
    known = np.isfinite(state.points).all(axis=1, keepdims=True)
    before = np.where(known, state.points, points)
    velocity = np.where(np.isfinite(state.velocity), state.velocity, 0.0)
    velocity = velocity + _share(config.speed_cutoff, step) * ((points - before) / step - velocity)
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    moved = before + _share(config.cutoff + config.gain * speed, step) * (points - before)
    return OneEuroState(moved, np.where(known, velocity, 0.0), stamp)


def _share(cutoff: float | np.ndarray, step: float) -> np.ndarray:
    """Weight of the new value in a first-order low-pass."""
    return np.asarray(1.0 / (1.0 + 1.0 / (2.0 * math.pi * cutoff * step)))

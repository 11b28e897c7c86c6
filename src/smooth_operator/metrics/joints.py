"""Metrics in joint space: jitter, sudden steps, and commands beyond the limits."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.metrics import summary
from smooth_operator.metrics.consistency import second_derivative

LIMIT_TOLERANCE: Final = 1e-6
"""Excess over a limit that counts as rounding (a float32 of 2 rad has a precision of 1e-7)
[rad]."""


def joint_jitter(joint_positions: Float[np.ndarray, "T n"]) -> float | None:
    """Mean |q(t+1) + q(t-1) - 2 q(t)| over frames and joints [rad]; lower is better. None for fewer
    than three frames. It depends on the frame rate, unlike ``joint_acceleration``."""
    q = joint_positions
    return summary.mean(np.abs(q[2:] + q[:-2] - 2.0 * q[1:-1]))


def joint_acceleration(
    joint_positions: Float[np.ndarray, "T n"], stamps: Float[np.ndarray, " T"]
) -> float | None:
    """Mean magnitude of joint acceleration [rad/s^2], from the real timestamps [s]; lower is
    better. None for fewer than three frames."""
    return summary.mean(np.abs(second_derivative(joint_positions, stamps)))


def max_joint_step(joint_positions: Float[np.ndarray, "T n"]) -> float | None:
    """Largest change of any joint from one frame to the next [rad]; lower is better. None for
    fewer than two frames."""
    return summary.maximum(np.abs(np.diff(joint_positions, axis=0)))


def limit_violation(
    joint_positions: Float[np.ndarray, "T n"], joint_limits: Float[np.ndarray, "n 2"]
) -> tuple[float | None, float | None]:
    """Returns the largest amount by which commands exceed the (n, 2) joint limits [rad], 0 if they
    never do, and the share of frames in which some joint exceeds a limit by more than
    ``LIMIT_TOLERANCE``. Lower is better; None for an empty run. A missing limit is NaN or infinite.
    """
    lower, upper = joint_limits.T
    excess = np.fmax(np.fmax(lower - joint_positions, joint_positions - upper), 0.0)
    return summary.maximum(excess), summary.mean((excess > LIMIT_TOLERANCE).any(axis=-1))

"""Trajectory optimisation: minimises the costs of a recording's frames together with the cost of
their motion.

The objective over q(1) .. q(T) is::

    sum_t f_t(q(t)) + w_a sum |q''|^2 + sum_t s(t)/2 |p(q(t)) - p(q(t-1)) - d(t)|^2

with derivatives by finite differences, points p of a pose that shall move by d between two frames,
and a high cost on joints that are faster than a limit. A difference joins at most three frames, so
the Hessian (Gauss-Newton for the motion of the points) is banded, and a Newton step takes time and
memory in proportion to T (banded Cholesky factor). It is the fixed-interval smoother of control
theory with any cost in place of that of a measurement: past and future have the same influence, so
nothing lags.

Source: Bell, "The Iterated Kalman Smoother as a Gauss-Newton Method" (SIAM J. Optim. 4, 1994), for
the equivalence; Bertsekas, "Projected Newton Methods for Optimization Problems with Simple
Constraints" (SIAM J. Control Optim. 20, 1982), for the bounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.retargeting.trajectory import SPEEDING, TrajectoryConfig

JOINED: Final = 2
"""Number of frames before and after a frame that its acceleration depends on."""

FrameBlocks: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Cost (T,), gradient (T, m) and Hessian (T, m, m) of each frame."""

FrameCosts: TypeAlias = Callable[[np.ndarray], FrameBlocks]
"""Function from (T, m) poses to ``FrameBlocks``."""

_DAMPING_FIRST, _DAMPING_MOST = 1e-3, 1e8


class ExtraTerms(Protocol):
    """Additional costs of the frames, which may have additional variables.

    The variables x of a frame are the m joint positions [rad], then V more.
    """

    limits: Float[np.ndarray, "V 2"]
    """Bounds of the V variables."""
    start: Float[np.ndarray, "T V"]
    """Their initial values."""

    def costs(self, x: Float[np.ndarray, "t v"], part: slice) -> FrameBlocks:
        """Costs (t,), gradients (t, m + V) and Hessians of the frames in one part of the
        recording."""

    def settle(self, pose: Float[np.ndarray, "T V"]) -> None:
        """Receives the solution when the optimisation has ended."""


@dataclass(frozen=True, eq=False)
class Led:
    """Points of the robot that should move by given steps from frame to frame.

    Attributes:
        points: function from (T, m) poses to (T, P) coordinates and their derivatives (T, P, m).
        steps: (T - 1, P) desired change of each coordinate between two frames.
        weights: (T - 1, P) weights of half the squared difference; 0 leaves it out.
    """

    points: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    steps: Float[np.ndarray, "S P"]
    weights: Float[np.ndarray, "S P"]


class TrajectoryResult(NamedTuple):
    """Result of a trajectory optimisation.

    Attributes:
        q: (T, m) the poses, within the limits [rad].
        cost: their cost.
        iterations: number of Newton steps that were tried.
        converged: True if the tolerance was reached.
    """

    q: Float[np.ndarray, "T m"]
    cost: float
    iterations: int
    converged: bool


def smooth_trajectory(
    frames: FrameCosts,
    start: Float[np.ndarray, "T m"],
    stamps: Float[np.ndarray, " T"],
    limits: Float[np.ndarray, "m 2"],
    config: TrajectoryConfig,
    fixed: int = 0,
    led: Led | None = None,
) -> TrajectoryResult:
    """Minimises the objective within bounds, starting from a trajectory. The cost never increases.

    Args:
        frames: costs of the frames; zeros for a frame without a usable hand.
        start: (T, m) poses [rad].
        stamps: (T,) strictly increasing times [s].
        limits: (m, 2) bounds [rad].
        fixed: number of frames at the beginning that do not change: the end of the last window.
        led: points whose motion follows given steps; None without such points.
    """
    low, high = limits[:, 0], limits[:, 1]
    q = np.clip(np.asarray(start, np.float64), low, high)
    price = motion_price(stamps, config)
    most = config.speed_limit * float(np.median(np.diff(stamps))) if len(stamps) > 1 else math.inf
    held = np.zeros(q.shape, bool)
    held[:fixed] = True

    def look(q: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray | None]:
        """Value, and gradient and blocks of the Hessian without those of smooth motion."""
        costs, gradient, hessian = frames(q)
        hessian = _convex(hessian)
        motion = 0.5 * (q * _times(price, q)).sum() + 0.5 * SPEEDING * (_excess(q, most) ** 2).sum()
        value = float(costs.sum(dtype=np.float64) + motion)
        if led is None:
            return value, gradient, hessian, None
        points, jacobian = led.points(q)
        error = np.diff(points, axis=0) - led.steps
        slopes = led.weights * error
        gradient = gradient.copy()
        sides = [np.einsum("tp,tpj->tj", slopes, jacobian[i : len(q) - 1 + i]) for i in (0, 1)]
        gradient[:-1] -= sides[0]
        gradient[1:] += sides[1]
        weighted = led.weights[:, :, None]
        hessian[:-1] += np.swapaxes(jacobian[:-1], 1, 2) @ (weighted * jacobian[:-1])
        hessian[1:] += np.swapaxes(jacobian[1:], 1, 2) @ (weighted * jacobian[1:])
        coupling = -np.swapaxes(jacobian[1:], 1, 2) @ (weighted * jacobian[:-1])
        return value + 0.5 * float((slopes * error).sum()), gradient, hessian, coupling

    value, gradient, hessian, coupling = look(q)
    damping = 0.0
    for done in range(1, config.iterations + 1):
        too_much = SPEEDING * _excess(q, most)
        slope = gradient + _times(price, q)
        slope[1:] += too_much
        slope[:-1] -= too_much
        outwards = ((q <= low) & (slope > 0)) | ((q >= high) & (slope < 0))
        free = ~(held | outwards)
        speeding = SPEEDING * (too_much != 0)
        band = _band(hessian, coupling, price, speeding, free, damping)
        trial = np.clip(q - _newton_step(band, slope, free), low, high)
        new = look(trial)
        moved = float(np.abs(trial - q).max(initial=0.0))
        if not new[0] <= value:  # the step was too long: damp it
            if damping >= _DAMPING_MOST or moved <= config.tolerance:
                return TrajectoryResult(q, value, done, True)
            damping = max(10.0 * damping, _DAMPING_FIRST)
            continue
        q, (value, gradient, hessian, coupling) = trial, new
        damping = 0.0 if damping <= _DAMPING_FIRST else 0.1 * damping
        if moved <= config.tolerance:
            return TrajectoryResult(q, value, done, True)
    return TrajectoryResult(q, value, config.iterations, False)


def motion_price(
    stamps: Float[np.ndarray, " T"], config: TrajectoryConfig
) -> Float[np.ndarray, "3 T"]:
    """Returns the cost of acceleration as a quadratic form over all frames of one joint.

    Returns:
        (3, T) lower diagonals of its matrix; [k, t] couples the frames t and t + k.
    """
    price = np.zeros((JOINED + 1, len(stamps)))
    rows = len(stamps) - JOINED
    if rows < 1:
        return price
    # twice the divided difference, which is exact for polynomials of degree 2
    at = np.stack([stamps[i : i + rows] for i in range(JOINED + 1)])
    apart = at[:, None] - at[None]
    apart[np.arange(JOINED + 1), np.arange(JOINED + 1)] = 1.0
    coefficients = 2.0 / apart.prod(axis=1)
    for i in range(JOINED + 1):
        for j in range(i, JOINED + 1):
            products = coefficients[i] * coefficients[j]
            price[j - i, i : i + rows] += 2.0 * config.acceleration_weight * products
    return price


def _excess(q: Float[np.ndarray, "T m"], most: float) -> np.ndarray:
    """(T - 1, m) signed excess of each joint's change over the largest allowed change."""
    change = np.diff(q, axis=0)
    return np.asarray(change - np.clip(change, -most, most))


def _times(price: Float[np.ndarray, "3 T"], q: Float[np.ndarray, "T m"]) -> np.ndarray:
    """Multiplies the quadratic form's matrix by q."""
    out: np.ndarray = price[0][:, None] * q
    for k in range(1, min(len(price), len(q))):
        coupling = price[k, : len(q) - k, None]
        out[k:] += coupling * q[:-k]
        out[:-k] += coupling * q[k:]
    return out


def _convex(hessian: Float[np.ndarray, "T m m"]) -> Float[np.ndarray, "T m m"]:
    """Replaces the eigenvalues of Hessians by their absolute values.

    With negative curvature, the minimum lies further down the slope, about as far as with positive
    curvature (Dauphin et al., "Identifying and attacking the saddle point problem", 2014).
    """
    values, vectors = np.linalg.eigh(hessian.astype(np.float64))
    return np.asarray((vectors * np.abs(values)[:, None]) @ np.swapaxes(vectors, 1, 2))


def _band(
    hessian: Float[np.ndarray, "T m m"],
    coupling: Float[np.ndarray, "S m m"] | None,
    price: Float[np.ndarray, "3 T"],
    speeding: Float[np.ndarray, "S m"],
    free: Bool[np.ndarray, "T m"],
    damping: float,
) -> Float[np.ndarray, "B N"]:
    """Lower diagonals of the whole Hessian; variables that are not free are decoupled.

    Variables are ordered frame by frame, so that the band is narrow.
    """
    count, size = free.shape
    band = np.zeros(((JOINED + 1) * size, count * size))
    blocks = band.reshape(len(band), count, size)
    for i in range(size):
        for j in range(i + 1):
            blocks[i - j, :, j] = hessian[:, i, j] * free[:, i] * free[:, j]
    for k in range(1, min(JOINED + 1, count)):
        both = free[k:] & free[:-k]
        blocks[k * size, :-k] += price[k, : count - k, None] * both
    if coupling is not None:
        for i in range(size):
            for j in range(size):
                both = free[1:, i] & free[:-1, j]
                blocks[size + i - j, :-1, j] += coupling[:, i, j] * both
    blocks[0] += np.where(free, price[0][:, None] + damping + 1e-9, 1.0)
    blocks[0, 1:] += speeding * free[1:]
    blocks[0, :-1] += speeding * free[:-1]
    blocks[size, :-1] -= speeding * free[1:] * free[:-1]
    return band


def _newton_step(
    band: Float[np.ndarray, "B N"], slope: Float[np.ndarray, "T m"], free: Bool[np.ndarray, "T m"]
) -> Float[np.ndarray, "T m"]:
    """Solves for the Newton step; variables that are not free do not move."""
    from scipy.linalg import solveh_banded  # takes 0.25 s to import

    right = np.where(free, slope, 0.0).ravel()
    solved = solveh_banded(band, right, lower=True, overwrite_ab=True, check_finite=False)
    return np.asarray(solved.reshape(slope.shape))

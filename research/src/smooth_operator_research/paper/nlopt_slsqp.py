"""NLopt's SLSQP within bounds, as named in the supplement's comparison of solvers.

Its result is the best point that was evaluated, for whatever reason it stopped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import nlopt
import numpy as np
from jaxtyping import Float

from smooth_operator.baselines.slsqp_method import SlsqpResult, ValueAndGradient
from smooth_operator.settings import check_numbers

LINE_SEARCH_FAILED: Final = (
    nlopt.RoundoffLimited,
    RuntimeError,
    getattr(nlopt, "runtime_error", RuntimeError),
)
"""Exceptions of NLopt after a failed line search, which float32 rounding can cause; the type
depends on the version."""


@dataclass(frozen=True)
class NloptConfig:
    """Stopping conditions of NLopt's SLSQP.

    Attributes:
        tolerance: smallest change of the objective in an iteration.
        max_evaluations: largest number of evaluations of the objective per frame.
    """

    tolerance: float = 1e-6
    max_evaluations: int = 100

    def __post_init__(self) -> None:
        check_numbers(self, positive=("tolerance", "max_evaluations"))


def nlopt_minimise(
    objective: ValueAndGradient,
    start: Float[np.ndarray, " m"],
    limits: Float[np.ndarray, "m 2"],
    config: NloptConfig,
) -> SlsqpResult:
    """Minimises within bounds (m, 2) from a start, which is clipped to them."""
    low, high = limits[:, 0], limits[:, 1]
    best = np.clip(np.asarray(start, np.float64), low, high)
    lowest, evaluations = math.inf, 0
    last_x, last = b"", np.empty(0)

    def evaluate(x: np.ndarray, gradient: np.ndarray) -> float:
        nonlocal best, lowest, evaluations, last_x, last
        # a line search evaluates the value, and then the gradient at the same point
        here = x.tobytes()
        if here != last_x:
            evaluations += 1
            last_x, last = here, objective(x)
            if not math.isfinite(last.sum()):  # a single test for all components
                raise nlopt.ForcedStop("the objective is not finite")
        value = float(last[0])
        if value < lowest:
            best, lowest = x.copy(), value
            # A point whose clipped gradient step stays where it is is a minimum.
            if not abs(np.clip(x - last[1:], low, high) - x).max():
                raise nlopt.ForcedStop("this is a minimum")
        if gradient.size:
            gradient[:] = last[1:]
        return value

    solver = nlopt.opt(nlopt.LD_SLSQP, len(best))
    solver.set_lower_bounds(low)
    solver.set_upper_bounds(high)
    solver.set_ftol_abs(config.tolerance)
    solver.set_maxeval(config.max_evaluations)
    solver.set_min_objective(evaluate)
    try:
        solver.optimize(best.copy())
    except (nlopt.ForcedStop, *LINE_SEARCH_FAILED):
        pass  # the best point so far is the result
    best = np.clip(best, low, high)  # NLopt may round over a bound
    return SlsqpResult(best, lowest if math.isfinite(lowest) else math.nan, evaluations)

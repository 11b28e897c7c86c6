"""Sequential least-squares quadratic programming (SLSQP; Kraft 1988) within bounds, by SciPy.

The published methods use at most 20 iterations. If the limit ends a frame, the result is not a
minimum, and the next frame continues from it, so the limit acts as a filter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.settings import check_numbers

ValueAndGradient: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""Function from (m,) float64 to (1 + m,): the value, followed by the gradient."""


@dataclass(frozen=True)
class SlsqpConfig:
    """Stopping conditions of SLSQP.

    Attributes:
        tolerance: smallest change of the objective in an iteration.
        max_iterations: largest number of iterations per frame; each is a quadratic subproblem and
            a line search with one or more evaluations.
    """

    tolerance: float = 1e-6
    max_iterations: int = 20

    def __post_init__(self) -> None:
        check_numbers(self, positive=("tolerance", "max_iterations"))


class SlsqpResult(NamedTuple):
    """Result of SLSQP.

    Attributes:
        x: (m,) the point, within the bounds.
        value: objective at the point; NaN if it is not finite.
        evaluations: number of evaluations of the objective.
    """

    x: Float[np.ndarray, " m"]
    value: float
    evaluations: int


def slsqp_minimise(
    objective: ValueAndGradient,
    start: Float[np.ndarray, " m"],
    limits: Float[np.ndarray, "m 2"],
    config: SlsqpConfig,
) -> SlsqpResult:
    """Minimises an objective within (m, 2) bounds, from a start that is clipped to them. The result
    is the last point, as in published code."""
    from scipy.optimize import minimize  # here, since the import takes half a second

    low, high = limits[:, 0], limits[:, 1]

    def evaluate(x: np.ndarray) -> tuple[float, np.ndarray]:
        both = objective(x).astype(np.float64)
        return float(both[0]), both[1:]

    solution = minimize(
        evaluate,
        np.clip(np.asarray(start, np.float64), low, high),
        jac=True,
        method="SLSQP",
        bounds=np.stack([low, high], axis=1),
        tol=config.tolerance,
        options={"maxiter": config.max_iterations},
    )
    x = np.clip(np.asarray(solution.x, np.float64), low, high)
    value = float(solution.fun)
    finite = math.isfinite(value) and bool(np.isfinite(x).all())
    return SlsqpResult(x, value if finite else math.nan, solution.nfev)

"""Sequential least-squares quadratic programming within bounds: SciPy's SLSQP, on the host.

The descending methods as published are solved by it, with a limit of 20 iterations. Where that
limit ends a frame, the answer is not a minimum, and the next frame goes on from it: the limit acts
as a filter. ``smooth_operator.baselines.slsqp`` has NLopt's form of the same algorithm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.baselines.slsqp import SlsqpResult, Stop, ValueAndGradient
from smooth_operator.errors import ConfigError

_STOPS: Final[dict[int, Stop]] = {0: "tolerance", 9: "evaluations"}
"""SciPy's exit modes; the others are failures of the line search or of the subproblem."""


@dataclass(frozen=True)
class ScipySlsqpConfig:
    """When SciPy's SLSQP stops.

    Attributes:
        tolerance: change of the objective in one iteration that counts as none.
        max_iterations: iterations per frame; each is one quadratic subproblem and a line search, of
            one evaluation or more.
    """

    tolerance: float = 1e-6
    max_iterations: int = 20

    def __post_init__(self) -> None:
        if self.tolerance <= 0 or self.max_iterations < 1:
            raise ConfigError(
                "SciPy's SLSQP needs tolerance > 0 and max_iterations >= 1, not "
                f"tolerance={self.tolerance}, max_iterations={self.max_iterations}"
            )


def scipy_slsqp_minimise(
    objective: ValueAndGradient,
    start: Float[np.ndarray, " m"],
    limits: Float[np.ndarray, "m 2"],
    config: ScipySlsqpConfig,
) -> SlsqpResult:
    """Minimise within bounds.

    The answer is the point where SciPy ends, as published code takes it, and not the best point
    seen. ``stopped_by`` is ``evaluations`` where the limit of iterations ended it.

    Args:
        objective: value and gradient at a point.
        start: (m,) where to begin; clipped to the bounds.
        limits: (m, 2) bounds.
        config: when to stop.
    """
    from scipy.optimize import minimize  # half a second that other methods need not pay

    low, high = limits[:, 0], limits[:, 1]
    evaluations = 0

    def evaluate(x: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal evaluations
        evaluations += 1
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
    if not (math.isfinite(value) and np.isfinite(x).all()):
        return SlsqpResult(x, math.nan, evaluations, "rounding")
    return SlsqpResult(x, value, evaluations, _STOPS.get(int(solution.status), "rounding"))

"""Sequential least-squares quadratic programming (SLSQP) within bounds, on the host.

DexPilot and its successors use Kraft's SLSQP (1988). With NLopt's implementation, the result is
the best evaluated point, whatever the reason of the stop. With SciPy's, which the published
descending methods use with 20 iterations at most, it is the last point: if the limit ends a frame,
that is not a minimum, and the next frame continues from it, so the limit acts as a filter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import nlopt
import numpy as np
from jaxtyping import Float

from smooth_operator.settings import check_numbers

ValueAndGradient: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""(m,) float64 to (1 + m,): the value, then the gradient."""


Stop: TypeAlias = Literal["tolerance", "optimality", "evaluations", "time", "rounding"]
"""Reason of a stop of SLSQP."""


LINE_SEARCH_FAILED: Final = (
    nlopt.RoundoffLimited,
    RuntimeError,
    getattr(nlopt, "runtime_error", RuntimeError),
)
"""Exceptions of NLopt after a failed line search, which the rounding of float32 can cause; which
one depends on the version."""


@dataclass(frozen=True)
class SlsqpConfig:
    """Stopping conditions of NLopt's SLSQP.

    Attributes:
        tolerance: smallest change of the objective in an iteration.
        max_evaluations: largest number of evaluations of the objective per frame.
        time_budget_ms: largest time per frame [ms], after which the result is the best point so
            far; commands then depend on the machine's speed. None: no limit.
        optimality: largest component of the gradient, without those that push against a bound, at
            which a point counts as a minimum. With 0, a search that starts at a minimum goes on
            until rounding stops it.
    """

    tolerance: float = 1e-6
    max_evaluations: int = 100
    time_budget_ms: float | None = None
    optimality: float = 0.0

    def __post_init__(self) -> None:
        numbers = ("tolerance", "max_evaluations", "time_budget_ms")
        check_numbers(self, positive=numbers, not_negative=("optimality",))


class SlsqpResult(NamedTuple):
    """Result of SLSQP.

    Attributes:
        x: (m,) the point, within the bounds.
        value: objective at the point; NaN if no evaluation was finite.
        evaluations: number of evaluations of the objective.
        stopped_by: ``tolerance``, ``optimality``, ``evaluations``, ``time`` or ``rounding`` (no
            further descent in the precision of the objective).
    """

    x: Float[np.ndarray, " m"]
    value: float
    evaluations: int
    stopped_by: Stop


def slsqp_minimise(
    objective: ValueAndGradient,
    start: Float[np.ndarray, " m"],
    limits: Float[np.ndarray, "m 2"],
    config: SlsqpConfig,
) -> SlsqpResult:
    """Minimise within (m, 2) bounds by NLopt's SLSQP from a start, which is clipped to them; the
    result is the best evaluated point. The objective is not finite where it is undefined."""
    low, high = limits[:, 0], limits[:, 1]
    best = np.clip(np.asarray(start, np.float64), low, high)
    lowest, evaluations = math.inf, 0
    last_x, last = b"", np.empty(0)
    stopped_by: Stop = "tolerance"

    def evaluate(x: np.ndarray, gradient: np.ndarray) -> float:
        nonlocal stopped_by, best, lowest, evaluations, last_x, last
        # a line search evaluates the value, and then the gradient at the same point
        here = x.tobytes()
        if here != last_x:
            evaluations += 1
            last_x, last = here, objective(x)
            if not math.isfinite(last.sum()):  # a single test for all components
                stopped_by = "rounding"
                raise nlopt.ForcedStop("the objective is not finite")
        value = float(last[0])
        if value < lowest:
            best, lowest = x.copy(), value
            # gradient step, clipped to the bounds
            if abs(np.clip(x - last[1:], low, high) - x).max() <= config.optimality:
                stopped_by = "optimality"
                raise nlopt.ForcedStop("this is a minimum")
        if gradient.size:
            gradient[:] = last[1:]
        return value

    solver = nlopt.opt(nlopt.LD_SLSQP, len(best))
    solver.set_lower_bounds(low)
    solver.set_upper_bounds(high)
    solver.set_ftol_abs(config.tolerance)
    solver.set_maxeval(config.max_evaluations)
    if config.time_budget_ms is not None:
        solver.set_maxtime(config.time_budget_ms * 1e-3)
    solver.set_min_objective(evaluate)
    try:
        solver.optimize(best.copy())
    except nlopt.ForcedStop:
        pass  # ``evaluate`` has set the reason
    except LINE_SEARCH_FAILED:
        stopped_by = "rounding"
    else:
        code = solver.last_optimize_result()
        if code == nlopt.MAXEVAL_REACHED:
            stopped_by = "evaluations"
        elif code == nlopt.MAXTIME_REACHED:
            stopped_by = "time"
    best = np.clip(best, low, high)  # NLopt may round over a bound
    return SlsqpResult(best, lowest if math.isfinite(lowest) else math.nan, evaluations, stopped_by)


_STOPS: Final[dict[int, Stop]] = {0: "tolerance", 9: "evaluations"}
"""SciPy's exit modes; others are failures of the line search or of the subproblem."""


@dataclass(frozen=True)
class ScipySlsqpConfig:
    """Stopping conditions of SciPy's SLSQP.

    Attributes:
        tolerance: smallest change of the objective in an iteration.
        max_iterations: largest number of iterations per frame; each is a quadratic subproblem and
            a line search with one or more evaluations.
    """

    tolerance: float = 1e-6
    max_iterations: int = 20

    def __post_init__(self) -> None:
        check_numbers(self, positive=("tolerance", "max_iterations"))


def scipy_slsqp_minimise(
    objective: ValueAndGradient,
    start: Float[np.ndarray, " m"],
    limits: Float[np.ndarray, "m 2"],
    config: ScipySlsqpConfig,
) -> SlsqpResult:
    """Minimise as ``slsqp_minimise`` by SciPy's SLSQP; the result is the last point, as in
    published code. ``stopped_by`` is ``evaluations`` after the limit of iterations."""
    from scipy.optimize import minimize  # here, since the import takes half a second

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

"""Sequential least-squares quadratic programming within bounds: NLopt's SLSQP, on the host.

Kraft's SLSQP (1988) is what DexPilot and its successors are solved with. Whatever makes it stop,
the answer here is the best point that it has seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import nlopt
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError

ValueAndGradient: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""(m,) float64 to (1 + m,): the value, then the gradient."""


Stop: TypeAlias = Literal["tolerance", "optimality", "evaluations", "time", "rounding"]
"""Why SLSQP stopped."""


LINE_SEARCH_FAILED: Final = (
    nlopt.RoundoffLimited,
    RuntimeError,
    getattr(nlopt, "runtime_error", RuntimeError),
)
"""What NLopt raises of a failed line search, which float32 may end in: a RuntimeError or, by the
version, another exception."""


@dataclass(frozen=True)
class SlsqpConfig:
    """When SLSQP stops.

    Attributes:
        tolerance: change of the objective in one iteration that counts as none.
        max_evaluations: evaluations of the objective per frame.
        time_budget_ms: time per frame [ms]; the best point so far is then the answer, and the
            same frames no longer give the same commands on a slower machine. None: no limit.
        optimality: largest component of the gradient, but for those that push against a bound, at
            which a point counts as a minimum. 0 asks for none: from a start that is one already,
            SLSQP then searches until rounding stops it.
    """

    tolerance: float = 1e-6
    max_evaluations: int = 100
    time_budget_ms: float | None = None
    optimality: float = 0.0

    def __post_init__(self) -> None:
        if self.tolerance <= 0 or self.max_evaluations < 1:
            raise ConfigError(
                "SLSQP needs tolerance > 0 and max_evaluations >= 1, not "
                f"tolerance={self.tolerance}, max_evaluations={self.max_evaluations}"
            )
        if not self.optimality >= 0:
            raise ConfigError(f"optimality must not be negative, not {self.optimality}")
        if self.time_budget_ms is not None and not self.time_budget_ms > 0:
            raise ConfigError(
                f"time_budget_ms must be positive, or None for no limit, not {self.time_budget_ms}"
            )


class SlsqpResult(NamedTuple):
    """Where SLSQP ended.

    Attributes:
        x: (m,) the best point seen, within the bounds.
        value: the objective there; NaN if it was finite nowhere.
        evaluations: of the objective.
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
    """Minimise within bounds.

    Args:
        objective: value and gradient at a point; not finite where it is undefined.
        start: (m,) where to begin; clipped to the bounds.
        limits: (m, 2) bounds.
        config: when to stop.
    """
    low, high = limits[:, 0], limits[:, 1]
    best = np.clip(np.asarray(start, np.float64), low, high)
    lowest, evaluations = math.inf, 0
    last_x, last = b"", np.empty(0)
    stopped_by: Stop = "tolerance"

    def evaluate(x: np.ndarray, gradient: np.ndarray) -> float:
        nonlocal stopped_by, best, lowest, evaluations, last_x, last
        # A line search asks for the value, and then for the gradient at the same point.
        here = x.tobytes()
        if here != last_x:
            evaluations += 1
            last_x, last = here, objective(x)
            if not math.isfinite(last.sum()):  # one number counts them all
                stopped_by = "rounding"
                raise nlopt.ForcedStop("the objective is not finite")
        value = float(last[0])
        if value < lowest:
            best, lowest = x.copy(), value
            # a step down the gradient that the bounds cut short
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
        pass  # it was said why
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

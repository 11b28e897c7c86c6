"""Population-averaged regression: GEE with an exchangeable working correlation.

The fit is statsmodels' ``GEE``. Rows of one operator share the correlation α; scale φ and α are
moment estimates without correction for the number of coefficients, as geepack has them.

Two covariances of the coefficients: the sandwich (Liang and Zeger 1986), which is too small with
few operators, and Mancl and DeRouen's (2001), which corrects each operator's residuals for their
leverage.

Separation is detected by linear programming before the fit: if some combination of the columns is
never negative for successes, never positive for failures, and not always zero, its coefficient is
infinite and has no standard error, although an iteration may seem to converge (Albert and Anderson
1984; Konis 2007).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linprog

from smooth_operator.errors import MissingExtraError, StudyError
from smooth_operator.study.analysis.frame import Frame

_ROUNDS: Final = 10
_STEPS: Final = 50
"""Steps of a round; after each round the fit is checked."""
_TOLERANCE: Final = 1e-12
"""Norm of the estimating equations at which a fit has converged, over that of sum |x|."""
_STILL: Final = 1e-10
"""Last step, over 1 + |beta|, at which a fit has converged as well: near the lowest possible
working correlation, rounding errors of the equations exceed the tolerance."""
_RUNAWAY: Final = 20.0
"""Log-odds from which a fit diverges: they are a probability of 2e-9."""
_EDGE: Final = 0.01
"""Smallest eigenvalue of a working correlation that can be inverted reliably."""
_ALONE: Final = 1 - 1e-10
"""Leverage from which an operator alone determines a coefficient."""
_INFINITE: Final = (
    "the GEE runs away to infinite odds: retargeter, task or trial (nearly) determine success "
    "without error"
)


@dataclass(frozen=True, eq=False)
class GeeFit:
    """A fitted population-averaged logistic model.

    Attributes:
        beta: coefficients, on the logit scale (p,).
        robust: sandwich covariance (p, p).
        mancl_derouen: sandwich covariance with residuals corrected for leverage (p, p); None if the
            leverage of an operator can't be corrected.
        alpha: working correlation α of two rows of one operator.
        phi: scale φ.
        operators: number of operators.
        margin: 1 + (n - 1) α for the operator with the most rows n. For a negative α it is the
            smallest eigenvalue of the working correlation, which must be positive.
    """

    beta: Float[np.ndarray, " p"]
    robust: Float[np.ndarray, "p p"]
    mancl_derouen: Float[np.ndarray, "p p"] | None
    alpha: float
    phi: float
    operators: int
    margin: float

    def check_correlation(self) -> None:
        """Refuses a working correlation near the lowest possible one.

        Raises:
            StudyError: the working correlation is at its lower bound, or below.
        """
        if self.margin < _EDGE:
            raise StudyError(
                f"the working correlation is estimated as {self.alpha:.4f}, at the edge of what "
                "the rows of one operator can have, or beyond it: successes and failures alternate "
                "more evenly than by chance. Estimates can then be far from the observed rates; "
                "see those"
            )


def require_statsmodels() -> Any:
    """Imports statsmodels' module with the class ``GEE``, which takes seconds.

    Raises:
        MissingExtraError: statsmodels is not installed.
    """
    try:
        from statsmodels.genmod import generalized_estimating_equations
    except ImportError as error:
        raise MissingExtraError("analysing success rates", "study") from error
    return generalized_estimating_equations


def fit_gee(
    design: Float[np.ndarray, "n p"],
    success: Float[np.ndarray, " n"],
    groups: Int[np.ndarray, " n"],
) -> GeeFit:
    """Fits by Fisher scoring; every step estimates α and φ again.

    Args:
        design: columns of full rank; separation must be excluded before.
        success: 0 or 1 for each row.
        groups: operator of each row, codes 0 to g - 1, all of which occur.

    Returns:
        The fit at the fixed point.

    Raises:
        StudyError: the fit does not converge, or diverges to infinite odds.
        MissingExtraError: statsmodels is not installed.
    """
    estimating_equations = require_statsmodels()
    from statsmodels.genmod.cov_struct import Exchangeable
    from statsmodels.genmod.families import Binomial

    sizes = np.bincount(groups)
    correctable = _correctable(design, groups)
    try:
        # A fit that diverges is refused below, with its own message.
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = estimating_equations.GEE(
                success, design, groups=groups, family=Binomial(), cov_struct=Exchangeable()
            )
            start = None
            for _ in range(_ROUNDS):
                fit = model.fit(
                    maxiter=_STEPS,
                    ctol=_TOLERANCE * float(np.linalg.norm(np.abs(design).sum(axis=0))),
                    start_params=start,
                    cov_type="bias_reduced" if correctable else "robust",
                    ddof_scale=0,
                    scale="X2",
                )
                if fit is None or not np.max(np.abs(design @ fit.params)) <= _RUNAWAY:
                    raise StudyError(_INFINITE)
                start = fit.params
                history = np.array(fit.fit_history["params"])
                step = float(np.max(np.abs(np.diff(history[-2:], axis=0)), initial=0.0))
                still = len(history) > 1 and step <= _STILL * (1 + np.max(np.abs(start)))
                converged = fit.converged or still
                if converged:
                    break
    except np.linalg.LinAlgError as error:  # NumPy's error for infinite odds
        raise StudyError(_INFINITE) from error
    alpha = float(fit.cov_struct.dep_params)
    if not converged:
        raise StudyError(
            f"the GEE did not converge in {_ROUNDS * _STEPS} steps (last step {step:.1e}, working "
            f"correlation {alpha:.3f}); its figures would mean nothing"
        )
    largest = int(sizes.max())
    return GeeFit(
        beta=fit.params,
        robust=fit.cov_robust,
        mancl_derouen=fit.cov_robust_bc if correctable else None,
        alpha=alpha,
        phi=float(fit.scale),
        operators=len(sizes),
        margin=1 + (largest - 1) * alpha,
    )


def mancl_derouen(
    design: Float[np.ndarray, "n p"],
    residuals: Float[np.ndarray, " n"],
    groups: Int[np.ndarray, " n"],
    ratio: float,
) -> Float[np.ndarray, "p p"] | None:
    """Covariance of a linear model's coefficients that is robust against any correlation within
    operators.

    It is the sandwich covariance of a fit with a random intercept as working covariance, corrected
    for leverage. With t on one degree of freedom less than operators it also holds where operators
    differ in a slope, unlike Satterthwaite's t on a model without random slopes.

    Args:
        design: fixed effects, with full column rank.
        residuals: y - X β, with the predicted intercepts still in them.
        groups: operator of each row, codes from 0.
        ratio: variance of operators over residual variance in the working covariance.

    Returns:
        The covariance; None where an operator's leverage can't be corrected.
    """
    if not _correctable(design, groups):
        return None
    estimating_equations = require_statsmodels()
    from statsmodels.genmod.cov_struct import Exchangeable

    structure = Exchangeable()
    model = estimating_equations.GEE(
        residuals, design, groups=groups, cov_struct=structure, update_dep=False
    )
    structure.dep_params = ratio / (1 + ratio)
    start = np.zeros(design.shape[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = model.fit(maxiter=2, start_params=start, cov_type="bias_reduced")
    return np.asarray(fit.cov_robust_bc)


def _correctable(design: Float[np.ndarray, "n p"], groups: Int[np.ndarray, " n"]) -> bool:
    """True if no operator alone determines a coefficient.

    The leverage of an operator is the largest eigenvalue of its block of the hat matrix, 0 to 1.
    Without an operator with leverage 1 the design loses rank, whatever the weights.
    """
    basis, _ = np.linalg.qr(design)
    blocks = (basis[groups == k] for k in range(int(groups.max()) + 1))
    return bool(max(np.linalg.norm(block, 2) ** 2 for block in blocks) < _ALONE)


_ANY: Final = 1e-7


def separating(
    design: Float[np.ndarray, "n p"], success: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " p"] | None:
    """Finds a direction that separates successes from failures, completely or in part.

    Args:
        design: columns of the model (n, p).
        success: 0 or 1 (n,).

    Returns:
        Coefficients of the direction in -1 to 1; None without separation.
    """
    signed = design * np.where(success > 0, 1.0, -1.0)[:, None]
    # Equal rows are one constraint; without the index of the trial a study has few distinct rows.
    signed = np.unique(signed, axis=0)
    solution = linprog(
        -signed.sum(axis=0),
        A_ub=-signed,
        b_ub=np.zeros(len(signed)),
        bounds=[(-1, 1)] * design.shape[1],
        method="highs",
    )
    if solution.status != 0 or -solution.fun <= _ANY:
        return None
    return np.asarray(solution.x)


def one_sided_levels(frame: Frame) -> list[str]:
    """Describes retargeters and tasks that always succeed or always fail."""
    texts = []
    for kind, names, codes in (
        ("retargeter", frame.retargeters, frame.retargeter),
        ("task", frame.tasks, frame.task),
    ):
        for j, name in enumerate(names):
            outcome = frame.outcome[codes == j]
            if len(outcome) and np.ptp(outcome) == 0:
                texts.append(f"{kind} {name} has {_count(outcome)}")
    return texts


def one_sided_cells(frame: Frame) -> list[str]:
    """Describes cells of retargeter and task that always succeed or always fail."""
    texts = []
    for j, name in enumerate(frame.retargeters):
        for k, task in enumerate(frame.tasks):
            outcome = frame.outcome[(frame.retargeter == j) & (frame.task == k)]
            if len(outcome) and np.ptp(outcome) == 0:
                texts.append(f"{name} in task {task} has {_count(outcome)}")
    return texts


def _count(outcome: Float[np.ndarray, " n"]) -> str:
    return f"{int(outcome.sum())} successes in {len(outcome)} trials"

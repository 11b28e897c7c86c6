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

Where a retargeter or task always or never succeeds, the fit is Firth's (1993) bias-reduced logistic
regression, whose coefficients are always finite (Heinze and Schemper 2002). It is a GEE with
independence as working correlation, so that the same covariances hold. All residuals of such a
level are alike. The sandwich takes that for certainty, so the model's own variance is added for the
level, as Morel, Bokossa and Neerchal (2003) do for all coefficients.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linprog
from scipy.special import expit

from smooth_operator.errors import StudyError
from smooth_operator_study.analysis.frame import Frame

_ROUNDS: Final = 10
_STEPS: Final = 50
"""Number of steps per round; after each round the fit is checked."""
_TOLERANCE: Final = 1e-12
"""Norm of the estimating equations at which a fit has converged, over that of sum |x|."""
_STILL: Final = 1e-10
"""Last step, over 1 + |beta|, at which a fit has converged as well: near the lowest possible
working correlation, rounding errors of the equations exceed the tolerance."""
_RUNAWAY: Final = 20.0
"""Log-odds above which a fit counts as diverging; they correspond to a probability of 2e-9."""
_LONGEST: Final = 2.0
"""Largest change of a row's log-odds in one step of the bias-reduced fit."""
_EDGE: Final = 0.01
"""Smallest eigenvalue of a working correlation that can be inverted reliably."""
_ALONE: Final = 1 - 1e-10
"""Leverage above which an operator alone determines a coefficient."""
_INFINITE: Final = (
    "the GEE diverges to infinite odds: retargeter, task or trial determine success (nearly) "
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
        firth: True for Firth's bias-reduced fit, which has α = 0 and φ = 1.
    """

    beta: Float[np.ndarray, " p"]
    robust: Float[np.ndarray, "p p"]
    mancl_derouen: Float[np.ndarray, "p p"] | None
    alpha: float
    phi: float
    operators: int
    margin: float
    firth: bool = False

    def check_correlation(self) -> None:
        """Raises StudyError if the working correlation is near the lowest possible one."""
        if self.margin < _EDGE:
            raise StudyError(
                "with so few trials the model could not be fitted: successes and failures of an "
                f"operator alternate more evenly than by chance (working correlation "
                f"{self.alpha:.4f}, at or beyond its lowest value). See the observed rates"
            )


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
    """
    # Imported here, since it takes seconds.
    from statsmodels.genmod.cov_struct import Exchangeable
    from statsmodels.genmod.families import Binomial
    from statsmodels.genmod.generalized_estimating_equations import GEE

    sizes = np.bincount(groups)
    correctable = _correctable(design, groups)
    try:
        # A fit that diverges is refused below, with its own message.
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = GEE(
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
            f"the GEE did not converge in {_ROUNDS * _STEPS} steps (last step {step:.1e}, "
            f"working correlation {alpha:.3f}); its results would be meaningless"
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


@dataclass(frozen=True, eq=False)
class OneSided:
    """Level of a factor that always or never succeeds.

    Attributes:
        text: description, with the number of successes.
        rows: rows of the level (n,).
        direction: change of the coefficients that changes the log-odds of this level alone (p,).
    """

    text: str
    rows: Bool[np.ndarray, " n"]
    direction: Float[np.ndarray, " p"]


def one_sided_levels(frame: Frame) -> list[OneSided]:
    """Finds retargeters and tasks that always or never succeed; none if the outcome is constant."""
    if not len(frame) or np.ptp(frame.outcome) == 0:
        return []
    levels, first, width = list[OneSided](), 1, frame.design()[0].shape[1]
    for kind, names, codes in (
        ("retargeter", frame.retargeters, frame.retargeter),
        ("task", frame.tasks, frame.task),
    ):
        for j, name in enumerate(names):
            rows = codes == j
            if rows.any() and np.ptp(frame.outcome[rows]) == 0:
                direction = np.zeros(width)
                if j:
                    direction[first + j - 1] = 1
                else:  # the reference: the intercept changes, and all other levels change back
                    direction[0] = 1
                    direction[first : first + len(names) - 1] = -1
                text = f"{kind} {name} has {_count(frame.outcome[rows])}"
                levels.append(OneSided(text, rows, direction))
        first += len(names) - 1
    return levels


def fit_firth(
    design: Float[np.ndarray, "n p"],
    success: Float[np.ndarray, " n"],
    groups: Int[np.ndarray, " n"],
    levels: Sequence[OneSided],
) -> GeeFit:
    """Fits Firth's bias-reduced logistic regression, with covariances clustered by operators.

    The score has (1/2 - π) h x of each row added, where h is the leverage of the row.

    Args:
        design: columns of full rank.
        success: 0 or 1 for each row.
        groups: operator of each row, codes 0 to g - 1, all of which occur.
        levels: levels that always or never succeed. The covariances have the model's variance of
            their log-odds added.
    """
    width = design.shape[1]
    beta = np.zeros(width)
    for _ in range(_STEPS * _ROUNDS):
        chance = expit(design @ beta)
        weighted = (chance * (1 - chance))[:, None] * design
        inverse = np.linalg.inv(design.T @ weighted)
        leverage = np.sum((weighted @ inverse) * design, axis=1)
        score = design.T @ (success - chance + leverage * (0.5 - chance))
        step = inverse @ score
        furthest = float(np.max(np.abs(design @ step)))
        beta = beta + step * min(1.0, _LONGEST / max(furthest, _STILL))
        if furthest <= _STILL:
            break
    else:
        raise StudyError(f"the bias-reduced fit did not converge (last step {furthest:.1e})")
    if np.max(np.abs(design @ beta)) > _RUNAWAY:
        raise StudyError(_INFINITE)
    own = np.zeros((width, width))
    for level in levels:
        mean = design[level.rows].mean(axis=0)
        own += float(mean @ inverse @ mean) * np.outer(level.direction, level.direction)
    residuals = (success - chance)[:, None] * design
    scores = np.zeros((int(groups.max()) + 1, width))
    np.add.at(scores, groups, residuals)
    robust = inverse @ scores.T @ scores @ inverse
    corrected = None
    if _correctable(design, groups):
        # (I - H_k)⁻¹ of the residuals of operator k, in the space of the coefficients
        for k in range(len(scores)):
            block = design[groups == k].T @ weighted[groups == k]
            scores[k] = np.linalg.solve(np.eye(width) - block @ inverse, scores[k])
        corrected = inverse @ scores.T @ scores @ inverse + own
    return GeeFit(
        beta=beta,
        robust=robust + own,
        mancl_derouen=corrected,
        alpha=0.0,
        phi=1.0,
        operators=len(scores),
        margin=1.0,
        firth=True,
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
    # Imported here, since it takes seconds.
    from statsmodels.genmod.cov_struct import Exchangeable
    from statsmodels.genmod.generalized_estimating_equations import GEE

    structure = Exchangeable()
    model = GEE(residuals, design, groups=groups, cov_struct=structure, update_dep=False)
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

"""Linear mixed model with nested random intercepts, fitted by restricted maximum likelihood (REML).

y = X β + Σ_k u_k[group] + ε,  u_k ~ N(0, λ_k σ²),  ε ~ N(0, σ²). The groups of each level lie
within those of the level before: operators, operators with one retargeter, blocks. The operators'
level alone gives the model of a random intercept for each operator.

The data determine the λ only through the means over the finest groups (leaves), so every matrix has
as many rows as there are leaves. The covariance of the leaves' means is σ² H, with
H = diag(1 / size) + Σ_k λ_k G_k G_k', where G_k is 1 where a leaf lies in a group of level k.
Criterion, gradient and Hessian are exact. Degrees of freedom are Satterthwaite's, as in lmerTest: a
variance that is estimated as zero does not count.

Sources: Bates et al. 2015 (profiled criterion), Gilmour, Thompson and Cullis 1995 (derivatives),
Fai and Cornelius 1996 and Kuznetsova et al. 2017 (Satterthwaite's approximation).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.errors import StudyError

_START: Final = 0.3
"""Ratio of every variance at the start of the search."""
_STEPS: Final = 200
_FLAT: Final = 1e-13
"""Expected gain of a step at which the search ends, in units of -2 log L."""
_NO_RESIDUAL: Final = 1e-12
"""Share of the outcome's sum of squares within leaves below which there is no residual."""
_EXPLAINED: Final = (
    "the model explains the outcome without any residual, so nothing can be tested: within "
    "the blocks of operators, the outcome is constant or varies exactly as the model predicts"
)


@dataclass(frozen=True, eq=False)
class MixedFit:
    """A fitted model with nested random intercepts.

    Attributes:
        beta: fixed effects (p,).
        covariance: covariance (X' V⁻¹ X)⁻¹ of the fixed effects (p, p).
        levels: names of the levels of the model, coarse to fine.
        ratios: λ of each level, its variance over the residual variance (k,).
        residual_variance: σ².
        intercepts: predicted u of each group of the first level (g,), in the order of their codes.
        residuals: y - X β - all u, of each row (n,).
        log_likelihood: restricted log-likelihood, as lme4 reports it.
    """

    beta: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    levels: tuple[str, ...]
    ratios: Float[np.ndarray, " k"]
    residual_variance: float
    intercepts: Float[np.ndarray, " g"]
    residuals: Float[np.ndarray, " n"]
    log_likelihood: float
    _gradient: Float[np.ndarray, "k p p"]  # d (X' V⁻¹ X)⁻¹ / d λ, over σ²
    _information: Float[np.ndarray, "l l"]  # half the Hessian of -2 log L in (λ, σ²)

    @property
    def variances(self) -> dict[str, float]:
        """Variance of each level, and ``residual``."""
        by_level = {
            name: float(ratio * self.residual_variance)
            for name, ratio in zip(self.levels, self.ratios, strict=True)
        }
        return by_level | {"residual": self.residual_variance}

    @property
    def sd_row(self) -> float:
        """Standard deviation of a single row, from all variances together."""
        return float(np.sqrt(self.residual_variance * (1 + self.ratios.sum())))

    @cached_property
    def _variance_of_parameters(self) -> Float[np.ndarray, "l l"]:
        # At the edge a λ does not vary: its level is gone from the model.
        free = np.flatnonzero(np.append(self.ratios > 0, True))
        covariance = np.zeros_like(self._information)
        covariance[np.ix_(free, free)] = np.linalg.pinv(
            self._information[np.ix_(free, free)], rcond=1e-12, hermitian=True
        )
        return covariance

    def satterthwaite(self, contrast: Float[np.ndarray, " p"]) -> float:
        """Degrees of freedom of a contrast of the fixed effects."""
        variance = float(contrast @ self.covariance @ contrast)
        by_ratio = self.residual_variance * (self._gradient @ contrast @ contrast)
        gradient = np.append(by_ratio, variance / self.residual_variance)
        spread = float(gradient @ self._variance_of_parameters @ gradient)
        return 2.0 * variance**2 / spread if spread > 0 else float("nan")


def fit_mixed(
    design: Float[np.ndarray, "n p"],
    outcome: Float[np.ndarray, " n"],
    levels: Mapping[str, Int[np.ndarray, " n"]],
) -> MixedFit:
    """Fits the model by REML.

    Args:
        design: fixed effects, of full column rank.
        levels: name of each level -> group of each row, codes from 0; coarse to fine. A level that
            can't be separated from the one before, or from the residual, is left out of the model.

    Returns:
        The fit at the minimum of the criterion.
    """
    rows, width = design.shape
    if rows <= width:
        raise StudyError(
            f"a mixed model with {width} coefficients needs more rows than coefficients; "
            f"there are {rows}"
        )
    return _Profile(design, outcome, _estimable(levels)).fit()


def _estimable(levels: Mapping[str, Int[np.ndarray, " n"]]) -> dict[str, Int[np.ndarray, " n"]]:
    """Levels with more groups than the one before, and fewer than rows."""
    estimable: dict[str, Int[np.ndarray, " n"]] = {}
    before = 0
    for name, codes in levels.items():
        count = len(np.unique(codes))
        if not estimable or before < count < len(codes):
            estimable[name] = codes
            before = count
    return estimable


@dataclass(frozen=True, eq=False)
class _Derivatives:
    """Quantities at λ, with P = H⁻¹ - H⁻¹ X A⁻¹ X' H⁻¹, A = X' H⁻¹ X and V_k = G_k G_k'."""

    free: int  # rows less coefficients
    beta: Float[np.ndarray, " p"]
    inverse: Float[np.ndarray, "p p"]  # A⁻¹
    squares: float  # y' P y
    traces: Float[np.ndarray, " k"]  # tr P V_k
    sums: list[Float[np.ndarray, " g"]]  # G_k' P y
    crossed: Float[np.ndarray, "k k"]  # tr P V_k P V_l
    bent: Float[np.ndarray, "k k"]  # y' P V_k P V_l P y
    gradient: Float[np.ndarray, "k p p"]  # d A⁻¹ / d λ_k

    @property
    def squared(self) -> Float[np.ndarray, " k"]:
        """Quadratic forms y' P V_k P y."""
        return np.array([sums @ sums for sums in self.sums])

    @property
    def slope(self) -> Float[np.ndarray, " k"]:
        """Gradient of the criterion."""
        return self.traces - self.free * self.squared / self.squares

    @property
    def observed(self) -> Float[np.ndarray, "k k"]:
        """Hessian of the criterion."""
        scaled = self.squared / self.squares
        return -self.crossed + self.free * (2 * self.bent / self.squares - np.outer(scaled, scaled))

    @property
    def expected(self) -> Float[np.ndarray, "k k"]:
        """Expectation of the Hessian of the criterion."""
        return self.crossed - np.outer(self.traces, self.traces) / self.free


class _Profile:
    """The restricted likelihood as a function of λ, computed from means over the leaves."""

    def __init__(
        self,
        design: Float[np.ndarray, "n p"],
        outcome: Float[np.ndarray, " n"],
        levels: Mapping[str, Int[np.ndarray, " n"]],
    ) -> None:
        self.levels = tuple(levels)
        self.design, self.outcome = design, outcome
        self.free = len(design) - design.shape[1]
        codes = np.column_stack(list(levels.values()))
        paths, self.leaf = np.unique(codes, axis=0, return_inverse=True)
        self.leaf = self.leaf.reshape(-1)
        self.members = [
            (column[:, None] == np.unique(column)).astype(float) for column in paths.T
        ]  # G_k
        self.sizes = np.bincount(self.leaf).astype(float)
        both = np.column_stack([design, outcome])
        sums = np.zeros((len(self.sizes), both.shape[1]))
        np.add.at(sums, self.leaf, both)
        self.means = sums / self.sizes[:, None]
        within = both - self.means[self.leaf]
        self.within = within.T @ within
        self._check_residual()

    def _check_residual(self) -> None:
        moment, right = self.within[:-1, :-1], self.within[:-1, -1]
        total = float(self.within[-1, -1])
        left = total - float(right @ np.linalg.lstsq(moment, right, rcond=None)[0])
        centred = self.outcome - self.outcome.mean()
        if left <= _NO_RESIDUAL * max(total, 1e-12 * float(centred @ centred)) or total == 0:
            raise StudyError(_EXPLAINED)

    def covariance(self, ratios: Float[np.ndarray, " k"]) -> Float[np.ndarray, "m m"]:
        """H at λ."""
        parts = (ratio * g @ g.T for ratio, g in zip(ratios, self.members, strict=True))
        return np.asarray(np.diag(1 / self.sizes) + sum(parts))

    def solve(
        self, cross: Float[np.ndarray, "q q"]
    ) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"], float]:
        """(A, β, y' P y) of the cross products [X y]' H⁻¹ [X y] of all rows."""
        matrix, right = cross[:-1, :-1], cross[:-1, -1]
        beta = np.linalg.solve(matrix, right)
        signed = np.append(-beta, 1.0)
        return matrix, beta, float(signed @ cross @ signed)

    def criterion(self, ratios: Float[np.ndarray, " k"]) -> float:
        """-2 log of the restricted likelihood with β and σ² profiled out, without constants."""
        root = np.linalg.cholesky(self.covariance(ratios))
        scaled = np.linalg.solve(root, self.means)
        matrix, _, squares = self.solve(self.within + scaled.T @ scaled)
        if squares <= 0:  # only rounding is left
            raise StudyError(_EXPLAINED)
        logs = 2 * np.sum(np.log(np.diag(root))) + np.sum(np.log(self.sizes))
        return float(logs + np.linalg.slogdet(matrix)[1] + self.free * np.log(squares / self.free))

    def derivatives(self, ratios: Float[np.ndarray, " k"]) -> _Derivatives:
        """Quantities for the derivatives of the criterion at λ."""
        metric = np.linalg.inv(self.covariance(ratios))
        matrix, beta, squares = self.solve(self.within + self.means.T @ metric @ self.means)
        inverse = np.linalg.inv(matrix)
        fixed = metric @ self.means[:, :-1]
        projected = metric - fixed @ inverse @ fixed.T
        left = metric @ (self.means[:, -1] - self.means[:, :-1] @ beta)
        sums = [g.T @ left for g in self.members]
        halves = [g.T @ projected for g in self.members]
        blocks = [[half @ g for g in self.members] for half in halves]
        turned = [g.T @ fixed @ inverse for g in self.members]
        return _Derivatives(
            self.free,
            beta,
            inverse,
            squares,
            np.array([np.trace(row[k]) for k, row in enumerate(blocks)]),
            sums,
            np.array([[np.sum(block**2) for block in row] for row in blocks]),
            np.array(
                [
                    [sums[k] @ block @ sums[j] for j, block in enumerate(row)]
                    for k, row in enumerate(blocks)
                ]
            ),
            np.array([one.T @ one for one in turned]),
        )

    def minimise(self) -> Float[np.ndarray, " k"]:
        """Finds λ at the minimum of the criterion, with no λ below zero, by Newton's method."""
        ratios = np.full(len(self.levels), _START)
        value = self.criterion(ratios)
        for _ in range(_STEPS):
            at = self.derivatives(ratios)
            slope = at.slope
            free = (ratios > 0) | (slope < 0)
            while True:
                direction = _step(at, free)
                outwards = (ratios == 0) & (direction < 0)
                if not outwards.any():
                    break
                free &= ~outwards
            gain = -float(direction @ slope)
            if gain < _FLAT:
                break
            ratios, value, moved = self._search(ratios, value, direction, gain)
            if not moved:
                break
        return ratios

    def _search(
        self,
        ratios: Float[np.ndarray, " k"],
        value: float,
        direction: Float[np.ndarray, " k"],
        gain: float,
    ) -> tuple[Float[np.ndarray, " k"], float, bool]:
        """Halves a step until it lowers the criterion; a λ that would be negative becomes zero."""
        falling = direction < 0
        reach = np.full(len(ratios), np.inf)
        reach[falling] = -ratios[falling] / direction[falling]
        length = min(1.0, float(reach.min()))
        for _ in range(60):
            # A λ that would end a hair above zero is set to zero, or steps would get ever shorter.
            there = np.where(reach <= length, 0.0, np.maximum(ratios + length * direction, 0.0))
            after = self.criterion(there)
            if after <= value - 1e-4 * length * gain or (gain < 1e-8 and after <= value + 1e-9):
                return there, after, bool(np.any(there != ratios))
            length /= 2
        return ratios, value, False

    def fit(self) -> MixedFit:
        """Fits the model."""
        ratios = self.minimise()
        at = self.derivatives(ratios)
        variance, count = at.squares / self.free, len(ratios)
        information = np.zeros((count + 1, count + 1))
        information[:count, :count] = -at.crossed + 2 * at.bent / variance
        information[:count, count] = information[count, :count] = at.squared / variance**2
        information[count, count] = self.free / variance**2
        effects = [ratio * sums for ratio, sums in zip(ratios, at.sums, strict=True)]
        of_leaves = sum(g @ effect for g, effect in zip(self.members, effects, strict=True))
        deviance = self.criterion(ratios) + self.free * (1 + np.log(2 * np.pi))
        return MixedFit(
            beta=at.beta,
            covariance=variance * at.inverse,
            levels=self.levels,
            ratios=ratios,
            residual_variance=variance,
            intercepts=effects[0],
            residuals=self.outcome - self.design @ at.beta - np.asarray(of_leaves)[self.leaf],
            log_likelihood=-0.5 * deviance,
            _gradient=at.gradient,
            _information=0.5 * information,
        )


def _step(at: _Derivatives, free: Bool[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Newton's step in the free directions; Fisher's step if the criterion is not convex."""
    step = np.zeros(len(free))
    for hessian in (at.observed, at.expected, np.diag(np.diag(at.expected))):
        part = hessian[np.ix_(free, free)]
        try:
            np.linalg.cholesky(part)
        except np.linalg.LinAlgError:
            continue
        step[free] = -np.linalg.solve(part, at.slope[free])
        break
    return step

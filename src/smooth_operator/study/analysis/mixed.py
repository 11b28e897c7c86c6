"""Linear mixed model with nested random intercepts, by profile REML.

y = X β + Σ_k u_k[group] + ε,  u_k ~ N(0, λ_k σ²),  ε ~ N(0, σ²), where the groups of each level lie
within those of the one before: operators, operators with one retargeter, and blocks.

All that the data say about the λ is in the means over the finest groups (leaves), so every matrix
has as many rows as there are leaves. Criterion, gradient and Hessian are exact. Degrees of freedom
are Satterthwaite's, as lmerTest has them: a variance that is estimated as zero does not count.

With the operators' level alone it is the model of a random intercept for each operator.

Sources: Bates et al. 2015 (profiled criterion), Gilmour, Thompson and Cullis 1995 (derivatives),
Fai and Cornelius 1996 and Kuznetsova et al. 2017 (Satterthwaite's approximation), Mancl and
DeRouen 2001 (``mancl_derouen``).
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
"""Ratio of every variance at which the search begins."""
_STEPS: Final = 200
_FLAT: Final = 1e-13
"""Expected gain of a step, in units of -2 log L, at which the search ends."""
_NO_RESIDUAL: Final = 1e-12
"""Share of the outcome's sum of squares within leaves below which no residual is left."""
_ALONE: Final = 1 - 1e-10
"""Leverage from which on an operator alone determines a coefficient."""
_EXPLAINED: Final = (
    "the model explains the outcome without any residual, so nothing can be tested: within the "
    "blocks of operators it never varies, or never but as the model says"
)


@dataclass(frozen=True, eq=False)
class MixedFit:
    """A fitted model with nested random intercepts.

    Attributes:
        beta: fixed effects (p,).
        covariance: (X' V⁻¹ X)⁻¹ of the fixed effects (p, p).
        levels: names of the levels that the model has, coarse to fine.
        ratios: λ of each level, variance over residual variance (k,).
        residual_variance: σ².
        intercepts: predicted u of each group of the first level (g,), in the order of their codes.
        residuals: y - X β - all u, of each row (n,).
        log_likelihood: restricted, as lme4 reports it.
    """

    beta: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    levels: tuple[str, ...]
    ratios: Float[np.ndarray, " k"]
    residual_variance: float
    intercepts: Float[np.ndarray, " g"]
    residuals: Float[np.ndarray, " n"]
    log_likelihood: float
    _gradient: Float[np.ndarray, "k p p"]  # d (X' H⁻¹ X)⁻¹ / d λ
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
        """Standard deviation of a single row: all variances together."""
        return float(np.sqrt(self.residual_variance * (1 + self.ratios.sum())))

    @cached_property
    def _variance_of_parameters(self) -> Float[np.ndarray, "l l"]:
        # At the edge a λ does not vary: its group is gone from the model.
        free = np.flatnonzero(np.append(self.ratios > 0, True))
        values, vectors = np.linalg.eigh(self._information[np.ix_(free, free)])
        usable = values > 1e-12 * values[-1]
        covariance = np.zeros_like(self._information)
        covariance[np.ix_(free, free)] = (vectors[:, usable] / values[usable]) @ vectors[
            :, usable
        ].T
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
    """Fits by REML.

    Args:
        design: fixed effects, of full column rank.
        outcome: y.
        levels: name of each level and group of each row, codes from 0, coarse to fine. A level that
            can't be separated from the one before, or from the residual, is left out of the model.

    Returns:
        The fit at the minimum of the criterion.

    Raises:
        StudyError: no more rows than coefficients, or the model leaves no residual.
    """
    rows, width = design.shape
    if rows <= width:
        raise StudyError(
            f"a mixed model with {width} coefficients needs more rows than that; came {rows}"
        )
    profile = _Profile(design, outcome, _estimable(levels))
    return profile.fit(profile.minimise(np.full(len(profile.levels), _START)))


def mancl_derouen(
    design: Float[np.ndarray, "n p"],
    residuals: Float[np.ndarray, " n"],
    groups: Int[np.ndarray, " n"],
    ratio: float,
) -> Float[np.ndarray, "p p"] | None:
    """Covariance of the coefficients that holds whatever is alike within operators.

    The sandwich of a fit by generalised least squares with a random intercept as its working
    covariance V, each operator's residuals corrected for their leverage. With t on one degree of
    freedom less than operators it holds where operators differ in a slope as well, which
    Satterthwaite's t on a model without random slopes does not.

    Args:
        design: fixed effects, with full column rank.
        residuals: y - X β, with the predicted intercepts still in them.
        groups: operator of each row, codes from 0.
        ratio: variance of operators over residual variance in the working covariance.

    Returns:
        The covariance; None where an operator's leverage can't be corrected.
    """
    rows = [np.flatnonzero(groups == k) for k in range(int(groups.max()) + 1)]
    # V⁻¹ X of each operator, up to the residual variance, which cancels.
    weighted_rows = []
    for own in rows:
        part = design[own]
        weighted_rows.append(part - ratio / (1 + ratio * len(own)) * part.sum(axis=0))
    bread = np.linalg.inv(
        sum(design[own].T @ w for own, w in zip(rows, weighted_rows, strict=True))
    )
    meat = np.zeros_like(bread)
    for own, weighted in zip(rows, weighted_rows, strict=True):
        # (I - X B W')⁻¹ r by the inverse of a p x p matrix (Woodbury).
        inner = np.eye(len(bread)) - weighted.T @ design[own] @ bread
        if np.min(np.abs(np.linalg.eigvals(inner))) < 1 - _ALONE:
            return None
        score = weighted.T @ residuals[own]
        corrected = np.linalg.solve(inner, score)
        meat += np.outer(corrected, corrected)
    return np.asarray(bread @ meat @ bread)


def _estimable(levels: Mapping[str, Int[np.ndarray, " n"]]) -> dict[str, Int[np.ndarray, " n"]]:
    estimable: dict[str, Int[np.ndarray, " n"]] = {}
    before = 0
    for name, codes in levels.items():
        count = len(np.unique(codes))
        if not estimable or before < count < len(codes):
            estimable[name] = codes
            before = count
    return estimable


class _Profile:
    """The restricted likelihood as a function of λ, from means over the leaves."""

    def __init__(
        self,
        design: Float[np.ndarray, "n p"],
        outcome: Float[np.ndarray, " n"],
        levels: Mapping[str, Int[np.ndarray, " n"]],
    ) -> None:
        self.levels = tuple(levels)
        self.design, self.outcome = design, outcome
        rows, self.width = design.shape
        self.free = rows - self.width
        # Leaves in such an order that groups of every level are neighbours.
        path = np.zeros(rows, np.int64)
        for codes in levels.values():
            path = path * (int(codes.max()) + 1) + codes
        _, first, self.leaf = np.unique(path, return_index=True, return_inverse=True)
        self.sizes = np.bincount(self.leaf).astype(float)
        both = np.column_stack([design, outcome])
        sums = np.zeros((len(self.sizes), self.width + 1))
        np.add.at(sums, self.leaf, both)
        self.means = sums / self.sizes[:, None]
        within = both - self.means[self.leaf]
        self.within = within.T @ within
        changes = [np.diff(codes[first], prepend=-1) != 0 for codes in levels.values()]
        self.starts = [np.flatnonzero(change) for change in changes]
        self.groups = [np.cumsum(change) - 1 for change in changes]
        self.same = [group[:, None] == group for group in self.groups]
        self._check_residual()

    def _check_residual(self) -> None:
        moment, right = self.within[:-1, :-1], self.within[:-1, -1]
        total = float(self.within[-1, -1])
        left = total - float(right @ np.linalg.lstsq(moment, right, rcond=None)[0])
        centred = self.outcome - self.outcome.mean()
        if left <= _NO_RESIDUAL * max(total, 1e-12 * float(centred @ centred)) or total == 0:
            raise StudyError(_EXPLAINED)

    def solve(
        self, ratios: Float[np.ndarray, " k"]
    ) -> tuple[float, Float[np.ndarray, "p p"], Float[np.ndarray, " p"], float]:
        """(log |H|, X' H⁻¹ X, β, residual sum of squares in the metric of H) at λ."""
        weights, means = self.sizes, self.means
        cross, logs = self.within.copy(), 0.0
        # From the finest level up: a group of a level is one mean with one weight to the next.
        for level in range(len(ratios) - 1, -1, -1):
            spread = 1 + ratios[level] * weights
            logs += float(np.sum(np.log(spread)))
            weights = weights / spread
            if level:
                group = self._group(level - 1, level)
                starts = np.flatnonzero(np.diff(group, prepend=-1))
                total = np.add.reduceat(weights, starts)
                middle = np.add.reduceat(weights[:, None] * means, starts) / total[:, None]
                apart = means - middle[group]
                cross += (weights[:, None] * apart).T @ apart
                weights, means = total, middle
        cross += (weights[:, None] * means).T @ means
        matrix, right = cross[:-1, :-1], cross[:-1, -1]
        beta = np.linalg.solve(matrix, right)
        signed = np.append(-beta, 1.0)
        return logs, matrix, beta, float(signed @ cross @ signed)

    def _group(self, coarse: int, fine: int) -> Int[np.ndarray, " m"]:
        """Group of the coarse level of each group of the fine one."""
        return self.groups[coarse][self.starts[fine]]

    def criterion(self, ratios: Float[np.ndarray, " k"]) -> float:
        """-2 log of the restricted likelihood with β and σ² profiled out, without constants."""
        logs, matrix, _, squares = self.solve(ratios)
        if squares <= 0:  # nothing but rounding is left
            raise StudyError(_EXPLAINED)
        return float(logs + np.linalg.slogdet(matrix)[1] + self.free * np.log(squares / self.free))

    def parts(self, ratios: Float[np.ndarray, " k"]) -> _Parts:
        """The parts of the derivatives at λ."""
        _, matrix, beta, squares = self.solve(ratios)
        inverse = np.linalg.inv(matrix)
        weights = self.sizes / (1 + ratios[-1] * self.sizes)
        metric = np.diag(weights)
        for level in range(len(ratios) - 2, -1, -1):
            share = metric.sum(axis=1)
            total = np.add.reduceat(share, self.starts[level])
            pull = (ratios[level] / (1 + ratios[level] * total))[self.groups[level]]
            metric = metric - self.same[level] * np.outer(pull * share, share)
        fixed = metric @ self.means[:, :-1]
        left = metric @ (self.means[:, -1] - self.means[:, :-1] @ beta)
        projected = metric - fixed @ inverse @ fixed.T
        count = len(ratios)
        traces = np.zeros(count)
        crossed, bent = np.zeros((count, count)), np.zeros((count, count))
        pulls, gradient = [], np.zeros((count, self.width, self.width))
        for k in range(count):
            half = np.add.reduceat(projected, self.starts[k], axis=0)
            pulls.append(np.add.reduceat(left, self.starts[k]))
            turned = np.add.reduceat(fixed, self.starts[k], axis=0) @ inverse
            gradient[k] = turned.T @ turned
            for j in range(k + 1):
                block = np.add.reduceat(half, self.starts[j], axis=1)
                if j == k:
                    traces[k] = np.trace(block)
                crossed[j, k] = crossed[k, j] = np.sum(block**2)
                bent[j, k] = bent[k, j] = pulls[k] @ block @ pulls[j]
        return _Parts(
            squares, traces, np.array([p @ p for p in pulls]), crossed, bent, pulls, gradient
        )

    def minimise(self, ratios: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """λ at the minimum, none below zero, by Newton's method."""
        value = self.criterion(ratios)
        for _ in range(_STEPS):
            parts = self.parts(ratios)
            slope = parts.traces - self.free * parts.squared / parts.squares
            scaled = parts.squared / parts.squares
            observed = -parts.crossed + self.free * (
                2 * parts.bent / parts.squares - np.outer(scaled, scaled)
            )
            expected = parts.crossed - np.outer(parts.traces, parts.traces) / self.free
            free = (ratios > 0) | (slope < 0)
            while True:
                direction = _step(observed, expected, slope, free)
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
        """The longest of ever shorter steps that pays; one that leaves the edge ends there."""
        falling = direction < 0
        reach = np.full(len(ratios), np.inf)
        reach[falling] = -ratios[falling] / direction[falling]
        length = min(1.0, float(reach.min()))
        for _ in range(60):
            # What would end a hair above zero is zero, or the steps would get ever shorter.
            there = np.where(reach <= length, 0.0, np.maximum(ratios + length * direction, 0.0))
            after = self.criterion(there)
            if after <= value - 1e-4 * length * gain or (gain < 1e-8 and after <= value + 1e-9):
                return there, after, bool(np.any(there != ratios))
            length /= 2
        return ratios, value, False

    def fit(self, ratios: Float[np.ndarray, " k"]) -> MixedFit:
        """Everything at λ."""
        _, matrix, beta, squares = self.solve(ratios)
        parts = self.parts(ratios)
        variance, count = squares / self.free, len(ratios)
        information = np.zeros((count + 1, count + 1))
        information[:count, :count] = -parts.crossed + 2 * parts.bent / variance
        information[:count, count] = information[count, :count] = parts.squared / variance**2
        information[count, count] = self.free / variance**2
        effects = [ratio * pull for ratio, pull in zip(ratios, parts.pulls, strict=True)]
        residuals = self.outcome - self.design @ beta
        for effect, group in zip(effects, self.groups, strict=True):
            residuals = residuals - effect[group][self.leaf]
        deviance = self.criterion(ratios) + self.free * (1 + np.log(2 * np.pi))
        return MixedFit(
            beta=beta,
            covariance=variance * np.linalg.inv(matrix),
            levels=self.levels,
            ratios=ratios,
            residual_variance=variance,
            intercepts=effects[0],
            residuals=residuals,
            log_likelihood=-0.5 * deviance,
            _gradient=parts.gradient,
            _information=0.5 * information,
        )


@dataclass(frozen=True, eq=False)
class _Parts:
    """With P = H⁻¹ - H⁻¹ X A⁻¹ X' H⁻¹ and V_k = 1 where two rows share a group of level k."""

    squares: float  # y' P y
    traces: Float[np.ndarray, " k"]  # tr P V_k
    squared: Float[np.ndarray, " k"]  # y' P V_k P y
    crossed: Float[np.ndarray, "k k"]  # tr P V_k P V_l
    bent: Float[np.ndarray, "k k"]  # y' P V_k P V_l P y
    pulls: list[Float[np.ndarray, " g"]]  # sums of P y over the groups of each level
    gradient: Float[np.ndarray, "k p p"]  # d A⁻¹ / d λ_k


def _step(
    observed: Float[np.ndarray, "k k"],
    expected: Float[np.ndarray, "k k"],
    slope: Float[np.ndarray, " k"],
    free: Bool[np.ndarray, " k"],
) -> Float[np.ndarray, " k"]:
    """Newton's step in the free directions; Fisher's where the criterion is not convex."""
    step = np.zeros_like(slope)
    for hessian in (observed, expected, np.diag(np.diag(expected))):
        try:
            root = np.linalg.cholesky(hessian[np.ix_(free, free)])
        except np.linalg.LinAlgError:
            continue
        step[free] = -np.linalg.solve(root.T, np.linalg.solve(root, slope[free]))
        break
    return step

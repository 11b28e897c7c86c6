"""An outcome fitted with other columns, by the method of mode small-sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.contrasts import Freedom
from smooth_operator.study.analysis.emm import MarginalMeans, linear_means, response_means
from smooth_operator.study.analysis.frame import Frame, check_frame, dependent_columns
from smooth_operator.study.analysis.gee import fit_gee
from smooth_operator.study.analysis.nested import fit_nested
from smooth_operator.study.analysis.readings.clusters import (
    WaldTest,
    clustered_wald,
    model_wald,
)
from smooth_operator.study.analysis.readings.parts import Estimate, estimated
from smooth_operator.study.analysis.results import Outcome
from smooth_operator.study.analysis.separation import separating

_NO_SPREAD: Final = 1e-20
"""Share of the largest variance of a coefficient below which that of a difference is no number."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Coefficients of a fit, their covariance and degrees of freedom.

    Attributes:
        outcome: which one.
        beta: coefficients; of success on the logit (p,).
        covariance: theirs (p, p).
        freedom: degrees of freedom of a combination of them.
        operators: clusters.
        means: of the retargeters where the further columns are zero.
    """

    outcome: Outcome
    beta: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    freedom: Freedom
    operators: int
    means: MarginalMeans

    def joint(self, columns: slice) -> WaldTest:
        """Are these coefficients all zero?

        Raises:
            StudyError: there are too few operators for it.
        """
        chosen = np.eye(len(self.beta))[columns]
        values = chosen @ self.beta
        covariance = chosen @ self.covariance @ chosen.T
        if self.outcome == "success":
            return clustered_wald(values, covariance, self.operators)
        return model_wald(values, covariance, chosen, self.freedom)

    def coefficient(self, j: int) -> Estimate:
        """One of them."""
        axis = np.eye(len(self.beta))[j]
        se = float(np.sqrt(self.covariance[j, j]))
        return estimated(float(self.beta[j]), se, self.freedom(axis))

    def differences(self) -> dict[str, Estimate]:
        """Mean of each retargeter minus that of the first, by name; not adjusted.

        Raises:
            StudyError: one of them has no estimated error.
        """
        found = {}
        for j, name in enumerate(self.means.names[1:], 1):
            contrast = self.means.gradient[j] - self.means.gradient[0]
            variance = float(contrast @ self.covariance @ contrast)
            if not variance > _NO_SPREAD * float(np.max(np.diag(self.covariance))):
                raise StudyError(f"too few operators for a test of {name} against the baseline")
            se = float(np.sqrt(variance))
            difference = float(self.means.values[j] - self.means.values[0])
            found[name] = estimated(difference, se, self.freedom(contrast))
        return found


def fit_with(
    outcome: Outcome,
    frame: Frame,
    more: Float[np.ndarray, "n q"] | None = None,
    *,
    index: bool = True,
) -> Fit:
    """Fits retargeter, task, the index and further columns.

    Args:
        outcome: decides on the model.
        frame: the rows.
        more: further columns, centred so that means are at their mean.
        index: whether the index of the trial is a term.

    Raises:
        StudyError: the rows do not carry the model.
    """
    check_frame(frame)
    design = frame.design()[0] if index else frame.factors()[0]
    if more is not None and more.shape[1]:
        design = np.column_stack([design, more])
    if dependent_columns(design):
        raise StudyError("the further terms are not independent of retargeter, task and trial")
    if len(frame) <= design.shape[1]:
        raise StudyError(f"{len(frame)} rows are too few for {design.shape[1]} coefficients")
    operators = len(frame.operators)
    if outcome == "success":
        if separating(design, frame.outcome) is not None:
            raise StudyError("separation: with these terms the odds are infinite")
        gee = fit_gee(design, frame.outcome, frame.group)
        gee.check_correlation()
        if gee.mancl_derouen is None:
            raise StudyError(f"{operators} operators are too few for {design.shape[1]} terms")
        means = response_means(frame, gee.beta)
        return Fit(
            outcome, gee.beta, gee.mancl_derouen, lambda _: operators - 1.0, operators, means
        )
    nested = fit_nested(design, frame.outcome, frame.levels)
    means = linear_means(frame, nested.beta)
    return Fit(outcome, nested.beta, nested.covariance, nested.satterthwaite, operators, means)

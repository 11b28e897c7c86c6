"""Estimated marginal means: what each retargeter would score on average, all else equal.

Tasks weigh equally and the index of the trial is at its mean. For a logistic model the mean is one
of probabilities and not of logits, so that it is the success rate one would see; its standard error
is by the delta method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from smooth_operator.study.analysis.frame import Frame


@dataclass(frozen=True, eq=False)
class MarginalMeans:
    """Means of retargeters, and how they depend on the coefficients.

    Attributes:
        names: of the retargeters (r,).
        values: the means (r,).
        gradient: derivatives in the coefficients (r, p).
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, " r"]
    gradient: Float[np.ndarray, "r p"]

    def covariance(self, of_coefficients: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "r r"]:
        """Covariance of the means."""
        return np.asarray(self.gradient @ of_coefficients @ self.gradient.T)


def linear_means(frame: Frame, beta: Float[np.ndarray, " p"]) -> MarginalMeans:
    """Means of a linear predictor: of times and workload, or of logits."""
    gradient = frame.grid(len(beta)).mean(axis=1)
    return MarginalMeans(frame.retargeters, gradient @ beta, gradient)


def response_means(frame: Frame, beta: Float[np.ndarray, " p"]) -> MarginalMeans:
    """Means of probabilities of a logistic model."""
    grid = frame.grid(len(beta))
    probability = expit(grid @ beta)
    slope = probability * (1 - probability)
    gradient = np.mean(slope[:, :, None] * grid, axis=1)
    return MarginalMeans(frame.retargeters, probability.mean(axis=1), gradient)

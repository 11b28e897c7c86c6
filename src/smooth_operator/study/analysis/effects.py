"""Effect sizes, and the words for them (Cohen 1988)."""

from __future__ import annotations

from typing import Final

import numpy as np

_MEANS: Final = (0.2, 0.5, 0.8)
_CORRELATIONS: Final = (0.1, 0.3, 0.5)
_WORDS: Final = ("negligible", "small", "medium", "large")


def standardised(difference: float, spread: float) -> float:
    """Difference of means in standard deviations of single rows, all variances together."""
    return difference / spread


def cohen_h(probability: float, baseline: float) -> float:
    """Difference of two probabilities after the arcsine transform."""
    return float(2 * np.arcsin(np.sqrt(probability)) - 2 * np.arcsin(np.sqrt(baseline)))


def in_words(effect: float) -> str:
    """negligible, small, medium or large: of a difference d or h."""
    return _WORDS[int(np.searchsorted(_MEANS, abs(effect), side="right"))]


def correlation_in_words(rho: float) -> str:
    """negligible, small, medium or large: of a correlation."""
    return _WORDS[int(np.searchsorted(_CORRELATIONS, abs(rho), side="right"))]

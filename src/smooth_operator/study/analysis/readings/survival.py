"""Cumulative incidence with competing events (Aalen and Johansen 1978), of many samples together.

A sample holds row i ``weights[k, i]`` times, so that a bootstrap is one computation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int

CENSORED: Final = 0
SUCCESS: Final = 1
COMPETING: Final = 2


@dataclass(frozen=True, eq=False)
class Incidence:
    """Steps of the cumulative incidence of success.

    Attributes:
        times: at which something ended, ascending [s] (u,).
        reached: share that has succeeded by then, of each sample (k, u); NaN in a sample without
            rows.
    """

    times: Float[np.ndarray, " u"]
    reached: Float[np.ndarray, "k u"]

    def at(self, time: float) -> Float[np.ndarray, " k"]:
        """Share that has succeeded by a time [s], of each sample (k,)."""
        place = int(np.searchsorted(self.times, time, side="right"))
        if place:
            return self.reached[:, place - 1]
        return np.where(np.isnan(self.reached[:, -1]), np.nan, 0.0)

    def restricted_mean(self, limit: float) -> Float[np.ndarray, " k"]:
        """Mean time without success up to a limit [s], of each sample (k,).

        What never succeeds counts with the limit.
        """
        inside = self.times < limit
        ends = np.concatenate([self.times[inside], [limit]])
        starts = np.concatenate([[0.0], self.times[inside]])
        waiting = 1 - np.column_stack([self.at(-1.0), self.reached[:, inside]])
        return np.asarray(waiting @ (ends - starts))


def incidence(
    times: Float[np.ndarray, " n"],
    events: Int[np.ndarray, " n"],
    weights: Float[np.ndarray, "k n"],
) -> Incidence:
    """Estimates the cumulative incidence of success.

    Args:
        times: at which each row ended, above 0 [s]; there is at least one row.
        events: how it ended: ``SUCCESS``, ``COMPETING`` (never a success) or ``CENSORED`` (it is
            not known what would have come; after other events at the same time).
        weights: how often each row is in each sample.
    """
    levels, place = np.unique(times, return_inverse=True)
    shape = (len(times), len(levels))
    member = np.zeros(shape)
    member[np.arange(len(times)), place] = 1
    total = weights @ member
    won = weights @ (member * (events == SUCCESS)[:, None])
    ended = weights @ (member * (events != CENSORED)[:, None])
    at_risk = np.cumsum(total[:, ::-1], axis=1)[:, ::-1]
    some = at_risk > 0
    hazard = np.divide(ended, at_risk, out=np.zeros_like(ended), where=some)
    won_hazard = np.divide(won, at_risk, out=np.zeros_like(won), where=some)
    left = np.cumprod(1 - hazard, axis=1)
    before = np.column_stack([np.ones(len(left)), left[:, :-1]])
    reached = np.cumsum(before * won_hazard, axis=1)
    reached[at_risk[:, 0] == 0] = np.nan
    return Incidence(levels, reached)

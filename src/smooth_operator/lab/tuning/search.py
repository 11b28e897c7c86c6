"""Search: low-discrepancy points over the box, then steps along the axes of the best.

Both are deterministic, and ask for points by the batch, so that workers run in
parallel. A repeated search with the same scores asks for the same points.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

SPREAD: Final = 0.5
"""Share of the trials that is spread over the box."""
FIRST_STEP: Final = 0.15
"""Of the steps along the axes, in shares of the box; halved where none helps."""
LAST_STEP: Final = 0.005


def search(
    start: Float[np.ndarray, " d"], trials: int, seed: int, spread: float = SPREAD
) -> Generator[list[np.ndarray], Sequence[float], None]:
    """Points to try, in the unit cube; to be sent the score of each, less is better.

    First comes ``start``, alone. Then a scrambled Sobol sequence, ``spread`` of the trials. Then,
    from the best so far, one step up and one down along each axis, and one that takes all
    steps that helped alone; the best of them is the next to step from, and where none is better the
    steps are halved. It ends with the trials, or with steps under ``LAST_STEP``.

    Args:
        start: where to begin.
        trials: how many points there may be.
        seed: of the scrambling.
        spread: share of the trials for the sequence.

    Yields:
        batches of points.
    """
    from scipy.stats import qmc  # half a second, which `--help` need not spend

    size, left = len(start), trials
    best, lowest = np.clip(np.asarray(start, float), 0.0, 1.0), float("inf")

    def cut(points: list[np.ndarray]) -> list[np.ndarray]:
        nonlocal left
        points = points[:left]
        left -= len(points)
        return points

    scores = yield cut([best])
    lowest = scores[0]
    count = min(round(spread * trials), left)
    if count > 0:
        power = int(np.ceil(np.log2(count)))
        points = cut(list(qmc.Sobol(size, seed=seed).random_base2(power)[:count]))
        scores = yield points
        best, lowest = _better(best, lowest, points, scores)
    step = FIRST_STEP
    while left > 0 and step >= LAST_STEP:
        moves = [sign * step * axis for axis in np.eye(size) for sign in (1.0, -1.0)]
        points = [np.clip(best + move, 0.0, 1.0) for move in moves]
        inside = [i for i, point in enumerate(points) if not np.array_equal(point, best)]
        asked = cut([points[i] for i in inside])
        scores = yield asked
        helped = [moves[i] for i, s in zip(inside[: len(asked)], scores, strict=True) if s < lowest]
        here, before = best, lowest
        best, lowest = _better(best, lowest, asked, scores)
        if len(helped) > 1 and left > 0:
            together = cut([np.clip(here + np.sum(helped, axis=0), 0.0, 1.0)])
            best, lowest = _better(best, lowest, together, (yield together))
        if lowest >= before:
            step /= 2


def _better(
    best: np.ndarray, lowest: float, points: Sequence[np.ndarray], scores: Sequence[float]
) -> tuple[np.ndarray, float]:
    for point, score in zip(points, scores, strict=True):
        if score < lowest:
            best, lowest = point, score
    return best, lowest

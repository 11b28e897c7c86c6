"""Coverage of the intervals of the paper's experiments, by simulation.

Log ratios of independent recordings are drawn from several distributions without any effect, and
given to the project's own `contrast` and judge. A 95 % interval should contain the true value in
95 % of the draws; every direction that is found is an error.

    python -m smooth_operator_research.paper.interval_coverage
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import tyro

from smooth_operator_research.paper.experiment import Table
from smooth_operator_research.paper.intervals import Samples, contrast
from smooth_operator_research.paper.verdicts import Direction, judge
from smooth_operator_research.run_report import markdown

COUNTS: Final = (4, 20)
"""Independent recordings."""

Draw = Callable[[np.random.Generator, int], np.ndarray]
"""Draws log ratios of independent recordings with mean 0."""

DRAWS: Final[dict[str, Draw]] = {
    "normal": lambda rng, n: rng.normal(0.0, 0.3, n),
    "skewed (exponential)": lambda rng, n: 0.3 * (rng.exponential(1.0, n) - 1.0),
    "heavy tails (t, 3 degrees)": lambda rng, n: 0.17 * rng.standard_t(3, n),
    "one in ten tenfold as far": lambda rng, n: (
        rng.normal(0.0, 0.1, n) * np.where(rng.random(n) < 0.1, 10.0, 1.0)
    ),
}
"""Distributions of differences between recordings, with spreads like those of the experiments."""


@dataclass(frozen=True)
class Settings:
    """Settings of the simulation of coverage."""

    draws: int = 10_000
    """Number of draws for each cell of the table."""

    counts: tuple[int, ...] = COUNTS
    """Numbers of independent recordings, one column each."""


class Coverage(NamedTuple):
    """Shares of intervals that contain the truth, and of draws in which a direction is shown."""

    covered: float
    shown: float


def coverage(draw: Draw, count: int, draws: int, windows: int = 1, alone: bool = False) -> Coverage:
    """Judges draws without an effect.

    Args:
        count: number of independent recordings.
        windows: number of parts of each recording, which share its log ratio.
        alone: True to count the parts as independent recordings, which they are not.
    """
    rng = np.random.default_rng(0)
    total = count * windows
    units = [str(k if alone else k // windows) for k in range(total)]
    covered = shown = 0
    for _ in range(draws):
        ratios = np.exp(np.repeat(draw(rng, count), windows) + rng.normal(0.0, 0.02, total))
        base = 10.0 ** rng.uniform(-2, 0, total)  # recordings differ a hundredfold
        a, b = (Samples([[x] for x in values], units) for values in (ratios * base, base))
        estimate = contrast(a, b, "ratio")
        assert estimate.low is not None
        assert estimate.high is not None
        covered += estimate.low <= 1.0 <= estimate.high
        shown += judge(Direction(1.0, upwards=False), [estimate]) != "not shown"
    return Coverage(covered / draws, shown / draws)


def coverage_table(settings: Settings) -> Table:
    """Makes the table of coverage: a row per distribution, a column per number of recordings."""

    def cells(draw: Draw, windows: int = 1, alone: bool = False) -> list[str]:
        rows = [coverage(draw, n, settings.draws, windows, alone) for n in settings.counts]
        return [f"{100 * one.covered:.1f} %" for one in rows]

    rows = [[name, *cells(draw)] for name, draw in DRAWS.items()]
    normal = DRAWS["normal"]
    rows.append(["normal, two windows of each recording", *cells(normal, 2)])
    rows.append(["the same, wrongly counted as independent", *cells(normal, 2, alone=True)])
    return Table(
        "Coverage",
        ["log ratios of recordings", *(f"n = {n}" for n in settings.counts)],
        rows,
        f"{settings.draws:,} draws for each cell: how often the 95 % interval contains the true "
        "value. In the other draws, a direction is found although there is none.",
    )


def main(settings: Settings) -> None:
    """Prints the table."""
    table = coverage_table(settings)
    print(markdown(table.headers, table.rows), table.note, sep="\n\n")


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))

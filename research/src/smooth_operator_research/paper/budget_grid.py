"""The grid of samples N and cycles L: its cells, its contours of equal compute, its runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from smooth_operator_research.paper.compared_solvers import Sampling
from smooth_operator_research.paper.sizes import Size


@dataclass(frozen=True, order=True)
class Point:
    """A cell of the grid.

    Attributes:
        samples: N.
        cycles: L.
    """

    samples: int
    cycles: int

    @property
    def budget(self) -> int:
        """N x L: candidates a frame, as the paper counts them."""
        return self.samples * self.cycles

    def __str__(self) -> str:
        return f"N = {self.samples:,}, L = {self.cycles}"

    def solver(self, most_cycles: int) -> Sampling:
        """Algorithm 1 of this size, in the program that all L of this N share."""
        return Sampling(self.samples, self.cycles, most_cycles=most_cycles)


def grid_points(size: Size) -> list[Point]:
    """The cells within the budget."""
    every = [Point(n, cycles) for n in size.grid_samples for cycles in size.grid_cycles]
    return [point for point in every if point.budget <= size.grid_budget]


def most_cycles(points: Sequence[Point], samples: int) -> int:
    """The largest L of an N."""
    return max(point.cycles for point in points if point.samples == samples)


def contours(points: Sequence[Point], fewest: int = 3) -> list[list[Point]]:
    """Cells of equal N x L, from the widest (largest N) to the deepest (largest L).

    Args:
        points: of the grid.
        fewest: contours with fewer cells have no middle, and are left out.

    Returns:
        The contours, by budget.
    """
    by_budget: dict[int, list[Point]] = {}
    for point in points:
        by_budget.setdefault(point.budget, []).append(point)
    return [sorted(own, reverse=True) for _, own in sorted(by_budget.items()) if len(own) >= fewest]

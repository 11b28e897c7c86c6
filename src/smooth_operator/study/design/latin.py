"""Balanced Latin squares for the order of conditions.

A row is an order of the conditions. In each place every condition stands equally often, and right
before each condition every other one stands equally often, so that neither practice, fatigue nor
what the one before left behind favours a condition. An even number of conditions needs as many rows
as conditions; an odd one has no such square, and needs two: a cyclic square and the same read
backwards.

Sources: Williams 1949 (both constructions); Bradley 1958 (the form for even numbers).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from smooth_operator.errors import StudyError


def balanced_rows(count: int) -> tuple[tuple[int, ...], ...]:
    """The rows of a balanced Latin square.

    Args:
        count: number of conditions, n.

    Returns:
        n rows if n is even, 2 n if it is odd, of the numbers 0 .. n-1; then row k + n is row k
        backwards.

    Raises:
        StudyError: fewer than two conditions.
    """
    if count < 2:
        raise StudyError(f"an order needs two conditions or more, not {count}")
    # 0, 1, n-1, 2, n-2, ...: the steps between neighbours are all different modulo n.
    zigzag = [(k + 1) // 2 if k % 2 else (count - k // 2) % count for k in range(count)]
    rows = [tuple((start + z) % count for z in zigzag) for start in range(count)]
    if count % 2:
        rows += [row[::-1] for row in rows]
    return tuple(rows)


@dataclass(frozen=True)
class Balance:
    """How evenly a set of orders treats the conditions.

    Attributes:
        places: (condition, place) -> how often.
        neighbours: (condition, the next one) -> how often.
        conditions: those that were counted.
    """

    places: Counter[tuple[str, int]]
    neighbours: Counter[tuple[str, str]]
    conditions: tuple[str, ...]

    @property
    def spread_of_places(self) -> int:
        """Most minus least often that a condition is in a place; 0 is balanced."""
        n = len(self.conditions)
        counts = [self.places[name, place] for name in self.conditions for place in range(n)]
        return max(counts) - min(counts)

    @property
    def spread_of_neighbours(self) -> int:
        """Most minus least often that a condition follows another; 0 is carry-over balanced."""
        counts = [self.neighbours[a, b] for a in self.conditions for b in self.conditions if a != b]
        return max(counts) - min(counts)

    @property
    def unevenness(self) -> int:
        """Sum of squared counts: lower is more even, for the same number of orders."""
        return sum(c * c for c in self.places.values()) + sum(
            c * c for c in self.neighbours.values()
        )


def balance(orders: Sequence[Sequence[str]], conditions: Sequence[str]) -> Balance:
    """Counts places and neighbours.

    Args:
        orders: each all conditions, in the order in which an operator meets them.
        conditions: their names.
    """
    places: Counter[tuple[str, int]] = Counter()
    neighbours: Counter[tuple[str, str]] = Counter()
    for order in orders:
        places.update((name, place) for place, name in enumerate(order))
        neighbours.update(pairwise(order))
    return Balance(places, neighbours, tuple(conditions))

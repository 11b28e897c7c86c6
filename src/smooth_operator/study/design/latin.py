"""Balanced orders of conditions (Williams squares), and draws that any machine repeats."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from typing import Final

from smooth_operator.errors import StudyError

_TREES: Final = (
    "Alder", "Aspen", "Beech", "Birch", "Cedar", "Cypress", "Elm", "Fir", "Hazel", "Holly",
    "Juniper", "Larch", "Linden", "Maple", "Oak", "Olive", "Pine", "Rowan", "Spruce", "Willow",
)  # fmt: skip


def lot(seed: int, *key: object) -> float:
    """Draws a number in [0, 1) that depends on the seed and the other arguments only."""
    digest = sha256("\x1f".join(map(str, (seed, *key))).encode()).digest()
    return int.from_bytes(digest[:6], "big") / 2**48


def shuffled(items: Iterable[str], seed: int, what: str) -> list[str]:
    """Returns the items in a random order."""
    return sorted(items, key=lambda item: lot(seed, what, item))


def blind_labels(names: Sequence[str], used: Collection[str], seed: int) -> dict[str, str]:
    """Draws names of trees as neutral labels of conditions.

    Args:
        names: names of the conditions.
        used: labels that are used already.
        seed: seed of the draw.

    Returns:
        Name of a condition -> label.
    """
    free = [tree for tree in shuffled(_TREES, seed, "label") if tree not in used]
    free += [f"Tree-{k}" for k in range(1, len(names) + 1) if f"Tree-{k}" not in used]
    return dict(zip(shuffled(names, seed, "labelled"), free, strict=False))


def balanced_rows(count: int) -> tuple[tuple[int, ...], ...]:
    """Returns the rows of a balanced Latin square (Williams 1949).

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
    """Counts of places and neighbours of the conditions in a set of orders.

    Attributes:
        places: (condition, place) -> count.
        neighbours: (condition, next condition) -> count.
        conditions: names of the conditions.
    """

    places: Counter[tuple[str, int]]
    neighbours: Counter[tuple[str, str]]
    conditions: tuple[str, ...]

    @property
    def spread_of_places(self) -> int:
        """Largest minus smallest count of a condition in a place; 0 is balanced."""
        n = len(self.conditions)
        counts = [self.places[name, place] for name in self.conditions for place in range(n)]
        return max(counts) - min(counts)

    @property
    def spread_of_neighbours(self) -> int:
        """Largest minus smallest count of two neighbours; 0 is balanced for carry-over."""
        counts = [self.neighbours[a, b] for a in self.conditions for b in self.conditions if a != b]
        return max(counts) - min(counts)


def balance(orders: Sequence[Sequence[str]], conditions: Sequence[str]) -> Balance:
    """Counts places and neighbours.

    Args:
        orders: orders of all conditions, one for each operator.
        conditions: names of the conditions.
    """
    places: Counter[tuple[str, int]] = Counter()
    neighbours: Counter[tuple[str, str]] = Counter()
    for order in orders:
        places.update((name, place) for place, name in enumerate(order))
        neighbours.update(pairwise(order))
    return Balance(places, neighbours, tuple(conditions))

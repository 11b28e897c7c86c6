"""Random draws from a seed, equal in every version and on every machine.

A library's generator may draw differently tomorrow; a study that is half run must not.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from hashlib import sha256
from typing import Final

_TREES: Final = (
    "Alder", "Aspen", "Beech", "Birch", "Cedar", "Cypress", "Elm", "Fir", "Hazel", "Holly",
    "Juniper", "Larch", "Linden", "Maple", "Oak", "Olive", "Pine", "Rowan", "Spruce", "Willow",
)  # fmt: skip


def lot(seed: int, *what: object) -> float:
    """A number in [0, 1) that belongs to a seed and to what it is drawn for."""
    digest = sha256("\x1f".join(map(str, (seed, *what))).encode()).digest()
    return int.from_bytes(digest[:6], "big") / 2**48


def shuffled(items: Iterable[str], seed: int, what: str) -> list[str]:
    """The items in an order that the seed draws."""
    return sorted(items, key=lambda item: lot(seed, what, item))


def blind_labels(names: Sequence[str], taken: Collection[str], seed: int) -> dict[str, str]:
    """Names of trees for conditions, drawn so that none shows which condition it is.

    Args:
        names: of the conditions.
        taken: labels that can't be used.
        seed: of the draw.
    """
    free = [tree for tree in shuffled(_TREES, seed, "label") if tree not in taken]
    free += [f"Tree-{k}" for k in range(1, len(names) + 1) if f"Tree-{k}" not in taken]
    return dict(zip(shuffled(names, seed, "labelled"), free, strict=False))

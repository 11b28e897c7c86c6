"""Touch pads of the Inspire RH56 DFTP and FTP: their registers and cells.

Facts: the maker's user manual "RH56DFTP R1", HWK V1.0.0, chapter 2.6, as published in
github.com/laurent-19/inspire_hand_ws, commit c246b93. A cell is a word, 0 to 4095. Addresses count
bytes. The cells of a finger run by rows; those of the palm by columns, each from the last row to
the first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from jaxtyping import Float

_FINGER: Final = {"tip": (3, 3), "nail": (12, 8), "pad": (10, 8)}
_THUMB: Final = {"tip": (3, 3), "nail": (12, 8), "middle": (3, 3), "pad": (12, 8)}
_AREAS: Final = (
    *((finger, start, _FINGER) for finger, start in (("little", 3000), ("ring", 3370))),
    *((finger, start, _FINGER) for finger, start in (("middle", 3740), ("index", 4110))),
    ("thumb", 4480, _THUMB),
    ("palm", 4900, {"": (8, 14)}),
)
"""Finger, address of its first cell, and its pads in their order: name -> rows and columns."""

_MOST: Final = 112
"""Words of a question, under the 125 that the protocol allows."""


def _blocks() -> Iterator[tuple[int, int]]:
    for _, start, pads in _AREAS:
        words = sum(rows * columns for rows, columns in pads.values())
        yield from ((start + 2 * k, min(_MOST, words - k)) for k in range(0, words, _MOST))


BLOCKS: Final = tuple(_blocks())
"""Address and number of words of each question that all pads take."""


def pads(words: Mapping[int, list[int]]) -> dict[str, Float[np.ndarray, "rows columns"]]:
    """Pad -> its cells: ``index_tip``, ``palm``; empty if a block is missing.

    Args:
        words: address of a block -> its words.
    """
    if len(words) < len(BLOCKS):
        return {}
    found = {}
    for finger, start, shapes in _AREAS:
        mine = [words[address] for address, _ in BLOCKS if 0 <= address - start < 420]
        cells = np.array([cell for block in mine for cell in block], float)
        for name, (rows, columns) in shapes.items():
            part, cells = cells[: rows * columns], cells[rows * columns :]
            if name:
                found[f"{finger}_{name}"] = part.reshape(rows, columns)
            else:
                found[finger] = part.reshape(columns, rows).T[::-1]
    return found

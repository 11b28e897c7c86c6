"""Touch matrices of a LinkerHand's fingertips: their questions and rows.

Facts, by the maker: a finger is asked with its kind of frame and a code for the matrix, 0xA4 for
the 10 x 4 cells of the O6 and 0xC6 for the 12 x 6 cells of the others. It answers with a frame for
each row: its kind, the row's number in the upper four bits of a byte, and the cells, 0 to 255.
``force_sensor.py`` of the package ``linkerbot`` 0.5.4 (O6, L6, L20 lite, L25), and
``LinkerHand/core/can`` of linker-bot/linkerhand-python-sdk, commit b371361 (all models). They don't
say which row is at the tip.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

FINGERS: Final = ("thumb", "index", "middle", "ring", "little")
_FIRST: Final = 0xB1


class TouchMatrices:
    """The matrices of a hand, of which one finger is asked at a time.

    Args:
        code: code of the matrix.
        shape: number of rows and of columns.
    """

    def __init__(self, code: int, shape: tuple[int, int]) -> None:
        self._code, self._shape, self._turn = code, shape, 0
        self._rows: dict[int, bytes] = {}
        self._matrices: dict[str, Float[np.ndarray, "rows columns"]] = {}

    def question(self) -> tuple[int, list[int]]:
        """Kind and values of the next question; the hand answers one finger at a time."""
        self._turn = (self._turn + 1) % len(FINGERS)
        self._rows = {}
        return _FIRST + self._turn, [self._code]

    def take(self, frame: bytes) -> None:
        """Takes a frame of the hand; others than rows of the finger that was asked are skipped."""
        rows, columns = self._shape
        if len(frame) != columns + 2 or frame[0] != _FIRST + self._turn:
            return
        self._rows[frame[1] >> 4] = frame[2:]
        if self._rows.keys() >= set(range(rows)):
            cells = [list(self._rows[row]) for row in range(rows)]
            self._matrices[FINGERS[self._turn]] = np.array(cells, float)

    @property
    def pads(self) -> dict[str, Float[np.ndarray, "rows columns"]]:
        """Finger -> its cells; empty until all fingers were read."""
        if len(self._matrices) < len(FINGERS):
            return {}
        return {finger: self._matrices[finger] for finger in FINGERS}

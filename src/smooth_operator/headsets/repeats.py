"""Hands that an app sends again because its tracker has nothing new."""

from __future__ import annotations

import numpy as np

from smooth_operator.types import HandFrame, Side


class Repeats:
    """Tells a new measurement from the last one, sent again.

    Some apps send what they know at a rate of their own, also where the headset has lost the hand.
    Of a hand that is seen, no two measurements are the same to the last bit.
    """

    def __init__(self) -> None:
        self._last: dict[Side, HandFrame] = {}

    def is_new(self, frame: HandFrame) -> bool:
        """Whether a hand differs from the last one of its side."""
        last = self._last.get(frame.side)
        self._last[frame.side] = frame
        return last is None or not (
            np.array_equal(frame.landmarks, last.landmarks, equal_nan=True)
            and _same(frame.T_world_wrist, last.T_world_wrist)
        )


def _same(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other, equal_nan=True)

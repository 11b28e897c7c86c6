"""Hands that an app sends again because its tracker has nothing new."""

from __future__ import annotations

import dataclasses

import numpy as np

from smooth_operator.types import HandFrame, Side


class Repeats:
    """Keeps what is new of hands that are sent at an app's own rate.

    Some apps send what they know also where the headset has lost the hand. Of a hand that is seen,
    no two measurements are the same to the last bit.

    Args:
        wrist: whether a wrist that stands still to the last bit while the fingers move is lost; not
            for an app that rounds it.
    """

    def __init__(self, wrist: bool = False) -> None:
        self._wrist = wrist
        self._last: dict[Side, HandFrame] = {}

    def new(self, frame: HandFrame) -> HandFrame | None:
        """The frame, its wrist not valid where that is lost; None if it is the last one again."""
        last = self._last.get(frame.side)
        self._last[frame.side] = frame
        if last is None or not _same(frame.T_world_wrist, last.T_world_wrist):
            return frame
        if _same(frame.landmarks, last.landmarks):
            return None
        if self._wrist and frame.T_world_wrist is not None:
            return dataclasses.replace(frame, T_world_wrist=np.full(7, np.nan))
        return frame


def _same(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other, equal_nan=True)

"""Drops hand frames that an app repeats without a new measurement."""

from __future__ import annotations

import dataclasses

import numpy as np

from smooth_operator.types import HandFrame, Side


class Repeats:
    """Passes new measurements of hands and drops repeated ones.

    Some apps repeat the last values while the headset has lost the hand. Two measurements of a
    visible hand are never equal in every bit.

    Args:
        wrist: True if a wrist that is equal while the fingers move also counts as lost; False for
            an app that rounds the wrist.
    """

    def __init__(self, wrist: bool = False) -> None:
        self._wrist = wrist
        self._last: dict[Side, HandFrame] = {}

    def new(self, frame: HandFrame) -> HandFrame | None:
        """Returns the frame, or None if it is a repetition. If only the wrist was lost, its pose is
        marked invalid."""
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

"""Notices a hand that restarted, and so lost its limits, gains or speed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

import numpy as np

from smooth_operator.errors import SinkError
from smooth_operator.teleop.hardware.device import (
    DeviceLostError,
    HandDevice,
    Setting,
    WrongAnswerError,
)

_EVERY_S: Final = 1.0
"""Time between two readings of a hand's settings [s]."""

_TRIES: Final = 3
"""Readings without any confirmed setting after which there are no more: the hand can't tell, and
waiting for its answer costs time on the bus."""

_TOLERANCE: Final = 0.01
"""Relative difference of two values that counts as rounding."""


class SettingsWatch:
    """Reads a hand's volatile settings back, now and then, and compares them with what was written.

    No driver has been tried on a physical hand. So only a setting that the hand has once read back
    as written counts; one that it never did is a warning, and no loss.

    Args:
        device: the hand.
        names: the actuators' names, for messages.

    Attributes:
        warnings: settings that the hand did not take as they were written, a few words each.
    """

    def __init__(self, device: HandDevice, names: Sequence[str]) -> None:
        self.warnings: tuple[str, ...] = ()
        self._device, self._names = device, names
        self._confirmed: set[str] = set()
        self._readings = 0
        self._last = -np.inf

    def look(self) -> None:
        """Read the settings, if it is time to.

        Raises:
            DeviceLostError: the hand had a setting and has it no longer, in two readings.
            WrongAnswerError: it does not answer, or never did and fails.
        """
        now = time.perf_counter()
        useful = self._confirmed or self._readings < _TRIES
        if now - self._last < _EVERY_S or not useful:
            return
        self._last = now
        self._readings += 1
        try:
            different = self._different(self._device.settings())
            if not self._confirmed.isdisjoint(different):  # one wrong reading restarts no hand
                different = self._different(self._device.settings())
        except SinkError as error:
            if self._confirmed:
                raise
            self.warnings = ("its limits can't be read back",)
            raise WrongAnswerError(str(error)) from error  # a hand that is gone fails again
        if lost := [text for name, text in different.items() if name in self._confirmed]:
            raise DeviceLostError(f"the hand restarted: {', '.join(lost)}")
        self.warnings = tuple(different.values())

    def _different(self, settings: Sequence[Setting]) -> dict[str, str]:
        """Name of each setting that differs -> how; the others are confirmed."""
        different: dict[str, str] = {}
        for setting in settings:
            pairs = zip(setting.measured, setting.expected, strict=True)
            wrong = [k for k, (a, b) in enumerate(pairs) if abs(a - b) > _TOLERANCE * abs(b)]
            if not wrong:
                self._confirmed.add(setting.name)
                continue
            first, every = wrong[0], len(setting.measured) == len(self._names)
            where = self._names[first] if every else f"no. {first + 1}"
            different[setting.name] = (
                f"{setting.name} of {where} is {setting.measured[first]:g}, not "
                f"{setting.expected[first]:g}"
            )
        return different

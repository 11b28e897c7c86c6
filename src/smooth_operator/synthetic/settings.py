"""Checks of settings, with one wording."""

from __future__ import annotations

import math
import operator

from smooth_operator.errors import ConfigError


def check_range(name: str, value: float, least: float, most: float, unit: str = "") -> None:
    """Refuse a number outside ``least`` to ``most``, or NaN.

    Raises:
        ConfigError: naming the setting, its range and what came.
    """
    if not least <= value <= most:
        unit = f" {unit}" if unit else ""
        bounds = (
            f"{least:g} to {most:g}" if math.isfinite(most) else f"finite and from {least:g} on"
        )
        raise ConfigError(f"{name} must be {bounds}{unit}, not {value!r}")
    if not math.isfinite(value):
        raise ConfigError(f"{name} must be finite, not {value!r}")


def check_seed(name: str, value: int) -> None:
    """Refuse a seed that isn't a whole number from 0 on.

    Raises:
        ConfigError: naming the setting and what came.
    """
    try:
        good = operator.index(value) >= 0
    except TypeError:
        good = False
    if not good:
        raise ConfigError(f"{name} must be a whole number from 0 on, not {value!r}")

"""Checks settings, such as frame rates; numbers may be traced by JAX, for example while tuning."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from smooth_operator.errors import ConfigError

RATE_RANGE_HZ: Final = (1.0, 2000.0)
"""Bounds [Hz] on a tracker's median rate. Timestamps of 2 to 1000 Hz in another unit fall
outside."""

LARGEST: Final = 1e9
"""Largest magnitude of a setting. The product of its square and another setting is still finite."""


def check_frame_rate(rate: float | None) -> None:
    """Raises ConfigError for a frame rate outside ``RATE_RANGE_HZ`` [Hz]; None is accepted."""
    low, high = RATE_RANGE_HZ
    if rate is not None and not low <= rate <= high:
        raise ConfigError(f"rate must be {low:g} to {high:g} frames per second, not {rate:g}")


def is_off(setting: object) -> bool:
    """True if a setting is a plain zero; False for a value that JAX traces."""
    return isinstance(setting, int | float) and setting == 0


def check_choice(config: object, name: str, options: Iterable[str]) -> None:
    """Raises ConfigError if a field of a configuration is not one of the allowed words."""
    value, words = getattr(config, name), [repr(option) for option in options]
    if repr(value) not in words:
        raise ConfigError(f"{name} must be {' or '.join(words)}, not {value!r}")


def check_range(name: str, value: object, low: float, high: float, unit: str = "") -> None:
    """Raises ConfigError for a number that is NaN or outside ``low`` to ``high``; None and traced
    values are accepted."""
    if isinstance(value, int | float) and not low <= value <= high:
        unit = f" {unit}" if unit else ""
        raise ConfigError(f"{name} must be {low:g} to {high:g}{unit}, not {value}")


def check_numbers(
    config: object,
    prefix: str = "",
    *,
    positive: Iterable[str] = (),
    not_negative: Iterable[str] | None = None,
    finite: Iterable[str] = (),
) -> None:
    """Checks fields of a configuration that hold numbers. None and traced values are accepted.

    No field may exceed ``LARGEST``: infinity can't be used for "no limit", because arithmetic with
    it ends in NaN.

    Args:
        prefix: prefix of a field's name in the message.
        positive: names of fields that must be positive.
        not_negative: names of fields that must not be negative; None for all other numbers.
        finite: names of fields that may have either sign.

    Raises:
        ConfigError: a field violates its condition or is NaN; the message names it.
    """
    for name in positive:
        value = getattr(config, name)
        if isinstance(value, int | float) and not 0 < value <= LARGEST:
            raise ConfigError(
                f"{prefix}{name} must be positive and at most {LARGEST:g}, not {value}"
            )
    if not_negative is None:
        not_negative = [name for name in vars(config) if name not in (*positive, *finite)]
    for names, low in ((not_negative, 0.0), (finite, -LARGEST)):
        for name in names:
            check_range(f"{prefix}{name}", getattr(config, name), low, LARGEST)

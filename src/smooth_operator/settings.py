"""Checks of settings: frame rates, and numbers that JAX may trace, as when they are tuned."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from smooth_operator.errors import ConfigError

RATE_RANGE_HZ: Final = (1.0, 2000.0)
"""Bounds [Hz] on a tracker's median rate. Stamps of 2 to 1000 Hz in another unit fall outside."""

LARGEST: Final = 1e9
"""Largest magnitude of a setting; its square still has a finite product with another one."""


def check_frame_rate(rate: float | None) -> None:
    """Refuse a frame rate [Hz] that no tracker has; None passes.

    Raises:
        ConfigError: the rate is outside ``RATE_RANGE_HZ``, or NaN.
    """
    low, high = RATE_RANGE_HZ
    if rate is not None and not low <= rate <= high:
        raise ConfigError(f"rate must be {low:g} to {high:g} frames a second, not {rate:g}")


def is_off(setting: object) -> bool:
    """True for a plain zero; False for a value that JAX traces."""
    return isinstance(setting, int | float) and setting == 0


def check_choice(config: object, name: str, options: Iterable[str]) -> None:
    """Check that a field of a configuration is one of some words.

    Raises:
        ConfigError: it is another; the message names the field and the words.
    """
    value, words = getattr(config, name), [repr(option) for option in options]
    if repr(value) not in words:
        raise ConfigError(f"{name} must be {' or '.join(words)}, not {value!r}")


def check_range(name: str, value: object, low: float, high: float, unit: str = "") -> None:
    """Refuse a number outside ``low`` to ``high``, or NaN; None and traced values pass.

    Raises:
        ConfigError: the number is refused; names the setting, its range and the number.
    """
    if isinstance(value, int | float) and not low <= value <= high:
        unit = f" {unit}" if unit else ""
        raise ConfigError(f"{name} must be {low:g} to {high:g}{unit}, not {value}")


def check_numbers(
    config: object,
    prefix: str = "",
    *,
    positive: Iterable[str] = (),
    not_negative: Iterable[str] = (),
    finite: Iterable[str] = (),
) -> None:
    """Check fields of a configuration; None and traced values pass.

    No field may exceed ``LARGEST``, so infinity never stands for "no limit": arithmetic with it
    ends in NaN.

    Args:
        prefix: prefix of a field's name in the message.
        positive: names of fields that must be positive.
        not_negative: names of fields that must not be negative.
        finite: names of fields that may have either sign.

    Raises:
        ConfigError: a field is not so, or is NaN; the message names it.
    """
    for name in positive:
        value = getattr(config, name)
        if isinstance(value, int | float) and not 0 < value <= LARGEST:
            raise ConfigError(
                f"{prefix}{name} must be positive and at most {LARGEST:g}, not {value}"
            )
    for names, low in ((not_negative, 0.0), (finite, -LARGEST)):
        for name in names:
            check_range(f"{prefix}{name}", getattr(config, name), low, LARGEST)

"""Checks of settings: frame rates, and numbers that JAX may trace, as when they are tuned."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from smooth_operator.errors import ConfigError

RATE_RANGE_HZ: Final = (1.0, 2000.0)
"""Bounds [Hz] on a tracker's median rate. Stamps of 2 to 1000 Hz in another unit fall outside."""


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


def check_numbers(
    config: object,
    prefix: str = "",
    *,
    positive: Iterable[str] = (),
    not_negative: Iterable[str] = (),
) -> None:
    """Check fields of a configuration; traced values pass.

    Args:
        prefix: prefix of a field's name in the message.
        positive: names of fields that must be positive.
        not_negative: names of fields that must not be negative.

    Raises:
        ConfigError: a field is not so, or is NaN; the message names it.
    """
    for name in positive:
        value = getattr(config, name)
        if isinstance(value, int | float) and not value > 0:
            raise ConfigError(f"{prefix}{name} must be positive, not {value}")
    for name in not_negative:
        value = getattr(config, name)
        if isinstance(value, int | float) and not value >= 0:
            raise ConfigError(f"{prefix}{name} must not be negative, not {value}")

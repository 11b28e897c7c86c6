"""Checks of settings that may be traced by JAX, as when they are tuned."""

from __future__ import annotations

from collections.abc import Iterable

from smooth_operator.errors import ConfigError


def is_off(setting: object) -> bool:
    """Whether a setting is a plain zero; one that is traced is not."""
    return isinstance(setting, int | float) and setting == 0


def check_numbers(
    config: object,
    prefix: str = "",
    *,
    positive: Iterable[str] = (),
    not_negative: Iterable[str] = (),
) -> None:
    """Checks fields of a configuration; traced values pass.

    Args:
        config: has the fields.
        prefix: put before a field's name in the message.
        positive: fields that must be over 0.
        not_negative: fields that must be 0 or more.

    Raises:
        ConfigError: one is not, or is NaN; the message names it.
    """
    for name in positive:
        value = getattr(config, name)
        if isinstance(value, int | float) and not value > 0:
            raise ConfigError(f"{prefix}{name} must be positive, not {value}")
    for name in not_negative:
        value = getattr(config, name)
        if isinstance(value, int | float) and not value >= 0:
            raise ConfigError(f"{prefix}{name} must not be negative, not {value}")

"""Variables of a search and their bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass

from smooth_operator.errors import ConfigError
from smooth_operator.formats.setting_paths import find_setting, numeric_settings


@dataclass(frozen=True)
class Variable:
    """One setting that is varied.

    Attributes:
        path: path of the setting in the configuration.
        low, high: bounds, both included.
        log: True if equal steps are equal ratios.
        whole: True for a whole number.
        start: value in the configuration that the search begins at, within the bounds.
    """

    path: str
    low: float
    high: float
    log: bool
    whole: bool
    start: float

    def rounded(self, value: float) -> float | int:
        """A value within the bounds, whole or of six digits.

        Six digits are more than any setting is known to, and make a preset that can be read.
        """
        if self.whole:
            return int(value)
        return min(max(float(f"{value:.6g}"), self.low), self.high)


def parse_variable(text: str, config: object) -> Variable:
    """A variable from ``NAME=LOW:HIGH`` or ``NAME=LOW:HIGH:log``.

    Args:
        text: the name is a path of a setting, or the end of one.
        config: whose setting it is, and where the search begins.

    Raises:
        UnknownNameError: there is no such setting.
        ConfigError: the text is something else, or the bounds can't be.
    """
    name, equals, bounds = text.partition("=")
    words = bounds.split(":")
    if not equals or len(words) not in (2, 3) or (len(words) == 3 and words[2] != "log"):
        raise ConfigError(
            f"{text!r}: expected NAME=LOW:HIGH or NAME=LOW:HIGH:log, as in pose_weight=0.01:0.1:log"
        )
    try:
        low, high = float(words[0]), float(words[1])
    except ValueError:
        raise ConfigError(f"{text!r}: the bounds must be numbers") from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ConfigError(f"{text!r}: the bounds must be finite, the lower one first")
    log = len(words) == 3
    if log and low <= 0:
        raise ConfigError(f"{text!r}: with log, the bounds must be positive")
    path = find_setting(config, name.strip())
    now = numeric_settings(config)[path]
    whole = isinstance(now, int)
    if whole and math.ceil(low) >= math.floor(high):
        raise ConfigError(f"{text!r}: {path} is a whole number, and there are not two between")
    return Variable(path, low, high, log, whole, min(max(float(now), low), high))

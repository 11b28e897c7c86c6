"""What names and numbers of a plan may be."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from smooth_operator.errors import StudyError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def check_name(name: str, what: str) -> str:
    """A name that may stand in a table, a file name and an address.

    Raises:
        StudyError: it holds other characters, or is too long.
    """
    if not _NAME.fullmatch(name) or len(name) > 64:
        raise StudyError(
            f"{what} {name!r}: use up to 64 letters, digits and '_', '.', '-', and a letter or "
            "digit first"
        )
    return name


def distinct(names: Sequence[str], what: str) -> None:
    """Refuses a name that comes twice."""
    for name in names:
        if names.count(name) > 1:
            raise StudyError(f"{what} need different names; {name!r} comes twice")


def whole(value: int, least: int, most: int, what: str) -> None:
    """Refuses what is no whole number in a range."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise StudyError(f"{what} must be a whole number from {least} to {most}, not {value!r}")


def seconds(value: float, what: str, least: float = 0.0) -> None:
    """Refuses what is no time of up to a day."""
    if not math.isfinite(value) or not least <= value <= 86_400:
        raise StudyError(f"{what} must be {least:g} to 86400 s, not {value}")

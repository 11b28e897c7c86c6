"""Outcomes of a study by name: the primary one, and margins of equivalence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from smooth_operator.errors import StudyError, UnknownNameError

OUTCOMES: Final = ("success", "time", "tlx")
"""Success rate (0 to 1), completion time [s], workload (0 to 100 points)."""
POOLED: Final = "pooled"
"""The scope that is all tasks together; the others are the tasks."""
PRIMARY: Final = f"{OUTCOMES[0]}/{POOLED}"
PAPER_MARGINS: Final = {"success": 0.10, "time": 5.0, "tlx": 10.0}

_LARGEST: Final = {"success": 1.0, "time": 86_400.0, "tlx": 100.0}


def check_primary(primary: str, tasks: Sequence[str], *, workload: bool) -> None:
    """Refuses a primary endpoint that the study will not have.

    Args:
        primary: ``OUTCOME/SCOPE``; empty for none.
        tasks: names.
        workload: whether questionnaires are asked.

    Raises:
        StudyError: it is not of that form, or workload without questionnaires.
        UnknownNameError: there is no such outcome or scope.
    """
    if not primary:
        return
    outcome, slash, scope = primary.partition("/")
    if not slash or not scope:
        raise StudyError(
            f"the primary endpoint must be OUTCOME/SCOPE as in {PRIMARY!r}, not {primary!r}"
        )
    if outcome not in OUTCOMES:
        raise UnknownNameError("outcome of the primary endpoint:", outcome, OUTCOMES)
    if scope not in (POOLED, *tasks):
        raise UnknownNameError("scope of the primary endpoint:", scope, (POOLED, *tasks))
    if outcome == "tlx" and not workload:
        raise StudyError(f"the primary endpoint {primary!r} needs questionnaires; none are planned")


def margins_of(words: Iterable[str]) -> dict[str, float]:
    """Margins from what a person types, ``OUTCOME=DIFFERENCE`` each.

    Raises:
        ValueError: a word is not of that form, or an outcome comes twice.
        StudyError: a margin can't be one.
        UnknownNameError: there is no such outcome.
    """
    found: dict[str, float] = {}
    for word in words:
        outcome, _, number = word.partition("=")
        try:
            margin = float(number)
        except ValueError:
            raise ValueError(
                f"expected OUTCOME=DIFFERENCE as in success=0.1, not {word!r}"
            ) from None
        if outcome in found:
            raise ValueError(f"{outcome} comes twice")
        found[outcome] = margin
    check_margins(found)
    return found


def check_margins(margins: Mapping[str, float]) -> None:
    """Refuses margins that are none.

    Raises:
        StudyError: one is not above 0, or as large as the outcome's whole range.
        UnknownNameError: there is no such outcome.
    """
    for outcome, margin in margins.items():
        if outcome not in OUTCOMES:
            raise UnknownNameError("outcome of a margin:", outcome, OUTCOMES)
        if not math.isfinite(margin) or not 0 < margin < _LARGEST[outcome]:
            raise StudyError(
                f"the margin of {outcome} must be above 0 and below {_LARGEST[outcome]:g}, in the "
                f"outcome's unit (success: a share, 0.1 is 10 percentage points), not {margin:g}"
            )

"""Result of one check, and the results of all checks on a hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from smooth_operator.types import Side

Verdict: TypeAlias = Literal["ok", "warning", "failed", "unjudged", "skipped"]
"""``unjudged`` and ``skipped`` are neither good nor bad: one has figures to which no bound applies,
of the other ``measured`` says why nothing was measured."""


@dataclass(frozen=True)
class Check:
    """One line of the checklist.

    Attributes:
        name: name of the check.
        verdict: verdict of the check.
        measured: the figures, in words.
        advice: advice to the user; empty if all is well.
        figures: the figures, as plain numbers and strings.
    """

    name: str
    verdict: Verdict
    measured: str
    advice: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class HandValidation:
    """Results of all checks on a hand.

    Attributes:
        hand: its name.
        side: side of the hand.
        checks: in the order of the list.
    """

    hand: str
    side: Side
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """True if no check failed; warnings are allowed."""
        return not self.failed

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if check.verdict == "failed")

    def __getitem__(self, name: str) -> Check:
        """A check by its name.

        Raises:
            KeyError: there is none of that name.
        """
        for check in self.checks:
            if check.name == name:
                return check
        raise KeyError(name)

    def to_json(self) -> dict[str, Any]:
        """The whole as one object of plain lists, numbers and strings."""
        return {
            "hand": self.hand,
            "side": self.side,
            "ok": self.ok,
            "checks": [
                {
                    "name": check.name,
                    "verdict": check.verdict,
                    "measured": check.measured,
                    "advice": check.advice,
                    "figures": dict(check.figures),
                }
                for check in self.checks
            ],
        }


def worst(*verdicts: Verdict) -> Verdict:
    """The worst of several; ok if there is none."""
    order: tuple[Verdict, ...] = ("ok", "warning", "failed")
    return max((v for v in verdicts if v in order), key=order.index, default="ok")

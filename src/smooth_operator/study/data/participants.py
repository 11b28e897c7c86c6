"""Who takes part in a study, who left, and what was repeated or corrected on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Withdrawal:
    """An operator who left the study.

    Attributes:
        keep: whether the data up to then may be analysed.
        reason: as the experimenter noted it.
        at: ISO date and time.
    """

    keep: bool
    reason: str = ""
    at: str = ""


@dataclass(frozen=True)
class Flow:
    """Participants from enrolment to analysis, as CONSORT counts them, and irregular events.

    Attributes:
        logged: whether a log of the study is known; without one, enrolled and started are those
            who have data, and the rest is unknown.
        planned: number of operators of the plan; None where unknown.
        enrolled: operators.
        started: those who have an event.
        completed: those who did all that was planned for them.
        withdrawn: operator -> how they left.
        replaces: operator -> the withdrawn one whose place they took.
        excluded: operator -> reason why their data are left out of the analysis.
        analysed: operators whose data are in the analysis.
        voids: retargeter -> trials that were declared void and repeated.
        undone: retargeter -> events that were taken back.
        amended: retargeter -> trials that were corrected later.
        pauses: of all operators.
        recalibrations: after the first calibration, of all operators.
        ended_early: blocks that were ended before their last trial.
    """

    logged: bool = False
    planned: int | None = None
    enrolled: tuple[str, ...] = ()
    started: tuple[str, ...] = ()
    completed: tuple[str, ...] = ()
    withdrawn: Mapping[str, Withdrawal] = field(default_factory=dict)
    replaces: Mapping[str, str] = field(default_factory=dict)
    excluded: Mapping[str, str] = field(default_factory=dict)
    analysed: tuple[str, ...] = ()
    voids: Mapping[str, int] = field(default_factory=dict)
    undone: Mapping[str, int] = field(default_factory=dict)
    amended: Mapping[str, int] = field(default_factory=dict)
    pauses: int = 0
    recalibrations: int = 0
    ended_early: int = 0


@dataclass(frozen=True, eq=False)
class SecondRatings:
    """Scores that another rater gave, for instance from video.

    Attributes:
        operator: pseudonymous codes (n,) of str.
        task: names (n,) of str.
        block: which block of the operator's task, from 1 (n,).
        trial_in_block: from 1 (n,).
        score: 0, 0.5 or 1 (n,).
    """

    operator: np.ndarray
    task: np.ndarray
    block: Int[np.ndarray, " n"]
    trial_in_block: Int[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.score)

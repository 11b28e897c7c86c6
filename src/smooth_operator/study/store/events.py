"""Events of an operator in a study; only events are stored.

Events are values; they say where they belong (task, block, trial), so that a page that was left
open can't score the wrong trial. Nothing is changed or taken back in the log: a mistake is undone
by one more event.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, ClassVar, Final, TypeAlias

from smooth_operator.study.design.protocol import Point


@dataclass(frozen=True)
class _Event:
    kind: ClassVar[str]


@dataclass(frozen=True)
class _OfBlock(_Event):
    task: str
    block: int


@dataclass(frozen=True)
class _OfTrial(_OfBlock):
    trial: int


@dataclass(frozen=True)
class Calibrated(_Event):
    """The tracker was calibrated to the operator, or that was left out."""

    kind: ClassVar[str] = "calibrated"
    task: str
    detail: str = ""


@dataclass(frozen=True)
class BlockStarted(_OfBlock):
    """The retargeter was switched to the block's condition.

    Attributes:
        condition: name.
        method: that the teleoperation said it runs then; empty where none was attached.
        preset: of the method, likewise.
    """

    kind: ClassVar[str] = "block_started"
    condition: str
    method: str = field(default="", compare=False)
    preset: str = field(default="", compare=False)


@dataclass(frozen=True)
class FamiliarisationStarted(_OfBlock):
    """Free movement begins, and its countdown.

    Attributes:
        clock: reading of a steady clock (``smooth_operator.study.store.clock``).
    """

    kind: ClassVar[str] = "familiarisation_started"
    clock: str = field(default="", compare=False)


@dataclass(frozen=True)
class FamiliarisationEnded(_OfBlock):
    """Free movement is over."""

    kind: ClassVar[str] = "familiarisation_ended"


@dataclass(frozen=True)
class TrialStarted(_OfTrial):
    """The clock of a trial runs.

    Attributes:
        clock: reading of a steady clock (``smooth_operator.study.store.clock``).
    """

    kind: ClassVar[str] = "trial_started"
    clock: str = field(default="", compare=False)


@dataclass(frozen=True)
class TrialReset(_OfTrial):
    """The object was put back; caps the score."""

    kind: ClassVar[str] = "trial_reset"


@dataclass(frozen=True)
class TrialScored(_OfTrial):
    """The trial ended.

    Attributes:
        line: of the task's rubric.
        score: of that line, capped if there was a reset.
        time_s: from its start, without pauses [s].
        proposed_line: what a simulation proposed; empty where it did not.
        proposed_score: of that line; None where nothing was proposed.
    """

    kind: ClassVar[str] = "trial_scored"
    line: str
    score: float
    time_s: float
    proposed_line: str = field(default="", compare=False)
    proposed_score: float | None = field(default=None, compare=False)


@dataclass(frozen=True)
class TrialVoided(_OfTrial):
    """The trial doesn't count, for a reason that is not the operator's; it is done again."""

    kind: ClassVar[str] = "trial_voided"
    reason: str


@dataclass(frozen=True)
class TrialPaused(_OfTrial):
    """The clock of the trial that runs was stopped for a fault that is not the operator's.

    Attributes:
        reason: why.
        clock: reading of a steady clock (``smooth_operator.study.store.clock``).
    """

    kind: ClassVar[str] = "trial_paused"
    reason: str = ""
    clock: str = field(default="", compare=False)


@dataclass(frozen=True)
class TrialResumed(_OfTrial):
    """The clock of a paused trial goes on.

    Attributes:
        paused_s: how long it had stood [s].
    """

    kind: ClassVar[str] = "trial_resumed"
    paused_s: float = field(default=0.0, compare=False)


@dataclass(frozen=True)
class Amended(_OfTrial):
    """A scored trial was corrected later; the first score stays in the log.

    Attributes:
        line: of the task's rubric, as it is from now on.
        score: of that line, capped if there was a reset.
        time_s: as it is from now on [s].
        reason: why.
        who: decided so; initials, never a name.
    """

    kind: ClassVar[str] = "amended"
    line: str
    score: float
    time_s: float
    reason: str
    who: str = ""


@dataclass(frozen=True)
class BlockEnded(_OfBlock):
    """The rest of a block is not done.

    Attributes:
        reason: why.
    """

    kind: ClassVar[str] = "block_ended"
    reason: str


@dataclass(frozen=True)
class Recalibrated(_Event):
    """The tracker was calibrated once more.

    Attributes:
        task: that is on.
        detail: file or remark.
    """

    kind: ClassVar[str] = "recalibrated"
    task: str
    detail: str = ""


@dataclass(frozen=True)
class Withdrawn(_Event):
    """The operator takes no further part.

    Attributes:
        keep: whether the data so far may be analysed.
        reason: why.
    """

    kind: ClassVar[str] = "withdrawn"
    keep: bool
    reason: str = ""


@dataclass(frozen=True)
class Replaces(_Event):
    """The operator has the rows of one who withdrew.

    Attributes:
        operator: pseudonym of that one.
    """

    kind: ClassVar[str] = "replaces"
    operator: str


@dataclass(frozen=True)
class Chosen(_Event):
    """Another operator was put on at a console.

    Attributes:
        operator: who is on now.
        before: who was; empty for nobody.
    """

    kind: ClassVar[str] = "chosen"
    operator: str
    before: str = ""


@dataclass(frozen=True)
class FormAnswered(_Event):
    """A form of the study was filled in, by the operator or from paper.

    Attributes:
        form: name.
        answers: field -> text, number, yes or no, or list of texts.
        who: typed it in for the operator; initials. Empty where the operator did it.
        reason: why answers that were there already are replaced; empty where none were.
    """

    kind: ClassVar[str] = "form_answered"
    form: str
    answers: Mapping[str, Any]
    who: str = ""
    reason: str = ""


@dataclass(frozen=True)
class FormOnPaper(_Event):
    """A form is filled in on paper, and typed in later.

    Attributes:
        form: name.
        who: has the paper; initials.
    """

    kind: ClassVar[str] = "form_on_paper"
    form: str
    who: str


@dataclass(frozen=True)
class Answered(_OfBlock):
    """NASA-TLX was filled in, by the operator or from paper.

    Attributes:
        point: which of the block's questionnaires.
        ratings: scale -> 0 to 100.
        who: typed it in for the operator; initials. Empty where the operator did it.
    """

    kind: ClassVar[str] = "questionnaire_answered"
    point: Point
    ratings: Mapping[str, int]
    who: str = ""


@dataclass(frozen=True)
class Weighed(_OfBlock):
    """The fifteen pairs of NASA-TLX were chosen from.

    Attributes:
        winners: of each of ``PAIRS``, in that order.
        shown: the pairs as the operator saw them, ``left-right``, in that order; empty if unknown.
        who: typed them in for the operator; initials. Empty where the operator did it.
    """

    kind: ClassVar[str] = "weights_answered"
    winners: tuple[str, ...]
    shown: tuple[str, ...] = field(default=(), compare=False)
    who: str = ""


@dataclass(frozen=True)
class BreakStarted(_Event):
    """The operator rests."""

    kind: ClassVar[str] = "break_started"


@dataclass(frozen=True)
class BreakEnded(_Event):
    """The operator is back."""

    kind: ClassVar[str] = "break_ended"


@dataclass(frozen=True)
class Noted(_Event):
    """Something worth remembering."""

    kind: ClassVar[str] = "noted"
    text: str


@dataclass(frozen=True)
class Undone(_Event):
    """An earlier event counts no more.

    Attributes:
        number: of the event among the operator's.
        reason: why.
    """

    kind: ClassVar[str] = "undone"
    number: int
    reason: str = ""


Event: TypeAlias = (
    Calibrated
    | BlockStarted
    | FamiliarisationStarted
    | FamiliarisationEnded
    | TrialStarted
    | TrialReset
    | TrialScored
    | TrialVoided
    | Answered
    | Weighed
    | BreakStarted
    | BreakEnded
    | Noted
    | Undone
    | TrialPaused
    | TrialResumed
    | Amended
    | BlockEnded
    | Recalibrated
    | Withdrawn
    | Replaces
    | Chosen
    | FormAnswered
    | FormOnPaper
)

ASIDE: Final = (Noted, Chosen, Replaces)
"""Kinds that change nothing in what is due, and are not undone."""
EVENTS: Final[dict[str, type[Event]]] = {
    made.kind: made
    for made in (
        Calibrated, BlockStarted, FamiliarisationStarted, FamiliarisationEnded, TrialStarted,
        TrialReset, TrialScored, TrialVoided, Answered, Weighed, BreakStarted, BreakEnded, Noted,
        Undone, TrialPaused, TrialResumed, Amended, BlockEnded, Recalibrated, Withdrawn, Replaces,
        Chosen, FormAnswered, FormOnPaper,
    )
}  # fmt: skip
"""Kind, as it is stored -> class."""


@dataclass(frozen=True)
class Record:
    """An event in the log.

    Attributes:
        number: among the operator's events, from 1, without gaps.
        at: when it was written, UTC.
        author: who did it: ``experimenter``, ``operator`` or ``system``.
        event: what happened.
    """

    number: int
    at: datetime
    author: str
    event: Event

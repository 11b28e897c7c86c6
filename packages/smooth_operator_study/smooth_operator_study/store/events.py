"""Events of an operator in a study: fields, checks, and text for people.

The store holds only events. An event names its task, block and trial, so that a page that was left
open can't score another trial. The log is append-only: a mistake is undone by one more event.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, ClassVar, Final, TypeAlias

from smooth_operator.errors import StudyError
from smooth_operator.io.entries import Entries
from smooth_operator_study.design.protocol import Point
from smooth_operator_study.records import record
from smooth_operator_study.store.nasa_tlx import check_ratings, raw_workload

Naming: TypeAlias = Callable[[str], str]
"""Function from the name of a condition to the name that a reader may see."""
EVENTS: Final[dict[str, type[Event]]] = {}
"""Kind of event, as it is stored -> class."""
_LONGEST_TEXT: Final = 20_000


@dataclass(frozen=True)
class Event:
    """Base class of the events.

    Attributes:
        kind: name in the store and in exports: the class name in lower case.
        command: name of the pages' command that causes the event; empty if no command does.
        due: steps of the protocol in which the event is expected; ``progress`` has further rules.
        line_format: line for people, a format of the event (``0``) and its reason (``why``).
    """

    kind: ClassVar[str]
    command: ClassVar[str]
    due: ClassVar[tuple[str, ...]]
    line_format: ClassVar[str]

    def __init_subclass__(
        cls, command: str = "", due: tuple[str, ...] = (), line: str = ""
    ) -> None:
        cls.kind = re.sub("(?!^)([A-Z])", r"_\1", cls.__name__).lower()
        cls.command, cls.due, cls.line_format = command, due, line
        if not cls.__name__.startswith("_"):
            EVENTS[cls.kind] = cls

    def describe(self, naming: Naming, *, workload: bool = True) -> str:
        """Describes the event in a line for people.

        Args:
            naming: gives the name of a condition that the reader may see.
            workload: whether the reader may know the workload already.
        """
        return self._describe(naming, workload)

    def _describe(self, naming: Naming, workload: bool) -> str:
        reason = getattr(self, "detail", "") or getattr(self, "reason", "")
        return self.line_format.format(self, why=_why(reason))


@dataclass(frozen=True)
class _BlockEvent(Event):
    task: str
    block: int


@dataclass(frozen=True)
class _TrialEvent(_BlockEvent):
    trial: int


@dataclass(frozen=True)
class Calibrated(
    Event, command="calibrated", due=("calibrate",), line="Calibrated for {0.task}{why}"
):
    """The tracker was calibrated to the operator, or calibration was left out.

    Attributes:
        task: name of the task.
        detail: file or remark.
    """

    task: str
    detail: str = ""


@dataclass(frozen=True)
class BlockStarted(_BlockEvent, command="start_block", due=("start_block",)):
    """A block started; the hand was switched to its condition.

    Attributes:
        condition: name of the condition.
        method: method that the teleoperation reported to run; empty without a teleoperation.
        preset: preset that the teleoperation reported to run.
    """

    condition: str
    method: str = field(default="", compare=False)
    preset: str = field(default="", compare=False)

    def _describe(self, naming: Naming, workload: bool) -> str:
        return f"Block {self.block} of {self.task} began: {naming(self.condition)}"


@dataclass(frozen=True)
class FamiliarisationStarted(
    _BlockEvent,
    command="start_familiarisation",
    due=("start_familiarisation",),
    line="Free movement began",
):
    """Free movement and its countdown started."""


@dataclass(frozen=True)
class FamiliarisationEnded(
    _BlockEvent, command="end_familiarisation", due=("familiarise",), line="Free movement ended"
):
    """Free movement ended."""


@dataclass(frozen=True)
class TrialStarted(
    _TrialEvent, command="start_trial", due=("start_trial",), line="Trial {0.trial} started"
):
    """The clock of a trial started."""


@dataclass(frozen=True)
class TrialReset(
    _TrialEvent, command="reset", due=("trial", "paused"), line="Trial {0.trial}: object reset"
):
    """The object was put back, which caps the score of the trial."""


@dataclass(frozen=True)
class TrialScored(
    _TrialEvent,
    command="score",
    due=("trial",),
    line="Trial {0.trial}: {0.line}, score {0.score:g}, {0.time_s:.1f}\u00a0s",
):
    """A trial ended and was scored.

    Attributes:
        line: line of the task's rubric.
        score: score of that line, capped after a reset.
        time_s: time from the start of the trial, without pauses [s].
        proposed_line: line that a simulation proposed; empty without a proposal.
        proposed_score: score of the proposed line; None without a proposal.
    """

    line: str
    score: float
    time_s: float
    proposed_line: str = field(default="", compare=False)
    proposed_score: float | None = field(default=None, compare=False)


@dataclass(frozen=True)
class TrialVoided(_TrialEvent, command="void", due=("trial", "paused")):
    """A trial does not count, for a reason that is not the operator's; it is repeated."""

    reason: str

    def _describe(self, naming: Naming, workload: bool) -> str:
        return f"Trial {self.trial} void: {self.reason or 'no reason given'}"


@dataclass(frozen=True)
class TrialPaused(
    _TrialEvent, command="pause", due=("trial",), line="Trial {0.trial}: clock paused{why}"
):
    """The clock of the running trial was stopped for a fault that is not the operator's.

    Attributes:
        reason: reason of the pause.
    """

    reason: str = ""


@dataclass(frozen=True)
class TrialResumed(
    _TrialEvent,
    command="resume",
    due=("paused",),
    line="Trial {0.trial}: clock resumed after {0.paused_s:.1f}\u00a0s",
):
    """The clock of a paused trial continued.

    Attributes:
        paused_s: length of the pause [s].
    """

    paused_s: float = field(default=0.0, compare=False)


@dataclass(frozen=True)
class Amended(_TrialEvent, command="amend"):
    """A scored trial was corrected later; the log keeps the first score.

    Attributes:
        line: corrected line of the task's rubric.
        score: score of that line, capped after a reset.
        time_s: corrected time [s].
        reason: reason of the correction.
        who: initials of the person who decided, never a name.
    """

    line: str
    score: float
    time_s: float
    reason: str
    who: str = ""

    def _describe(self, naming: Naming, workload: bool) -> str:
        where = f"Trial {self.trial} of {self.task}, block {self.block}"
        now = f"{self.line}, score {self.score:g}, {self.time_s:.1f}\u00a0s"
        return f"{where} amended to {now}: {self.reason}" + (f" ({self.who})" if self.who else "")


@dataclass(frozen=True)
class BlockEnded(
    _BlockEvent,
    command="end_block",
    due=("start_block", "start_familiarisation", "start_trial", "questionnaire"),
    line="Block {0.block} of {0.task} ended early: {0.reason}",
):
    """A block was ended early, so its remaining trials are left out.

    Attributes:
        reason: reason to end the block.
    """

    reason: str


@dataclass(frozen=True)
class Recalibrated(Event, command="recalibrate", line="Calibrated again for {0.task}{why}"):
    """The tracker was calibrated once more.

    Attributes:
        task: name of the current task.
        detail: file or remark.
    """

    task: str
    detail: str = ""


@dataclass(frozen=True)
class Withdrawn(Event, command="withdraw"):
    """The operator takes no further part.

    Attributes:
        keep: whether the data so far may be analysed.
        reason: reason of the operator, if one was given.
    """

    keep: bool
    reason: str = ""

    def _describe(self, naming: Naming, workload: bool) -> str:
        data = "the data is kept" if self.keep else "the data is excluded"
        return f"Withdrew, {data}" + _why(self.reason)


@dataclass(frozen=True)
class FormAnswered(Event, command="form", due=("form",), line="Form {0.form} filled in"):
    """A form of the study was filled in.

    Attributes:
        form: name of the form.
        answers: field -> text, number, yes or no, or list of texts.
    """

    form: str
    answers: Mapping[str, Any]


@dataclass(frozen=True)
class QuestionnaireAnswered(_BlockEvent, command="answer", due=("questionnaire",)):
    """NASA-TLX was filled in.

    Attributes:
        point: initial, midpoint or final.
        ratings: scale -> 0 to 100.
    """

    point: Point
    ratings: Mapping[str, int]

    def _describe(self, naming: Naming, workload: bool) -> str:
        answer = f": workload {raw_workload(self.ratings):.0f}" if workload else " answered"
        return f"Questionnaire ({self.point}){answer}"


@dataclass(frozen=True)
class BreakStarted(Event, command="start_break", line="Break began"):
    """A break began."""


@dataclass(frozen=True)
class BreakEnded(Event, command="end_break", due=("break",), line="Break ended"):
    """The break ended."""


@dataclass(frozen=True)
class Noted(Event, command="note", line="Note: {0.text}"):
    """A remark of the experimenter or of the program."""

    text: str


@dataclass(frozen=True)
class Undone(Event, command="undo", line="Event {0.number} undone{why}"):
    """An earlier event does not count any more.

    Attributes:
        number: number of that event among the operator's.
        reason: reason to undo it.
    """

    number: int
    reason: str = ""


@dataclass(frozen=True)
class Record:
    """An event in the log.

    Attributes:
        number: number among the operator's events, from 1, without gaps.
        at: time at which it was written, UTC.
        author: ``experimenter``, ``operator`` or ``system``.
        event: the event.
    """

    number: int
    at: datetime
    author: str
    event: Event


def _why(text: str) -> str:
    return f": {text}" if text else ""


def payload(event: Event) -> dict[str, Any]:
    """Fields of an event as plain values."""
    return dataclasses.asdict(event)


def event_of(kind: str, values: Mapping[str, Any]) -> Event:
    """Makes an event from its kind and fields; checks what can be checked without the plan."""
    if kind not in EVENTS:
        raise StudyError(f"no event is called {kind!r}; expected one of {', '.join(EVENTS)}")
    cls, entries = EVENTS[kind], Entries(f"event {kind!r}", values, StudyError)
    tables = {
        name: read(entries.table(name))
        for name, read in (("ratings", _ratings), ("answers", _answers))
        if name in cls.__dataclass_fields__
    }
    event = record(cls, entries, tuple(tables), lines=True, **tables)
    for name, value in vars(event).items():
        if isinstance(value, int | float) and value < 0:
            raise entries.error(name, f"expected 0 or more, not {value!r}")
        if isinstance(value, str) and (len(value) > _LONGEST_TEXT or "\x00" in value):
            raise entries.error(name, f"expected a string of up to {_LONGEST_TEXT} characters")
    return event


def _ratings(entries: Entries) -> dict[str, int]:
    check_ratings(entries.values)
    return dict(entries.values)


def _answers(entries: Entries) -> dict[str, Any]:
    if len(json.dumps(dict(entries.values))) > _LONGEST_TEXT:
        raise StudyError(f"{entries.file}: the answers have more than {_LONGEST_TEXT} characters")
    for name, one in entries.values.items():
        if isinstance(one, list | tuple):
            entries.texts(name)
        elif isinstance(one, float):
            entries.number(name)
        elif not isinstance(one, str | bool | int):
            raise entries.error(
                name, "expected a string, a number, yes or no, or a list of strings"
            )
    return {name: list(v) if isinstance(v, tuple) else v for name, v in entries.values.items()}

"""Events of an operator in a study: fields, text, and what each changes; only events are stored.

Events are values; they say where they belong (task, block, trial), so that a page that was left
open can't score the wrong trial. Nothing is changed or taken back in the log: a mistake is undone
by one more event.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias, get_args, get_type_hints

from smooth_operator.errors import StudyError
from smooth_operator.study.design.protocol import Point
from smooth_operator.study.store.nasa_tlx import check_ratings, check_winners, raw_workload

if TYPE_CHECKING:
    from smooth_operator.study.store.operator_state import OperatorState

Named: TypeAlias = Callable[[str], str]
"""From the name of a condition to what a reader may see."""
EVENTS: Final[dict[str, type[Event]]] = {}
"""Kind, as it is stored -> class."""
_LONGEST_TEXT: Final = 20_000


@dataclass(frozen=True)
class Event:
    """Something that happened to an operator.

    Attributes:
        kind: name in the store and in exports: that of the class, in lower case.
        word: name of the pages' command that causes it; empty where none does.
        due: steps of the protocol in which it is expected; further rules are in ``progress``.
        words: a line for people: a format of the event (``0``) and its reason (``why``).
    """

    kind: ClassVar[str]
    word: ClassVar[str]
    due: ClassVar[tuple[str, ...]]
    words: ClassVar[str]

    def __init_subclass__(cls, word: str = "", due: tuple[str, ...] = (), words: str = "") -> None:
        cls.kind = re.sub("(?!^)([A-Z])", r"_\1", cls.__name__).lower()
        cls.word, cls.due, cls.words = word, due, words
        if not cls.__name__.startswith("_"):
            EVENTS[cls.kind] = cls

    def in_words(self, named: Named, *, sums: bool = True) -> str:
        """The event in a line for people.

        Args:
            named: turns the name of a condition into what the reader may see.
            sums: whether the workload may be known already.
        """
        return self._line(named, sums)

    def fold(self, state: OperatorState, record: Record) -> None:
        """Changes the state of the operator by this event, which was checked before."""
        self._change(state, record)

    def _line(self, named: Named, sums: bool) -> str:
        reason = getattr(self, "detail", "") or getattr(self, "reason", "")
        return self.words.format(self, why=_why(reason))

    def _change(self, state: OperatorState, record: Record) -> None:
        """Nothing, where an event changes nothing."""


@dataclass(frozen=True)
class _OfBlock(Event):
    task: str
    block: int


@dataclass(frozen=True)
class _OfTrial(_OfBlock):
    trial: int


@dataclass(frozen=True)
class Calibrated(
    Event, word="calibrated", due=("calibrate",), words="Calibrated for {0.task}{why}"
):
    """The tracker was calibrated to the operator, or that was left out."""

    task: str
    detail: str = ""

    def _change(self, state: OperatorState, record: Record) -> None:
        state.calibrated.add(self.task)


@dataclass(frozen=True)
class BlockStarted(_OfBlock, word="start_block", due=("start_block",)):
    """The retargeter was switched to the block's condition.

    Attributes:
        condition: name.
        method: that the teleoperation said it runs then; empty where none was attached.
        preset: of the method, likewise.
    """

    condition: str
    method: str = field(default="", compare=False)
    preset: str = field(default="", compare=False)

    def _line(self, named: Named, sums: bool) -> str:
        return f"Block {self.block} of {self.task} began: {named(self.condition)}"

    def _change(self, state: OperatorState, record: Record) -> None:
        state.started[self.task, self.block] = (self.method, self.preset)


@dataclass(frozen=True)
class FamiliarisationStarted(
    _OfBlock,
    word="start_familiarisation",
    due=("start_familiarisation",),
    words="Free movement began",
):
    """Free movement begins, and its countdown.

    Attributes:
        clock: reading of a steady clock (``smooth_operator.study.store.clock``).
    """

    clock: str = field(default="", compare=False)

    def _change(self, state: OperatorState, record: Record) -> None:
        state.moving = (record.at, self.clock)


@dataclass(frozen=True)
class FamiliarisationEnded(
    _OfBlock, word="end_familiarisation", due=("familiarise",), words="Free movement ended"
):
    """Free movement is over."""

    def _change(self, state: OperatorState, record: Record) -> None:
        state.moving = None
        state.moved.add((self.task, self.block))


@dataclass(frozen=True)
class TrialStarted(
    _OfTrial, word="start_trial", due=("start_trial",), words="Trial {0.trial} started"
):
    """The clock of a trial runs.

    Attributes:
        clock: reading of a steady clock (``smooth_operator.study.store.clock``).
    """

    clock: str = field(default="", compare=False)

    def _change(self, state: OperatorState, record: Record) -> None:
        state.begin_trial(self.trial, record.at, self.clock)


@dataclass(frozen=True)
class TrialReset(
    _OfTrial, word="reset", due=("trial", "paused"), words="Trial {0.trial}: object put back"
):
    """The object was put back; caps the score."""

    def _change(self, state: OperatorState, record: Record) -> None:
        state.trials[-1].resets += 1


@dataclass(frozen=True)
class TrialScored(
    _OfTrial,
    word="score",
    due=("trial",),
    words="Trial {0.trial}: {0.line}, score {0.score:g}, {0.time_s:.1f}\u00a0s",
):
    """The trial ended.

    Attributes:
        line: of the task's rubric.
        score: of that line, capped if there was a reset.
        time_s: from its start, without pauses [s].
        proposed_line: what a simulation proposed; empty where it did not.
        proposed_score: of that line; None where nothing was proposed.
    """

    line: str
    score: float
    time_s: float
    proposed_line: str = field(default="", compare=False)
    proposed_score: float | None = field(default=None, compare=False)

    def _change(self, state: OperatorState, record: Record) -> None:
        trial = state.trials[-1]
        trial.line, trial.score, trial.time_s = self.line, self.score, self.time_s
        trial.proposed_line, trial.proposed_score = self.proposed_line, self.proposed_score
        state.scored[self.task, self.block] += 1


@dataclass(frozen=True)
class TrialVoided(_OfTrial, word="void", due=("trial", "paused")):
    """The trial doesn't count, for a reason that is not the operator's; it is done again."""

    reason: str

    def _line(self, named: Named, sums: bool) -> str:
        return f"Trial {self.trial} void: {self.reason or 'no reason given'}"

    def _change(self, state: OperatorState, record: Record) -> None:
        state.void_trial(self.reason, record.at)


@dataclass(frozen=True)
class TrialPaused(
    _OfTrial, word="pause", due=("trial",), words="Trial {0.trial}: clock paused{why}"
):
    """The clock of the trial that runs was stopped for a fault that is not the operator's.

    Attributes:
        reason: why.
        clock: reading of a steady clock (``smooth_operator.study.store.clock``).
    """

    reason: str = ""
    clock: str = field(default="", compare=False)

    def _change(self, state: OperatorState, record: Record) -> None:
        trial = state.trials[-1]
        trial.pauses += ((record.at, None, self.reason),)
        trial.paused_clock = self.clock


@dataclass(frozen=True)
class TrialResumed(
    _OfTrial,
    word="resume",
    due=("paused",),
    words="Trial {0.trial}: clock goes on after {0.paused_s:.1f}\u00a0s",
):
    """The clock of a paused trial goes on.

    Attributes:
        paused_s: how long it had stood [s].
    """

    paused_s: float = field(default=0.0, compare=False)

    def _change(self, state: OperatorState, record: Record) -> None:
        state.trials[-1].end_pause(self.paused_s)


@dataclass(frozen=True)
class Amended(_OfTrial, word="amend"):
    """A scored trial was corrected later; the first score stays in the log.

    Attributes:
        line: of the task's rubric, as it is from now on.
        score: of that line, capped if there was a reset.
        time_s: as it is from now on [s].
        reason: why.
        who: decided so; initials, never a name.
    """

    line: str
    score: float
    time_s: float
    reason: str
    who: str = ""

    def _line(self, named: Named, sums: bool) -> str:
        where = f"Trial {self.trial} of {self.task}, block {self.block}"
        now = f"{self.line}, score {self.score:g}, {self.time_s:.1f}\u00a0s"
        return f"{where} amended to {now}: {self.reason}" + (f" ({self.who})" if self.who else "")

    def _change(self, state: OperatorState, record: Record) -> None:
        place = self.task, self.block, self.trial
        after = self.line, self.score, self.time_s
        state.amend_trial(place, after, record.number, record.at, self.reason, self.who)


@dataclass(frozen=True)
class BlockEnded(
    _OfBlock,
    word="end_block",
    due=("start_block", "start_familiarisation", "start_trial", "questionnaire", "weights"),
    words="Block {0.block} of {0.task} ended early: {0.reason}",
):
    """The rest of a block is not done.

    Attributes:
        reason: why.
    """

    reason: str

    def _change(self, state: OperatorState, record: Record) -> None:
        state.ended_early[self.task, self.block] = (record.at, self.reason)


@dataclass(frozen=True)
class Recalibrated(Event, word="recalibrate", words="Calibrated again for {0.task}{why}"):
    """The tracker was calibrated once more.

    Attributes:
        task: that is on.
        detail: file or remark.
    """

    task: str
    detail: str = ""

    def _change(self, state: OperatorState, record: Record) -> None:
        state.recalibrations.append((record.at, self.task, self.detail))


@dataclass(frozen=True)
class Withdrawn(Event, word="withdraw"):
    """The operator takes no further part.

    Attributes:
        keep: whether the data so far may be analysed.
        reason: why.
    """

    keep: bool
    reason: str = ""

    def _line(self, named: Named, sums: bool) -> str:
        data = "the data is kept" if self.keep else "the data is left out"
        return f"Withdrew, {data}" + _why(self.reason)

    def _change(self, state: OperatorState, record: Record) -> None:
        state.withdraw(record.at, self.keep, self.reason)


@dataclass(frozen=True)
class Replaces(Event, words="Takes the place of {0.operator}"):
    """The operator has the rows of one who withdrew.

    Attributes:
        operator: pseudonym of that one.
    """

    operator: str

    def _change(self, state: OperatorState, record: Record) -> None:
        state.replaces = self.operator


@dataclass(frozen=True)
class Chosen(Event):
    """Another operator was put on at a console.

    Attributes:
        operator: who is on now.
        before: who was; empty for nobody.
    """

    operator: str
    before: str = ""

    def _line(self, named: Named, sums: bool) -> str:
        before = f", {self.before} was on" if self.before else ""
        return f"{self.operator} was put on{before}"


@dataclass(frozen=True)
class FormAnswered(Event, word="form", due=("form",)):
    """A form of the study was filled in, by the operator or from paper.

    Attributes:
        form: name.
        answers: field -> text, number, yes or no, or list of texts.
        who: typed it in for the operator; initials. Empty where the operator did it.
        reason: why answers that were there already are replaced; empty where none were.
    """

    form: str
    answers: Mapping[str, Any]
    who: str = ""
    reason: str = ""

    def _line(self, named: Named, sums: bool) -> str:
        if not self.who:
            return f"Form {self.form} filled in"
        return f"Form {self.form} typed in by {self.who}" + _why(self.reason)

    def _change(self, state: OperatorState, record: Record) -> None:
        state.forms[self.form] = (record.at, dict(self.answers))
        state.on_paper.pop(self.form, None)
        state.typed.pop(self.form, None)
        if self.who:
            state.typed[self.form] = self.who


@dataclass(frozen=True)
class FormOnPaper(Event, word="paper", due=("form",), words="Form {0.form} is on paper ({0.who})"):
    """A form is filled in on paper, and typed in later.

    Attributes:
        form: name.
        who: has the paper; initials.
    """

    form: str
    who: str

    def _change(self, state: OperatorState, record: Record) -> None:
        state.on_paper[self.form] = (record.at, self.who)


@dataclass(frozen=True)
class QuestionnaireAnswered(_OfBlock, word="answer", due=("questionnaire",)):
    """NASA-TLX was filled in, by the operator or from paper.

    Attributes:
        point: which of the block's questionnaires.
        ratings: scale -> 0 to 100.
        who: typed it in for the operator; initials. Empty where the operator did it.
    """

    point: Point
    ratings: Mapping[str, int]
    who: str = ""

    def _line(self, named: Named, sums: bool) -> str:
        if not sums:  # who scores the rest of the block is not to know
            return f"Questionnaire ({self.point}) {_how(self.who)}"
        more = f", {_how(self.who)}" if self.who else ""
        return f"Questionnaire ({self.point}): workload {raw_workload(self.ratings):.0f}{more}"

    def _change(self, state: OperatorState, record: Record) -> None:
        state.answer(self.point, record.at, self.ratings, self.who)
        state.answered.add((self.task, self.block, self.point))


@dataclass(frozen=True)
class WeightsAnswered(_OfBlock, word="weigh", due=("weights",)):
    """The fifteen pairs of NASA-TLX were chosen from.

    Attributes:
        winners: of each of ``PAIRS``, in that order.
        shown: the pairs as the operator saw them, ``left-right``, in that order; empty if unknown.
        who: typed them in for the operator; initials. Empty where the operator did it.
    """

    winners: tuple[str, ...]
    shown: tuple[str, ...] = field(default=(), compare=False)
    who: str = ""

    def _line(self, named: Named, sums: bool) -> str:
        return f"Pairs of scales {_how(self.who)}"

    def _change(self, state: OperatorState, record: Record) -> None:
        state.winners[self.task, self.block] = self.winners


@dataclass(frozen=True)
class BreakStarted(Event, word="start_break", words="Break began"):
    """The operator rests."""

    def _change(self, state: OperatorState, record: Record) -> None:
        state.breaks.append((record.at, None))


@dataclass(frozen=True)
class BreakEnded(Event, word="end_break", due=("break",), words="Break ended"):
    """The operator is back."""

    def _change(self, state: OperatorState, record: Record) -> None:
        state.end_break(record.at)


@dataclass(frozen=True)
class Noted(Event, word="note", words="Note: {0.text}"):
    """Something worth remembering."""

    text: str

    def _change(self, state: OperatorState, record: Record) -> None:
        state.notes.append((record.at, self.text))


@dataclass(frozen=True)
class Undone(Event, word="undo", words="Event {0.number} undone{why}"):
    """An earlier event counts no more.

    Attributes:
        number: of the event among the operator's.
        reason: why.
    """

    number: int
    reason: str = ""


ASIDE: Final = (Noted, Chosen, Replaces)
"""Kinds that change nothing in what is due, and are not undone."""


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


def _how(who: str) -> str:
    return f"typed in from paper by {who}" if who else "answered"


def _why(text: str) -> str:
    return f": {text}" if text else ""


def payload(event: Event) -> dict[str, Any]:
    """An event's fields as plain values."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in dataclasses.asdict(event).items()
    }


def event_of(kind: str, values: Mapping[str, Any]) -> Event:
    """An event from its kind and fields, checked as far as it can be without the plan.

    Raises:
        StudyError: no such kind, or a field is missing, unknown or of the wrong type.
    """
    if kind not in EVENTS:
        raise StudyError(f"no event is called {kind!r}; expected one of {', '.join(EVENTS)}")
    event = EVENTS[kind]
    hints = get_type_hints(event)
    names = [f.name for f in fields(event)]
    needed = {f.name for f in fields(event) if f.default is dataclasses.MISSING}
    missing, unknown = sorted(needed - set(values)), sorted(set(values) - set(names))
    if missing or unknown:
        raise StudyError(
            f"event {kind!r} has the fields {', '.join(names) or '(none)'}"
            + (f"; missing: {', '.join(missing)}" if missing else "")
            + (f"; unknown: {', '.join(unknown)}" if unknown else "")
        )
    return event(**{name: _checked(kind, name, v, hints[name]) for name, v in values.items()})


def _checked(kind: str, name: str, value: Any, hint: Any) -> Any:
    where = f"event {kind!r}: {name}"
    if name == "ratings":
        if not isinstance(value, Mapping):
            raise StudyError(f"{where} must be a table of the six scales, not {value!r}")
        check_ratings(value)
        return dict(value)
    if name == "winners":
        if not isinstance(value, list | tuple):
            raise StudyError(f"{where} must be a list of scales, not {value!r}")
        check_winners(value)
        return tuple(value)
    if name == "answers":
        return _answers(where, value)
    if name == "shown":
        listed = isinstance(value, list | tuple) and all(isinstance(v, str) for v in value)
        if not listed:
            raise StudyError(f"{where} must be a list of pairs of scales, not {value!r}")
        return tuple(value)
    if value is None and type(None) in get_args(hint):
        return None
    if hint is bool:
        if not isinstance(value, bool):
            raise StudyError(f"{where} must be true or false, not {value!r}")
        return value
    if hint is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise StudyError(f"{where} must be a whole number, not {value!r}")
        return value
    if hint in (float, float | None):
        right = isinstance(value, int | float) and not isinstance(value, bool)
        if not right or not math.isfinite(value) or value < 0:
            raise StudyError(f"{where} must be a number of 0 or more, not {value!r}")
        return float(value)
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT or "\x00" in value:
        raise StudyError(f"{where} must be a text of up to {_LONGEST_TEXT} characters")
    return value


def _answers(where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping) or len(json.dumps(dict(value))) > _LONGEST_TEXT:
        raise StudyError(f"{where} must be a table of fields, not {str(value)[:80]!r}")
    for name, one in value.items():
        plain = isinstance(one, str | bool | int | float)
        listed = isinstance(one, list | tuple) and all(isinstance(part, str) for part in one)
        if not isinstance(name, str) or not (plain or listed):
            raise StudyError(f"{where}: {name!r} must be a text, a number, yes or no, or a list")
        if isinstance(one, float) and not math.isfinite(one):
            raise StudyError(f"{where}: {name!r} must be a finite number")
    return {name: list(v) if isinstance(v, tuple) else v for name, v in value.items()}

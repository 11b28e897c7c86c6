"""Progress of an operator through the protocol, computed from the events of the log.

Events are folded one after the other, and each is checked against the step that is due. After an
undo the remaining events are folded again. Progress is never stored.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Final, Literal, TypeAlias, TypeVar

from smooth_operator.errors import StudyError
from smooth_operator_study.design.forms import When
from smooth_operator_study.design.plan import Block, Plan
from smooth_operator_study.design.protocol import Point
from smooth_operator_study.store.events import (
    Amended,
    BlockEnded,
    BlockStarted,
    BreakEnded,
    BreakStarted,
    Calibrated,
    Event,
    FamiliarisationEnded,
    FamiliarisationStarted,
    FormAnswered,
    Noted,
    QuestionnaireAnswered,
    Recalibrated,
    Record,
    TrialPaused,
    TrialReset,
    TrialResumed,
    TrialScored,
    TrialStarted,
    TrialVoided,
    Undone,
    Withdrawn,
)

StepKind: TypeAlias = Literal[
    "form",
    "calibrate",
    "start_block",
    "start_familiarisation",
    "familiarise",
    "start_trial",
    "trial",
    "paused",
    "questionnaire",
    "break",
    "refused",
    "withdrawn",
    "done",
]
E = TypeVar("E", bound=Event)
_NO_BREAK: Final = ("break", "trial", "paused", "familiarise", "refused", "withdrawn", "done")
"""Steps in which no break can begin."""
_NO_CALIBRATION: Final = ("form", "calibrate", "trial", "paused", "refused", "withdrawn", "done")
"""Steps in which the tracker can't be calibrated once more."""


@dataclass(frozen=True)
class Step:
    """The step of the protocol that is due.

    Attributes:
        what: kind of step.
        block: block of the step; None if all blocks are done.
        trial: number of the trial in the block, from 1; None without a trial.
        point: initial, midpoint or final, for a questionnaire.
        since: start of the free movement, trial, pause or break.
        form: name of the form that is due.
        title: title of the form.
    """

    what: StepKind
    block: Block | None = None
    trial: int | None = None
    point: Point | None = None
    since: datetime | None = None
    form: str | None = None
    title: str = ""

    def __str__(self) -> str:
        """Describes the step in a few words."""
        if self.block is None:
            texts = {"withdrawn": "withdrawn", "refused": "consent refused"}
            return f"form: {self.title}" if self.what == "form" else texts.get(self.what, "done")
        where = f"{self.block.task.name}, block {self.block.number}"
        match self.what:
            case "calibrate":
                return f"calibration for {self.block.task.name}"
            case "start_block":
                return f"start of {where}"
            case "start_familiarisation" | "familiarise":
                return f"free movement, {where}"
            case "start_trial" | "trial" | "paused":
                return f"trial {self.trial}, {where}" + " (paused)" * (self.what == "paused")
            case "questionnaire":
                return f"questionnaire ({self.point}), {where}"
        return f"break, {where}"


@dataclass
class Trial:
    """A trial that was started.

    Attributes:
        block: block of the plan.
        number: number in the block, from 1.
        started: time of the start.
        resets: number of times that the object was put back.
        line: line of the rubric; None while the trial runs, or if it is void.
        score: score of that line; None like ``line``.
        time_s: time of the trial [s]; None like ``line``.
        void: reason why the trial does not count; None if it counts.
        undone_time_s: time of a score that was undone, for scoring the trial again [s].
        pauses: start, length [s] (None while it lasts) and reason of each pause of the clock.
        amended: whether line, score or time differ from the first scoring.
    """

    block: Block
    number: int
    started: datetime
    resets: int = 0
    line: str | None = None
    score: float | None = None
    time_s: float | None = None
    void: str | None = None
    undone_time_s: float | None = None
    pauses: tuple[tuple[datetime, float | None, str], ...] = ()
    amended: bool = False

    @property
    def paused_s(self) -> float:
        """Length of the pauses that are over [s]."""
        return sum(length or 0.0 for _, length, _ in self.pauses)

    @property
    def paused(self) -> bool:
        """True while the clock of the trial is paused."""
        return bool(self.pauses) and self.pauses[-1][1] is None

    def end_pause(self, seconds: float) -> None:
        """Ends the last pause, with its length [s]."""
        start, _, reason = self.pauses[-1]
        self.pauses = (*self.pauses[:-1], (start, seconds, reason))

    @property
    def counts(self) -> bool:
        """True if the trial was scored and is not void."""
        return self.score is not None and self.void is None


@dataclass
class Progress:
    """Progress of an operator; later events make a new one.

    Attributes:
        plan: plan of the study.
        operator: pseudonym.
        records: all events of the log, undone ones included.
        effective: events that count, without undone ones and undoings.
        trials: trials that were started, void ones included.
        breaks: start and end of each break; the end is None while it lasts.
        amendments: record of each correction, its trial, and line, score and time [s] before it.
        ended_early: (task, block) of blocks whose rest was left out.
        withdrawn: withdrawal of the operator; None while the operator takes part.
        forms: name of a form -> time of the answers, and the answers.
        scored: (task, block) -> number of scored trials.
        answered: (task, block, point) of answered questionnaires.
        calibrations: task -> file or remark of the last calibration.
        started: (task, block) -> method and preset that the hand reported to run.
        moving: start of the free movement; None without free movement.
        moved: (task, block) whose free movement is over.
    """

    plan: Plan
    operator: str
    records: list[Record] = field(default_factory=list)
    effective: list[Record] = field(default_factory=list)
    trials: list[Trial] = field(default_factory=list)
    breaks: list[tuple[datetime, datetime | None]] = field(default_factory=list)
    amendments: list[tuple[Record, Trial, tuple[Any, ...]]] = field(default_factory=list)
    ended_early: set[tuple[str, int]] = field(default_factory=set)
    withdrawn: Withdrawn | None = None
    forms: dict[str, tuple[datetime, dict[str, Any]]] = field(default_factory=dict)
    scored: Counter[tuple[str, int]] = field(default_factory=Counter)
    answered: set[tuple[str, int, Point]] = field(default_factory=set)
    calibrations: dict[str, str] = field(default_factory=dict)
    started: dict[tuple[str, int], tuple[str, str]] = field(default_factory=dict)
    moving: datetime | None = None
    moved: set[tuple[str, int]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.blocks = self.plan.blocks(self.operator)

    # State.

    @property
    def step(self) -> Step:
        """The step of the protocol that is due."""
        if self.withdrawn is not None:
            return Step("withdrawn")
        if self.breaks and self.breaks[-1][1] is None:
            return Step("break", self._block(), since=self.breaks[-1][0])
        if (step := self._form_step("before")) is not None:
            return step
        block = self._block()
        if block is None:
            return self._form_step("after") or Step("done")
        key = block.place
        if block.task.name not in self.calibrations:
            return Step("calibrate", block)
        if key not in self.started:
            return Step("start_block", block)
        if key not in self.moved and self.plan.protocol.familiarisation_s > 0:
            if self.moving is not None:
                return Step("familiarise", block, since=self.moving)
            return Step("start_familiarisation", block)
        if (running := self.running) is not None:
            if running.paused:
                return Step("paused", block, running.number, since=running.pauses[-1][0])
            return Step("trial", block, running.number, since=running.started)
        done = self.scored[key]
        point = block.questionnaires.get(done)
        if point is not None and (*key, point) not in self.answered:
            return Step("questionnaire", block, done, point)
        return Step("start_trial", block, done + 1)

    @property
    def number(self) -> int:
        """Number of the last event; 0 before the first."""
        return len(self.records)

    @property
    def undoable(self) -> Record | None:
        """The event that ``Undone`` would take back now: the last one that counts."""
        for record in reversed(self.effective):
            if not isinstance(record.event, Noted):
                return record
        return None

    @property
    def begun(self) -> Block | None:
        """The current block once it was started: the hand should run its condition."""
        block = None if self.withdrawn else self._block()
        return block if block and block.place in self.started else None

    @property
    def begun_with(self) -> tuple[str, str | None] | None:
        """Method and preset that the hand reported as the current block began; None if unknown."""
        block = self.begun
        method, preset = self.started[block.place] if block else ("", "")
        return (method, preset or None) if method else None

    @property
    def running(self) -> Trial | None:
        """The trial that was started and is neither scored nor void, paused ones included."""
        last = self.trials[-1] if self.trials else None
        return last if last is not None and last.line is None and last.void is None else None

    @property
    def busy(self) -> bool:
        """True during a trial or free movement."""
        return self.running is not None or self.step.what == "familiarise"

    @property
    def over(self) -> bool:
        """True if no step is due any more."""
        return self.step.what in ("done", "withdrawn")

    def undone(self) -> Counter[str]:
        """Counts the undone events of each condition."""
        conditions = {block.place: block.condition.name for block in self.blocks}
        counts: Counter[str] = Counter()
        for record in self.records:
            if isinstance(record.event, Undone):
                event = self.records[record.event.number - 1].event
                key = (getattr(event, "task", ""), getattr(event, "block", 0))
                if key in conditions:
                    counts[conditions[key]] += 1
        return counts

    def events(self, kind: type[E]) -> list[tuple[datetime, E]]:
        """Returns time and event of each event of a kind that counts."""
        return [(one.at, one.event) for one in self.effective if isinstance(one.event, kind)]

    def ranking(self) -> tuple[str, ...]:
        """Conditions as the operator ranked them, the best first; empty without a ranking."""
        names = {c.label: c.name for c in self.plan.protocol.conditions}
        for form in self.plan.protocol.forms:
            for one in form.fields:
                answers = self.forms[form.name][1] if form.name in self.forms else {}
                if one.kind == "ranking" and one.name in answers:
                    return tuple(names[label] for label in answers[one.name])
        return ()

    def ranked_labels(self) -> tuple[str, ...]:
        """Labels of the conditions that the operator has met, in the order of the plan."""
        met = {trial.block.condition.name for trial in self.trials}
        return tuple(c.label for c in self.plan.protocol.conditions if c.name in met)

    def capped(self, line: str, trial: Trial | None = None) -> float:
        """Score of a line of the rubric in a trial.

        Args:
            line: line of the rubric of the trial's task.
            trial: None for the running one.
        """
        trial = trial or self.running
        if trial is None:
            raise StudyError(f"operator {self.operator}: no trial is running that could be scored")
        score = trial.block.task.line(line).score
        return min(score, self.plan.protocol.reset_cap) if trial.resets else score

    def scored_trial(self, task: Any, block: Any, number: Any) -> Trial:
        """Finds a trial that was scored and counts."""
        for trial in self.trials:
            if trial.counts and (*trial.block.place, trial.number) == (task, block, number):
                return trial
        raise StudyError(
            f"operator {self.operator}: trial {number} in block {block} of {task} was not scored; "
            "only a scored trial can be amended"
        )

    def finished(self, block: Block) -> bool:
        """True if no step of a block is due any more."""
        key = block.place
        return key in self.ended_early or (
            self.scored[key] >= block.task.trials
            and all((*key, point) in self.answered for point in block.questionnaires.values())
        )

    def _form_step(self, when: When) -> Step | None:
        for form in self.plan.protocol.forms:
            _, answers = self.forms.get(form.name, (None, None))
            if form.when == when == "before" and answers is not None and form.refused(answers):
                return Step("refused", form=form.name, title=form.heading)
        if when == "before" and self.started:
            return None  # the plan may have gained a form since
        for form in self.plan.protocol.forms:
            if form.when == when and form.name not in self.forms:
                return Step("form", form=form.name, title=form.heading)
        return None

    def _block(self) -> Block | None:
        """The current block, or the next one."""
        return next((block for block in self.blocks if not self.finished(block)), None)

    # Changes by events.

    def apply(self, record: Record) -> None:
        """Checks one more event and applies it."""
        check_event(self, record.event)
        if record.number != self.number + 1:
            raise StudyError(
                f"operator {self.operator}: event {record.number} follows event "
                f"{self.number}; events of the log are missing"
            )
        self.records.append(record)
        if isinstance(record.event, Undone):
            self._undo(record.event.number)
        else:
            self._fold(record)

    def _fold(self, record: Record) -> None:
        """Updates the progress with an event that has been checked."""
        self.effective.append(record)
        event, at = record.event, record.at
        last = self.trials[-1] if self.trials else None
        place = (getattr(event, "task", ""), getattr(event, "block", 0))
        match event:
            case Calibrated() | Recalibrated():
                self.calibrations[event.task] = event.detail
            case BlockStarted():
                self.started[place] = (event.method, event.preset)
            case FamiliarisationStarted():
                self.moving = at
            case FamiliarisationEnded():
                self.moving = None
                self.moved.add(place)
            case TrialStarted():
                block = self._block()
                assert block is not None
                self.trials.append(Trial(block, event.trial, at))
            case TrialReset() if last is not None:
                last.resets += 1
            case TrialPaused() if last is not None:
                last.pauses += ((at, None, event.reason),)
            case TrialResumed() if last is not None:
                last.end_pause(event.paused_s)
            case TrialScored() if last is not None:
                last.line, last.score, last.time_s = event.line, event.score, event.time_s
                self.scored[place] += 1
            case TrialVoided():
                self._void(event.reason, at)
            case Amended():
                trial = self.scored_trial(event.task, event.block, event.trial)
                self.amendments.append((record, trial, (trial.line, trial.score, trial.time_s)))
                trial.line, trial.score, trial.time_s = event.line, event.score, event.time_s
                trial.amended = True
            case QuestionnaireAnswered():
                self.answered.add((*place, event.point))
            case FormAnswered():
                self.forms[event.form] = (at, dict(event.answers))
            case BlockEnded():
                self.ended_early.add(place)
            case BreakStarted():
                self.breaks.append((at, None))
            case BreakEnded():
                self._end_break(at)
            case Withdrawn():
                if self.running is not None:
                    self._void("the operator withdrew", at)
                if self.breaks and self.breaks[-1][1] is None:
                    self._end_break(at)
                self.moving = None
                self.withdrawn = event

    def _undo(self, number: int) -> None:
        undone = self.records[number - 1].event
        fresh = Progress(self.plan, self.operator)
        for record in self.effective:
            if record.number != number:
                fresh._fold(record)
        self.__dict__.update(fresh.__dict__ | {"records": self.records})
        if isinstance(undone, TrialScored):
            self.trials[-1].undone_time_s = undone.time_s

    def _void(self, reason: str, at: datetime) -> None:
        """Makes the last trial void and ends its pause."""
        trial = self.trials[-1]
        trial.void = reason
        if trial.paused:
            trial.end_pause(max(0.0, (at - trial.pauses[-1][0]).total_seconds()))

    def _end_break(self, at: datetime) -> None:
        self.breaks[-1] = (self.breaks[-1][0], at)


def replay(plan: Plan, operator: str, records: Iterable[Record]) -> Progress:
    """Computes an operator's progress from the log."""
    progress = Progress(plan, operator)
    for record in records:
        progress.apply(record)
    return progress


def check_event(state: Progress, event: Event) -> None:
    """Raises StudyError if an event is not due; changes nothing."""
    step = state.step
    match event:
        case Noted():
            return
        case Undone():
            due = state.undoable
            if due is None or due.number != event.number:
                what = "nothing" if due is None else f"event {due.number} ({due.event.kind})"
                raise _refusal(state, f"event {event.number} can't be undone; {what} can")
        case Amended():
            _check_amendment(state, event)
        case Withdrawn():
            if state.withdrawn is not None:
                raise _refusal(state, "has already withdrawn")
        case BreakStarted():
            if step.what in _NO_BREAK:
                raise _refusal(state, f"a break can't begin: {_message(step)} is in progress")
        case Recalibrated():
            if step.what in _NO_CALIBRATION:
                raise _refusal(
                    state, f"calibration is not possible now: {_message(step)} is in progress"
                )
            if step.block is not None:
                _check_place(state, event, step, step.block)
        case _:
            _check_due(state, event, step)


def _check_due(state: Progress, event: Event, step: Step) -> None:
    if step.what not in event.due:
        more = "; score or void its trial first" if isinstance(event, BlockEnded) else ""
        raise _refusal(state, f"{event.kind!r} is not due; {_message(step)} is{more}")
    if isinstance(event, FormAnswered):
        form = next(form for form in state.plan.protocol.forms if form.name == step.form)
        if event.form != form.name:
            raise _refusal(state, f"form {event.form!r} is not due; {form.name!r} is")
        form.check(event.answers, state.ranked_labels())
    elif not isinstance(event, BreakEnded) and step.block is not None:
        _check_place(state, event, step, step.block)


def _check_place(state: Progress, event: Any, step: Step, block: Block) -> None:
    places = {
        "task": block.task.name,
        "block": block.number,
        "condition": block.condition.name,
        "trial": step.trial,
        "point": step.point,
    }
    for name, due in places.items():
        came = getattr(event, name, due)
        if came != due:
            raise _refusal(
                state,
                f"{event.kind!r} is for {name} {came!r}, but {name} {due!r} is current; "
                "reload the page if it was left open",
            )
    if isinstance(event, TrialReset):
        allowed, trial = state.plan.protocol.resets, state.running
        if trial is not None and trial.resets >= allowed:
            raise _refusal(
                state, f"a trial may have {allowed} reset(s), which this trial has already used"
            )
    if isinstance(event, TrialScored):
        _check_score(state, event, state.capped(event.line))
    if isinstance(event, BlockEnded) and not event.reason.strip():
        raise _refusal(state, "state the reason for ending the block early")


def _check_amendment(state: Progress, event: Amended) -> None:
    trial = state.scored_trial(event.task, event.block, event.trial)
    if not event.reason.strip():
        raise _refusal(state, "state the reason for amending the trial")
    _check_score(state, event, state.capped(event.line, trial))
    if (event.line, event.time_s) == (trial.line, trial.time_s):
        raise _refusal(state, f"trial {event.trial} already has that line and time")


def _check_score(state: Progress, event: TrialScored | Amended, due: float) -> None:
    if event.score != due:
        raise _refusal(
            state,
            f"line {event.line!r} of the rubric scores {due:g} in this trial, not {event.score:g}",
        )


def _refusal(state: Progress, text: str) -> StudyError:
    return StudyError(f"operator {state.operator}: {text}")


def _message(step: Step) -> str:
    """Describes a step for the message of a refusal."""
    where = "" if step.block is None else f" in block {step.block.number} of {step.block.task.name}"
    trial = "" if step.trial is None else f" {step.trial}"
    form = "" if step.form is None else f" {step.form!r}"
    return f"{step.what.replace('_', ' ')}{form}{trial}{where}"

"""Progress of an operator in the protocol, computed from events and never stored.

Events are folded one after the other; each is checked against what the protocol wants next, so that
a log holds only what could have happened. What was undone is left out, and the rest folded again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any, Literal, TypeAlias

from smooth_operator.errors import StudyError
from smooth_operator.study.design.plan import Block, Plan
from smooth_operator.study.design.protocol import Point
from smooth_operator.study.store.events import (
    Answered,
    BlockStarted,
    BreakEnded,
    BreakStarted,
    Calibrated,
    Event,
    FamiliarisationEnded,
    FamiliarisationStarted,
    Noted,
    Record,
    TrialReset,
    TrialScored,
    TrialStarted,
    TrialVoided,
    Undone,
    Weighed,
)

What: TypeAlias = Literal[
    "calibrate", "start_block", "start_familiarisation", "familiarise", "start_trial", "trial",
    "questionnaire", "weights", "break", "done",
]  # fmt: skip


@dataclass(frozen=True)
class Step:
    """What the protocol wants now.

    Attributes:
        what: kind of step.
        block: where; None where all is done.
        trial: of the block, from 1, where there is one.
        point: of the questionnaire, where there is one.
        since: when it began, where it runs: familiarisation, trial, break.
        clock: reading of the steady clock then, of familiarisation and trial.
    """

    what: What
    block: Block | None = None
    trial: int | None = None
    point: Point | None = None
    since: datetime | None = None
    clock: str = ""


@dataclass
class Trial:
    """A trial that was begun.

    Attributes:
        block: number of the block.
        number: in the block.
        started: when.
        resets: how often the object was put back.
        line: of the rubric; None while it runs, or if void.
        score: None likewise.
        time_s: None likewise.
        void: why it doesn't count; None if it does.
        undone_time_s: time of a score that was undone, for scoring it again.
        clock: reading of the steady clock at its start; empty if there is none.
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
    clock: str = ""


@dataclass(frozen=True)
class Questionnaire:
    """An answered one."""

    block: Block
    point: Point
    at: datetime
    ratings: Mapping[str, int]


@dataclass
class Progress:
    """An operator's part of the study so far.

    Attributes:
        plan: of the study.
        operator: pseudonym.
        records: all of the log, undone ones included.
        trials: begun ones, void ones included.
        questionnaires: answered ones.
        winners: (task, block) -> choices from the fifteen pairs.
        notes: with their times.
        breaks: (start, end); the end is None while it lasts.
    """

    plan: Plan
    operator: str
    records: list[Record] = field(default_factory=list)
    trials: list[Trial] = field(default_factory=list)
    questionnaires: list[Questionnaire] = field(default_factory=list)
    winners: dict[tuple[str, int], tuple[str, ...]] = field(default_factory=dict)
    notes: list[tuple[datetime, str]] = field(default_factory=list)
    breaks: list[tuple[datetime, datetime | None]] = field(default_factory=list)
    _effective: list[Record] = field(default_factory=list)
    _scored: Counter[tuple[str, int]] = field(default_factory=Counter)
    _answered: set[tuple[str, int, Point]] = field(default_factory=set)
    _calibrated: set[str] = field(default_factory=set)
    _started: set[tuple[str, int]] = field(default_factory=set)
    _moving: tuple[datetime, str] | None = None
    _moved: set[tuple[str, int]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.blocks = self.plan.blocks(self.operator)

    @property
    def number(self) -> int:
        """Of the last event; 0 before the first."""
        return len(self.records)

    @property
    def step(self) -> Step:
        """What the protocol wants now."""
        if self.breaks and self.breaks[-1][1] is None:
            return Step("break", self._block(), since=self.breaks[-1][0])
        block = self._block()
        if block is None:
            return Step("done")
        key = (block.task.name, block.number)
        if block.task.name not in self._calibrated:
            return Step("calibrate", block)
        if key not in self._started:
            return Step("start_block", block)
        if key not in self._moved and self.plan.protocol.familiarisation_s > 0:
            if self._moving is not None:
                since, clock = self._moving
                return Step("familiarise", block, since=since, clock=clock)
            return Step("start_familiarisation", block)
        if (running := self.running) is not None:
            since, clock = running.started, running.clock
            return Step("trial", block, running.number, since=since, clock=clock)
        done = self._scored[key]
        point = block.questionnaires.get(done)
        if point is not None and (*key, point) not in self._answered:
            return Step("questionnaire", block, done, point)
        if done == block.task.trials:
            return Step("weights", block, done)
        return Step("start_trial", block, done + 1)

    @property
    def begun(self) -> Block | None:
        """The block that is on and was begun: its condition is what the hand should run."""
        block = self._block()
        return block if block and (block.task.name, block.number) in self._started else None

    @property
    def running(self) -> Trial | None:
        """The trial whose clock runs."""
        last = self.trials[-1] if self.trials else None
        return last if last is not None and last.line is None and last.void is None else None

    @property
    def undoable(self) -> Record | None:
        """What ``Undone`` would take back now: the last event that counts, notes aside."""
        for record in reversed(self._effective):
            if not isinstance(record.event, Noted):
                return record
        return None

    def capped(self, line: str) -> float:
        """What a line of the rubric scores in the trial that runs.

        Raises:
            StudyError: none runs.
            UnknownNameError: the rubric has no such line.
        """
        trial = self.running
        if trial is None:
            raise StudyError(f"operator {self.operator}: no trial runs that could be scored")
        score = trial.block.task.line(line).score
        return min(score, self.plan.protocol.reset_cap) if trial.resets else score

    def copy(self) -> Progress:
        """The same, which later events of this one don't change."""
        twin = Progress(self.plan, self.operator)
        for name, value in self.__dict__.items():
            same = value.copy() if isinstance(value, list | dict | set) else value
            twin.__dict__[name] = same
        twin.trials = [replace(trial) for trial in self.trials]
        return twin

    def apply(self, record: Record) -> None:
        """One event more.

        Raises:
            StudyError: it is not its turn; says what is.
        """
        self.check(record.event)
        if record.number != self.number + 1:
            raise StudyError(
                f"operator {self.operator}: event {record.number} follows event {self.number}; "
                "the log has lost something"
            )
        self.records.append(record)
        if isinstance(record.event, Undone):
            self._undo(record.event.number)
        else:
            self._take(record)

    def check(self, event: Event) -> None:
        """Refuses an event that is not due; changes nothing.

        Raises:
            StudyError: it is not its turn; says what is.
        """
        if isinstance(event, Noted):
            return
        if isinstance(event, Undone):
            due = self.undoable
            if due is None or due.number != event.number:
                what = "nothing" if due is None else f"event {due.number} ({due.event.kind})"
                raise self._refusal(f"event {event.number} can't be undone; {what} can")
            return
        step = self.step
        if isinstance(event, BreakStarted):
            if step.what in ("break", "trial", "familiarise"):
                raise self._refusal(f"no break can begin: {_named(step)} is on")
            return
        wanted = _WANTED[step.what]
        if not isinstance(event, wanted):
            raise self._refusal(f"{event.kind!r} is not due; {_named(step)} is")
        if isinstance(event, BreakEnded) or step.block is None:
            return
        self._check_place(event, step, step.block)

    def _check_place(self, event: Any, step: Step, block: Block) -> None:
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
                raise self._refusal(
                    f"{event.kind!r} is for {name} {came!r}, but {name} {due!r} is on; reload the "
                    "page if it was left open"
                )
        if isinstance(event, TrialReset):
            allowed, trial = self.plan.protocol.resets, self.running
            if trial is not None and trial.resets >= allowed:
                raise self._refusal(f"a trial may have {allowed} reset(s), and this one had them")
        if isinstance(event, TrialScored) and event.score != (due := self.capped(event.line)):
            raise self._refusal(
                f"line {event.line!r} of the rubric scores {due:g} in this trial, not "
                f"{event.score:g}"
            )

    def _take(self, record: Record) -> None:
        self._effective.append(record)
        event, at = record.event, record.at
        match event:
            case Noted():
                self.notes.append((at, event.text))
            case BreakStarted():
                self.breaks.append((at, None))
            case BreakEnded():
                self.breaks[-1] = (self.breaks[-1][0], at)
            case Calibrated():
                self._calibrated.add(event.task)
            case BlockStarted():
                self._started.add((event.task, event.block))
            case FamiliarisationStarted():
                self._moving = (at, event.clock)
            case FamiliarisationEnded():
                self._moving = None
                self._moved.add((event.task, event.block))
            case TrialStarted():
                block = self._block()
                assert block is not None
                self.trials.append(Trial(block, event.trial, at, clock=event.clock))
            case TrialReset():
                self.trials[-1].resets += 1
            case TrialScored():
                last = self.trials[-1]
                last.line, last.score, last.time_s = event.line, event.score, event.time_s
                self._scored[event.task, event.block] += 1
            case TrialVoided():
                self.trials[-1].void = event.reason
            case Answered():
                block = self._block()
                assert block is not None
                self.questionnaires.append(
                    Questionnaire(block, event.point, at, dict(event.ratings))
                )
                self._answered.add((event.task, event.block, event.point))
            case Weighed():
                self.winners[event.task, event.block] = event.winners

    def _undo(self, number: int) -> None:
        left_out = next(r for r in self._effective if r.number == number)
        kept = [record for record in self._effective if record.number != number]
        records = self.records
        fresh = Progress(self.plan, self.operator)
        for record in kept:
            fresh._take(record)
        self.__dict__.update(fresh.__dict__)
        self.records = records
        if isinstance(left_out.event, TrialScored):
            self.trials[-1].undone_time_s = left_out.event.time_s

    def _block(self) -> Block | None:
        """The block that is on, or the next one."""
        for block in self.blocks:
            if not self._finished(block):
                return block
        return None

    def _finished(self, block: Block) -> bool:
        key = (block.task.name, block.number)
        if self._scored[key] < block.task.trials:
            return False
        if any((*key, point) not in self._answered for point in block.questionnaires.values()):
            return False
        unweighed = self.plan.protocol.weights and block.questionnaires
        return not unweighed or key in self.winners

    def _refusal(self, text: str) -> StudyError:
        return StudyError(f"operator {self.operator}: {text}")


_WANTED: dict[What, tuple[type[Event], ...]] = {
    "calibrate": (Calibrated,),
    "start_block": (BlockStarted,),
    "start_familiarisation": (FamiliarisationStarted,),
    "familiarise": (FamiliarisationEnded,),
    "start_trial": (TrialStarted,),
    "trial": (TrialReset, TrialScored, TrialVoided),
    "questionnaire": (Answered,),
    "weights": (Weighed,),
    "break": (BreakEnded,),
    "done": (),
}


def replay(plan: Plan, operator: str, records: Iterable[Record]) -> Progress:
    """An operator's progress from the log.

    Raises:
        StudyError: the log holds what the plan doesn't allow.
    """
    progress = Progress(plan, operator)
    for record in records:
        progress.apply(record)
    return progress


def _named(step: Step) -> str:
    where = "" if step.block is None else f" in block {step.block.number} of {step.block.task.name}"
    trial = "" if step.trial is None else f" {step.trial}"
    return f"{step.what.replace('_', ' ')}{trial}{where}"

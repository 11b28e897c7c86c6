"""The state of an operator in the protocol, which the events of the log change.

It names no event: ``progress`` folds events into it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Final, Literal, TypeAlias

from smooth_operator.errors import StudyError
from smooth_operator.study.design.forms import Form, When
from smooth_operator.study.design.plan import Block, Plan
from smooth_operator.study.design.protocol import Point

LEFT: Final = "the operator withdrew"
"""Why a trial is void that ran as its operator withdrew."""
What: TypeAlias = Literal[
    "form", "calibrate", "start_block", "start_familiarisation", "familiarise", "start_trial",
    "trial", "paused", "questionnaire", "weights", "break", "refused", "withdrawn", "done",
]  # fmt: skip


@dataclass(frozen=True)
class Step:
    """The step of the protocol that is due.

    Attributes:
        what: kind of step.
        block: where; None where all is done.
        trial: of the block, from 1, where there is one.
        point: of the questionnaire, where there is one.
        since: when it began, where it runs: familiarisation, trial, pause, break.
        clock: reading of the steady clock then, of familiarisation, trial and pause.
        form: name of the form, where one is due.
    """

    what: What
    block: Block | None = None
    trial: int | None = None
    point: Point | None = None
    since: datetime | None = None
    clock: str = ""
    form: str | None = None


@dataclass
class Trial:
    """A trial that was begun.

    Attributes:
        block: of the plan.
        number: in the block.
        started: when.
        resets: how often the object was put back.
        line: of the rubric; None while it runs, or if void.
        score: None likewise.
        time_s: None likewise.
        void: why it doesn't count; None if it does.
        undone_time_s: time of a score that was undone, for scoring it again.
        clock: reading of the steady clock at its start; empty if there is none.
        pauses: start, length [s] (None while it lasts) and reason of each pause of its clock.
        paused_clock: reading of the steady clock at the start of the last pause.
        amended: whether line, score or time are not those of the first scoring.
        proposed_line: what a simulation proposed; empty where it did not.
        proposed_score: of that line.
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
    pauses: tuple[tuple[datetime, float | None, str], ...] = ()
    paused_clock: str = ""
    amended: bool = False
    proposed_line: str = ""
    proposed_score: float | None = None

    @property
    def paused_s(self) -> float:
        """Length of its pauses that are over [s]."""
        return sum(length or 0.0 for _, length, _ in self.pauses)

    def paused_within(self, seconds: float) -> float:
        """Length of the pauses in so many seconds from its start [s].

        For a simulation whose own clock went on in the pauses.
        """
        parts = ((at - self.started, length or 0.0) for at, length, _ in self.pauses)
        return sum(min(max(0.0, seconds - a.total_seconds()), length) for a, length in parts)

    @property
    def paused(self) -> bool:
        """True while its clock stands."""
        return bool(self.pauses) and self.pauses[-1][1] is None

    def end_pause(self, seconds: float) -> None:
        """The clock of the trial goes on after so many seconds."""
        start, _, reason = self.pauses[-1]
        self.pauses = (*self.pauses[:-1], (start, seconds, reason))

    @property
    def counts(self) -> bool:
        """True if it was scored and is not void."""
        return self.score is not None and self.void is None


@dataclass(frozen=True)
class Questionnaire:
    """An answered one; ``who`` typed it in from paper, empty where the operator answered."""

    block: Block
    point: Point
    at: datetime
    ratings: Mapping[str, int]
    who: str = ""


@dataclass(frozen=True)
class Amendment:
    """A correction of a scored trial.

    Attributes:
        number: of its event.
        at: when it was made.
        block: of the trial.
        trial: number in the block.
        before: line, score and time [s] until then.
        after: the same from then on.
        reason: why.
        who: decided so.
    """

    number: int
    at: datetime
    block: Block
    trial: int
    before: tuple[str, float, float]
    after: tuple[str, float, float]
    reason: str
    who: str


@dataclass(frozen=True)
class Withdrawal:
    """The operator takes no further part.

    Attributes:
        at: when.
        keep: whether the data so far may be analysed.
        reason: why.
    """

    at: datetime
    keep: bool
    reason: str


@dataclass
class OperatorState:
    """An operator's part of the study so far.

    Attributes:
        plan: of the study.
        operator: pseudonym.
        trials: begun ones, void ones included.
        questionnaires: answered ones.
        winners: (task, block) -> choices from the fifteen pairs.
        notes: with their times.
        breaks: (start, end); the end is None while it lasts.
        amendments: corrections of scored trials.
        recalibrations: time, task and detail of each.
        ended_early: (task, block) -> when and why the rest of a block was left out.
        withdrawn: whether and how the operator left; None if not.
        replaces: whose rows the operator has; empty if nobody's.
        forms: name -> when, and answers.
        typed: forms that somebody typed in for the operator -> who.
        on_paper: forms on paper that were not typed in yet -> when and who has them.
        scored: (task, block) -> number of scored trials.
        answered: (task, block, point) of answered questionnaires.
        calibrated: tasks that the tracker was calibrated for.
        started: (task, block) -> method and preset that the hand said it ran.
        moving: when free movement began, and the clock then; None where none is on.
        moved: (task, block) whose free movement is over.
    """

    plan: Plan
    operator: str
    trials: list[Trial] = field(default_factory=list)
    questionnaires: list[Questionnaire] = field(default_factory=list)
    winners: dict[tuple[str, int], tuple[str, ...]] = field(default_factory=dict)
    notes: list[tuple[datetime, str]] = field(default_factory=list)
    breaks: list[tuple[datetime, datetime | None]] = field(default_factory=list)
    amendments: list[Amendment] = field(default_factory=list)
    recalibrations: list[tuple[datetime, str, str]] = field(default_factory=list)
    ended_early: dict[tuple[str, int], tuple[datetime, str]] = field(default_factory=dict)
    withdrawn: Withdrawal | None = None
    replaces: str = ""
    forms: dict[str, tuple[datetime, dict[str, Any]]] = field(default_factory=dict)
    typed: dict[str, str] = field(default_factory=dict)
    on_paper: dict[str, tuple[datetime, str]] = field(default_factory=dict)
    scored: Counter[tuple[str, int]] = field(default_factory=Counter)
    answered: set[tuple[str, int, Point]] = field(default_factory=set)
    calibrated: set[str] = field(default_factory=set)
    started: dict[tuple[str, int], tuple[str, str]] = field(default_factory=dict)
    moving: tuple[datetime, str] | None = None
    moved: set[tuple[str, int]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.blocks = self.plan.blocks(self.operator)

    @property
    def step(self) -> Step:
        """The step of the protocol that is due."""
        if self.withdrawn is not None:
            return Step("withdrawn", since=self.withdrawn.at)
        if self.breaks and self.breaks[-1][1] is None:
            return Step("break", self._block(), since=self.breaks[-1][0])
        if (step := self._form_step("before")) is not None:
            return step
        block = self._block()
        if block is None:
            return self._form_step("after") or Step("done")
        key = (block.task.name, block.number)
        if block.task.name not in self.calibrated:
            return Step("calibrate", block)
        if key not in self.started:
            return Step("start_block", block)
        if key not in self.moved and self.plan.protocol.familiarisation_s > 0:
            if self.moving is not None:
                since, clock = self.moving
                return Step("familiarise", block, since=since, clock=clock)
            return Step("start_familiarisation", block)
        if (running := self.running) is not None:
            if running.paused:
                since, clock = running.pauses[-1][0], running.paused_clock
                return Step("paused", block, running.number, since=since, clock=clock)
            since, clock = running.started, running.clock
            return Step("trial", block, running.number, since=since, clock=clock)
        done = self.scored[key]
        point = block.questionnaires.get(done)
        if point is not None and (*key, point) not in self.answered:
            return Step("questionnaire", block, done, point)
        if done == block.task.trials:
            return Step("weights", block, done)
        return Step("start_trial", block, done + 1)

    @property
    def begun(self) -> Block | None:
        """The block that is on and was begun: its condition is what the hand should run."""
        block = None if self.withdrawn else self._block()
        return block if block and (block.task.name, block.number) in self.started else None

    @property
    def begun_with(self) -> tuple[str, str | None] | None:
        """Method and preset that the hand said it runs as the block that is on began.

        None where no block is on, or nothing was heard then.
        """
        block = self.begun
        method, preset = self.started[block.task.name, block.number] if block else ("", "")
        return (method, preset or None) if method else None

    @property
    def running(self) -> Trial | None:
        """The trial that was begun and is neither scored nor void, paused ones included."""
        last = self.trials[-1] if self.trials else None
        return last if last is not None and last.line is None and last.void is None else None

    @property
    def busy(self) -> bool:
        """True while a trial or free movement is on."""
        return self.running is not None or self.step.what == "familiarise"

    @property
    def over(self) -> bool:
        """True if nothing is due any more."""
        return self.step.what in ("done", "withdrawn")

    def ranking(self) -> tuple[str, ...]:
        """Conditions as the operator ranked them, from the best on; empty if not asked."""
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
        """The score of a line of the rubric in a trial.

        Args:
            line: of the rubric of its task.
            trial: None for the one that runs.

        Raises:
            StudyError: none runs.
            UnknownNameError: the rubric has no such line.
        """
        trial = trial or self.running
        if trial is None:
            raise StudyError(f"operator {self.operator}: no trial runs that could be scored")
        score = trial.block.task.line(line).score
        return min(score, self.plan.protocol.reset_cap) if trial.resets else score

    def scored_trial(self, task: str, block: int, number: int) -> Trial:
        """A trial that was scored and counts.

        Raises:
            StudyError: there is none at that place.
        """
        for trial in self.trials:
            place = (trial.block.task.name, trial.block.number, trial.number)
            if trial.counts and place == (task, block, number):
                return trial
        raise StudyError(
            f"operator {self.operator}: trial {number} in block {block} of {task} was not scored; "
            "only a scored trial can be amended"
        )

    def due_form(self, when: When) -> Form | None:
        """The next form that was not filled in, nor is on paper."""
        for form in self.plan.protocol.forms:
            if form.when == when and form.name not in {**self.forms, **self.on_paper}:
                return form
        return None

    def can_type(self, form: Form) -> bool:
        """True if an experimenter may type a form in now: not before it is due."""
        return (
            form.name in {**self.forms, **self.on_paper}
            or self.withdrawn is not None
            or self.step.form == form.name
            or (form.when == "before" and bool(self.started))
        )

    def finished(self, block: Block) -> bool:
        """True if nothing of a block is due any more."""
        key = (block.task.name, block.number)
        if key in self.ended_early:
            return True
        if self.scored[key] < block.task.trials:
            return False
        if any((*key, point) not in self.answered for point in block.questionnaires.values()):
            return False
        unweighed = self.plan.protocol.weights and block.questionnaires
        return not unweighed or key in self.winners

    # Changes by events.

    def begin_trial(self, number: int, at: datetime, clock: str) -> None:
        """A trial of the block that is on begins."""
        self.trials.append(Trial(self._on(), number, at, clock=clock))

    def answer(self, point: Point, at: datetime, ratings: Mapping[str, int], who: str) -> None:
        """A questionnaire of the block that is on was filled in."""
        self.questionnaires.append(Questionnaire(self._on(), point, at, dict(ratings), who))

    def amend_trial(
        self,
        place: tuple[str, int, int],
        after: tuple[str, float, float],
        number: int,
        at: datetime,
        reason: str,
        who: str,
    ) -> None:
        """A scored trial, given by task, block and number, gets another line, score and time."""
        trial = self.scored_trial(*place)
        assert trial.line is not None
        assert trial.score is not None
        assert trial.time_s is not None
        before = (trial.line, trial.score, trial.time_s)
        self.amendments.append(
            Amendment(number, at, trial.block, place[2], before, after, reason, who)
        )
        trial.line, trial.score, trial.time_s = after
        trial.amended = True

    def void_trial(self, reason: str, at: datetime) -> None:
        """The last trial doesn't count; a pause of it is over."""
        trial = self.trials[-1]
        trial.void = reason
        if trial.paused:
            trial.end_pause(max(0.0, (at - trial.pauses[-1][0]).total_seconds()))

    def end_break(self, at: datetime) -> None:
        """The break that is on is over."""
        self.breaks[-1] = (self.breaks[-1][0], at)

    def withdraw(self, at: datetime, keep: bool, reason: str) -> None:
        """The operator leaves; whatever was on ends with it."""
        if self.running is not None:
            self.void_trial(LEFT, at)
        if self.breaks and self.breaks[-1][1] is None:
            self.end_break(at)
        self.moving = None
        self.withdrawn = Withdrawal(at, keep, reason)

    def _on(self) -> Block:
        block = self._block()
        assert block is not None
        return block

    def _form_step(self, when: When) -> Step | None:
        for form in self.plan.protocol.forms:
            answered = self.forms.get(form.name)
            if (
                form.when == "before"
                and when == "before"
                and answered
                and form.refused(answered[1])
            ):
                return Step("refused", form=form.name)
        if when == "before" and self.started:
            return None  # the plan may have gained a form since
        due = self.due_form(when)
        return None if due is None else Step("form", form=due.name)

    def _block(self) -> Block | None:
        """The block that is on, or the next one."""
        for block in self.blocks:
            if not self.finished(block):
                return block
        return None

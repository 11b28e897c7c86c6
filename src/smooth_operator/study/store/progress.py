"""Progress of an operator in the protocol, computed from events and never stored.

Events are folded one after the other; each is checked against what the protocol wants next. What
was undone is left out, and the rest folded again.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from smooth_operator.errors import StudyError
from smooth_operator.study.design.plan import Block, Plan
from smooth_operator.study.store.event_rules import check_event
from smooth_operator.study.store.events import (
    Amended,
    Answered,
    BlockEnded,
    BlockStarted,
    BreakEnded,
    BreakStarted,
    Calibrated,
    Event,
    FamiliarisationEnded,
    FamiliarisationStarted,
    FormAnswered,
    FormOnPaper,
    Noted,
    Recalibrated,
    Record,
    Replaces,
    TrialPaused,
    TrialReset,
    TrialResumed,
    TrialScored,
    TrialStarted,
    TrialVoided,
    Undone,
    Weighed,
    Withdrawn,
)
from smooth_operator.study.store.operator_state import (
    Amendment,
    OperatorState,
    Questionnaire,
    Trial,
    Withdrawal,
)
from smooth_operator.study.store.operator_state import Step as Step

LEFT = "the operator withdrew"
"""Why a trial is void that ran as its operator withdrew."""


class Progress(OperatorState):
    """An operator's part of the study so far, which grows with each event."""

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
        check_event(self, event)

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
            case Recalibrated():
                self.recalibrations.append((at, event.task, event.detail))
            case BlockStarted():
                self._started[event.task, event.block] = (event.method, event.preset)
            case BlockEnded():
                self.ended_early[event.task, event.block] = (at, event.reason)
            case FamiliarisationStarted():
                self._moving = (at, event.clock)
            case FamiliarisationEnded():
                self._moving = None
                self._moved.add((event.task, event.block))
            case Answered():
                self.questionnaires.append(
                    Questionnaire(self._on(), event.point, at, dict(event.ratings), event.who)
                )
                self._answered.add((event.task, event.block, event.point))
            case Weighed():
                self.winners[event.task, event.block] = event.winners
            case FormAnswered():
                self.forms[event.form] = (at, dict(event.answers))
                self.on_paper.pop(event.form, None)
                self.typed.pop(event.form, None)
                if event.who:
                    self.typed[event.form] = event.who
            case FormOnPaper():
                self.on_paper[event.form] = (at, event.who)
            case Replaces():
                self.replaces = event.operator
            case Withdrawn():
                self._withdraw(record, event)
            case _:
                self._take_of_trial(record)

    def _take_of_trial(self, record: Record) -> None:
        event, at = record.event, record.at
        match event:
            case TrialStarted():
                self.trials.append(Trial(self._on(), event.trial, at, clock=event.clock))
            case TrialReset():
                self.trials[-1].resets += 1
            case TrialPaused():
                last = self.trials[-1]
                last.pauses += ((at, None, event.reason),)
                last.paused_clock = event.clock
            case TrialResumed():
                last = self.trials[-1]
                start, _, reason = last.pauses[-1]
                last.pauses = (*last.pauses[:-1], (start, event.paused_s, reason))
            case TrialScored():
                last = self.trials[-1]
                last.line, last.score, last.time_s = event.line, event.score, event.time_s
                last.proposed_line = event.proposed_line
                last.proposed_score = event.proposed_score
                self._scored[event.task, event.block] += 1
            case TrialVoided():
                self._void(event.reason, record)
            case Amended():
                self._amend(record, event)

    def _amend(self, record: Record, event: Amended) -> None:
        trial = self.scored_trial(event.task, event.block, event.trial)
        assert trial.line is not None
        assert trial.score is not None
        assert trial.time_s is not None
        before = (trial.line, trial.score, trial.time_s)
        after = (event.line, event.score, event.time_s)
        self.amendments.append(
            Amendment(record.number, record.at, trial.block, event.trial, before, after,
                      event.reason, event.who)
        )  # fmt: skip
        trial.line, trial.score, trial.time_s = after
        trial.amended = True

    def _withdraw(self, record: Record, event: Withdrawn) -> None:
        """Whatever was on ends with it."""
        if self.running is not None:
            self._void(LEFT, record)
        if self.breaks and self.breaks[-1][1] is None:
            self.breaks[-1] = (self.breaks[-1][0], record.at)
        self._moving = None
        self.withdrawn = Withdrawal(record.at, event.keep, event.reason)

    def _void(self, reason: str, record: Record) -> None:
        last = self.trials[-1]
        last.void = reason
        if last.paused:
            start, _, why = last.pauses[-1]
            length = max(0.0, (record.at - start).total_seconds())
            last.pauses = (*last.pauses[:-1], (start, length, why))

    def _on(self) -> Block:
        block = self._block()
        assert block is not None
        return block

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


def replay(plan: Plan, operator: str, records: Iterable[Record]) -> Progress:
    """An operator's progress from the log.

    Raises:
        StudyError: the log holds what the plan doesn't allow.
    """
    progress = Progress(plan, operator)
    for record in records:
        progress.apply(record)
    return progress

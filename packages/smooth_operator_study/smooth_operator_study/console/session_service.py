"""Logic of the console without the network: commands, current operator, running teleoperation.

All methods may be called from any thread. A command returns when its event is on disk. It is a JSON
object: ``token`` (unique text), ``do`` (a word below), ``operator``, ``after`` (number of the last
event that the page had seen), ``waited_s`` (age of the command [s]: it may have waited in a page
without a connection) and the ``fields`` of its word.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from datetime import datetime
from typing import Annotated, Any, Final, Literal, TypeAlias

import msgspec
from msgspec import Meta

from smooth_operator.errors import SmoothOperatorError, StudyError
from smooth_operator_study.console.page_state import experimenter_view, operator_view
from smooth_operator_study.console.switching import SessionTeleop, Teleop
from smooth_operator_study.design.plan import Plan
from smooth_operator_study.store import events
from smooth_operator_study.store.events import (
    FamiliarisationEnded,
    FamiliarisationStarted,
    Noted,
)
from smooth_operator_study.store.nasa_tlx import ENGLISH, TlxWords
from smooth_operator_study.store.progress import Progress, Trial, check_event
from smooth_operator_study.store.study_store import StudyStore

Role: TypeAlias = Literal["experimenter", "operator"]
EVENTS: Final = {event.command: kind for kind, event in events.EVENTS.items() if event.command}
"""Command -> kind of the event that it causes."""
OTHER: Final = ("choose", "enrol", "switch")
"""Commands that cause no event of the current operator."""
OPERATOR_COMMANDS: Final = ("answer", "form")
"""Commands of the operator's page; the experimenter's page has all others."""


@dataclass(frozen=True)
class Command:
    """A request of a page.

    Attributes:
        token: unique text of the command, the same each time that it is sent.
        do: one of ``EVENTS`` or ``OTHER``.
        operator: pseudonym.
        after: number of the last event that the page had seen; None where that doesn't matter.
        fields: further fields of the command.
        waited_s: age of the command [s]; for a score the time since the clock was stopped.
    """

    token: Annotated[str, Meta(min_length=8, max_length=128)]
    do: str
    operator: str = ""
    after: int | None = None
    fields: Mapping[str, Any] = field(default_factory=dict)
    waited_s: Annotated[float, Meta(ge=0.0, le=86_400.0)] = 0.0


def command_of(message: Mapping[str, Any], role: Role) -> Command:
    """Makes a command of a page's message, checked as far as possible without the study."""
    try:
        command = msgspec.convert(message, Command)
    except msgspec.ValidationError as error:
        raise StudyError(f"this is not a command: {error}; reload the page") from None
    if not command.token.isprintable():
        raise StudyError(f"a token must be printable, not {command.token!r}")
    if command.do not in (*EVENTS, *OTHER):
        raise StudyError(f"no such command: {command.do!r}; reload the page")
    if (role == "operator") != (command.do in OPERATOR_COMMANDS):
        raise StudyError(f"the {role}'s page is not allowed to do {command.do!r}")
    return command


def event_for(
    command: Command,
    progress: Progress,
    elapsed_s: float | None,
    measured_s: float | None = None,
    more: Mapping[str, Any] | None = None,
) -> events.Event:
    """Makes the event of a command. Facts that the protocol decides are not taken from the page.

    Args:
        elapsed_s: time from the start of the trial to the command [s]; None without a trial.
        measured_s: time of the trial by a simulation [s]; None without one.
        more: fields that the console knows and the page does not send.
    """
    values = dict(command.fields)
    if command.do == "score":
        line = str(values.get("line"))
        values["score"] = progress.capped(line)
        _check_reset(line, progress.running)
        values["time_s"] = trial_time(progress, elapsed_s, command.waited_s, measured_s)
    elif command.do == "start_block":
        block = progress.step.block
        values["condition"] = "" if block is None else block.condition.name
    elif command.do == "amend":
        values = _amended(values, progress)
    return events.event_of(EVENTS[command.do], {**values, **(more or {})})


def _check_reset(line: str, trial: Trial | None) -> None:
    if trial is not None and not trial.resets and line.endswith("after-reset"):
        raise StudyError(
            f"line {line!r} of the rubric needs a reset, and this trial had none; if the "
            "object was reset, record the reset first"
        )


def _amended(values: dict[str, Any], progress: Progress) -> dict[str, Any]:
    """Completes an amendment by the trial's line and time, and by the score of the rubric."""
    task, block, number = (values.get(name) for name in ("task", "block", "trial"))
    trial = progress.scored_trial(task, block, number)
    line = str(values.get("line") or trial.line)
    if line != trial.line:
        _check_reset(line, trial)
    time_s = trial.time_s if values.get("time_s") is None else values["time_s"]
    return {**values, "line": line, "score": progress.capped(line, trial), "time_s": time_s}


def trial_time(
    progress: Progress,
    elapsed_s: float | None,
    waited_s: float,
    measured_s: float | None = None,
) -> float:
    """Time of the running trial [s], to the millisecond.

    It goes from the stored start to the moment when the page stopped the clock, so that neither a
    killed server nor a lost connection changes it. A trial whose score was undone keeps its time.

    Args:
        elapsed_s: time from the start of the trial until now [s].
        waited_s: time since the page stopped the clock [s].
        measured_s: time by the clock of a simulation, without pauses [s].
    """
    trial = progress.running
    if trial is None or elapsed_s is None:
        raise StudyError(f"operator {progress.operator}: no trial is running that could be scored")
    if trial.undone_time_s is not None:
        return trial.undone_time_s
    if measured_s is not None:
        return round(measured_s, 3)
    return round(max(0.0, elapsed_s - waited_s - trial.paused_s), 3)


def check_seen(command: Command, progress: Progress) -> None:
    """Refuses a command of a page that had not seen the latest events."""
    if command.after is None or command.do == "note":
        return
    for record in progress.records[command.after :]:
        if isinstance(record.event, events.Amended) and command.do not in ("amend", "undo"):
            continue  # it concerns an earlier trial: the step that is due is the same
        if not isinstance(record.event, events.Noted):
            what = record.event.kind.replace("_", " ")
            raise StudyError(
                "not done: in the meantime another page or this console wrote event "
                f"{record.number} ({what}); check the current state and repeat the action if "
                "it is still right"
            )


_STARTS: Final = (
    "calibrated",
    "recalibrate",
    "start_block",
    "start_familiarisation",
    "start_trial",
)
_TELEOP_COMMANDS: Final = (
    *_STARTS,
    "reset",
    "void",
    "score",
    "pause",
    "resume",
    "withdraw",
    "undo",
)
"""Commands that involve the teleoperation."""


class StoreFailedError(StudyError):
    """Raised if the store can't be used now; the command is valid and may succeed when sent
    again."""


@contextmanager
def store_failures() -> Iterator[None]:
    """Turns an error of the database into ``StoreFailedError``."""
    try:
        yield
    except StudyError as error:
        cause = error.__cause__
        if isinstance(cause, sqlite3.Error | OSError) and not isinstance(
            cause, SmoothOperatorError
        ):
            raise StoreFailedError(str(error)) from error
        raise


class SessionService:
    """Carries out the commands of one console's pages and gives the content of the pages.

    Args:
        store: store of the study.
        operator: current operator; None for the one with the last event who is not done.
        blind: whether the experimenter sees labels instead of conditions.
        teleop: running teleoperation that is switched to the conditions; None without one.
        words: words of NASA-TLX for the operators.
        enrolled: called with each plan that was changed here and is stored.
        changed: called, from any thread, when the pages should be drawn again.
        report: called with sentences for the terminal.
    """

    def __init__(
        self,
        store: StudyStore,
        *,
        operator: str | None = None,
        blind: bool = False,
        teleop: Teleop | None = None,
        words: TlxWords = ENGLISH,
        enrolled: Callable[[Plan], None] = lambda plan: None,
        changed: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._store = store
        self._blind = blind
        self._words = words
        self._enrolled = enrolled
        self._changed = changed
        self._report = report
        self._lock = threading.RLock()
        self._switching = threading.RLock()
        self._marks: tuple[object, ...] = ()
        self._hand = None
        if teleop is not None:
            self._hand = SessionTeleop(
                teleop, blind=blind, report=report, changed=lambda: self._changed()
            )
        if operator is not None:
            store.progress(operator)
        self.operator = self._latest() if operator is None else operator
        """Current operator; None before one is chosen."""

    # Commands.

    def carry_out(self, command: Command, role: Role) -> int:
        """Carries out a command; one that is sent again is not done again.

        Returns:
            Number of the event that is now stored; 0 where there is none.
        """
        at = self._store.clock.now()  # time that is spent here does not count for the trial
        with store_failures():
            match command.do:
                case "choose":
                    return self._choose(command.operator)
                case "enrol":
                    return self._enrol(command)
                case "switch":
                    return self._switch_again()
            if self._hand is not None and command.do in _TELEOP_COMMANDS:
                return self._write_with(self._hand, command, role, at)
            return self._write(command, role, at)

    def _latest(self) -> str | None:
        """The operator with the last event who is not done yet."""
        everyone = [self._store.progress(code) for code in self._store.plan.codes]
        latest = [(p.records[-1].at, p.operator) for p in everyone if p.records and not p.over]
        return max(latest)[1] if latest else None

    def _choose(self, operator: str) -> int:
        """Makes an operator the current one, unless the other is in a trial or moves the hand."""
        with self._lock:
            self._store.progress(operator)  # refuses an unknown or erased one
            if operator != self.operator and (current := self._busy()) is not None:
                raise StudyError(
                    f"not done: {current.step} of operator {current.operator} is in "
                    "progress; end it, or void the trial, before you choose another operator"
                )
            self.operator = operator
        self._changed()
        return 0

    def _busy(self) -> Progress | None:
        """The current operator during a trial or free movement."""
        progress = None if self.operator is None else self._store.progress(self.operator)
        return progress if progress is not None and progress.busy else None

    def _enrol(self, command: Command) -> int:
        """Adds an operator, or tasks for one, to the plan."""
        tasks = command.fields.get("tasks")
        listed = isinstance(tasks, list) and all(isinstance(task, str) for task in tasks)
        if tasks is not None and not listed:
            raise StudyError("tasks must be a list of names")
        with self._lock:
            plan, code = self._store.plan, command.operator
            if code in self._store.erased:
                raise StudyError(f"{code} was deleted; codes are not used again")
            if code not in plan.codes or not set(tasks or ()) <= set(plan.enrolment(code).rows):
                self._store.revise(plan.enrol(code, tasks or None, absent=self._store.absent()))
                try:
                    self._enrolled(self._store.plan)
                except SmoothOperatorError as error:  # the store has the plan; the file is a copy
                    self._report(
                        f"{code} is enrolled, but the files of the plan were not updated: {error}"
                    )
            if self._busy() is None:
                return self._choose(code)
            self._changed()  # a trial or free movement of another operator continues
            return 0

    def _switch_again(self) -> int:
        if self._hand is None or self.operator is None:
            raise StudyError("no running teleop is connected, so nothing can be switched")
        with self._switching:
            self._hand.again(self._store.progress(self.operator))
        return 0

    # Regular jobs.

    def tick(self) -> bool:
        """Ends free movement whose time is over.

        Returns:
            Whether it ended free movement.
        """
        operator = self.operator
        if operator is None:
            return False
        with store_failures(), self._lock:
            progress = self._store.progress(operator)
            step, block = progress.step, progress.step.block
            if step.what != "familiarise" or block is None or step.since is None:
                return False
            moved = (self._store.clock.now() - step.since).total_seconds()
            if moved < progress.plan.protocol.familiarisation_s:
                return False
            started = max(
                r.number for r in progress.records if isinstance(r.event, FamiliarisationStarted)
            )
            # Once for each start: whoever undoes it wants the operator to go on moving.
            token = f"time-over-{operator}-{started}"
            if self._store.recorded(token) is not None:
                return False
            event = FamiliarisationEnded(block.task.name, block.number)
            self._store.append(operator, event, author="system", token=token)
        return True

    def watch(self) -> None:
        """Looks at the teleoperation, and puts it back on the condition of the current block."""
        if self._hand is None or not self._switching.acquire(blocking=False):
            return  # it is being switched right now
        try:
            with store_failures():
                progress = None if self.operator is None else self._store.progress(self.operator)
                text = self._hand.watch(progress)
                if text and progress is not None:
                    self._store.append(progress.operator, Noted(text), author="system")
        finally:
            self._switching.release()

    # Content of the pages.

    def look(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Returns the content of the experimenter's page and of the operator's page."""
        with store_failures():
            plan = self._store.plan
            everyone = [self._store.progress(code) for code in plan.codes]
        current = next((p for p in everyone if p.operator == self.operator), None)
        view = experimenter_view(plan, everyone, current, self._blind)
        view["teleop"] = None if self._hand is None else self._hand.view(current)
        return view, operator_view(plan, current, self._words)

    def now(self) -> datetime:
        """Returns this moment by the clock of the store."""
        return self._store.clock.now()

    def has_news(self) -> bool:
        """True if the store or the operator has changed since the last call."""
        with store_failures():
            before, self._marks = self._marks, (self.operator, *self._store.version())
        return before != self._marks

    # Events.

    def _write(
        self,
        command: Command,
        role: Role,
        at: datetime,
        measured_s: float | None = None,
        more: Mapping[str, Any] | None = None,
    ) -> int:
        with self._lock:
            if (number := self._written_number(command)) is not None:
                return number
            progress = self._due(command)
            elapsed = self._elapsed(progress, at)
            event = event_for(command, progress, elapsed, measured_s, more)
            try:
                number = self._store.append(
                    command.operator, event, author=role, token=command.token
                ).number
            except StudyError:
                # A connection that was lost may have committed what it did not acknowledge.
                if (number := self._written_number(command)) is None:
                    raise
        self._changed()
        return number

    def _write_with(self, hand: SessionTeleop, command: Command, role: Role, at: datetime) -> int:
        """Writes the event of a command, and lets the teleoperation follow it."""
        with self._switching if command.do in _STARTS else nullcontext():
            if (number := self._written_number(command)) is not None:
                return number
            with self._lock:
                progress = self._due(command)
                elapsed = self._elapsed(progress, at)
                check_event(progress, event_for(command, progress, elapsed))
            hand.before(command.do, command.fields, progress)
            measured = hand.measured(progress) if command.do == "score" else None
            facts = hand.facts(command.do, progress)
            try:
                number = self._write(command, role, at, measured, facts)
            except StudyError:
                if command.do == "start_trial":
                    hand.abandon()
                raise
        # ``watch`` compares the hand with the log, so a pause is not seen half done.
        with self._switching if command.do in ("pause", "resume") else nullcontext():
            hand.along(command.do, progress)
        return number

    def _written_number(self, command: Command) -> int | None:
        """Number of the event that this very command has caused already."""
        written = self._store.recorded(command.token)
        if written is None:
            return None
        operator, record = written
        if operator != command.operator or record.event.kind != EVENTS[command.do]:
            raise StudyError(f"token {command.token!r} already belongs to another command")
        return record.number

    def _due(self, command: Command) -> Progress:
        """The operator's progress, if the command may be carried out now."""
        if command.operator != self.operator:
            selected = f"operator {self.operator}" if self.operator else "no operator"
            raise StudyError(
                f"not done: it is for operator {command.operator}, but {selected} is selected "
                "at this console"
            )
        progress = self._store.progress(command.operator)
        check_seen(command, progress)
        return progress

    def _elapsed(self, progress: Progress, at: datetime) -> float | None:
        """Time from the start of the running trial to a moment [s]."""
        trial = progress.running
        return None if trial is None else (at - trial.started).total_seconds()

"""Console without a network: commands, the current operator, the running method.

All methods may be called from any thread. A command returns when what it caused is on the disk.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from datetime import datetime
from typing import Any, Final

from smooth_operator.errors import SmoothOperatorError, StudyError
from smooth_operator.study.console.commands import (
    EVENTS,
    Command,
    Role,
    check_seen,
    event_for,
)
from smooth_operator.study.console.page_state import experimenter_view, operator_view, step_in_words
from smooth_operator.study.console.session_teleop import SessionTeleop
from smooth_operator.study.console.switching import Switch, Teleop
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.store.clock import Elapsed
from smooth_operator.study.store.events import (
    Chosen,
    FamiliarisationEnded,
    FamiliarisationStarted,
    Noted,
    TrialScored,
    TrialStarted,
)
from smooth_operator.study.store.nasa_tlx import ENGLISH, TlxWords
from smooth_operator.study.store.progress import Progress
from smooth_operator.study.store.study_store import StudyStore


class StoreFailedError(StudyError):
    """Nothing is wrong with the command, but it can't be written now: trying again may help."""


@contextmanager
def store_failures() -> Iterator[None]:
    """Raises ``StoreFailedError`` where a database is to blame, and not what was asked."""
    try:
        yield
    except StoreFailedError:
        raise
    except StudyError as error:
        cause = error.__cause__
        blamed = isinstance(cause, sqlite3.Error | OSError)
        if blamed and not isinstance(cause, SmoothOperatorError):
            raise StoreFailedError(str(error)) from error
        raise


class OperatorChoice:
    """The operator who is on at one console.

    Args:
        store: of the study.
        operator: who is on; None for the one who was on last and is not done.
        enrolled: called with a plan that was changed here and is stored.
        changed: called when another operator is on.
        report: where a sentence for the terminal goes.
        lock: held while something is written at this console.

    Raises:
        UnknownNameError: there is no such operator.
    """

    def __init__(
        self,
        store: StudyStore,
        operator: str | None,
        *,
        enrolled: Callable[[Plan], None],
        changed: Callable[[], None],
        report: Callable[[str], None],
        lock: threading.RLock,
    ) -> None:
        self._store = store
        self._enrolled = enrolled
        self._changed = changed
        self._report = report
        self._lock = lock
        self.chosen = operator is not None
        """True if the current operator was stated and not guessed."""
        if operator is not None:
            store.progress(operator)
        self.operator = self._latest() if operator is None else operator
        """Who is on; None for nobody."""
        self.left = self._left_before()
        """Who was on before, if they were left in a trial or in free movement."""

    def propose(self, operator: str) -> None:
        """A page that comes back says who was on; heeded if nobody was chosen here since."""
        with self._lock:
            busy = self.operator is not None and self._store.progress(self.operator).busy
            if not self.chosen and not busy and operator in self._store.plan.codes:
                self.choose(operator, None)

    def _latest(self) -> str | None:
        """Who did something last and is not done yet."""
        latest: list[tuple[datetime, str]] = []
        codes = self._store.plan.codes
        over = {code for code in codes if self._store.progress(code).over}
        for code in codes:
            for record in reversed(self._store.records(code)):
                event = record.event
                who = event.operator if isinstance(event, Chosen) else code
                if who in codes and who not in over:
                    latest.append((record.at, who))
                    break
        return max(latest)[1] if latest else None

    def _left_before(self) -> str | None:
        """Who was left in a trial or in free movement before this program was started."""
        for code in self._store.plan.codes:
            if code == self.operator or not self._store.progress(code).busy:
                continue
            for record in reversed(self._store.records(code)):
                if isinstance(record.event, TrialStarted | FamiliarisationStarted):
                    break
                if isinstance(record.event, Chosen):
                    return code
        return None

    def choose(self, operator: str, author: Role | None, confirmed: bool = False) -> int:
        """Puts an operator on; logged where it was somebody's doing."""
        with self._lock:
            chosen = self._store.progress(operator)  # there is one, and not erased
            if operator != self.operator:
                before = None if self.operator is None else self._store.progress(self.operator)
                busy = before is not None and before.busy
                if before is not None and busy and author is not None and not confirmed:
                    raise StudyError(
                        f"not done: {step_in_words(before.step)} of operator {before.operator} is "
                        "on; confirm that another operator is to be put on meanwhile"
                    )
                event = Chosen(operator, self.operator or "")
                logs = [p.operator for p in (before, chosen) if p is not None and p.number]
                if author is not None and logs:
                    self._store.append(logs[0], event, author=author)
                if before is not None and busy:
                    self.left = before.operator
            self.operator, self.chosen = operator, True
        self._changed()
        return 0

    def still_busy(self) -> str | None:
        """Whose trial or free movement is on with the hand, if that is not who is on here."""
        if self.left is None or self.left == self.operator:
            return None
        with store_failures():
            if self._store.progress(self.left).busy:
                return self.left
        self.left = None
        return None

    def _put_on(self, operator: str, role: Role) -> int:
        """Chooses somebody new, unless that would disturb who is on."""
        on = None if self.operator is None else self._store.progress(self.operator)
        if on is not None and on.busy:
            self._changed()
            return 0
        return self.choose(operator, role)

    def replace(self, command: Command, role: Role) -> int:
        """Gives the rows of the operator of a command, who withdrew, to a new one."""
        by = command.fields.get("by")
        if not isinstance(by, str):
            raise StudyError("the code of the new operator is missing")
        with self._lock:
            self._store.replace(command.operator, by, author=role, token=command.token)
            self._keep(self._store.plan, by)
            return self._put_on(by, role)

    def _keep(self, plan: Plan, code: str) -> None:
        try:
            self._enrolled(plan)
        except SmoothOperatorError as error:  # the store has it; the file is a copy
            self._report(f"{code} is enrolled, but the files of the plan are old: {error}")

    def enrol(self, command: Command, role: Role) -> int:
        """Adds an operator, or tasks for one, to the plan."""
        tasks = command.fields.get("tasks")
        listed = isinstance(tasks, list) and all(isinstance(task, str) for task in tasks)
        if tasks is not None and not listed:
            raise StudyError("tasks must be a list of names")
        with self._lock:
            plan = self._store.plan
            code = command.operator
            if code in self._store.erased:
                raise StudyError(f"{code} was deleted; codes are not used again")
            if code not in plan.codes or not set(tasks or ()) <= set(plan.enrolment(code).rows):
                plan = plan.enrol(code, tasks or None, absent=self._store.absent())
                self._store.revise(plan)
                self._keep(plan, code)
            return self._put_on(code, role)


_STARTS: Final = (
    "calibrated", "recalibrate", "start_block", "start_familiarisation", "start_trial",
)  # fmt: skip
_WITH_THE_HAND: Final = (
    *_STARTS, "reset", "void", "score", "pause", "resume", "withdraw",
    "undo",
)  # fmt: skip
"""Commands that the teleoperation has a part in."""


class SessionService:
    """Carries out the commands of one console's pages and says what they show.

    Args:
        store: of the study.
        operator: who is on; None for the one with the last event who is not done.
        blind: whether the experimenter sees labels in the place of conditions.
        teleop: the running teleoperation, if it is to be switched.
        words: of NASA-TLX, as operators read it.
        enrolled: called with a plan that was changed here and is stored.
        changed: called, from any thread, when the pages should be drawn again.
        report: where a sentence for the terminal goes.

    Raises:
        UnknownNameError: there is no such operator.
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
        self._changed = changed
        self._report = report
        self._lock = threading.RLock()
        self._switching = threading.RLock()
        self._known_progress: dict[str, tuple[tuple[int, int], Progress]] = {}
        switch = None if teleop is None else Switch(teleop, lambda: self._changed())
        self._hand = None if switch is None else SessionTeleop(switch, blind=blind, report=report)
        self._choice = OperatorChoice(
            store,
            operator,
            enrolled=enrolled,
            changed=lambda: self._changed(),
            report=report,
            lock=self._lock,
        )

    @property
    def operator(self) -> str | None:
        """Who is on; None for nobody."""
        return self._choice.operator

    # What the pages do.

    def carry_out(self, command: Command, role: Role) -> int:
        """Does what a command says; sent again, it is not done again.

        Returns:
            Number of the event that is now stored; 0 where there is none.

        Raises:
            StoreFailedError: it can't be written now.
            SmoothOperatorError: it is refused; nothing was written.
        """
        at = self._store.clock.seconds()  # what takes long here does not count
        with store_failures():
            if command.do == "choose":
                confirmed = command.fields.get("confirm") is True
                return self._choice.choose(command.operator, role, confirmed)
            if command.do == "replace":
                return self._choice.replace(command, role)
            if command.do == "enrol":
                return self._choice.enrol(command, role)
            if command.do == "switch":
                return self._switch_again()
            if command.do == "cancel_start":
                self.give_up_start()
                return 0
            if self._hand is not None and command.do in _WITH_THE_HAND:
                return self._write_with(self._hand, command, role, at)
            return self._write(command, role, at)

    def propose(self, operator: str) -> None:
        """A page that comes back says who was on; heeded if nobody was chosen here since."""
        self._choice.propose(operator)

    # What happens by itself.

    def tick(self) -> bool:
        """Ends free movement whose time is over.

        Returns:
            Whether it did.

        Raises:
            StoreFailedError: it is over, but that can't be written.
        """
        if self.operator is None:
            return False
        self._note_clock_steps(self.operator)
        ended = [self._end_movement(code) for code in {self.operator, self._choice.left} if code]
        return any(ended)

    def _end_movement(self, operator: str) -> bool:
        with store_failures(), self._lock:
            progress = self._store.progress(operator)
            step, block = progress.step, progress.step.block
            if step.what != "familiarise" or block is None or step.since is None:
                return False
            moved = self._store.clock.since(step.since, step.clock).seconds
            if moved < progress.plan.protocol.familiarisation_s:
                return False
            started = max(
                r.number for r in progress.records if isinstance(r.event, FamiliarisationStarted)
            )
            # Once for each start: if someone undoes it, they want the operator to go on moving.
            token = f"time-over-{operator}-{started}"
            if self._store.recorded(token) is not None:
                return False
            event = FamiliarisationEnded(block.task.name, block.number)
            self._store.append(operator, event, author="system", token=token)
        return True

    def _note_clock_steps(self, operator: str) -> None:
        step = self._store.clock.step()
        if step:
            text = (
                f"the machine's clock was set by {step:+.0f} s; this console goes on by its own, "
                "so durations are right, and moments are as they would be without that"
            )
            self._report(text)
            with store_failures():
                self._store.append(operator, Noted(text), author="system")

    def watch(self) -> None:
        """Looks at the teleoperation, and puts it back on the method of the block that is on.

        Raises:
            StoreFailedError: the store can't be read.
        """
        if self._hand is None or not self._switching.acquire(blocking=False):
            return  # something is being switched right now
        try:
            with store_failures():
                progress = None if self.operator is None else self._store.progress(self.operator)
                if self._choice.still_busy() is not None:
                    progress = None  # the hand stays with the one who was left
                for text in self._hand.watch(progress):
                    assert progress is not None  # or there is nothing to note
                    self._store.append(progress.operator, Noted(text), author="system")
        finally:
            self._switching.release()

    def give_up_start(self) -> None:
        """A trial that waits for the hand to be clear does not start."""
        if self._hand is not None:
            self._hand.scenes.give_up()

    # What the pages show.

    def look(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Content of the experimenter's page and of the operator's page.

        Raises:
            StoreFailedError: the store can't be read.
        """
        with store_failures():
            version, counts = self._store.newest()
            plan = self._store.plan
            everyone = [
                self._progress_at(code, (version, counts.get(code, 0))) for code in plan.codes
            ]
        current = next((p for p in everyone if p.operator == self.operator), None)
        view = experimenter_view(plan, everyone, current, self._blind, self._words)
        view["teleop"] = None if self._hand is None else self._hand.view(current)
        return view, operator_view(plan, current, self._words)

    def now(self) -> datetime:
        """This moment, by the clock that trials are timed by."""
        return self._store.clock.now()

    def marks(self) -> tuple[object, ...]:
        """Changes whenever what the pages show changes."""
        with store_failures():
            version, counts = self._store.newest()
            return (self.operator, version, *sorted(counts.items()))

    def _progress_at(self, operator: str, mark: tuple[int, int]) -> Progress:
        """An operator's progress, read again only where something was written."""
        cached = self._known_progress.get(operator)
        if cached is None or cached[0] != mark:
            cached = self._known_progress[operator] = (mark, self._store.progress(operator))
        return cached[1]

    def _known_number(self, command: Command) -> int | None:
        """Number of the event that this very command has caused already."""
        written = self._store.recorded(command.token)
        if written is None:
            return None
        whose, record = written
        if whose != command.operator or record.event.kind != EVENTS[command.do]:
            raise StudyError(f"token {command.token!r} belongs to another command already")
        return record.number

    def _write(
        self,
        command: Command,
        role: Role,
        at: float,
        measured_s: float | None = None,
        more: Mapping[str, Any] | None = None,
    ) -> int:
        with self._lock:
            if (number := self._known_number(command)) is not None:
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
                if (number := self._known_number(command)) is None:
                    raise
            if isinstance(event, TrialScored) and elapsed is not None and measured_s is None:
                self._note_doubt(command, progress, elapsed)
        self._changed()
        return number

    def _elapsed(self, progress: Progress, at: float) -> Elapsed | None:
        """Time that the trial that runs had taken at a moment of the steady clock."""
        trial, clock = progress.running, self._store.clock
        if trial is None:
            return None
        elapsed = clock.since(trial.started, trial.clock)
        return replace(elapsed, seconds=elapsed.seconds - (clock.seconds() - at))

    def _note_doubt(self, command: Command, progress: Progress, elapsed: Elapsed) -> None:
        """Says in the log why the time of a trial may be wrong."""
        trial, doubt = progress.running, elapsed.doubt
        if trial is None or trial.undone_time_s is not None:
            return
        if elapsed.seconds < command.waited_s:
            doubt = "it has no time, since a clock was set: it would have ended before it began"
        if doubt:
            with suppress(StudyError):
                text = f"Trial {trial.number} of {trial.block.task.name}: {doubt}"
                self._store.append(command.operator, Noted(text), author="system")

    def _write_with(self, hand: SessionTeleop, command: Command, role: Role, at: float) -> int:
        """The same, with what the hand has to do before and along with it."""
        starts = command.do in _STARTS
        with self._switching if starts else nullcontext():
            if starts:
                self._check_hand_is_free()
            if (number := self._known_number(command)) is not None:
                return number
            with self._lock:
                progress = self._due(command)
                elapsed = self._elapsed(progress, at)
                progress.check(event_for(command, progress, elapsed))
            note = hand.before(command, progress)
            measured = hand.measured(progress) if command.do == "score" else None
            facts = hand.facts(command, progress)
            try:
                number = self._write(command, role, at, measured, facts)
            except StudyError:
                if command.do == "start_trial":
                    hand.scenes.abandon()
                raise
            if note:
                with suppress(StudyError):
                    self._store.append(command.operator, Noted(note), author="system")
        # Whoever watches the hand meanwhile goes by the log as it was before.
        with self._switching if command.do in ("pause", "resume") else nullcontext():
            hand.along(command.do, progress)
        return number

    def _due(self, command: Command) -> Progress:
        """The operator's progress, if the command may be carried out now."""
        if command.operator != self.operator:
            raise StudyError(
                f"not done: it is for operator {command.operator}, but operator "
                f"{self.operator or 'nobody'} is on at this console"
            )
        progress = self._store.progress(command.operator)
        check_seen(command, progress)
        return progress

    def _check_hand_is_free(self) -> None:
        """Refuses to touch a hand that another operator's trial runs with."""
        if (left := self._choice.still_busy()) is not None:
            raise StudyError(
                f"not done: operator {left} was left in a trial or in free movement with this "
                f"hand; go back to {left}, and end or void that first"
            )

    def _switch_again(self) -> int:
        if self._hand is None or self.operator is None:
            raise StudyError("no teleoperation is attached that could be switched")
        with self._switching:
            self._check_hand_is_free()
            self._hand.again(self._store.progress(self.operator))
        return 0

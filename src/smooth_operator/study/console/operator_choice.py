"""Who is on at a console: chosen, enrolled or put in the place of another."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import datetime

from smooth_operator.errors import SmoothOperatorError, StudyError
from smooth_operator.study.console.commands import Command, Role
from smooth_operator.study.console.event_texts import step_in_words
from smooth_operator.study.console.store_failures import store_failures
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.store.events import Chosen, FamiliarisationStarted, TrialStarted
from smooth_operator.study.store.study_store import StudyStore


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
        """Whether the current operator was stated and not guessed."""
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
        found: list[tuple[datetime, str]] = []
        codes = self._store.plan.codes
        over = {code for code in codes if self._store.progress(code).over}
        for code in codes:
            for record in reversed(self._store.records(code)):
                event = record.event
                who = event.operator if isinstance(event, Chosen) else code
                if who in codes and who not in over:
                    found.append((record.at, who))
                    break
        return max(found)[1] if found else None

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

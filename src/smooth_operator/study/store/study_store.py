"""Store of a study: appends events, and computes the progress of operators from them.

An event is acknowledged (``append`` returns) when it is on disk. Any number of processes may write
to one store; each decides on what is stored when its turn comes.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from sqlite3 import Connection, Row
from typing import Final

from smooth_operator.errors import StudyError
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import plan_of, plan_table
from smooth_operator.study.store.database import Database, stored
from smooth_operator.study.store.events import (
    Event,
    Record,
    TrialResumed,
    event_of,
    payload,
)
from smooth_operator.study.store.progress import Progress, check_event, replay

AUTHORS: Final = ("experimenter", "operator", "system")
"""Possible authors of an event."""


class Clock:
    """Time of day at the start of the program, and from then on a clock that only runs on.

    Args:
        wall: time of day [s since 1970].
        steady: clock that never jumps [s].
    """

    def __init__(
        self, wall: Callable[[], float] = time.time, steady: Callable[[], float] = time.monotonic
    ) -> None:
        self._steady = steady
        self._start = datetime.fromtimestamp(wall(), UTC) - timedelta(seconds=steady())

    def now(self) -> datetime:
        """Returns this moment in UTC, later than all before even if the machine's clock is set."""
        return self._start + timedelta(seconds=self._steady())


def open_study(target: str | Path, plan: Plan | None = None) -> StudyStore:
    """Opens the store of a study; creates it if a plan is given.

    Args:
        target: folder of the study, or its SQLite file.
        plan: plan of the study, whose new operators are taken over; None for the stored plan.

    Raises:
        StudyError: the store can't be opened, is empty, or has another protocol.
    """
    store = StudyStore(Database(target))
    try:
        if plan is not None:
            store.revise(plan)
        store.plan  # noqa: B018 (an empty store is refused here)
        return store
    except BaseException:
        store.close()
        raise


class StudyStore:
    """A study in a file; made by ``open_study``. All methods may be called from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._progress: dict[str, Progress] = {}
        self._plan: tuple[int, Plan] | None = None
        self.clock = Clock()
        """Clock of all times and durations."""

    def close(self) -> None:
        """Closes the file."""
        self._database.close()

    @property
    def plan(self) -> Plan:
        """The newest plan.

        Raises:
            StudyError: no study is stored.
        """
        with self._database.reading() as connection:
            return self._newest_plan(connection)

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.plan.protocol.name

    @property
    def erased(self) -> tuple[str, ...]:
        """Operators whose data was deleted; their codes are not used again."""
        query = "SELECT operator FROM participants WHERE erased_at IS NOT NULL ORDER BY operator"
        with self._database.reading() as connection:
            return tuple(row["operator"] for row in connection.execute(query))

    def absent(self) -> tuple[str, ...]:
        """Operators who withdrew with their data, whose rows are free."""
        everyone = [self.progress(code) for code in self.plan.codes]
        return tuple(
            progress.operator
            for progress in everyone
            if progress.withdrawn is not None and not progress.withdrawn.keep
        )

    def append(
        self,
        operator: str,
        event: Event,
        *,
        author: str = "experimenter",
        token: str | None = None,
    ) -> Record:
        """Writes an event.

        Args:
            operator: pseudonym.
            event: the event.
            author: one of ``AUTHORS``.
            token: unique text of this event. An event that is sent again with its token, because
                the answer got lost, is not written twice.

        Returns:
            The record that is now on disk.

        Raises:
            StudyError: the event is not due, or can't be written; then nothing was written.
            UnknownNameError: no such operator takes part.
        """
        if author not in AUTHORS:
            raise StudyError(f"an author is one of {', '.join(AUTHORS)}, not {author!r}")
        event = event_of(event.kind, payload(event))  # as strict as reading it back will be
        with self._database.writing() as connection:
            self._enter(connection, operator)
            if token is not None and (written := self._by_token(connection, token)) is not None:
                whose, record = written
                if whose != operator or record.event != event:
                    raise StudyError(f"token {token!r} belongs to another event already")
                return record
            progress = self._updated(connection, operator)
            check_event(progress, event)
            at = self.clock.now()
            if isinstance(event, TrialResumed) and progress.step.since is not None:
                length = (at - progress.step.since).total_seconds()
                event = replace(event, paused_s=round(max(0.0, length), 3))
            record = Record(progress.number + 1, at, author, event)
            _insert(connection, operator, record, token)
        # The cache is updated by the next read: only committed events are folded.
        return record

    def recorded(self, token: str) -> tuple[str, Record] | None:
        """Finds the operator and the record that were written with a token."""
        with self._database.reading() as connection:
            return self._by_token(connection, token)

    def version(self) -> tuple[int, int]:
        """Numbers that differ after each change, by this program or another one."""
        return self._database.version()

    def progress(self, operator: str) -> Progress:
        """Computes the progress of an operator.

        Returns:
            The progress, which later events don't change.

        Raises:
            UnknownNameError: no such operator takes part.
            StudyError: the data was deleted.
        """
        with self._database.reading() as connection:
            _check_not_erased(connection, operator)
            return self._updated(connection, operator)

    def records(self, operator: str) -> list[Record]:
        """Returns all events of an operator in their order, undone ones and undoings included."""
        with self._database.reading() as connection:
            return list(_records(connection, operator, 0))

    def revise(self, plan: Plan) -> None:
        """Replaces the plan, to enrol operators or, before anyone has begun, to change it.

        Raises:
            StudyError: the new plan has other rows for someone who has begun or, once anyone has,
                another protocol or other orders.
        """
        with self._database.writing() as connection:
            if _newest_plan_id(connection) is not None:
                before = self._newest_plan(connection)
                if plan == before:
                    return
                begun = connection.execute("SELECT * FROM participants").fetchall()
                _check_revision(before, plan, begun)
            _insert_plan(connection, plan)

    def erase(self, operator: str) -> int:
        """Deletes the events of an operator for good and takes them off the plan.

        The code is not used again. An interrupted call may be repeated.

        Returns:
            Number of deleted events.

        Raises:
            UnknownNameError: no such operator takes part.
        """
        with self._database.writing() as connection:
            if operator not in self.erased:
                self._enter(connection, operator)
                connection.execute(
                    "UPDATE participants SET erased_at = ? WHERE operator = ?", (now(), operator)
                )
                _insert_plan(connection, self._newest_plan(connection).withdraw(operator))
            query = "DELETE FROM events WHERE operator = ?"
            deleted = connection.execute(query, (operator,)).rowcount
        self._database.empty_write_ahead_log()
        return deleted

    def __enter__(self) -> StudyStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _enter(self, connection: Connection, operator: str) -> None:
        """Notes that an operator takes part; refuses one whose data was deleted."""
        if _participant(connection, operator) is None:
            self._newest_plan(connection).enrolment(operator)
            connection.execute(
                "INSERT INTO participants (operator, created_at) VALUES (?, ?)", (operator, now())
            )
        _check_not_erased(connection, operator)

    def _updated(self, connection: Connection, operator: str) -> Progress:
        """Progress with all stored events; a new object if there are new events."""
        plan = self._newest_plan(connection)  # a new plan empties the cache
        progress = self._progress.get(operator)
        number = 0 if progress is None else progress.number
        new = list(_records(connection, operator, number))
        if progress is None or new:
            records = [*(() if progress is None else progress.records), *new]
            progress = self._progress[operator] = replay(plan, operator, records)
        return progress

    def _by_token(self, connection: Connection, token: str) -> tuple[str, Record] | None:
        query = "SELECT * FROM events WHERE token = ?"
        row = connection.execute(query, (token,)).fetchone()
        return None if row is None else (row["operator"], record_of(row))

    def _newest_plan(self, connection: Connection) -> Plan:
        newest = _newest_plan_id(connection)
        if newest is None:
            raise StudyError("no study is stored here; smooth-operator study new makes one")
        if self._plan is None or self._plan[0] != newest:
            row = connection.execute("SELECT plan FROM plans WHERE id = ?", (newest,)).fetchone()
            plan = plan_of(stored(row["plan"], "the stored plan"), "the stored plan")
            self._plan = (newest, plan)
            self._progress.clear()
        return self._plan[1]


def record_of(row: Row) -> Record:
    """Makes a record of a row of the table of events."""
    event = event_of(row["kind"], stored(row["payload"], f"the stored event {row['number']}"))
    return Record(int(row["number"]), datetime.fromisoformat(row["at"]), row["author"], event)


def now() -> str:
    """This moment in UTC as ISO 8601 text."""
    return datetime.now(UTC).isoformat()


def _records(connection: Connection, operator: str, after: int) -> Iterator[Record]:
    query = "SELECT * FROM events WHERE operator = ? AND number > ? ORDER BY number"
    return map(record_of, connection.execute(query, (operator, after)))


def _participant(connection: Connection, operator: str) -> Row | None:
    query = "SELECT * FROM participants WHERE operator = ?"
    row: Row | None = connection.execute(query, (operator,)).fetchone()
    return row


def _newest_plan_id(connection: Connection) -> int | None:
    (newest,) = connection.execute("SELECT max(id) FROM plans").fetchone()
    return newest if newest is None else int(newest)


def _insert(connection: Connection, operator: str, record: Record, token: str | None) -> None:
    connection.execute(
        "INSERT INTO events (operator, number, kind, at, author, token, payload) "
        "VALUES (?, ?, ?, ?, ?, ?, ?)",
        (
            operator,
            record.number,
            record.event.kind,
            record.at.isoformat(),
            record.author,
            token,
            json.dumps(payload(record.event)),
        ),
    )


def _insert_plan(connection: Connection, plan: Plan) -> None:
    query = "INSERT INTO plans (at, plan) VALUES (?, ?)"
    connection.execute(query, (now(), json.dumps(plan_table(plan))))


def _check_revision(before: Plan, plan: Plan, begun: Sequence[Row]) -> None:
    """Refuses a new plan that changes the part of an operator who has begun.

    Args:
        before: stored plan.
        plan: new plan.
        begun: rows of the table of participants.

    Raises:
        StudyError: the plan changes such a part.
    """
    if begun and (plan.protocol != before.protocol or plan.orders != before.orders):
        raise StudyError(
            f"study {before.protocol.name!r} is stored with another protocol or other orders; "
            "those of a study don't change once someone has begun: make a new study, in another "
            "folder"
        )
    for row in begun:
        if row["erased_at"] is not None:
            if row["operator"] in plan.codes:
                _refuse_erased(row)
            continue
        rows = list(before.enrolment(row["operator"]).rows.items())
        enrolment = {one.code: one for one in plan.enrolled}.get(row["operator"])
        if enrolment is None or list(enrolment.rows.items())[: len(rows)] != rows:
            raise StudyError(
                f"operator {row['operator']} has begun with {dict(rows)}; tasks can be added "
                "at the end, not taken away or given another row"
            )


def _check_not_erased(connection: Connection, operator: str) -> None:
    row = _participant(connection, operator)
    if row is not None:
        _refuse_erased(row)


def _refuse_erased(row: Row) -> None:
    if row["erased_at"] is not None:
        raise StudyError(
            f"the data of operator {row['operator']} was deleted on {row['erased_at'][:10]}; enrol "
            "under another code"
        )

"""The store of one study: events go in, an operator's progress comes out.

An event is acknowledged (``append`` returns) when it is on the disk. Any number of processes may
write to one store; those about the same operator take turns, each decides on what is stored then.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from sqlite3 import Connection, Row
from typing import Final

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import plan_of, plan_table
from smooth_operator.study.store.clock import Clock
from smooth_operator.study.store.database import Database, stored
from smooth_operator.study.store.events import (
    Event,
    FamiliarisationStarted,
    Record,
    Replaces,
    TrialPaused,
    TrialResumed,
    TrialStarted,
    Undone,
    Withdrawn,
    event_of,
    payload,
)
from smooth_operator.study.store.progress import Progress

AUTHORS: Final = ("experimenter", "operator", "system")
"""Who may have caused an event."""
FORMAT: Final = 1
"""Version of what is stored; a store of a newer one is refused."""
_OF_OPERATOR: Final = "WHERE study_id = ? AND operator = ?"


def open_study(
    target: str | Path, plan: Plan | None = None, *, name: str | None = None
) -> StudyStore:
    """Opens the store of a study; makes it if a plan is given.

    Args:
        target: folder of the study, or its SQLite file.
        plan: plan of the study; operators that it newly enrols are taken over. None for the stored
            one.
        name: name of the study, where a file holds several and no plan is given.

    Raises:
        StudyError: it can't be opened, holds no such study, or that with another protocol.
        UnknownNameError: it holds no study of that name.
    """
    database = Database(target)
    try:
        name, study_id = _find(database, plan, plan.protocol.name if plan is not None else name)
        store = StudyStore(database, study_id, name)
        if plan is not None:
            store.revise(plan)
        return store
    except BaseException:
        database.close()
        raise


def _find(database: Database, plan: Plan | None, name: str | None) -> tuple[str, int]:
    with database.reading() if plan is None else database.writing() as connection:
        rows = {row["name"]: row for row in connection.execute("SELECT * FROM studies")}
        if name is None:
            if len(rows) != 1:
                held = ", ".join(sorted(rows)) or "none"
                raise StudyError(f"the store holds these studies: {held}; say which, by its name")
            name = next(iter(rows))
        if name in rows:
            if rows[name]["format"] != FORMAT:
                raise StudyError(
                    f"study {name!r} is stored in format {rows[name]['format']}, this program "
                    f"reads {FORMAT}: update it"
                )
            return name, int(rows[name]["id"])
        if plan is None:
            raise UnknownNameError("study", name, rows)
        cursor = connection.execute(
            "INSERT INTO studies (name, format, created_at) VALUES (?, ?, ?)", (name, FORMAT, now())
        )
        study_id = int(cursor.lastrowid or 0)
        _insert_plan(connection, study_id, plan)
        return name, study_id


class StudyStore:
    """One study in a file; made by ``open_study``. All methods may be called from any thread."""

    def __init__(self, database: Database, study_id: int, name: str) -> None:
        self._database = database
        self._id = study_id
        self._progress: dict[str, Progress] = {}
        self._newest: tuple[int, Plan] | None = None
        self.name = name
        """Name of the study."""
        self.clock = Clock()
        """Clock of all moments and durations."""

    def close(self) -> None:
        """Closes the file."""
        self._database.close()

    @property
    def plan(self) -> Plan:
        """The plan as it is now."""
        with self._database.reading() as connection:
            return self._plan(connection)

    @property
    def erased(self) -> tuple[str, ...]:
        """Operators whose data was deleted; their codes are not used again."""
        query = (
            "SELECT operator FROM participants WHERE study_id = ? AND erased_at IS NOT NULL "
            "ORDER BY operator"
        )
        with self._database.reading() as connection:
            return tuple(row["operator"] for row in connection.execute(query, (self._id,)))

    def absent(self) -> tuple[str, ...]:
        """Operators who withdrew, whose data is left out, and whom nobody has replaced."""
        everyone = [self.progress(code) for code in self.plan.codes]
        replaced = {progress.replaces for progress in everyone}
        return tuple(
            progress.operator
            for progress in everyone
            if progress.withdrawn is not None
            and not progress.withdrawn.keep
            and progress.operator not in replaced
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
            event: what happened.
            author: who did it.
            token: any text that belongs to this event alone; sent again after an answer that got
                lost, the event is not written twice.

        Returns:
            What is now on the disk.

        Raises:
            StudyError: the event is not due, or can't be written; then nothing was.
            UnknownNameError: no such operator takes part.
        """
        if author not in AUTHORS:
            raise StudyError(f"an author is one of {', '.join(AUTHORS)}, not {author!r}")
        event = event_of(event.kind, payload(event))  # as strict as reading it back will be
        with self._database.writing() as connection:
            self._take_turn(connection, operator)
            if token is not None and (written := self._by_token(connection, token)) is not None:
                whose, record = written
                if whose != operator or record.event != event:
                    raise StudyError(f"token {token!r} belongs to another event already")
                return record
            progress = self._caught_up(connection, operator)
            progress.check(event)
            if isinstance(event, TrialStarted | FamiliarisationStarted | TrialPaused):
                event = replace(event, clock=self.clock.reading())
            elif isinstance(event, TrialResumed) and progress.step.since is not None:
                stood = self.clock.since(progress.step.since, progress.step.clock).seconds
                event = replace(event, paused_s=round(max(0.0, stood), 3))
            elif isinstance(event, Undone):
                self._check_row_is_free(connection, operator, progress, event.number)
            record = Record(progress.number + 1, self.clock.now(), author, event)
            self._insert(connection, operator, record, token)
        # The cache learns of it on the next look: only what was committed is ever folded.
        return record

    def replace(
        self, withdrawn: str, by: str, *, author: str = "experimenter", token: str | None = None
    ) -> Record:
        """Gives the rows of an operator who withdrew to a new one: both, or neither, is written.

        Args:
            withdrawn: pseudonym of the one who left.
            by: of the new one.
            author: who did it.
            token: as of ``append``.

        Returns:
            The first event of the new operator.

        Raises:
            StudyError: the one has not withdrawn, or is replaced already, or the other is enrolled.
            UnknownNameError: nobody of the first code takes part.
        """
        with self._database.writing() as connection:
            self._take_turn(connection, withdrawn)
            if token is not None and (written := self._by_token(connection, token)) is not None:
                return written[1]
            progress = self._caught_up(connection, withdrawn)
            if progress.withdrawn is None:
                raise StudyError(f"operator {withdrawn} has not withdrawn; nobody can replace them")
            self._check_row_is_free(connection, withdrawn, progress, None)
            before = self._plan(connection)
            if by in (*before.codes, *self.erased):
                raise StudyError(f"{by} is or was an operator already; a new one needs a new code")
            _insert_plan(connection, self._id, before.replace_operator(withdrawn, by))
            self._take_turn(connection, by)
            record = Record(1, self.clock.now(), author, Replaces(withdrawn))
            self._insert(connection, by, record, token)
        return record

    def recorded(self, token: str) -> tuple[str, Record] | None:
        """The operator and the event that a token was written with; None if none was."""
        with self._database.reading() as connection:
            return self._by_token(connection, token)

    def newest(self) -> tuple[int, dict[str, int]]:
        """Differs from before if anything was written meanwhile, by whomever.

        Returns:
            Which version of the plan is the newest, and operator -> number of events.
        """
        counts = "SELECT operator, count(*) FROM events WHERE study_id = ? GROUP BY operator"
        newest = "SELECT max(id) FROM plans WHERE study_id = ?"
        with self._database.reading() as connection:
            events = {str(who): int(n) for who, n in connection.execute(counts, (self._id,))}
            return int(connection.execute(newest, (self._id,)).fetchone()[0]), events

    def progress(self, operator: str) -> Progress:
        """The progress of an operator.

        Returns:
            A view that later events don't change.

        Raises:
            UnknownNameError: no such operator takes part.
            StudyError: the data was deleted.
        """
        with self._database.reading() as connection:
            self._check_not_erased(connection, operator)
            return self._caught_up(connection, operator).copy()

    def records(self, operator: str) -> list[Record]:
        """All events of an operator, in their order; undone ones and undoings included."""
        with self._database.reading() as connection:
            return list(self._records(connection, operator, 0))

    def revise(self, plan: Plan) -> None:
        """Replaces the plan, to enrol operators or, before anyone has begun, to mend it.

        Raises:
            StudyError: the rows of someone who has begun differ, or, once anyone has, protocol or
                orders.
        """
        with self._database.writing() as connection:
            before = self._plan(connection)
            if plan == before:
                return
            begun = connection.execute(
                "SELECT * FROM participants WHERE study_id = ?", (self._id,)
            ).fetchall()
            _check_revision(self.name, before, plan, begun)
            _insert_plan(connection, self._id, plan)

    def erase(self, operator: str) -> int:
        """Deletes what is stored of an operator, for good; the code stays taken, and off the plan.

        May be called again, where it was interrupted.

        Returns:
            How many events were deleted.

        Raises:
            UnknownNameError: no such operator takes part.
        """
        mine = (self._id, operator)
        with self._database.writing() as connection:
            if operator not in self.erased:
                self._take_turn(connection, operator)
                connection.execute(
                    f"UPDATE participants SET erased_at = ? {_OF_OPERATOR}", (now(), *mine)
                )
                plan = self._plan(connection).withdraw(operator)
                _insert_plan(connection, self._id, plan)
            deleted = connection.execute(f"DELETE FROM events {_OF_OPERATOR}", mine).rowcount
        self._database.empty_write_ahead_log()
        return deleted

    def __enter__(self) -> StudyStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take_turn(self, connection: Connection, operator: str) -> None:
        """Notes that an operator takes part; refuses one whose data was deleted."""
        if self._participant(connection, operator) is None:
            self._plan(connection).enrolment(operator)
            connection.execute(
                "INSERT INTO participants (study_id, operator, created_at) VALUES (?, ?, ?)",
                (self._id, operator, now()),
            )
        self._check_not_erased(connection, operator)

    def _participant(self, connection: Connection, operator: str) -> Row | None:
        query = f"SELECT * FROM participants {_OF_OPERATOR}"
        row: Row | None = connection.execute(query, (self._id, operator)).fetchone()
        return row

    def _check_not_erased(self, connection: Connection, operator: str) -> None:
        row = self._participant(connection, operator)
        if row is not None:
            _refuse_erased(row)

    def _caught_up(self, connection: Connection, operator: str) -> Progress:
        plan = self._plan(connection)  # a new one empties the cache
        progress = self._progress.get(operator) or Progress(plan, operator)
        for record in self._records(connection, operator, progress.number):
            progress.apply(record)
        self._progress[operator] = progress
        return progress

    def _records(self, connection: Connection, operator: str, after: int) -> Iterator[Record]:
        query = f"SELECT * FROM events {_OF_OPERATOR} AND number > ? ORDER BY number"
        return map(record_of, connection.execute(query, (self._id, operator, after)))

    def _by_token(self, connection: Connection, token: str) -> tuple[str, Record] | None:
        query = "SELECT * FROM events WHERE study_id = ? AND token = ?"
        row = connection.execute(query, (self._id, token)).fetchone()
        return None if row is None else (row["operator"], record_of(row))

    def _plan(self, connection: Connection) -> Plan:
        query = "SELECT max(id) FROM plans WHERE study_id = ?"
        newest = int(connection.execute(query, (self._id,)).fetchone()[0])
        if self._newest is None or self._newest[0] != newest:
            row = connection.execute("SELECT plan FROM plans WHERE id = ?", (newest,)).fetchone()
            what = f"the stored plan of {self.name!r}"
            plan = plan_of(stored(row["plan"], what), what)
            self._newest = (newest, plan)
            self._progress.clear()
        return self._newest[1]

    def _insert(
        self, connection: Connection, operator: str, record: Record, token: str | None
    ) -> None:
        connection.execute(
            "INSERT INTO events (study_id, operator, number, kind, at, author, token, payload) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (
                self._id,
                operator,
                record.number,
                record.event.kind,
                record.at.isoformat(),
                record.author,
                token,
                json.dumps(payload(record.event)),
            ),
        )

    def _check_row_is_free(
        self, connection: Connection, operator: str, progress: Progress, undone: int | None
    ) -> None:
        """Refuses to undo a withdrawal, or to replace once more, where somebody has the rows."""
        if undone is not None:
            last = progress.undoable
            if last is None or last.number != undone or not isinstance(last.event, Withdrawn):
                return
        query = "SELECT * FROM events WHERE study_id = ? AND kind = ?"
        for row in connection.execute(query, (self._id, Replaces.kind)):
            if record_of(row).event == Replaces(operator):
                raise StudyError(f"operator {row['operator']} has replaced {operator} already")


def record_of(row: Row) -> Record:
    """A line of the table of events."""
    event = event_of(row["kind"], stored(row["payload"], f"the stored event {row['number']}"))
    return Record(int(row["number"]), datetime.fromisoformat(row["at"]), row["author"], event)


def now() -> str:
    """This moment in UTC, as it is stored."""
    return datetime.now(UTC).isoformat()


def _insert_plan(connection: Connection, study_id: int, plan: Plan) -> None:
    connection.execute(
        "INSERT INTO plans (study_id, at, plan) VALUES (?, ?, ?)",
        (study_id, now(), json.dumps(plan_table(plan))),
    )


def _check_revision(name: str, before: Plan, plan: Plan, begun: Sequence[Row]) -> None:
    """Refuses a new plan that changes what somebody has begun with.

    Args:
        name: of the study.
        before: the stored plan.
        plan: the new one.
        begun: rows of the table of participants.

    Raises:
        StudyError: it does.
    """
    if begun and (plan.protocol != before.protocol or plan.orders != before.orders):
        raise StudyError(
            f"study {name!r} is stored with another protocol or other orders; those of a "
            "study don't change once someone has begun: make a new study, under another name"
        )
    for row in begun:
        if row["erased_at"] is not None:
            if row["operator"] in plan.codes:
                _refuse_erased(row)
            continue
        was = before.enrolment(row["operator"])
        now = {one.code: one for one in plan.enrolled}.get(row["operator"])
        first_rows = None if now is None else dict(list(now.rows.items())[: len(was.rows)])
        if first_rows is None or list(first_rows.items()) != list(was.rows.items()):
            raise StudyError(
                f"operator {row['operator']} has begun with {dict(was.rows)}; tasks can be added "
                "at the end, not taken away or given another row"
            )


def _refuse_erased(row: Row) -> None:
    """Raises for a participant whose data was deleted.

    Raises:
        StudyError: the data was.
    """
    if row["erased_at"] is not None:
        raise StudyError(
            f"the data of operator {row['operator']} was deleted on {row['erased_at'][:10]}; enrol "
            "under another code"
        )

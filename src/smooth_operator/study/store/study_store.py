"""The store of one study: events go in, an operator's progress comes out.

An event is acknowledged (``append`` returns) when it is on the disk. Any number of processes may
write to one store; those about the same operator take turns, each decides on what is stored then.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.errors import StudyError
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import plan_of, plan_table
from smooth_operator.study.store.clock import Clock
from smooth_operator.study.store.database_tables import reason, stored, tables
from smooth_operator.study.store.events import (
    Event,
    FamiliarisationStarted,
    Record,
    TrialStarted,
    event_of,
    payload,
)
from smooth_operator.study.store.progress import Progress

if TYPE_CHECKING:
    from sqlalchemy import Connection, Engine

AUTHORS: Final = ("experimenter", "operator", "system")
"""Who may have caused an event."""


class StudyStore:
    """One study in a database.

    Made by ``open_study``. All methods may be called from
    any thread.
    """

    def __init__(self, engine: Engine, study_id: int, name: str) -> None:
        self._engine = engine
        self._tables = tables().tables
        self._id = study_id
        self._progress: dict[str, Progress] = {}
        self._newest: tuple[int, Plan] | None = None
        self._file = self._file_now()
        self._lock = threading.RLock()
        self.name = name
        """Of the study."""
        self.clock = Clock()
        """What moments and durations are taken from."""

    @property
    def plan(self) -> Plan:
        """The plan as it is now."""
        with self._reading() as connection:
            return self._plan(connection)

    @property
    def erased(self) -> tuple[str, ...]:
        """Operators whose data was deleted; their codes are not used again."""
        people = self._tables["participants"].c
        with self._reading() as connection:
            query = (
                self._tables["participants"]
                .select()
                .where(people.study_id == self._id, people.erased_at.is_not(None))
                .order_by(people.operator)
            )
            return tuple(row.operator for row in connection.execute(query))

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
        with self._lock, self._writing() as connection:
            self._take_turn(connection, operator)
            if token is not None and (known := self._by_token(connection, token)) is not None:
                whose, record = known
                if whose != operator or record.event != event:
                    raise StudyError(f"token {token!r} belongs to another event already")
                return record
            progress = self._caught_up(connection, operator)
            progress.check(event)
            if isinstance(event, TrialStarted | FamiliarisationStarted):
                event = replace(event, clock=self.clock.reading())
            record = Record(progress.number + 1, self.clock.now(), author, event)
            connection.execute(
                self._tables["events"]
                .insert()
                .values(
                    study_id=self._id,
                    operator=operator,
                    number=record.number,
                    kind=event.kind,
                    at=record.at.isoformat(),
                    author=author,
                    token=token,
                    payload=json.dumps(payload(event)),
                )
            )
        # The cache learns of it on the next look: only what was committed is ever folded.
        return record

    def recorded(self, token: str) -> tuple[str, Record] | None:
        """The operator and the event that a token was written with; None if none was."""
        with self._reading() as connection:
            return self._by_token(connection, token)

    def newest(self) -> tuple[int, dict[str, int]]:
        """Differs from before if anything was written meanwhile, by whomever.

        Returns:
            Which version of the plan is the newest, and operator -> number of events.
        """
        from sqlalchemy import func, select

        events, plans = self._tables["events"].c, self._tables["plans"].c
        counts = (
            select(events.operator, func.count())
            .where(events.study_id == self._id)
            .group_by(events.operator)
        )
        plan = select(func.max(plans.id)).where(plans.study_id == self._id)
        with self._reading() as connection:
            found = {str(operator): int(count) for operator, count in connection.execute(counts)}
            return int(connection.execute(plan).scalar_one()), found

    def progress(self, operator: str) -> Progress:
        """Where an operator is.

        Returns:
            A view that later events don't change.

        Raises:
            UnknownNameError: no such operator takes part.
            StudyError: the data was deleted.
        """
        with self._lock, self._reading() as connection:
            self._check_not_erased(connection, operator)
            return self._caught_up(connection, operator).copy()

    def records(self, operator: str) -> list[Record]:
        """All events of an operator, in their order; undone ones and undoings included."""
        with self._reading() as connection:
            return list(self._records(connection, operator, 0))

    def revise(self, plan: Plan) -> None:
        """Replaces the plan, to enrol operators or, before anyone has begun, to mend it.

        Raises:
            StudyError: the rows of someone who has begun differ, or, once anyone has, protocol or
                orders.
        """
        with self._lock, self._writing() as connection:
            if self._engine.dialect.name != "sqlite":
                studies = self._tables["studies"]
                connection.execute(
                    studies.select().where(studies.c.id == self._id).with_for_update()
                ).one()
            before = self._plan(connection)
            if plan == before:
                return
            self._check_revision(connection, before, plan)
            self._write_plan(connection, plan)

    def erase(self, operator: str) -> int:
        """Deletes what is stored of an operator, for good; the code stays taken, and off the plan.

        May be called again, where it was interrupted.

        Returns:
            How many events were deleted.

        Raises:
            UnknownNameError: no such operator takes part.
        """
        events, people = self._tables["events"], self._tables["participants"]
        with self._lock:
            with self._writing() as connection:
                if operator not in self.erased:
                    self._take_turn(connection, operator)
                    connection.execute(
                        people.update()
                        .where(people.c.study_id == self._id, people.c.operator == operator)
                        .values(erased_at=now().isoformat())
                    )
                    self._write_plan(connection, self._plan(connection).withdraw(operator))
                gone = connection.execute(
                    events.delete().where(
                        events.c.study_id == self._id, events.c.operator == operator
                    )
                ).rowcount
            if self._engine.dialect.name == "sqlite":
                self._empty_write_ahead_log()
            return gone

    def close(self) -> None:
        """Closes the database."""
        self._engine.dispose()

    def __enter__(self) -> StudyStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _empty_write_ahead_log(self) -> None:
        """What was overwritten in the file may still be in its write-ahead log, until now."""
        connection = self._engine.raw_connection()
        try:
            busy, *_ = connection.cursor().execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        finally:
            connection.close()
        if busy:
            raise StudyError(
                "the data was deleted, but another program that reads the store keeps old pages "
                "of it alive; end that, and delete again"
            )

    @contextmanager
    def _writing(self) -> Iterator[Connection]:
        from sqlalchemy.exc import SQLAlchemyError

        try:
            with self._engine.begin() as connection:
                yield connection
                self._check_there()
        except (SQLAlchemyError, OSError) as error:
            raise StudyError(f"nothing was written: {reason(error)}") from error

    @contextmanager
    def _reading(self) -> Iterator[Connection]:
        from sqlalchemy.exc import SQLAlchemyError

        try:
            with self._engine.connect().execution_options(reads=True) as connection:
                self._check_there()
                yield connection
        except (SQLAlchemyError, OSError) as error:
            raise StudyError(f"the store can't be read: {reason(error)}") from error

    def _check_there(self) -> None:
        """SQLite writes into a file that was deleted or moved away, and says nothing."""
        try:
            now = self._file_now()
        except FileNotFoundError:
            raise OSError(f"{self._engine.url.database} was deleted or moved away") from None
        if now != self._file:
            raise OSError(f"{self._engine.url.database} was replaced by another file")

    def _file_now(self) -> int | None:
        """What distinguishes the file of SQLite from another one at its place."""
        if self._engine.dialect.name != "sqlite" or not self._engine.url.database:
            return None
        return os.stat(self._engine.url.database).st_ino

    def _take_turn(self, connection: Connection, operator: str) -> None:
        """Until the transaction ends, nobody else writes about this operator."""
        people = self._tables["participants"]
        mine = people.select().where(people.c.study_id == self._id, people.c.operator == operator)
        if connection.execute(mine).first() is None:
            self._plan(connection).enrolment(operator)
            values = {"study_id": self._id, "operator": operator, "created_at": now().isoformat()}
            if self._engine.dialect.name == "postgresql":
                from sqlalchemy.dialects.postgresql import insert

                connection.execute(insert(people).values(values).on_conflict_do_nothing())
            else:
                connection.execute(people.insert().values(values))
        connection.execute(mine.with_for_update()).one()  # SQLite has its turn already
        self._check_not_erased(connection, operator)

    def _check_not_erased(self, connection: Connection, operator: str) -> None:
        people = self._tables["participants"]
        row = connection.execute(
            people.select().where(people.c.study_id == self._id, people.c.operator == operator)
        ).first()
        if row is not None and row.erased_at is not None:
            raise StudyError(
                f"the data of operator {operator} was deleted on {row.erased_at[:10]}; enrol "
                "under another code"
            )

    def _caught_up(self, connection: Connection, operator: str) -> Progress:
        plan = self._plan(connection)  # a new one empties the cache
        progress = self._progress.get(operator) or Progress(plan, operator)
        for record in self._records(connection, operator, progress.number):
            progress.apply(record)
        self._progress[operator] = progress
        return progress

    def _records(self, connection: Connection, operator: str, after: int) -> Iterator[Record]:
        events = self._tables["events"]
        query = (
            events.select()
            .where(
                events.c.study_id == self._id,
                events.c.operator == operator,
                events.c.number > after,
            )
            .order_by(events.c.number)
        )
        return map(record_of, connection.execute(query))

    def _by_token(self, connection: Connection, token: str) -> tuple[str, Record] | None:
        events = self._tables["events"]
        row = connection.execute(
            events.select().where(events.c.study_id == self._id, events.c.token == token)
        ).first()
        return None if row is None else (row.operator, record_of(row))

    def _plan(self, connection: Connection) -> Plan:
        plans = self._tables["plans"]
        ordered = plans.select().where(plans.c.study_id == self._id).order_by(plans.c.id.desc())
        newest = int(
            connection.execute(ordered.with_only_columns(plans.c.id).limit(1)).scalar_one()
        )
        if self._newest is None or self._newest[0] != newest:
            row = connection.execute(ordered.limit(1)).one()
            what = f"the stored plan of {self.name!r}"
            plan = plan_of(stored(row.plan, what), what)
            self._newest = (int(row.id), plan)
            self._progress.clear()
        return self._newest[1]

    def _write_plan(self, connection: Connection, plan: Plan) -> None:
        connection.execute(
            self._tables["plans"]
            .insert()
            .values(study_id=self._id, at=now().isoformat(), plan=json.dumps(plan_table(plan)))
        )

    def _check_revision(self, connection: Connection, before: Plan, plan: Plan) -> None:
        people = self._tables["participants"].c
        begun = connection.execute(
            self._tables["participants"].select().where(people.study_id == self._id)
        ).all()
        if begun and (plan.protocol != before.protocol or plan.orders != before.orders):
            raise StudyError(
                f"study {self.name!r} is stored with another protocol or other orders; those of a "
                "study don't change once someone has begun: make a new study, under another name"
            )
        for row in begun:
            if row.erased_at is not None:
                if row.operator in plan.codes:
                    self._check_not_erased(connection, row.operator)
                continue
            was = before.enrolment(row.operator)
            now = {one.code: one for one in plan.enrolled}.get(row.operator)
            kept = None if now is None else dict(list(now.rows.items())[: len(was.rows)])
            if kept is None or list(kept.items()) != list(was.rows.items()):
                raise StudyError(
                    f"operator {row.operator} has begun with {dict(was.rows)}; tasks can be added "
                    "at the end, not taken away or given another row"
                )


def record_of(row: Any) -> Record:
    """A line of the table of events."""
    event = event_of(row.kind, stored(row.payload, f"the stored event {row.number}"))
    return Record(int(row.number), datetime.fromisoformat(row.at), row.author, event)


def now() -> datetime:
    """This moment, in UTC."""
    return datetime.now(UTC)

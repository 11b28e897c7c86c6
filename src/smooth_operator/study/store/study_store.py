"""The store of one study: events go in, an operator's progress comes out.

An event is acknowledged (``append`` returns) when it is on the disk. Any number of processes may
write to one store; those about the same operator take turns, each decides on what is stored then.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.errors import StudyError
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import plan_of, plan_table
from smooth_operator.study.store.clock import Clock
from smooth_operator.study.store.database_access import DatabaseAccess
from smooth_operator.study.store.database_tables import stored
from smooth_operator.study.store.event_fields import event_of, payload
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
)
from smooth_operator.study.store.progress import Progress
from smooth_operator.study.store.revisions import check_revision, refuse_erased

if TYPE_CHECKING:
    from sqlalchemy import Connection, Engine

AUTHORS: Final = ("experimenter", "operator", "system")
"""Who may have caused an event."""


class StudyStore(DatabaseAccess):
    """One study in a database.

    Made by ``open_study``. All methods may be called from
    any thread.
    """

    def __init__(self, engine: Engine, study_id: int, name: str) -> None:
        super().__init__(engine)
        self._id = study_id
        self._progress: dict[str, Progress] = {}
        self._newest: tuple[int, Plan] | None = None
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
        with self._lock, self._writing() as connection:
            self._take_turn(connection, operator)
            if token is not None and (known := self._by_token(connection, token)) is not None:
                whose, record = known
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
        with self._lock, self._writing() as connection:
            self._take_turn(connection, withdrawn)
            if token is not None and (known := self._by_token(connection, token)) is not None:
                return known[1]
            progress = self._caught_up(connection, withdrawn)
            if progress.withdrawn is None:
                raise StudyError(f"operator {withdrawn} has not withdrawn; nobody can replace them")
            self._check_row_is_free(connection, withdrawn, progress, None)
            before = self._plan(connection)
            if by in (*before.codes, *self.erased):
                raise StudyError(f"{by} is or was an operator already; a new one needs a new code")
            self._write_plan(connection, before.replace_operator(withdrawn, by))
            self._take_turn(connection, by)
            record = Record(1, self.clock.now(), author, Replaces(withdrawn))
            self._insert(connection, by, record, token)
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
            people = self._tables["participants"]
            begun = connection.execute(people.select().where(people.c.study_id == self._id)).all()
            check_revision(self.name, before, plan, begun)
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

    def __enter__(self) -> StudyStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

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
        refuse_erased(row)

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

    def _insert(
        self, connection: Connection, operator: str, record: Record, token: str | None
    ) -> None:
        connection.execute(
            self._tables["events"]
            .insert()
            .values(
                study_id=self._id,
                operator=operator,
                number=record.number,
                kind=record.event.kind,
                at=record.at.isoformat(),
                author=record.author,
                token=token,
                payload=json.dumps(payload(record.event)),
            )
        )

    def _check_row_is_free(
        self, connection: Connection, operator: str, progress: Progress, undone: int | None
    ) -> None:
        """Refuses to undo a withdrawal, or to replace once more, where somebody has the rows."""
        if undone is not None:
            last = progress.undoable
            if last is None or last.number != undone or not isinstance(last.event, Withdrawn):
                return
        events = self._tables["events"]
        query = events.select().where(events.c.study_id == self._id, events.c.kind == Replaces.kind)
        for row in connection.execute(query):
            if record_of(row).event == Replaces(operator):
                raise StudyError(f"operator {row.operator} has replaced {operator} already")


def record_of(row: Any) -> Record:
    """A line of the table of events."""
    event = event_of(row.kind, stored(row.payload, f"the stored event {row.number}"))
    return Record(int(row.number), datetime.fromisoformat(row.at), row.author, event)


def now() -> datetime:
    """This moment, in UTC."""
    return datetime.now(UTC)

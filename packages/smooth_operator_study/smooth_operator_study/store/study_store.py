"""Store of a study: appends events to SQLite, and computes the progress of operators from them.

An event is acknowledged (``append`` returns) when it is on disk. Any number of processes may write
to one store; each decides on what is stored when its turn comes. Triggers refuse to change an
event, and to delete one whose operator was not erased first; erasing leaves a row that says so.
Times are ISO 8601 text in UTC.
"""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from sqlite3 import Connection, Row
from typing import Any, Final, Literal

from smooth_operator.errors import DocumentError, StudyError
from smooth_operator.io.documents import parse_json
from smooth_operator_study.design.plan import Plan
from smooth_operator_study.design.plan_file import plan_of, plan_table
from smooth_operator_study.store.events import (
    Event,
    Record,
    TrialResumed,
    event_of,
    payload,
)
from smooth_operator_study.store.progress import Progress, check_event, replay

FILE: Final = "study.db"
"""Name of the SQLite file in the folder of a study."""
FORMAT: Final = 1
"""Version of the tables, stored as SQLite's ``user_version``; a newer one is refused."""
BUSY_S: Final = 60.0
"""Longest time that a writer waits for its turn [s]."""
_TABLES: Final = (
    "CREATE TABLE plans (id INTEGER PRIMARY KEY, at TEXT NOT NULL, plan TEXT NOT NULL)",
    """CREATE TABLE participants (operator TEXT PRIMARY KEY, created_at TEXT NOT NULL,
    erased_at TEXT)""",
    """CREATE TABLE events (id INTEGER PRIMARY KEY, operator TEXT NOT NULL,
    number INTEGER NOT NULL, kind TEXT NOT NULL, at TEXT NOT NULL, author TEXT NOT NULL,
    token TEXT UNIQUE, payload TEXT NOT NULL, UNIQUE (operator, number))""",
    """CREATE TRIGGER events_never_change BEFORE UPDATE ON events
    BEGIN SELECT RAISE(ABORT, 'events are append-only'); END""",
    """CREATE TRIGGER events_never_vanish BEFORE DELETE ON events
    WHEN NOT EXISTS (SELECT 1 FROM participants p WHERE p.operator = OLD.operator
      AND p.erased_at IS NOT NULL)
    BEGIN SELECT RAISE(ABORT, 'events are append-only'); END""",
    """CREATE TRIGGER plans_never_change BEFORE UPDATE ON plans
    BEGIN SELECT RAISE(ABORT, 'plans are append-only'); END""",
    """CREATE TRIGGER plans_never_vanish BEFORE DELETE ON plans
    BEGIN SELECT RAISE(ABORT, 'plans are append-only'); END""",
    f"PRAGMA user_version = {FORMAT}",
)


class Clock:
    """Clock that starts at the time of day and then only moves forward.

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
        """Returns the current time in UTC; never goes back, even if the machine's clock is
        changed."""
        return self._start + timedelta(seconds=self._steady())


def open_study(target: str | Path, plan: Plan | None = None) -> StudyStore:
    """Opens the store of a study; creates it if a plan is given.

    Args:
        target: folder of the study, or its SQLite file.
        plan: plan of the study, whose new operators are taken over; None for the stored plan.

    Raises:
        StudyError: the store can't be opened, is empty, or has another protocol.
    """
    store = StudyStore(target)
    try:
        if plan is not None:
            store.revise(plan)
        store.plan  # noqa: B018 (an empty store is refused here)
        return store
    except BaseException:
        store.close()
        raise


class StudyStore:
    """Store of a study in a file; created by ``open_study``. All methods are thread-safe.

    Args:
        target: folder of a study, or its SQLite file, which is created if missing.
    """

    def __init__(self, target: str | Path) -> None:
        self._path = _path_of(target)
        self._lock = threading.RLock()
        self._progress: dict[str, Progress] = {}
        self._plan: tuple[int, Plan] | None = None
        self.clock = Clock()
        """Clock of all times and durations."""
        try:
            _make_private(self._path)
            self._connection = sqlite3.connect(
                self._path, timeout=BUSY_S, isolation_level=None, check_same_thread=False
            )
        except (sqlite3.Error, OSError) as error:
            raise StudyError(f"can't open the store {self._path}: {error}") from error
        try:
            self._connection.row_factory = sqlite3.Row
            _use_write_ahead_log(self._connection)
            # An event is on disk before it is acknowledged; an erased one can't be read from disk.
            for setting in ("synchronous=FULL", "foreign_keys=ON", "secure_delete=ON"):
                self._connection.execute(f"PRAGMA {setting}")
            self._file = os.stat(self._path).st_ino
            self._create()
        except BaseException as error:
            self.close()
            if isinstance(error, sqlite3.Error | OSError):
                raise StudyError(f"can't open the store {self._path}: {error}") from error
            raise

    def close(self) -> None:
        """Closes the file."""
        with self._lock:
            self._connection.close()

    def __enter__(self) -> StudyStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def writing(self) -> AbstractContextManager[Connection]:
        """Runs a transaction that is on disk when it ends, or leaves nothing after an exception.

        A writer locks the file before it reads, or two would decide on the same state.
        """
        return self._transaction("BEGIN IMMEDIATE", "nothing was written")

    def reading(self) -> AbstractContextManager[Connection]:
        """Runs a transaction that sees one state; inside ``writing`` it is a part of that one."""
        return self._transaction("BEGIN", "the store can't be read")

    @contextmanager
    def _transaction(self, begin: str, failure: str) -> Iterator[Connection]:
        connection = self._connection
        with self._lock:
            if connection.in_transaction:
                yield connection
                return
            try:
                connection.execute(begin)
                try:
                    self._check_file()
                    yield connection
                    self._check_file()
                    connection.execute("COMMIT")
                except BaseException:
                    if self._connection.in_transaction:
                        connection.execute("ROLLBACK")
                    raise
            except (sqlite3.Error, OSError) as error:
                raise StudyError(f"{failure}: {error}") from error

    @property
    def plan(self) -> Plan:
        """The newest plan."""
        with self.reading() as connection:
            return self._newest_plan(connection)

    @property
    def erased(self) -> tuple[str, ...]:
        """Operators whose data was deleted; their codes are not used again."""
        query = "SELECT operator FROM participants WHERE erased_at IS NOT NULL ORDER BY operator"
        with self.reading() as connection:
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
        author: Literal["experimenter", "operator", "system"] = "experimenter",
        token: str | None = None,
    ) -> Record:
        """Writes an event.

        Args:
            token: unique text of this event. An event that is sent again with its token, because
                the answer got lost, is not written twice.

        Returns:
            The record that is now on disk.
        """
        event = event_of(event.kind, payload(event))  # as strict as reading it back will be
        with self.writing() as connection:
            self._enter(connection, operator)
            if token is not None and (written := self._by_token(connection, token)) is not None:
                whose, record = written
                if whose != operator or record.event != event:
                    raise StudyError(f"token {token!r} already belongs to another event")
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
        with self.reading() as connection:
            return self._by_token(connection, token)

    def progress(self, operator: str) -> Progress:
        """Computes the progress of an operator.

        Returns:
            The progress, which later events don't change.
        """
        with self.reading() as connection:
            _check_not_erased(_participant(connection, operator))
            return self._updated(connection, operator)

    def records(self, operator: str) -> list[Record]:
        """Returns all events of an operator in their order, undone ones and undoings included."""
        with self.reading() as connection:
            return list(_records(connection, operator, 0))

    def revise(self, plan: Plan) -> None:
        """Replaces the plan, to enrol operators or, before anyone has begun, to change it."""
        with self.writing() as connection:
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
        """
        with self.writing() as connection:
            if operator not in self.erased:
                self._enter(connection, operator)
                connection.execute(
                    "UPDATE participants SET erased_at = ? WHERE operator = ?", (_now(), operator)
                )
                _insert_plan(connection, self._newest_plan(connection).withdraw(operator))
            query = "DELETE FROM events WHERE operator = ?"
            deleted = connection.execute(query, (operator,)).rowcount
        self._empty_write_ahead_log()
        return deleted

    def version(self) -> tuple[int, int]:
        """Numbers that differ after each change of the file, by this program or another one."""
        with self.reading() as connection:
            (others,) = connection.execute("PRAGMA data_version").fetchone()
            return int(others), connection.total_changes

    def _enter(self, connection: Connection, operator: str) -> None:
        """Notes that an operator takes part; refuses one whose data was deleted."""
        if _participant(connection, operator) is None:
            self._newest_plan(connection).enrolment(operator)
            connection.execute(
                "INSERT INTO participants (operator, created_at) VALUES (?, ?)", (operator, _now())
            )
        _check_not_erased(_participant(connection, operator))

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
            raise StudyError("no study is stored here; create one with smooth-operator study new")
        if self._plan is None or self._plan[0] != newest:
            row = connection.execute("SELECT plan FROM plans WHERE id = ?", (newest,)).fetchone()
            plan = plan_of(stored(row["plan"], "the stored plan"), "the stored plan")
            self._plan = (newest, plan)
            self._progress.clear()
        return self._plan[1]

    def _empty_write_ahead_log(self) -> None:
        """Removes deleted content that is still in the write-ahead log."""
        with self._lock:
            busy, *_ = self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        if busy:
            raise StudyError(
                "the data was deleted, but another program that reads the store still holds "
                "old pages of it; end that program, and delete again"
            )

    def _check_file(self) -> None:
        """Raises OSError if the file was deleted or moved; SQLite would silently write into it."""
        try:
            now = os.stat(self._path).st_ino
        except FileNotFoundError:
            raise OSError(f"{self._path} was deleted or moved away") from None
        if now != self._file:
            raise OSError(f"{self._path} was replaced by another file")

    def _create(self) -> None:
        """Creates the tables in an empty file."""
        with self.reading() as connection:
            if self._has_tables(connection):
                return
        with self.writing() as connection:
            if not self._has_tables(connection):
                for statement in _TABLES:
                    connection.execute(statement)

    def _has_tables(self, connection: Connection) -> bool:
        names = {row[0] for row in connection.execute("SELECT name FROM sqlite_master")}
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if names and (version != FORMAT or "events" not in names):
            raise StudyError(
                f"can't open the store {self._path}: it is in format {version}, but this "
                f"program reads {FORMAT}: update the program, or name the study.db of a study"
            )
        return bool(names)


def stored(text: str, what: str) -> Any:
    """Parses a value that the database holds as JSON and another program may have damaged."""
    try:
        return parse_json(text)
    except DocumentError as error:
        raise StudyError(
            f"{what} is damaged: {error}; restore the database from a backup"
        ) from error


def _path_of(target: str | Path) -> Path:
    path = Path(target)
    if path.is_dir():
        path = path / FILE
    if not path.parent.is_dir():
        raise StudyError(f"can't open the store {path}: there is no folder {path.parent}")
    return path.absolute()


def _make_private(path: Path) -> None:
    """Creates the file for its owner alone; leaves an existing one unchanged.

    It holds what people did and how they felt. SQLite gives its log file the same rights.
    """
    with contextlib.suppress(FileExistsError):
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))


def _use_write_ahead_log(connection: Connection) -> None:
    """Turns on the write-ahead log, with which readers don't block writers.

    SQLite does not wait for this change as it does for others.
    """
    until = time.monotonic() + BUSY_S
    while True:
        try:
            if connection.execute("PRAGMA journal_mode").fetchone()[0] == "wal":
                return
            connection.execute("PRAGMA journal_mode=WAL").fetchone()
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > until:
                raise
        time.sleep(0.01 + 0.01 * (os.getpid() % 7))


def record_of(row: Row) -> Record:
    """Makes a record of a row of the table of events."""
    event = event_of(row["kind"], stored(row["payload"], f"the stored event {row['number']}"))
    return Record(int(row["number"]), datetime.fromisoformat(row["at"]), row["author"], event)


def _now() -> str:
    """The current time in UTC as ISO 8601 text."""
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
    connection.execute(query, (_now(), json.dumps(plan_table(plan))))


def _check_revision(before: Plan, plan: Plan, begun: Sequence[Row]) -> None:
    """Refuses a new plan that changes the part of an operator who has begun.

    Args:
        begun: rows of the table of participants.
    """
    if begun and (plan.protocol != before.protocol or plan.orders != before.orders):
        raise StudyError(
            f"study {before.protocol.name!r} is stored with a different protocol or "
            "different orders, which can't change once an operator has begun: create a new "
            "study in another folder"
        )
    for row in begun:
        if row["erased_at"] is not None:
            if row["operator"] in plan.codes:
                _check_not_erased(row)
            continue
        rows = list(before.enrolment(row["operator"]).rows.items())
        enrolment = {one.code: one for one in plan.enrolled}.get(row["operator"])
        if enrolment is None or list(enrolment.rows.items())[: len(rows)] != rows:
            raise StudyError(
                f"operator {row['operator']} has begun with {dict(rows)}; tasks can be added "
                "at the end, but not removed or assigned another row"
            )


def _check_not_erased(row: Row | None) -> None:
    if row is not None and row["erased_at"] is not None:
        raise StudyError(
            f"the data of operator {row['operator']} was deleted on {row['erased_at'][:10]}; enrol "
            "under another code"
        )

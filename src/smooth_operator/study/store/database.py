"""SQLite file of a study: tables, transactions, and the rules that keep the log append-only.

A trigger refuses to change an event at all, and to delete one unless its participant was erased
first, which leaves a line that says so. Moments are ISO 8601 text in UTC.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import DocumentError, StudyError
from smooth_operator.io.documents import parse_json

FILE: Final = "study.db"
"""Name of the SQLite file in the folder of a study."""
BUSY_S: Final = 60.0
"""Longest time that a writer waits for its turn [s]."""
_TABLES: Final = (
    """CREATE TABLE studies (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE,
    format INTEGER NOT NULL, created_at TEXT NOT NULL)""",
    """CREATE TABLE plans (id INTEGER PRIMARY KEY,
    study_id INTEGER NOT NULL REFERENCES studies (id), at TEXT NOT NULL, plan TEXT NOT NULL)""",
    "CREATE INDEX ix_plans_study_id ON plans (study_id)",
    """CREATE TABLE participants (id INTEGER PRIMARY KEY,
    study_id INTEGER NOT NULL REFERENCES studies (id), operator TEXT NOT NULL,
    created_at TEXT NOT NULL, erased_at TEXT, UNIQUE (study_id, operator))""",
    """CREATE TABLE events (id INTEGER PRIMARY KEY,
    study_id INTEGER NOT NULL REFERENCES studies (id), operator TEXT NOT NULL,
    number INTEGER NOT NULL, kind TEXT NOT NULL, at TEXT NOT NULL, author TEXT NOT NULL, token TEXT,
    payload TEXT NOT NULL, UNIQUE (study_id, operator, number), UNIQUE (study_id, token))""",
    """CREATE TRIGGER events_never_change BEFORE UPDATE ON events
    BEGIN SELECT RAISE(ABORT, 'events are append-only'); END""",
    """CREATE TRIGGER events_never_vanish BEFORE DELETE ON events
    WHEN NOT EXISTS (SELECT 1 FROM participants p WHERE p.study_id = OLD.study_id
      AND p.operator = OLD.operator AND p.erased_at IS NOT NULL)
    BEGIN SELECT RAISE(ABORT, 'events are append-only'); END""",
    """CREATE TRIGGER plans_never_change BEFORE UPDATE ON plans
    BEGIN SELECT RAISE(ABORT, 'plans are append-only'); END""",
    """CREATE TRIGGER plans_never_vanish BEFORE DELETE ON plans
    BEGIN SELECT RAISE(ABORT, 'plans are append-only'); END""",
)


class Database:
    """One open file. All methods may be called from any thread; transactions take turns.

    Args:
        target: folder of a study, or its SQLite file; the file is made if it is not there.

    Raises:
        StudyError: it can't be opened, or is no SQLite database.
    """

    def __init__(self, target: str | Path) -> None:
        self._path = _path_of(target)
        self._lock = threading.RLock()
        try:
            _make_private(self._path)
            self._connection = sqlite3.connect(
                self._path, timeout=BUSY_S, isolation_level=None, check_same_thread=False
            )
        except (sqlite3.Error, OSError) as error:
            raise StudyError(f"can't open the store {self._path}: {error}") from error
        try:
            self._connection.row_factory = sqlite3.Row
            _into_wal(self._connection)
            # An event is on the disk before it is acknowledged; erased ones can't be read from it.
            for setting in ("synchronous=FULL", "foreign_keys=ON", "secure_delete=ON"):
                self._connection.execute(f"PRAGMA {setting}")
            self._file = os.stat(self._path).st_ino
            self._create()
        except (sqlite3.Error, OSError) as error:
            self.close()
            raise StudyError(f"can't open the store {self._path}: {error}") from error

    def close(self) -> None:
        """Closes the file."""
        with self._lock:
            self._connection.close()

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """A transaction that is on the disk when it ends, or leaves nothing after an exception.

        A writer takes its turn before it looks, or two would decide on the same state.

        Raises:
            StudyError: nothing was written; says why.
        """
        with self._lock:
            try:
                with self._transaction("BEGIN IMMEDIATE"):
                    yield self._connection
                    self._check_there()
            except (sqlite3.Error, OSError) as error:
                raise StudyError(f"nothing was written: {error}") from error

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """A transaction that sees one state; within one that writes, it is a part of that.

        Raises:
            StudyError: the file can't be read; says why.
        """
        with self._lock:
            if self._connection.in_transaction:
                yield self._connection
                return
            try:
                with self._transaction("BEGIN"):
                    self._check_there()
                    yield self._connection
            except (sqlite3.Error, OSError) as error:
                raise StudyError(f"the store can't be read: {error}") from error

    @contextmanager
    def _transaction(self, begin: str) -> Iterator[None]:
        self._connection.execute(begin)
        try:
            yield
            self._connection.execute("COMMIT")
        except BaseException:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            raise

    def empty_write_ahead_log(self) -> None:
        """Removes deleted content that is still in the write-ahead log.

        Raises:
            StudyError: another program keeps it alive.
        """
        with self._lock:
            busy, *_ = self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        if busy:
            raise StudyError(
                "the data was deleted, but another program that reads the store keeps old pages "
                "of it alive; end that, and delete again"
            )

    def _check_there(self) -> None:
        """SQLite writes into a file that was deleted or moved away, and says nothing."""
        try:
            now = os.stat(self._path).st_ino
        except FileNotFoundError:
            raise OSError(f"{self._path} was deleted or moved away") from None
        if now != self._file:
            raise OSError(f"{self._path} was replaced by another file")

    def _create(self) -> None:
        there = "SELECT 1 FROM sqlite_master WHERE name = 'events'"
        if self._connection.execute(there).fetchone():  # made with all the rest, or not at all
            return
        with self._transaction("BEGIN IMMEDIATE"):
            if not self._connection.execute(there).fetchone():
                for statement in _TABLES:
                    self._connection.execute(statement)


def stored(text: str, what: str) -> Any:
    """A value that the database holds as JSON, which another program may have damaged.

    Raises:
        StudyError: it is no JSON.
    """
    try:
        return parse_json(text)
    except DocumentError as error:
        raise StudyError(f"{what} is damaged: {error}; restore the database from a copy") from error


def _path_of(target: str | Path) -> Path:
    if "://" in str(target):  # not in the message: it may hold a password
        raise StudyError(
            "a study is stored in a file: give its folder, or its study.db, in place of a URL"
        )
    path = Path(target)
    if path.is_dir():
        path = path / FILE
    if not path.parent.is_dir():
        raise StudyError(f"can't open the store {path}: there is no folder {path.parent}")
    return path.absolute()


def _make_private(path: Path) -> None:
    """Makes the file, for its owner alone; leaves one that is there as it is.

    It holds what people did and how they felt. SQLite gives its log file the same rights.
    """
    with contextlib.suppress(FileExistsError):
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))


def _into_wal(connection: sqlite3.Connection) -> None:
    """Writers and readers side by side. SQLite doesn't wait for this change as for others."""
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

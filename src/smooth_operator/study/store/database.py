"""SQLite file of a study: tables, transactions, and the rules that keep the log append-only.

Triggers refuse to change an event, and to delete one whose operator was not erased first; erasing
leaves a row that says so. Times are ISO 8601 text in UTC.
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


class Database:
    """One open file. All methods may be called from any thread; transactions take turns.

    Args:
        target: folder of a study, or its SQLite file, which is created if missing.

    Raises:
        StudyError: the file can't be opened, or is no SQLite database.
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
            _use_write_ahead_log(self._connection)
            # An event is on disk before it is acknowledged; an erased one can't be read from disk.
            for setting in ("synchronous=FULL", "foreign_keys=ON", "secure_delete=ON"):
                self._connection.execute(f"PRAGMA {setting}")
            self._file = os.stat(self._path).st_ino
            self._create()
        except (sqlite3.Error, OSError) as error:
            self.close()
            raise StudyError(f"can't open the store {self._path}: {error}") from error
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Closes the file."""
        with self._lock:
            self._connection.close()

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Runs a transaction that is on disk when it ends, or leaves nothing after an exception.

        A writer locks the file before it reads, or two would decide on the same state.

        Raises:
            StudyError: nothing was written; says why.
        """
        with self._lock:
            try:
                with self._transaction("BEGIN IMMEDIATE"):
                    yield self._connection
                    self._check_file()
            except (sqlite3.Error, OSError) as error:
                raise StudyError(f"nothing was written: {error}") from error

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Runs a transaction that sees one state; inside ``writing`` it is a part of that one.

        Raises:
            StudyError: the file can't be read; says why.
        """
        with self._lock:
            if self._connection.in_transaction:
                yield self._connection
                return
            try:
                with self._transaction("BEGIN"):
                    self._check_file()
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

    def version(self) -> tuple[int, int]:
        """Numbers that differ after each change of the file, by this program or another one."""
        with self.reading() as connection:
            (others,) = connection.execute("PRAGMA data_version").fetchone()
            return int(others), connection.total_changes

    def empty_write_ahead_log(self) -> None:
        """Removes deleted content that is still in the write-ahead log.

        Raises:
            StudyError: another program that reads the file keeps the content alive.
        """
        with self._lock:
            busy, *_ = self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        if busy:
            raise StudyError(
                "the data was deleted, but another program that reads the store keeps old pages "
                "of it alive; end that, and delete again"
            )

    def _check_file(self) -> None:
        """Refuses a file that was deleted or moved away; SQLite would write into it silently."""
        try:
            now = os.stat(self._path).st_ino
        except FileNotFoundError:
            raise OSError(f"{self._path} was deleted or moved away") from None
        if now != self._file:
            raise OSError(f"{self._path} was replaced by another file")

    def _create(self) -> None:
        """Creates the tables in an empty file.

        Raises:
            StudyError: the file holds other tables, or those of a newer program.
        """
        with self.reading() as connection:
            if self._has_tables(connection):
                return
        with self.writing() as connection:
            if not self._has_tables(connection):
                for statement in _TABLES:
                    connection.execute(statement)

    def _has_tables(self, connection: sqlite3.Connection) -> bool:
        names = {row[0] for row in connection.execute("SELECT name FROM sqlite_master")}
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if names and (version != FORMAT or "events" not in names):
            raise StudyError(
                f"can't open the store {self._path}: it is in format {version}, this program reads "
                f"{FORMAT}: update it, or give the study.db of a study"
            )
        return bool(names)


def stored(text: str, what: str) -> Any:
    """Parses a value that the database holds as JSON and another program may have damaged.

    Raises:
        StudyError: it is no JSON.
    """
    try:
        return parse_json(text)
    except DocumentError as error:
        raise StudyError(f"{what} is damaged: {error}; restore the database from a copy") from error


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


def _use_write_ahead_log(connection: sqlite3.Connection) -> None:
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

"""The database: tables, and the rules that keep the log append-only.

Same tables on SQLite and PostgreSQL. A trigger refuses to change an event at all, and to delete one
unless its participant was erased first, which leaves a line that says so.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.errors import DocumentError, MissingExtraError, StudyError
from smooth_operator.io.documents import parse_json

if TYPE_CHECKING:
    from sqlalchemy import URL, Engine, MetaData

FILE: Final = "study.db"
"""Name of the SQLite file in the folder of a study."""
BUSY_S: Final = 60.0
"""How long a writer waits for its turn [s]."""

_APPEND_ONLY_SQLITE: Final = (
    """CREATE TRIGGER IF NOT EXISTS events_never_change BEFORE UPDATE ON events
    BEGIN SELECT RAISE(ABORT, 'events are append-only'); END""",
    """CREATE TRIGGER IF NOT EXISTS events_never_vanish BEFORE DELETE ON events
    WHEN NOT EXISTS (SELECT 1 FROM participants p WHERE p.study_id = OLD.study_id
      AND p.operator = OLD.operator AND p.erased_at IS NOT NULL)
    BEGIN SELECT RAISE(ABORT, 'events are append-only'); END""",
    """CREATE TRIGGER IF NOT EXISTS plans_never_change BEFORE UPDATE ON plans
    BEGIN SELECT RAISE(ABORT, 'plans are append-only'); END""",
    """CREATE TRIGGER IF NOT EXISTS plans_never_vanish BEFORE DELETE ON plans
    BEGIN SELECT RAISE(ABORT, 'plans are append-only'); END""",
)
_APPEND_ONLY_POSTGRESQL: Final = (
    """CREATE OR REPLACE FUNCTION study_log_is_append_only() RETURNS trigger AS $$
    BEGIN
      IF TG_OP = 'DELETE' AND TG_TABLE_NAME = 'events' AND EXISTS (
        SELECT 1 FROM participants p WHERE p.study_id = (to_jsonb(OLD) ->> 'study_id')::int
          AND p.operator = to_jsonb(OLD) ->> 'operator' AND p.erased_at IS NOT NULL) THEN
        RETURN OLD;
      END IF;
      RAISE EXCEPTION '% are append-only', TG_TABLE_NAME;
    END $$ LANGUAGE plpgsql""",
    """CREATE OR REPLACE TRIGGER events_append_only BEFORE UPDATE OR DELETE ON events
    FOR EACH ROW EXECUTE FUNCTION study_log_is_append_only()""",
    """CREATE OR REPLACE TRIGGER plans_append_only BEFORE UPDATE OR DELETE ON plans
    FOR EACH ROW EXECUTE FUNCTION study_log_is_append_only()""",
)
_CREATING: Final = 7_261_905
"""Key of the lock under which PostgreSQL's tables are made, so that only one makes them."""


def open_engine(target: str | Path) -> Engine:
    """A database with its tables; made if they are not there.

    Args:
        target: folder of a study, an SQLite file, or the URL of a database, such as
            ``postgresql://user@host/name``.

    Raises:
        MissingExtraError: SQLAlchemy, or the driver of PostgreSQL, is not installed.
        StudyError: the database can't be opened, or is no store of studies.
    """
    try:
        from sqlalchemy import create_engine
        from sqlalchemy.exc import ArgumentError, NoSuchModuleError, SQLAlchemyError
    except ImportError as error:
        raise MissingExtraError("storing a study", "study") from error
    try:
        url, shown = _url(target)
    except StudyError:
        raise
    except (ArgumentError, ValueError) as error:  # it may hold a password: not in the message
        raise StudyError(
            "the address of the database can't be read; expected postgresql://USER@HOST/NAME"
        ) from error
    try:
        if url.get_backend_name() == "sqlite":
            _make_private(url.database)
            engine = create_engine(url, connect_args={"timeout": BUSY_S})
            _prepare_sqlite(engine)
        else:
            engine = create_engine(url, pool_pre_ping=True)
        _create(engine)
    except ModuleNotFoundError as error:
        if error.name != "psycopg":
            raise StudyError(f"{shown}: no driver for this database: {error.name}") from error
        raise MissingExtraError("storing a study in PostgreSQL", "postgres") from error
    except (ArgumentError, NoSuchModuleError) as error:
        raise StudyError(
            f"{shown} is no database that can be used; expected a folder, a file ending in .db, "
            "or postgresql://USER@HOST/NAME"
        ) from error
    except (SQLAlchemyError, OSError) as error:
        raise StudyError(f"can't open the store {shown}: {reason(error)}") from error
    return engine


def reason(error: Exception) -> str:
    """What a database said, in one line."""
    return " ".join(str(getattr(error, "orig", None) or error).split())


def tables() -> MetaData:
    """Studies, their plans, participants and events.

    Moments are ISO 8601 text in UTC: the same in every database, and readable in each.
    """
    from sqlalchemy import (
        BigInteger,
        Column,
        ForeignKey,
        Integer,
        MetaData,
        Table,
        Text,
        UniqueConstraint,
    )

    made = MetaData()
    number = BigInteger().with_variant(Integer, "sqlite")  # SQLite counts only INTEGER keys itself
    Table(
        "studies",
        made,
        Column("id", Integer, primary_key=True),
        Column("name", Text, nullable=False, unique=True),
        Column("format", Integer, nullable=False),
        Column("created_at", Text, nullable=False),
    )
    Table(
        "plans",
        made,
        Column("id", Integer, primary_key=True),
        Column("study_id", Integer, ForeignKey("studies.id"), nullable=False, index=True),
        Column("at", Text, nullable=False),
        Column("plan", Text, nullable=False),
    )
    Table(
        "participants",
        made,
        Column("id", Integer, primary_key=True),
        Column("study_id", Integer, ForeignKey("studies.id"), nullable=False),
        Column("operator", Text, nullable=False),
        Column("created_at", Text, nullable=False),
        Column("erased_at", Text),
        UniqueConstraint("study_id", "operator"),
    )
    Table(
        "events",
        made,
        Column("id", number, primary_key=True),
        Column("study_id", Integer, ForeignKey("studies.id"), nullable=False),
        Column("operator", Text, nullable=False),
        Column("number", Integer, nullable=False),
        Column("kind", Text, nullable=False),
        Column("at", Text, nullable=False),
        Column("author", Text, nullable=False),
        Column("token", Text),
        Column("payload", Text, nullable=False),
        UniqueConstraint("study_id", "operator", "number"),
        UniqueConstraint("study_id", "token"),
    )
    return made


def _url(target: str | Path) -> tuple[URL, str]:
    """(URL for SQLAlchemy, what messages call it: never with a password)."""
    from sqlalchemy import URL, make_url

    text = str(target)
    if "://" not in text:
        path = Path(target)
        if path.is_dir():
            path = path / FILE
        if not path.parent.is_dir():
            raise StudyError(f"can't open the store {path}: there is no folder {path.parent}")
        # Not as text: "?", "#" and "%" mean something in a URL, and may stand in a path.
        return URL.create("sqlite", database=str(path.absolute())), str(path)
    scheme, _, rest = text.partition("://")
    if scheme in ("postgresql", "postgres"):
        scheme = "postgresql+psycopg"
    shown = f"{scheme.partition('+')[0]}://{rest.rpartition('@')[2]}"
    return make_url(f"{scheme}://{rest}"), shown


def _make_private(database: str | None) -> None:
    """Makes the file of SQLite, for its owner alone; leaves one that is there as it is.

    It holds what people did and how they felt. SQLite gives its log file the same rights.
    """
    if database is None or database in ("", ":memory:") or database.startswith("file:"):
        return
    with contextlib.suppress(FileExistsError):
        os.close(os.open(database, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))


def stored(text: str, what: str) -> Any:
    """A value that the database holds as JSON, which another program may have damaged.

    Raises:
        StudyError: it is no JSON.
    """
    try:
        return parse_json(text)
    except DocumentError as error:
        raise StudyError(f"{what} is damaged: {error}; restore the database from a copy") from error


def _prepare_sqlite(engine: Engine) -> None:
    from sqlalchemy import event

    @event.listens_for(engine, "connect")
    def opened(connection: Any, _: Any) -> None:
        connection.isolation_level = None  # Python's own BEGIN would come too late: see below
        cursor = connection.cursor()
        _into_wal(cursor)
        cursor.execute("PRAGMA synchronous=FULL")  # on the disk before it is acknowledged
        cursor.execute("PRAGMA foreign_keys=ON")
        cursor.execute("PRAGMA secure_delete=ON")  # what was erased can't be read from the file
        cursor.close()

    @event.listens_for(engine, "begin")
    def begins(connection: Any) -> None:
        # A writer takes its turn before it looks, or two would decide on the same state.
        reads = connection.get_execution_options().get("reads", False)
        connection.exec_driver_sql("BEGIN" if reads else "BEGIN IMMEDIATE")


def _into_wal(cursor: Any) -> None:
    """Writers and readers side by side. SQLite doesn't wait for this change as for others."""
    until = time.monotonic() + BUSY_S
    while True:
        try:
            if cursor.execute("PRAGMA journal_mode").fetchone()[0] == "wal":
                return
            cursor.execute("PRAGMA journal_mode=WAL").fetchone()
        except Exception as error:
            if "locked" not in str(error) or time.monotonic() > until:
                raise
        time.sleep(0.01 + 0.01 * (os.getpid() % 7))


def _create(engine: Engine) -> None:
    from sqlalchemy import inspect, text

    sqlite = engine.dialect.name == "sqlite"
    if not sqlite and engine.dialect.name != "postgresql":
        raise StudyError(f"studies are stored in SQLite or PostgreSQL, not {engine.dialect.name}")
    with engine.connect().execution_options(reads=True) as connection:
        if inspect(connection).has_table("events"):  # made with all the rest, or not at all
            return
    with engine.begin() as connection:
        if not sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _CREATING})
        made = tables()
        made.create_all(connection)
        for statement in _APPEND_ONLY_SQLITE if sqlite else _APPEND_ONLY_POSTGRESQL:
            connection.execute(text(statement))

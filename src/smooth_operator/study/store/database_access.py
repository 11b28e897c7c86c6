"""Access to the database of a study: transactions whose failures have a reason in one line."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from smooth_operator.errors import StudyError
from smooth_operator.study.store.database_tables import reason, tables

if TYPE_CHECKING:
    from sqlalchemy import Connection, Engine


class DatabaseAccess:
    """Reads and writes one database, and notices when its file is gone."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._tables = tables().tables
        self._file = self._file_now()

    def close(self) -> None:
        """Closes the database."""
        self._engine.dispose()

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

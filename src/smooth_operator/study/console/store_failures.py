"""Failures of the store, which are not those of what was asked of it."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

from smooth_operator.errors import SmoothOperatorError, StudyError


class StoreFailedError(StudyError):
    """Nothing is wrong with the command, but it can't be written now: trying again may help."""


@contextmanager
def store_failures() -> Iterator[None]:
    """Raises ``StoreFailedError`` where a database is to blame, and not what was asked."""
    try:
        yield
    except StoreFailedError:
        raise
    except StudyError as error:
        cause = error.__cause__
        blamed = isinstance(cause, sqlite3.Error | OSError)
        if blamed and not isinstance(cause, SmoothOperatorError):
            raise StoreFailedError(str(error)) from error
        raise

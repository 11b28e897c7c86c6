"""Output of a teleoperation for a person: a terminal, or logging."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Protocol

_LOG = logging.getLogger("smooth_operator.teleop")


class Reporter(Protocol):
    """Takes lines for a person."""

    def note(self, text: str, *, matters: bool = False) -> None:
        """Shows a line, even to who wants to read little if it ``matters``."""

    def waiting(self, text: str) -> AbstractContextManager[None]:
        """Shows that something takes a while."""


class LoggingReporter:
    """Lines go to the logger ``smooth_operator.teleop``: those that matter as warnings."""

    def note(self, text: str, *, matters: bool = False) -> None:
        """Logs a line."""
        _LOG.log(logging.WARNING if matters else logging.INFO, "%s", text)

    @contextlib.contextmanager
    def waiting(self, text: str) -> Iterator[None]:
        """Logs what takes a while."""
        self.note(text)
        yield

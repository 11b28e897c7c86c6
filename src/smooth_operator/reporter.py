"""Interface through which a long run reports progress and notes to its user."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol


class Advance(Protocol):
    """Function that reports how much work has been completed."""

    def __call__(
        self, count: int = 1, *, label: str = "", reason: str | None = None, extra: str = ""
    ) -> None:
        """Reports that one or several pieces are done.

        Args:
            count: number of pieces.
            label: name of the piece.
            reason: why it failed; None if it did not.
            extra: text next to the count.
        """


class Reporter:
    """Receives the progress and notes of a run and ignores them; a subclass can show them."""

    def note(self, text: str, *, matters: bool = False) -> None:
        """Reports a line; a line that ``matters`` is shown in quiet mode too."""

    def waiting(self, text: str) -> AbstractContextManager[None]:
        """Reports, for the duration of the block, that a task of unknown length is running."""
        return nullcontext()

    @contextmanager
    def counting(
        self, name: str, total: int, unit: str, *, done: int = 0, in_files: bool = False
    ) -> Iterator[Advance]:
        """Reports, for the duration of the block, how many pieces of work are done. Yields the
        function that counts them.

        Args:
            name: name of the work; empty for none.
            total: number of pieces.
            unit: name of the pieces, in the plural.
            done: number of pieces that earlier runs have done.
            in_files: show the end of the count if the output is not a terminal.
        """
        yield lambda count=1, **_: None

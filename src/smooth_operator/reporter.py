"""What a long run tells a person while it works."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol


class Advance(Protocol):
    """Tells that pieces of work are done."""

    def __call__(
        self, count: int = 1, *, label: str = "", reason: str | None = None, extra: str = ""
    ) -> None:
        """Called with each piece, or some of them.

        Args:
            count: number of pieces.
            label: name of the piece.
            reason: why it failed; None if it did not.
            extra: text beside the count.
        """


class Reporter:
    """Takes what a run tells and shows nothing; derive from it to show it."""

    def note(self, text: str, *, matters: bool = False) -> None:
        """A line; one that ``matters`` is shown in quiet mode, too."""

    def waiting(self, text: str) -> AbstractContextManager[None]:
        """Something that takes a while, in the block, and can't say how long."""
        return nullcontext()

    @contextmanager
    def counting(
        self, name: str, total: int, unit: str, *, done: int = 0, in_files: bool = False
    ) -> Iterator[Advance]:
        """Pieces of work, in the block; yields what counts them.

        Args:
            name: name of the work; empty for none.
            total: number of pieces.
            unit: what they are, in the plural.
            done: number of them that earlier runs have done.
            in_files: show the end of the count where there is no terminal.
        """
        yield lambda count=1, **_: None

"""Pacing by absolute deadlines, so that delays do not add up."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

from smooth_operator.teleop.sources.live import Clock

_Item = TypeVar("_Item")


class Stopping(Protocol):
    """What may end a wait: ``threading.Event``."""

    def wait(self, timeout: float) -> bool:
        """Wait up to ``timeout`` [s]; whether it is set."""

    def is_set(self) -> bool:
        """Whether it is set."""


def on_time(
    due: Iterable[tuple[float, _Item]], clock: Clock, stopping: Stopping
) -> Iterator[tuple[float, _Item]]:
    """Items when they are due; those that are late already come immediately, in order.

    Args:
        due: (time since the start [s], item), times not decreasing.
        clock: seconds that never go back. It starts when the first item has been made, which may
            take a while.
        stopping: ends it.

    Yields:
        How late the item is [s], and the item.
    """
    items = iter(due)
    first = list(itertools.islice(items, 1))
    start = clock()
    for time, item in itertools.chain(first, items):
        left = start + time - clock()
        if stopping.wait(left) if left > 0.0 else stopping.is_set():
            return
        yield clock() - (start + time), item

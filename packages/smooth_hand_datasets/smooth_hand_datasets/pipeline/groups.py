"""Groups of work on worker processes; a group whose worker dies is split."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeVar

from smooth_operator.parallel import TaskResult, run_tasks
from smooth_operator.parallel.tasks import DIED

T = TypeVar("T")
R = TypeVar("R")


def run_groups(
    function: Callable[[T], R],
    groups: Sequence[T],
    split: Callable[[T], Sequence[T]],
    *,
    workers: int | None = None,
    cluster: str | None = None,
    retries: int = 2,
) -> Generator[tuple[T, TaskResult[R]]]:
    """Runs groups of work like ``run_tasks``. If the workers of a group die, splits the group into
    parts.

    The parts run one by one. Yields groups, or parts of them, each with its result."""
    parts: list[T] = []
    options: dict[str, Any] = {"workers": workers, "cluster": cluster, "retries": retries}
    with contextlib.closing(run_tasks(function, groups, **options)) as results:
        for result in results:
            group = groups[result.index]
            lost = (result.error or "").startswith((DIED, MemoryError.__name__))
            if lost and len(alone := split(group)) > 1:
                parts += alone
            else:
                yield group, result
    if parts:
        with contextlib.closing(run_tasks(function, parts, **options)) as results:
            yield from ((parts[result.index], result) for result in results)

"""``smooth-operator hands check``: a hand's description, tested, as a checklist."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from typing import Final

from rich import box
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table
from rich.text import Text

from smooth_operator.cli.hands_check_options import Check
from smooth_operator.compilation.compile_cache import enable_cache, healing
from smooth_operator.lab.validation import HandValidation, check_hand
from smooth_operator.lab.validation.checks import Verdict
from smooth_operator.terminal import open_console

FAILED: Final = 1
"""Exit status when a check failed."""

_WIDTH_OF_A_FILE: Final = 160
_MARKS: Final[dict[Verdict, tuple[str, str]]] = {
    "ok": ("✓", "green"),
    "warning": ("?", "yellow"),
    "failed": ("!", "red"),
    "unjudged": ("·", "dim"),
    "skipped": ("–", "dim"),
}


def check_hand_command(options: Check) -> None:
    """Checks a hand and prints the checklist.

    Raises:
        UnknownNameError: there is no such hand.
        HandModelError: it can't be loaded.
        SystemExit: with ``FAILED``, if a check failed.
    """
    bar = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("poses"),
        TimeElapsedColumn(),
        console=open_console(stderr=True),
        disable=options.quiet,
        transient=True,
    )

    def track(what: str, steps: Sequence[int]) -> Iterator[int]:
        task = bar.add_task(what, total=len(steps))
        yield from bar.track(steps, task_id=task)
        bar.remove_task(task)

    with bar, healing(enable_cache()):
        found = check_hand(
            options.hand,
            options.side,
            quick=options.quick,
            poses=options.poses,
            seed=options.seed,
            track=track,
        )
    if options.json:
        print(json.dumps(found.to_json(), indent=2))
    else:
        _print(found)
    sys.stdout.flush()
    if not found.ok:
        raise SystemExit(FAILED)


def _print(found: HandValidation) -> None:
    console = open_console()
    if not console.is_terminal:  # a pipe or file has no width, and 80 columns would break lines
        console.width = _WIDTH_OF_A_FILE
    table = Table(
        title=f"{found.hand}, {found.side} hand",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    for header in ("", "check", "measured", "what to do"):
        table.add_column(header, no_wrap=header in ("", "check"))
    for check in found.checks:
        mark, style = _MARKS[check.verdict]
        table.add_row(Text(mark, style), check.name, Text(check.measured), Text(check.advice or ""))
    console.print(table)
    count = len(found.failed)
    warned = sum(check.verdict == "warning" for check in found.checks)
    said = "No check failed" if not count else f"{count} check{'s' * (count > 1)} failed"
    if warned:
        said += f", {warned} warning{'s' * (warned > 1)}"
    console.print(
        f"{said}. ✓ ok  ? warning  ! failed  · measured, not judged  – not checked", markup=False
    )

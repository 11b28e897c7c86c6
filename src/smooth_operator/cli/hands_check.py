"""``smooth-operator hands check``: a hand's description, tested, as a checklist."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from typing import Final

from rich.text import Text

from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.hands_check_options import Check
from smooth_operator.compilation.cache import jax_cache
from smooth_operator.lab.validation import HandValidation, check_hand
from smooth_operator.lab.validation.checks import Verdict

FAILED: Final = 1
"""Exit status when a check failed."""

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
    bar = Progressing(options.quiet).counter("poses", transient=True)

    def track(what: str, steps: Sequence[int]) -> Iterator[int]:
        task = bar.add_task(what, total=len(steps))
        yield from bar.track(steps, task_id=task)
        bar.remove_task(task)

    with bar, jax_cache():
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
    console = output_console()
    table = plain_table(f"{found.hand}, {found.side} hand")
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

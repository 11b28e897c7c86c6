"""``smooth-operator hands check``: tests a hand's description and prints a checklist."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Final

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import INSTALL_RESEARCH, Common, HandSide, Quiet
from smooth_operator.errors import ConfigError
from smooth_operator.plugins import Registry

if TYPE_CHECKING:
    from smooth_operator.hand_discovery.checks import HandValidation, Verdict


@dataclass(frozen=True, kw_only=True)
class Check(Common, Quiet):
    """Check a hand's description: limits, axes, fingertips, pinches and a round trip."""

    work: ClassVar[str] = "smooth_operator.cli.hands_check:check_hand_command"
    details: ClassVar[str] = """Each check reports what it measured and what to do. The round trip
retargets the landmarks of random poses of the hand; the results should be the same poses. The exit
status is 0 if no check failed, 1 if a check failed, 2 if the hand can't be loaded.

Examples:
  smooth-operator hands check my_hand
  smooth-operator hands check my_hand.right.toml --quick
  smooth-operator hands check shadow_hand --side left --json
  smooth-operator hands check wuji_hand --scorecard --out card.html"""

    hand: Annotated[Positional[str], arg(metavar="SPEC")]
    """Name of a hand, or path of a spec file (.toml)."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: right, or the side of the spec file."""

    quick: bool = False
    """Run the round trip only with sbr and smooth, not with every method."""

    poses: int = 20
    """Number of poses in each round trip."""

    seed: int = 0
    """Seed of the random poses."""

    json: bool = False
    """Print one JSON object on standard output instead of the checklist."""

    scorecard: bool = False
    """Print a scorecard instead of the checklist: what the thumb touches (Kapandji), the sizes of
    objects in each grasp, reach, and the human postures that the hand takes. Needs the distribution
    smooth-retargeting-research."""

    out: Annotated[Path | None, arg(metavar="HTML")] = None
    """With --scorecard: HTML page to write, with pictures of the thumb at each place that it
    touches."""


SCORECARDS: Final = Registry(
    "scorecard",
    {},
    elsewhere={
        "card": (
            f"part of the package smooth-retargeting-research: {INSTALL_RESEARCH} in a clone of "
            "the repository"
        )
    },
)
"""Functions that print a scorecard, from the options and the function of a progress bar."""
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
    """Checks a hand and prints the checklist, or its scorecard."""
    from smooth_operator.cli.console import Progressing
    from smooth_operator.hand_discovery import check_hand

    bar = Progressing(options.quiet).counter("poses", transient=True)

    def track(what: str, steps: Sequence[int]) -> Iterator[int]:
        task = bar.add_task(what, total=len(steps))
        yield from bar.track(steps, task_id=task)
        bar.remove_task(task)

    if options.scorecard:
        print_scorecard = SCORECARDS.load("card")
        with bar:
            print_scorecard(options, track)
        return
    if options.out is not None:
        raise ConfigError("--out writes the scorecard's page, so add --scorecard")
    with bar:
        validation = check_hand(
            options.hand,
            options.side,
            quick=options.quick,
            poses=options.poses,
            seed=options.seed,
            track=track,
        )
    if options.json:
        print(json.dumps(validation.to_json(), indent=2))
    else:
        _print(validation)
    sys.stdout.flush()
    if not validation.ok:
        raise SystemExit(FAILED)


def _print(validation: HandValidation) -> None:
    from rich.text import Text

    from smooth_operator.cli.console import output_console, plain_table

    console = output_console()
    table = plain_table(f"{validation.hand}, {validation.side} hand")
    for header in ("", "check", "measured", "what to do"):
        table.add_column(header, no_wrap=header in ("", "check"))
    for check in validation.checks:
        mark, style = _MARKS[check.verdict]
        table.add_row(Text(mark, style), check.name, Text(check.measured), Text(check.advice or ""))
    console.print(table)
    count = len(validation.failed)
    warned = sum(check.verdict == "warning" for check in validation.checks)
    summary = "No check failed" if not count else f"{count} check{'s' * (count > 1)} failed"
    if warned:
        summary += f", {warned} warning{'s' * (warned > 1)}"
    console.print(
        f"{summary}. ✓ ok  ? warning  ! failed  · measured, but not judged  – not checked",
        markup=False,
    )

"""Options of ``smooth-operator cross-hand`` and of its subcommands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, TypeAlias

from tyro.conf import OmitSubcommandPrefixes, arg, subcommand

from smooth_operator.cli.common_options import Common, Group

RESULTS = Path("research/results/cross-hand.jsonl")
"""Default file of the results, in a clone of the repository."""


@dataclass(frozen=True, kw_only=True)
class RunMatrix(Common):
    """Do the trials that the file of results does not have yet."""

    work: ClassVar[str] = "smooth_operator_research.commands.cross_hand:run"
    details: ClassVar[str] = """The file is written after each block of at most 24 trials. A stopped
run loses only the blocks that were running; the same command continues it, and a larger --worlds
adds worlds. Trials are repeated if their hand, task, method or simulation has changed since.

Exit status: 0 all trials were done, 1 some blocks failed, 2 the request is invalid, 130 stopped by
the user.

Examples:
  smooth-operator cross-hand run --worlds 12
  smooth-operator cross-hand run --hands mimic_p050,leap_hand --methods smooth --tasks cube
  smooth-operator cross-hand run --scaled --worlds 12
"""

    results: Annotated[Path, arg(metavar="FILE")] = RESULTS
    """File of the results."""

    tasks: Annotated[str, arg(metavar="A,B|all")] = "all"
    """Tasks, separated by commas."""

    hands: Annotated[str, arg(metavar="A,B|all")] = ""
    """Catalogue names of right robot hands, separated by commas; `all` for all built-in hands.
    Default: 17 hands."""

    methods: Annotated[str, arg(metavar="M1,M2|all")] = ""
    """Methods, separated by commas; METHOD:PRESET selects a preset. Default: smooth, sbr:paper,
    dexpilot:published, ako:published."""

    trackers: Annotated[str, arg(metavar="A,B")] = "glove,headset,camera"
    """Trackers that see the human, separated by commas. They take turns over the worlds."""

    worlds: Annotated[int, arg(metavar="N")] = 12
    """Number of worlds: 0 to N - 1."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of worker processes; 0 does the work in this process. Default: one per core."""

    keep_older: bool = False
    """Keep results by other code instead of repeating these trials."""

    scaled: bool = False
    """Scale relocate, hammer and tongs by the length of each robot hand, and leave out the other
    tasks. These trials have their own cells and tables."""

    quiet: bool = False
    """Hide progress output."""


@dataclass(frozen=True, kw_only=True)
class ReportMatrix(Common):
    """Print the tables of a file of results, or write them into a page."""

    work: ClassVar[str] = "smooth_operator_research.commands.cross_hand:report"
    details: ClassVar[str] = """Tables: success with 95 % intervals by task, hand and method, means
over hands, differences between methods, trackers, times, and reasons for failures. Cells with
trials by older code are marked.

Examples:
  smooth-operator cross-hand report
  smooth-operator cross-hand report --docs research/docs/cross-hand.md --plots research/docs/img
"""

    results: Annotated[Path, arg(metavar="FILE")] = RESULTS
    """File of the results."""

    docs: Annotated[Path | None, arg(metavar="PAGE")] = None
    """Markdown page whose tables are replaced, between `<!-- table: NAME -->` and `<!-- end -->`.
    Default: print all tables."""

    plots: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder for cross-hand.svg, a plot of the success of each hand."""


@dataclass(frozen=True, kw_only=True)
class DrawStrip(Common):
    """Draw one trial of each hand as a row of pictures, to see why a hand fails."""

    work: ClassVar[str] = "smooth_operator_research.commands.cross_hand:strip"
    details: ClassVar[str] = """Needs OpenGL; without a display, set MUJOCO_GL=egl or osmesa.

Example:
  smooth-operator cross-hand strip --task cube --hands leap_hand,inspire_hand --output strip.png
"""

    task: str
    """Task to do."""

    hands: Annotated[str, arg(metavar="A,B")]
    """Catalogue names of right robot hands, one row each."""

    method: str = "smooth"
    """Method, or METHOD:PRESET."""

    world: int = 0
    """Number of the world. Its tracker is that of the matrix."""

    pictures: int = 6
    """Number of pictures in a row, at equal intervals from start to end of the trial."""

    output: Annotated[Path, arg(metavar="FILE")]
    """File to write, .png or .webp."""


Subcommand: TypeAlias = (
    Annotated[RunMatrix, subcommand("run")]
    | Annotated[ReportMatrix, subcommand("report")]
    | Annotated[DrawStrip, subcommand("strip")]
)
"""Subcommands of the group."""


@dataclass(frozen=True, kw_only=True)
class CrossHand(Group):
    """Replay one human demonstration on many robot hands in a physics simulation, with several
    methods."""

    details: ClassVar[str] = """Examples:
  smooth-operator cross-hand run --worlds 12
  smooth-operator cross-hand report
  smooth-operator cross-hand strip --task cube --hands leap_hand --output strip.png

Each has its own help: smooth-operator cross-hand run --help"""

    what: Annotated[OmitSubcommandPrefixes[Subcommand], arg(name="")]
    """Subcommand."""

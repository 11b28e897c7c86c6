"""Options of ``smooth-operator study run``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class Run(Common):
    """Run a study in the browser: a page for the experimenter, one for the operator's tablet."""

    work: ClassVar[str] = "smooth_operator.cli.study_run:run_study"
    details: ClassVar[
        str
    ] = """The experimenter's page follows the protocol, the operator's shows the
questionnaires. Every event is on disk before a page shows it: server and browsers may be killed
at any time, and continue where they were. Ctrl-C ends.

Examples:
  smooth-operator study run my-study --open
  smooth-operator study run my-study --host 0.0.0.0 --teleop tcp://127.0.0.1:5558 --blind
  smooth-operator study run my-study --store /data/lab.db --operator P03"""

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """Folder of the study."""

    store: Annotated[str | None, arg(metavar="FILE")] = None
    """SQLite file instead of study.db in the folder; it may hold several studies."""

    name: Annotated[str | None, arg(metavar="TEXT")] = None
    """Name of the study, where study.db holds several."""

    operator: Annotated[str | None, arg(metavar="CODE")] = None
    """The current operator; if left out, the last active one who has not finished."""

    blind: bool = False
    """Show labels instead of conditions. The operator's page never shows either."""

    teleop: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """A running teleop --control ADDRESS, to be switched to the condition of each block."""

    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Where the pages listen; 0.0.0.0 lets other machines in, such as a tablet, by links with
    a token."""

    port: int = 8765
    """Port of the pages; 0 for any free one."""

    open: bool = False
    """Open the experimenter's page in the browser."""

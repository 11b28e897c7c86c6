"""Options of ``smooth-operator study run``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class Run(Common):
    """The study in a browser: a page for the experimenter, one for the operator's tablet."""

    work: ClassVar[str] = "smooth_operator.cli.study_run:run_study"
    details: ClassVar[str] = """The experimenter's page walks the protocol, the operator's shows the
questionnaires. Every event is on the disk before a page says so: server and browsers may be killed
at any time, and go on where they were. Ctrl-C ends.

Examples:
  smooth-operator study run my-study --open
  smooth-operator study run my-study --host 0.0.0.0 --teleop tcp://127.0.0.1:5558 --blind
  smooth-operator study run my-study --store postgresql://me@host/studies --operator P03"""

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """Folder of the study, or the URL of a database that holds it."""

    store: Annotated[str | None, arg(metavar="URL")] = None
    """Database in the place of study.db in the folder."""

    name: Annotated[str | None, arg(metavar="TEXT")] = None
    """Name of the study, where STUDY is a database that holds several."""

    operator: Annotated[str | None, arg(metavar="CODE")] = None
    """Who is on; whoever did something last and is not done, if left out."""

    blind: bool = False
    """Show labels in the place of conditions. The operator's page never shows either."""

    teleop: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """A running teleop --control ADDRESS, to be switched to the condition of each block."""

    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Where the pages listen; 0.0.0.0 lets other machines in, such as a tablet, by links that hold
    a token each."""

    port: int = 8765
    """Port of the pages; 0 for any free one."""

    open: bool = False
    """Open the experimenter's page in the browser."""

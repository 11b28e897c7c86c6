"""Options of ``smooth-operator study`` and of its subcommands.

A further subcommand: write its options as a dataclass in its own file (as
``study_analyze_options.py``) and its work in another (``study_analyze.py``), then add one line to
``What``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, TypeAlias

from tyro.conf import OmitSubcommandPrefixes, arg, subcommand

from smooth_operator.cli.study_analyze_options import Analyze
from smooth_operator.cli.study_data_options import Erase, Export
from smooth_operator.cli.study_metrics_options import Metrics
from smooth_operator.cli.study_new_options import Enrol, New
from smooth_operator.cli.study_power_options import Power
from smooth_operator.cli.study_run_options import Run
from smooth_operator.cli.subcommands import Group, described

What: TypeAlias = (
    Annotated[New, subcommand("new", description=described(New))]
    | Annotated[Enrol, subcommand("enrol", description=described(Enrol))]
    | Annotated[Power, subcommand("power", description=described(Power))]
    | Annotated[Run, subcommand("run", description=described(Run))]
    | Annotated[Export, subcommand("export", description=described(Export))]
    | Annotated[Metrics, subcommand("metrics", description=described(Metrics))]
    | Annotated[Erase, subcommand("erase", description=described(Erase))]
    | Annotated[Analyze, subcommand("analyze", description=described(Analyze))]
)
"""The subcommands of the group."""


@dataclass(frozen=True, kw_only=True)
class Study(Group):
    """A user study of retargeters: plan it, run it, and analyse what it measured."""

    details: ClassVar[str] = """Examples:
  smooth-operator study new my-study
  smooth-operator study power my-study
  smooth-operator study run my-study --open
  smooth-operator study analyze trials.csv tlx.csv --baseline dexpilot --output out

Each has its own help: smooth-operator study analyze --help"""

    what: Annotated[OmitSubcommandPrefixes[What], arg(name="")]
    """What to do."""

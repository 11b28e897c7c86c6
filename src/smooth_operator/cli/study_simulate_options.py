"""Options of ``smooth-operator study simulate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class Simulate(Common):
    """Have virtual operators do every trial of a plan in physics. They replace no person."""

    work: ClassVar[str] = "smooth_operator.cli.study_simulate:simulate_command"
    details: ClassVar[str] = """A virtual operator looks at the simulated hand with a delay,
corrects, waits, tries again and gets better with practice; persons differ. The tasks are those in
simulation (A or card, B or cube, C or screwdriver). The same command continues a stopped run. It
writes trials.csv and tlx.csv (with empty answers) for study analyze, details.csv, simulation.json.

Examples:
  smooth-operator study new my-study --no-wizard
  smooth-operator study simulate my-study --operators 18
  smooth-operator study analyze my-study/simulated --baseline dexpilot --output out"""

    study: Annotated[Positional[Path], arg(metavar="PLAN")]
    """Folder of the study, or its study.toml."""

    operators: Annotated[int | None, arg(metavar="INT")] = None
    """Number of virtual operators, in the plan's shares of the tasks; the plan's own if left
    out."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, which must be able to do the tasks."""

    body: Literal["matched", "human"] = "matched"
    """Kinematics of the operators' hands: the robot's at human size with other bones, or published
    human anatomy, whose thumb does not reach all that the tasks need."""

    seed: Annotated[int, arg(metavar="INT")] = 0
    """Seed of persons and trials: the same seed gives the same figures, with any --workers."""

    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Processes; one for each core if left out."""

    output: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Where results go; the folder simulated of the study if left out."""

    json: bool = False
    """One JSON object on standard output instead of the table."""

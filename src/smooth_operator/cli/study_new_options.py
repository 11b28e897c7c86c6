"""Options of ``smooth-operator study new`` and ``study enrol``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction, arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class New(Common):
    """Write a plan: conditions, tasks, balanced orders, schedule. Asks in a terminal."""

    work: ClassVar[str] = "smooth_operator.cli.study_new:new_study"
    details: ClassVar[str] = """It writes study.toml (the plan, which you may edit), schedule.csv
(with the conditions, for the experimenter), schedule.txt (with labels only, for the wall) and
PREREGISTRATION.md (hypotheses, design, models, corrections: complete it and register it).
Without options a terminal asks; elsewhere, and with --no-wizard, what is left out is as in the
paper: four retargeters as their authors run them, 30 commands a second, three tasks, 18 operators.

Examples:
  smooth-operator study new my-study
  smooth-operator study new my-study --conditions sbr dexpilot ako --baseline dexpilot \\
      --tasks pinch:12 turn:12:8 --operators 15 --primary time/pooled --margin time=3
  smooth-operator study new my-study --from draft.toml"""

    folder: Annotated[Positional[Path], arg(metavar="FOLDER")]
    """Folder of the new study."""

    name: Annotated[str | None, arg(metavar="TEXT")] = None
    """Name of the study; the folder's if left out."""

    conditions: Annotated[tuple[str, ...], arg(metavar="NAME[=METHOD[:PRESET]] ...")] = ()
    """What is compared; the name alone if the method is called so. If left out, the paper's four
    with the settings of its authors' code."""

    baseline: Annotated[str | None, arg(metavar="NAME")] = None
    """Condition that the others are compared with; dexpilot, or the first."""

    primary: Annotated[str | None, arg(metavar="OUTCOME/SCOPE")] = None
    """Endpoint that decides: success, time or tlx, and pooled or a task; all else is exploratory.
    success/pooled if left out."""

    margin: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="OUTCOME=DIFFERENCE")] = ()
    """Difference below which two conditions count as equivalent: success as a share, time in
    seconds, tlx in points; repeatable. If left out, those of the paper's design with its
    conditions (0.1, 5, 10), else none."""

    tasks: Annotated[tuple[str, ...], arg(metavar="NAME[:TRIALS[:OPERATORS]] ...")] = ()
    """What is done; 10 trials a block and all operators if left out."""

    operators: Annotated[int | None, arg(metavar="INT")] = None
    """How many take part."""

    familiarisation: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Free movement before the trials of a block [s]; 120 if left out."""

    questionnaires: Annotated[
        tuple[Literal["initial", "midpoint", "final", "none"], ...],
        arg(metavar="initial midpoint final|none"),
    ] = ()
    """NASA-TLX after the first, middle and last trial of a block: all three if left out."""

    weights: bool = False
    """Ask for the 15 pairwise comparisons of NASA-TLX at the end of a block."""

    no_forms: bool = False
    """Leave out the forms (consent, about the operator, a look back) on the operator's page."""

    seed: Annotated[int | None, arg(metavar="INT")] = None
    """Seed of orders, rows and labels; 0 if left out."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Commands per second to the hand in every condition [Hz]. If left out, 30 with the
    paper's conditions, else those that the teleoperation was started with."""

    from_: Annotated[Path | None, arg(name="from", metavar="TOML")] = None
    """A file to take the plan from, as study.toml; missing orders are generated."""

    no_wizard: bool = False
    """Ask nothing, even in a terminal."""

    overwrite: bool = False
    """Replace the plan of a study without stored data."""


@dataclass(frozen=True, kw_only=True)
class Enrol(Common):
    """Enrol an operator, or add tasks for one; assigns the least-used row."""

    work: ClassVar[str] = "smooth_operator.cli.study_new:enrol_operator"
    details: ClassVar[str] = """Examples:
  smooth-operator study enrol my-study P19
  smooth-operator study enrol my-study P03 --tasks C"""

    study: Annotated[Positional[Path], arg(metavar="STUDY")]
    """Folder of the study."""

    operator: Annotated[Positional[str], arg(metavar="CODE")]
    """Pseudonym; never a name."""

    tasks: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ()
    """What the operator does; all tasks if left out."""

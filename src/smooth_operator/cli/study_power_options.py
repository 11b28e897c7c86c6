"""Options of ``smooth-operator study power``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class Power(Common):
    """How many operators are enough? Simulates studies of a plan and analyses each."""

    work: ClassVar[str] = "smooth_operator.cli.study_power:simulate_power"
    details: ClassVar[str] = """For each number of operators, studies with the assumed differences
(power) and with none (family-wise error), analysed in both modes. The default assumptions
are the paper's figures of its four methods; others need --success, --time and --workload. The same
command continues a stopped run and adds what is new. It writes power.json, power.png and
studies.jsonl.

Examples:
  smooth-operator study power my-study
  smooth-operator study power my-study --operators 12 18 24 --success sbr=0.55 dexpilot=0.45
  smooth-operator study power --operators 18 --studies 4000 --output power-of-the-paper"""

    study: Annotated[Positional[Path | None], arg(metavar="STUDY")] = None
    """Folder of the study, or its study.toml; the paper's design if left out."""

    operators: Annotated[tuple[int, ...], arg(metavar="INT ...")] = ()
    """Numbers of operators; a third to twice as many as are planned if left out."""

    studies: Annotated[int, arg(metavar="INT")] = 1000
    """Simulated studies for each number, with the differences and again without."""

    success: Annotated[tuple[str, ...], arg(metavar="NAME=SHARE ...")] = ()
    """Expected success of conditions, 0 to 1."""

    time: Annotated[tuple[str, ...], arg(metavar="NAME=SECONDS ...")] = ()
    """Expected time of successful trials [s]."""

    workload: Annotated[tuple[str, ...], arg(metavar="NAME=POINTS ...")] = ()
    """Expected NASA-TLX, 0 to 100."""

    operators_differ: Annotated[tuple[float, float, float], arg(metavar="LOGIT SECONDS POINTS")] = (
        0.6,
        4.0,
        10.0,
    )
    """Standard deviation between operators: of success on the logit scale (0.6 is some 13 points
    of success), of time [s], of workload [points]."""

    preferences_differ: Annotated[
        tuple[float, float, float], arg(metavar="LOGIT SECONDS POINTS")
    ] = (0.3, 2.0, 5.0)
    """The same, of an operator's preference for single conditions. Mode paper has no term for it in
    time and workload, and errs."""

    trials_differ: Annotated[tuple[float, float], arg(metavar="SECONDS POINTS")] = (7.0, 6.0)
    """Standard deviation between trials of time [s], and between questionnaires of workload."""

    per_task: bool = False
    """Analyse each task by itself as well."""

    seed: Annotated[int, arg(metavar="INT")] = 0
    """Seed of all simulated studies: the same seed gives the same figures, with any --workers."""

    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Processes; one for each core if left out."""

    output: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Where results go; the folder power of the study if left out, else power."""

    json: bool = False
    """One JSON object on standard output instead of the tables."""

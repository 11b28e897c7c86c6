"""Options of the commands ``paper``, ``ablate``, ``physics`` and ``study simulate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeAlias

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Ordered

# Spelt out again: the catalogue that owns the names imports JAX, and `--help` needs none.
ExperimentName: TypeAlias = Literal[
    "fk", "compute", "solver", "velocity", "hessian", "table", "noise", "rate"
]


@dataclass(frozen=True, kw_only=True)
class Experimenting(Common):
    """Options of both commands."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write, new, empty or of earlier experiments."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each recording, as a Python slice: :500, 2600:3100, -500:"""

    quick: bool = False
    """A minimal size, to test that it runs; the verdicts mean little."""

    published: bool = False
    """For an accelerator: the published 32,768 samples and starts of RMSProp, 64 starts of SLSQP
    (it runs them one after the other), 1,024 of Newton, 500 frames."""

    quiet: bool = False
    """Hide progress output and the verdicts."""


@dataclass(frozen=True, kw_only=True)
class Ablate(Experimenting):
    """Re-run one of the paper's experiments on your own machine and recordings."""

    work: ClassVar[str] = "smooth_operator_research.commands.experiments:ablate"
    details: ClassVar[str] = """Experiments:
  fk        libraries of forward kinematics over the size of the batch
  compute   tracking loss over samples N and cycles L, along contours of equal compute
  solver    DexPilot's loss unchanged, the solver swapped: loss, jitter, time
  velocity  the same with a velocity term
  hessian   in which directions of the loss a solver jitters
  table     the six metrics of all methods, in the paper's layout
  noise     methods behind a tracker with noise and drop-outs
  rate      methods at frame rates from 15 to 100 Hz

FOLDER gets NAME/results.json, NAME/*.png, report.html (all experiments in the folder), and cells/
(what was computed, shared by the experiments). The same command continues a stopped
run. Without recordings twenty people of the built-in operator are used (four with --quick); a
recording may bring a range of frames, a rate or a side after an @, as for bench. Of each at most
300 frames are used (for the solvers 150, with --published 500). Files count as independent,
parts of one file as one.

Examples:
  smooth-operator ablate solver --output out
  smooth-operator ablate hessian glove.npz@2600:3100 --output out
"""

    name: Annotated[Positional[ExperimentName], arg(metavar="NAME")]
    """The experiment."""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic:SEED`, each with settings after an @ if need be."""


@dataclass(frozen=True, kw_only=True)
class Paper(Experimenting):
    """Re-run all of the paper's experiments, and judge each claim."""

    work: ClassVar[str] = "smooth_operator_research.commands.experiments:paper"
    details: ClassVar[str] = """FOLDER gets a folder for each experiment (results.json and figures),
and report.html with all of them. The same command continues a stopped run.

Examples:
  smooth-operator paper --output out
  smooth-operator paper --quick --output out
  smooth-operator paper glove.npz@2600:3100 video.npz@30hz --output out
"""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic:SEED`, each with settings after an @ if need be."""


@dataclass(frozen=True, kw_only=True)
class Physics(Ordered, Common):
    """Measure what the hand achieves in physics, by measures, hands and methods."""

    work: ClassVar[str] = "smooth_operator_research.commands.physics:physics"
    details: ClassVar[str] = """FOLDER gets for each measure a CSV with a row for each case,
summary.csv, results.json and report.html, with 95 % intervals over independent units. The same
command continues a stopped run. `bench --physics [MEASURE ...]` is the same command. Measures
(research/docs/physics-measures.md):
  reachable       the hand's own motions play the human: what is exact must come out exact
  demonstrations  the study's tasks in perturbed worlds, by their demonstrations
  pinch           objects that appear in the pinches of recordings: held, let go in time?
  grasp           a handle or a ball in the palm wherever a recording closes the hand
  operators       simulated persons who look and correct

Exit status: 0 all measured, 1 some cases failed (the report says which and why), 2 the
request is invalid, 130 stopped.

Examples:
  smooth-operator physics --measures reachable --hands mimic_p050,leap_hand --output out
      how exactly each method makes motions that the hands can make
  smooth-operator physics --quick --methods smooth,ako --output out
      every measure, few and short cases, to try it out
"""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic`, each with settings after an @ if need be."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write, new, empty or of earlier measures."""

    measures: Annotated[tuple[str, ...], arg(metavar="[MEASURE ...]")] = ()
    """Which measures; all if none is named."""

    hands: Annotated[str, arg(metavar="A,B|all")] = "mimic_p050"
    """Robot hands by their catalogue names, with commas between them."""

    methods: Annotated[str, arg(metavar="M1,M2|all")] = "all"
    """Methods, with commas between them; METHOD:PRESET for a preset."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each recording, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of recordings without time stamps [Hz]."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of each recording."""

    trackers: Annotated[str, arg(metavar="A,B")] = "glove,headset,camera"
    """Trackers of `reachable`, `demonstrations` and `operators`, with commas between them."""

    seed: int = 0
    """Seed of the methods' random numbers and of the units."""

    units: Annotated[int | None, arg(metavar="N")] = None
    """Number of independent units (seeds, worlds, operators) of each measure. Default: the number
    of the measure."""

    quick: bool = False
    """Few and short cases, to try things out."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of processes; 0 works in this process. Default: one per core."""

    cluster: Annotated[str | None, arg(metavar="auto|local|ADDRESS")] = None
    """Measure on a running Ray cluster (auto finds it), or start Ray here (local)."""

    no_report: bool = False
    """Write the results, but no report and no plots."""

    quiet: bool = False
    """Hide progress output and the table."""


@dataclass(frozen=True, kw_only=True)
class Simulate(Common):
    """Have virtual operators do every trial of a plan in physics. They replace no person."""

    work: ClassVar[str] = "smooth_operator_research.commands.study_simulate:simulate_command"
    details: ClassVar[str] = """A virtual operator looks at the simulated hand with a delay,
corrects, waits, tries again and gets better with practice; persons differ. The tasks are those in
simulation (A or card, B or cube, C or screwdriver). The same command continues a stopped run. It
writes trials.csv and tlx.csv (with empty answers) for study analyze, details.csv, simulation.json.

Examples:
  smooth-operator study new my-study
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

    tracker: Literal["glove", "headset", "camera"] = "glove"
    """Tracker that the operators are before, at the plan's rate if it has one."""

    seed: Annotated[int, arg(metavar="INT")] = 0
    """Seed of persons and trials: the same seed gives the same figures, with any --workers."""

    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Number of processes. Default: one per core."""

    output: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder of the results. Default: the folder simulated of the study."""

    json: bool = False
    """One JSON object on standard output instead of the table."""

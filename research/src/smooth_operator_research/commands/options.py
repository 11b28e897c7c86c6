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
    """Options that ``ablate`` and ``paper`` share."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write: a new one, an empty one or that of earlier experiments."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Catalogue name of the robot hand."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each recording, as a Python slice: :500, 2600:3100, -500:"""

    quick: bool = False
    """Minimal size, to test that everything runs; its verdicts are not meaningful."""

    published: bool = False
    """Published size, for an accelerator: 32,768 samples and starts of RMSProp, 64 starts of SLSQP
    (run one after the other), 1,024 starts of Newton, 500 frames."""

    quiet: bool = False
    """Hide progress output and verdicts."""


@dataclass(frozen=True, kw_only=True)
class Ablate(Experimenting):
    """Run one experiment of the Smooth Operator paper (Malate et al., 2026), with your
    recordings or a synthetic operator."""

    work: ClassVar[str] = "smooth_operator_research.commands.experiments:ablate"
    details: ClassVar[str] = """Experiments:
  fk        forward kinematics libraries against batch size
  compute   tracking loss over samples N and cycles L, along contours of equal compute
  solver    DexPilot's loss with different solvers: loss, jitter, time
  velocity  the same with an added velocity term
  hessian   directions of the loss in which a solver jitters
  table     the six metrics of all methods, in the paper's layout
  noise     methods with a tracker that has noise and dropouts
  rate      methods at frame rates from 15 to 100 Hz

Writes to FOLDER: NAME/results.json, NAME/*.png, report.html (all experiments in the folder), and
cells/ (results that experiments share). Run the same command again to continue a stopped run.
Without recordings, twenty people of the built-in operator are used (four with --quick). A range of
frames, a rate or a side can follow the name of a recording after an @, as for bench. At most 300
frames of each recording are used (150 for the solvers, 500 with --published). Files count as
independent; parts of one file count as one.

Examples:
  smooth-operator ablate solver --output out
  smooth-operator ablate hessian glove.npz@2600:3100 --output out
"""

    name: Annotated[Positional[ExperimentName], arg(metavar="NAME")]
    """Experiment to run."""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic:SEED`, each optionally with settings after an @."""


@dataclass(frozen=True, kw_only=True)
class Paper(Experimenting):
    """Repeat the Smooth Operator paper's experiments (Malate et al., 2026); check its claims."""

    work: ClassVar[str] = "smooth_operator_research.commands.experiments:paper"
    details: ClassVar[str] = """Writes to FOLDER: a folder for each experiment (results.json and
figures), and report.html with all of them. Run the same command again to continue a stopped run.

Examples:
  smooth-operator paper --output out
  smooth-operator paper --quick --output out
  smooth-operator paper glove.npz@2600:3100 video.npz@30hz --output out
"""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic:SEED`, each optionally with settings after an @."""


@dataclass(frozen=True, kw_only=True)
class Physics(Ordered, Common):
    """Run each method's joint commands in a physics simulation, and measure how well the hand does
    its tasks."""

    work: ClassVar[str] = "smooth_operator_research.commands.physics:physics"
    details: ClassVar[str] = """Writes to FOLDER: for each measure a CSV file with one row per case,
summary.csv, results.json and report.html, with 95 % intervals over independent units. Run the same
command again to continue a stopped run. `bench --physics [MEASURE ...]` is the same command.
Measures (research/docs/physics-measures.md):
  reachable       the human hand plays motions of the robot hand, so an exact method has no error
  demonstrations  the study's tasks in perturbed worlds, driven by demonstrations
  pinch           objects in the pinches of recordings: are they held, and released in time?
  grasp           a handle or a ball in the palm whenever a recording closes the hand
  operators       simulated people who see the object and correct

Exit status: 0 everything was measured, 1 some cases failed (the report says which and why), 2 the
request is invalid, 130 stopped by the user.

Examples:
  smooth-operator physics --measures reachable --hands mimic_p050,leap_hand --output out
      measure how exactly each method reproduces motions that the hands can make
  smooth-operator physics --quick --methods smooth,ako --output out
      try every measure with a few short cases
"""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic`, each optionally with settings after an @."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write: a new one, an empty one or that of earlier measures."""

    measures: Annotated[tuple[str, ...], arg(metavar="[MEASURE ...]")] = ()
    """Measures to run. Default: all."""

    hands: Annotated[str, arg(metavar="A,B|all")] = "mimic_p050"
    """Catalogue names of the robot hands, separated by commas."""

    methods: Annotated[str, arg(metavar="M1,M2|all")] = "all"
    """Methods, separated by commas; METHOD:PRESET selects a preset."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each recording, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of recordings without timestamps [Hz]."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of each recording."""

    trackers: Annotated[str, arg(metavar="A,B")] = "glove,headset,camera"
    """Trackers for `reachable`, `demonstrations` and `operators`, separated by commas."""

    seed: int = 0
    """Seed of the methods' random numbers and of the units."""

    units: Annotated[int | None, arg(metavar="N")] = None
    """Number of independent units (seeds, worlds, operators) of each measure. Default: depends on
    the measure."""

    quick: bool = False
    """Run only a few short cases, to try the measures."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of worker processes; 0 does the work in this process. Default: one per core."""

    cluster: Annotated[str | None, arg(metavar="auto|local|ADDRESS")] = None
    """Measure on a running Ray cluster (auto finds it), or start Ray here (local)."""

    no_report: bool = False
    """Write the results without a report and plots."""

    quiet: bool = False
    """Hide progress output and the table."""


@dataclass(frozen=True, kw_only=True)
class Simulate(Common):
    """Let virtual operators do every trial of a plan in simulated physics. They do not replace
    people."""

    work: ClassVar[str] = "smooth_operator_research.commands.study_simulate:simulate_command"
    details: ClassVar[str] = """A virtual operator looks at the simulated hand with a delay,
corrects, waits, tries again and gets better with practice; persons differ. Only the simulated tasks
are supported (A or card, B or cube, C or screwdriver). Run the same command again to continue a
stopped run. Writes trials.csv and tlx.csv (with empty answers) for study analyze, details.csv and
simulation.json.

Examples:
  smooth-operator study new my-study
  smooth-operator study simulate my-study --operators 18
  smooth-operator study analyze my-study/simulated --baseline dexpilot --output out"""

    study: Annotated[Positional[Path], arg(metavar="PLAN")]
    """Folder of the study, or its study.toml."""

    operators: Annotated[int | None, arg(metavar="INT")] = None
    """Number of virtual operators, distributed over the tasks as in the plan. Default: that of the
    plan."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Catalogue name of the robot hand, which must be able to do the tasks."""

    body: Literal["matched", "human"] = "matched"
    """Kinematics of the operators' hands: those of the robot at human size with varied bones, or
    published human anatomy, whose thumb can't reach every pose of the tasks."""

    tracker: Literal["glove", "headset", "camera"] = "glove"
    """Simulated tracker that sees the operators, at the rate of the plan if it has one."""

    seed: Annotated[int, arg(metavar="INT")] = 0
    """Seed of persons and trials: the same seed gives the same results for any number of
    --workers."""

    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Number of processes. Default: one per core."""

    output: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder of the results. Default: STUDY/simulated."""

    json: bool = False
    """Print one JSON object on standard output instead of the table."""

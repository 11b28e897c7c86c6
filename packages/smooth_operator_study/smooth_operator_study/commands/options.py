"""Options of ``smooth-operator study`` and of its subcommands.

A further subcommand: write its options as a dataclass here and its work in a file of its own (as
``analyze.py``), which is imported when it runs; then add one line to ``Subcommand``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeAlias

from tyro.conf import OmitSubcommandPrefixes, Positional, UseAppendAction, arg, subcommand

from smooth_operator.cli.common_options import Common, Group


@dataclass(frozen=True, kw_only=True)
class Stored(Common):
    """Options of commands about stored data."""

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """Folder of the study, or its study.db."""


@dataclass(frozen=True, kw_only=True)
class Export(Stored):
    """Write the stored data as trials.csv, tlx.csv and one study.json with the whole log."""

    work: ClassVar[str] = "smooth_operator_study.commands.data:export_data"
    details: ClassVar[str] = """Examples:
  smooth-operator study export my-study --output data
  smooth-operator study export my-study --operator P07 --output data-of-P07"""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder of the files."""

    operator: Annotated[tuple[str, ...], arg(metavar="CODE ...")] = ()
    """Operators to export; all if left out."""


@dataclass(frozen=True, kw_only=True)
class Erase(Stored):
    """Delete all data of one operator for good."""

    work: ClassVar[str] = "smooth_operator_study.commands.data:erase_data"
    details: ClassVar[str] = """The operator is taken off the plan, and the code is not used again.
Exported copies stay.

Example:
  smooth-operator study erase my-study P07 --yes"""

    operator: Annotated[Positional[str], arg(metavar="CODE")]
    """Pseudonym of the operator."""

    yes: bool = False
    """Delete without asking."""


@dataclass(frozen=True, kw_only=True)
class Metrics(Stored):
    """Simulation metrics by operator and retargeter, from the takes of a study."""

    work: ClassVar[str] = "smooth_operator_study.commands.metrics:study_metrics"
    details: ClassVar[str] = """It cuts the recordings of teleop --sink record:STUDY/takes/ to the
trials that count, and writes sim_metrics.csv, which study analyze correlates with success, time and
workload: cosine similarity, scale ratio, motion preservation, flatness, workspace utilisation and
latency.

Examples:
  smooth-operator study metrics my-study
  smooth-operator study metrics my-study --takes other/takes --output data/sim_metrics.csv"""

    takes: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder of the recordings; STUDY/takes if left out."""

    output: Annotated[Path | None, arg(metavar="CSV")] = None
    """File of the table; STUDY/sim_metrics.csv if left out."""


@dataclass(frozen=True, kw_only=True)
class New(Common):
    """Write a plan: conditions, tasks, balanced orders, schedule."""

    work: ClassVar[str] = "smooth_operator_study.commands.new:new_study"
    details: ClassVar[str] = """It writes study.toml (the plan, which you may edit), schedule.csv
and PREREGISTRATION.md (hypotheses, design, models, corrections: complete it and register it). What
is left out is as in the paper: four retargeters as their authors run them, 30 commands a second,
three tasks, 18 operators.

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
    """Compared conditions; the name alone if the method has the same name. If left out, the paper's
    four with the settings of its authors' code."""

    baseline: Annotated[str | None, arg(metavar="NAME")] = None
    """Condition that the others are compared with; dexpilot, or the first."""

    primary: Annotated[str | None, arg(metavar="OUTCOME/SCOPE")] = None
    """Endpoint that decides: success, time or tlx, and pooled or a task; all else is exploratory.
    success/pooled if left out."""

    margin: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="OUTCOME=DIFFERENCE")] = ()
    """Difference below which two conditions count as equivalent: success as a share, time in
    seconds, tlx in points. If left out, those of the paper's design with its
    conditions (0.1, 5, 10), else none."""

    tasks: Annotated[tuple[str, ...], arg(metavar="NAME[:TRIALS[:OPERATORS]] ...")] = ()
    """Tasks; 10 trials a block and all operators if left out."""

    operators: Annotated[int | None, arg(metavar="INT")] = None
    """Number of operators."""

    familiarisation: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Free movement before the trials of a block [s]; 120 if left out."""

    questionnaires: Annotated[
        tuple[Literal["initial", "midpoint", "final", "none"], ...],
        arg(metavar="initial midpoint final|none"),
    ] = ()
    """NASA-TLX after the first, middle and last trial of a block: all three if left out."""

    no_forms: bool = False
    """Leave out the forms (consent, about the operator, a look back) on the operator's page."""

    seed: Annotated[int | None, arg(metavar="INT")] = None
    """Seed of orders, rows and labels; 0 if left out."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Commands per second to the hand in every condition [Hz]. If left out, 30 with the
    paper's conditions, else those that the teleoperation was started with."""

    from_: Annotated[Path | None, arg(name="from", metavar="TOML")] = None
    """A file to take the plan from, as study.toml; missing orders are generated."""

    overwrite: bool = False
    """Replace the plan of a study without stored data."""


@dataclass(frozen=True, kw_only=True)
class Enrol(Common):
    """Enrol an operator, or add tasks for one; assigns the least-used row."""

    work: ClassVar[str] = "smooth_operator_study.commands.new:enrol_operator"
    details: ClassVar[str] = """Examples:
  smooth-operator study enrol my-study P19
  smooth-operator study enrol my-study P03 --tasks C"""

    study: Annotated[Positional[Path], arg(metavar="STUDY")]
    """Folder of the study."""

    operator: Annotated[Positional[str], arg(metavar="CODE")]
    """Pseudonym; never a name."""

    tasks: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ()
    """Tasks of the operator; all if left out."""


@dataclass(frozen=True, kw_only=True)
class Power(Common):
    """Find how many operators are enough: simulate studies of a plan and analyse each."""

    work: ClassVar[str] = "smooth_operator_study.commands.power:simulate_power"
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
    """Numbers of operators; from a third to twice the planned number if left out."""

    studies: Annotated[int, arg(metavar="INT")] = 1000
    """Simulated studies for each number of operators, with the differences and again without."""

    success: Annotated[tuple[str, ...], arg(metavar="NAME=SHARE ...")] = ()
    """Expected success rate of conditions, 0 to 1."""

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
    """Standard deviation of an operator's preference for single conditions. Mode paper has no term
    for it in time and workload, and errs."""

    trials_differ: Annotated[tuple[float, float], arg(metavar="SECONDS POINTS")] = (7.0, 6.0)
    """Standard deviation between trials of time [s], and between questionnaires of workload."""

    per_task: bool = False
    """Analyse each task by itself as well."""

    seed: Annotated[int, arg(metavar="INT")] = 0
    """Seed of all simulated studies: the same seed gives the same figures, with any --workers."""

    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Processes; one for each core if left out."""

    output: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder of the results; STUDY/power if left out, or power without a study."""

    json: bool = False
    """One JSON object on standard output instead of the tables."""


@dataclass(frozen=True, kw_only=True)
class Run(Common):
    """Run a study in the browser: a page for the experimenter, one for the operator's tablet."""

    work: ClassVar[str] = "smooth_operator_study.commands.run:run_study"
    details: ClassVar[
        str
    ] = """The experimenter's page follows the protocol, the operator's shows the
questionnaires. Every event is on disk before a page shows it: server and browsers may be killed
at any time, and continue where they were. Ctrl-C ends.

Examples:
  smooth-operator study run my-study --open
  smooth-operator study run my-study --host 0.0.0.0 --teleop tcp://127.0.0.1:5558 --blind
  smooth-operator study run my-study --operator P03"""

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """Folder of the study."""

    operator: Annotated[str | None, arg(metavar="CODE")] = None
    """The current operator; if left out, the last active one who has not finished."""

    blind: bool = False
    """Show labels instead of conditions. The operator's page never shows either."""

    teleop: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Address of a running teleop --control, which is switched to the condition of each block."""

    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address on which the pages listen; 0.0.0.0 lets other machines in, such as a tablet, by links
    with a token."""

    port: int = 8765
    """Port of the pages; 0 for any free one."""

    open: bool = False
    """Open the experimenter's page in the browser."""


@dataclass(frozen=True, kw_only=True)
class Analyze(Common):
    """Success, time and workload of a study: models, comparisons, learning, a report."""

    work: ClassVar[str] = "smooth_operator_study.commands.analyze:analyze_command"
    details: ClassVar[str] = """STUDY is the folder of a study that was run, or its study.db; or
a folder with trials.csv, tlx.csv and, if there is one, sim_metrics.csv; or such tables by any name
and in any order; or one JSON file of study export. Every value is checked, and
errors are listed by row and column. Columns:
  trials      operator, task, retargeter, block, trial_in_block, trial_global, score, time_s
  tlx         operator, task, retargeter, block, point, and the six scales
  simulation  operator, retargeter, and a column for each metric

In the folder of a given trials.csv, sim_metrics.csv is read too, and the plan from study.json.

Both modes are computed: small-sample (what to report) and paper (as published; right for many
operators only). The plan's baseline and primary endpoint are used. Operators who withdrew and want
their data left out are left out. FOLDER gets results.json, CSV tables, methods.txt, figures/ and
report.html.

Exit status: 0 done, 1 some parts were refused with a reason, 2 the data can't be used.

Examples:
  smooth-operator study analyze trials.csv tlx.csv --baseline dexpilot --output out
  smooth-operator study analyze my-study/ --output out --exclude P03="an author" \\
      --exclude P09="colour-blind"
  smooth-operator study analyze my-study/ --output out --no-report"""

    study: Annotated[Positional[tuple[str, ...]], arg(metavar="STUDY|CSV...")]
    """Folder, database or tables of the study."""

    baseline: Annotated[str | None, arg(metavar="NAME")] = None
    """The retargeter that the others are compared with. If left out, the plan's, or dexpilot
    where the data come without a plan."""

    exclude: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="OPERATOR=REASON")] = ()
    """An operator to leave out, with the reason, which is reported."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write, created if missing."""

    seed: int = 11
    """Seed of the bootstrap over operators."""

    no_report: bool = False
    """Write the results, but no report and no figures."""

    json: bool = False
    """results.json on standard output instead of the conclusion."""

    quiet: bool = False
    """No progress on standard error, no conclusion on standard output."""


Subcommand: TypeAlias = (
    Annotated[New, subcommand("new")]
    | Annotated[Enrol, subcommand("enrol")]
    | Annotated[Power, subcommand("power")]
    | Annotated[Run, subcommand("run")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Metrics, subcommand("metrics")]
    | Annotated[Erase, subcommand("erase")]
    | Annotated[Analyze, subcommand("analyze")]
)
"""The subcommands of the group."""


@dataclass(frozen=True, kw_only=True)
class Study(Group):
    """Plan, run and analyse a user study of retargeters."""

    details: ClassVar[str] = """Examples:
  smooth-operator study new my-study
  smooth-operator study power my-study
  smooth-operator study run my-study --open
  smooth-operator study analyze trials.csv tlx.csv --baseline dexpilot --output out
  smooth-operator study simulate my-study
      virtual operators do the plan; of the distribution research/ (research/docs/study.md)

Each has its own help: smooth-operator study analyze --help"""

    what: Annotated[OmitSubcommandPrefixes[Subcommand], arg(name="")]
    """Subcommand."""

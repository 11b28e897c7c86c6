"""Options of ``smooth-operator study`` and of its subcommands.

To add a subcommand, write its options as a dataclass here and its work in a file of its own (like
``analyze.py``), which is imported when the subcommand runs. Then add one line to ``Subcommand``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeAlias

from tyro.conf import OmitSubcommandPrefixes, Positional, UseAppendAction, arg, subcommand

from smooth_operator.cli.common_options import Common, Group


@dataclass(frozen=True, kw_only=True)
class Stored(Common):
    """Options of the commands about stored data."""

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """Folder of the study, or its study.db."""


@dataclass(frozen=True, kw_only=True)
class Export(Stored):
    """Write the stored data as trials.csv, tlx.csv and study.json (the complete log)."""

    work: ClassVar[str] = "smooth_operator_study.commands.data:export_data"
    details: ClassVar[str] = """Examples:
  smooth-operator study export my-study --output data
  smooth-operator study export my-study --operator P07 --output data-of-P07"""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder for the files."""

    operator: Annotated[tuple[str, ...], arg(metavar="CODE ...")] = ()
    """Operators to export. Default: all."""


@dataclass(frozen=True, kw_only=True)
class Erase(Stored):
    """Delete all data of one operator permanently."""

    work: ClassVar[str] = "smooth_operator_study.commands.data:erase_data"
    details: ClassVar[str] = """The operator is removed from the plan, and the code is not used
again. Exported copies are not deleted.

Example:
  smooth-operator study erase my-study P07 --yes"""

    operator: Annotated[Positional[str], arg(metavar="CODE")]
    """Pseudonym of the operator."""

    yes: bool = False
    """Delete without asking for confirmation."""


@dataclass(frozen=True, kw_only=True)
class Metrics(Stored):
    """Compute simulation metrics per operator and retargeter from the takes of a study."""

    work: ClassVar[str] = "smooth_operator_study.commands.metrics:study_metrics"
    details: ClassVar[str] = """Cuts the recordings of teleop --sink record:STUDY/takes/ to the
counted trials and writes sim_metrics.csv. study analyze correlates these metrics with success, time
and workload: cosine similarity, scale ratio, motion preservation, flatness, workspace utilisation
and latency.

Examples:
  smooth-operator study metrics my-study
  smooth-operator study metrics my-study --takes other/takes --output data/sim_metrics.csv"""

    takes: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder of the recordings. Default: STUDY/takes."""

    output: Annotated[Path | None, arg(metavar="CSV")] = None
    """File of the table. Default: STUDY/sim_metrics.csv."""


@dataclass(frozen=True, kw_only=True)
class New(Common):
    """Write the plan of a study: conditions, tasks, balanced orders, schedule."""

    work: ClassVar[str] = "smooth_operator_study.commands.new:new_study"
    details: ClassVar[str] = """Writes study.toml (the plan, which you may edit), schedule.csv and
PREREGISTRATION.md (hypotheses, design, models, corrections: complete and register it). The defaults
are those of the paper: four retargeters with their authors' settings, 30 commands per second, three
tasks, 18 operators.

Examples:
  smooth-operator study new my-study
  smooth-operator study new my-study --conditions sbr dexpilot ako --baseline dexpilot \\
      --tasks pinch:12 turn:12:8 --operators 15 --primary time/pooled --margin time=3
  smooth-operator study new my-study --from draft.toml"""

    folder: Annotated[Positional[Path], arg(metavar="FOLDER")]
    """Folder of the new study."""

    name: Annotated[str | None, arg(metavar="TEXT")] = None
    """Name of the study. Default: the name of the folder."""

    conditions: Annotated[tuple[str, ...], arg(metavar="NAME[=METHOD[:PRESET]] ...")] = ()
    """Conditions to compare; write only the name if the method has the same name. Default: the four
    of the paper, with the settings of its authors' code."""

    baseline: Annotated[str | None, arg(metavar="NAME")] = None
    """Condition with which the others are compared. Default: dexpilot, or the first condition."""

    primary: Annotated[str | None, arg(metavar="OUTCOME/SCOPE")] = None
    """Primary endpoint: success, time or tlx, then pooled or the name of a task; all other
    endpoints are exploratory. Default: success/pooled."""

    margin: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="OUTCOME=DIFFERENCE")] = ()
    """Difference below which two conditions count as equivalent: success as a fraction, time in
    seconds, tlx in points. Default: 0.1, 5 and 10 with the conditions of the paper, otherwise
    none."""

    tasks: Annotated[tuple[str, ...], arg(metavar="NAME[:TRIALS[:OPERATORS]] ...")] = ()
    """Tasks, with the number of trials per block (default: 10) and the number of operators
    (default: all)."""

    operators: Annotated[int | None, arg(metavar="INT")] = None
    """Number of operators."""

    familiarisation: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Time of free movement before the trials of a block [s]. Default: 120."""

    questionnaires: Annotated[
        tuple[Literal["initial", "midpoint", "final", "none"], ...],
        arg(metavar="initial midpoint final|none"),
    ] = ()
    """NASA-TLX after the first, middle or last trial of a block. Default: all three."""

    no_forms: bool = False
    """Omit the forms (consent, background, closing questionnaire) from the operator's page."""

    seed: Annotated[int | None, arg(metavar="INT")] = None
    """Seed of orders, rows and labels. Default: 0."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Commands per second to the hand in every condition [Hz]. Default: 30 with the conditions of
    the paper, otherwise the rate of the running teleoperation."""

    from_: Annotated[Path | None, arg(name="from", metavar="TOML")] = None
    """File from which to read the plan, in the format of study.toml. Missing orders are
    generated."""

    overwrite: bool = False
    """Replace the plan of a study that has no stored data yet."""


@dataclass(frozen=True, kw_only=True)
class Enrol(Common):
    """Enrol an operator, or add tasks for an operator; assigns the least-used row of orders."""

    work: ClassVar[str] = "smooth_operator_study.commands.new:enrol_operator"
    details: ClassVar[str] = """Examples:
  smooth-operator study enrol my-study P19
  smooth-operator study enrol my-study P03 --tasks C"""

    study: Annotated[Positional[Path], arg(metavar="STUDY")]
    """Folder of the study."""

    operator: Annotated[Positional[str], arg(metavar="CODE")]
    """Pseudonym of the operator; do not use a real name."""

    tasks: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ()
    """Tasks of the operator. Default: all."""


@dataclass(frozen=True, kw_only=True)
class Power(Common):
    """Estimate how many operators are needed, by simulating and analysing studies of a plan."""

    work: ClassVar[str] = "smooth_operator_study.commands.power:simulate_power"
    details: ClassVar[str] = """For each number of operators, simulates studies with the assumed
differences (power) and without differences (family-wise error), and analyses them in both modes.
The default assumptions are the results of the paper for its four methods; other conditions need
--success, --time and --workload. Run the same command again to continue a stopped run or to add new
settings. Writes power.json, power.png and studies.jsonl.

Examples:
  smooth-operator study power my-study
  smooth-operator study power my-study --operators 12 18 24 --success sbr=0.55 dexpilot=0.45
  smooth-operator study power --operators 18 --studies 4000 --output power-of-the-paper"""

    study: Annotated[Positional[Path | None], arg(metavar="STUDY")] = None
    """Folder of the study, or its study.toml. Default: the design of the paper."""

    operators: Annotated[tuple[int, ...], arg(metavar="INT ...")] = ()
    """Numbers of operators to simulate. Default: from a third to twice the planned number."""

    studies: Annotated[int, arg(metavar="INT")] = 1000
    """Number of simulated studies for each number of operators; the same number is simulated
    without differences."""

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
    """Standard deviation between operators: of success on the logit scale (0.6 is about 13
    percentage points of success), of time [s], of workload [points]."""

    preferences_differ: Annotated[
        tuple[float, float, float], arg(metavar="LOGIT SECONDS POINTS")
    ] = (0.3, 2.0, 5.0)
    """Standard deviation of an operator's preference for single conditions. Mode paper has no term
    for it in time and workload, so its p-values are too small."""

    trials_differ: Annotated[tuple[float, float], arg(metavar="SECONDS POINTS")] = (7.0, 6.0)
    """Standard deviation between trials of time [s], and between questionnaires of workload."""

    per_task: bool = False
    """Also analyse each task separately."""

    seed: Annotated[int, arg(metavar="INT")] = 0
    """Seed of all simulated studies: the same seed gives the same results for any number of
    --workers."""

    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Number of processes. Default: one per core."""

    output: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder of the results. Default: STUDY/power, or power without a study."""

    json: bool = False
    """Print one JSON object on standard output instead of the tables."""


@dataclass(frozen=True, kw_only=True)
class Run(Common):
    """Run a study in the browser, with a page for the experimenter and one for the operator's
    tablet."""

    work: ClassVar[str] = "smooth_operator_study.commands.run:run_study"
    details: ClassVar[
        str
    ] = """The experimenter's page guides you through the protocol; the operator's page shows the
questionnaires. Every event is written to disk before a page shows it, so the server and the
browsers may be killed at any time and continue at the same step. Press Ctrl-C to stop.

Examples:
  smooth-operator study run my-study --open
  smooth-operator study run my-study --host 0.0.0.0 --teleop tcp://127.0.0.1:5558 --blind
  smooth-operator study run my-study --operator P03"""

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """Folder of the study."""

    operator: Annotated[str | None, arg(metavar="CODE")] = None
    """Operator to start with. Default: the last active operator who has not finished."""

    blind: bool = False
    """Show labels instead of conditions. The operator's page never shows conditions or labels."""

    teleop: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Address of a running teleop --control; the study switches it to the condition of each
    block."""

    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address on which the pages listen. With 0.0.0.0, other machines, such as a tablet, can
    connect by links with a token."""

    port: int = 8765
    """Port of the pages; 0 chooses any free port."""

    open: bool = False
    """Open the experimenter's page in the browser."""


@dataclass(frozen=True, kw_only=True)
class Analyze(Common):
    """Analyse success, time and workload of a study: models, comparisons, learning effects, a
    report."""

    work: ClassVar[str] = "smooth_operator_study.commands.analyze:analyze_command"
    details: ClassVar[str] = """STUDY is one of: the folder of a study that was run, or its
study.db; a folder with trials.csv, tlx.csv and optionally sim_metrics.csv; such tables under any
names and in any order; a JSON file from study export. Every value is checked, and errors are listed
by row and column. Columns:
  trials      operator, task, retargeter, block, trial_in_block, trial_global, score, time_s
  tlx         operator, task, retargeter, block, point, and the six scales
  simulation  operator, retargeter, and one column per metric

If trials.csv is given, sim_metrics.csv and the plan in study.json are also read from its folder.
Both modes are computed: small-sample (to be reported) and paper (as published; valid only for many
operators). The baseline and the primary endpoint of the plan are used. Operators who withdrew and
asked for their data to be removed are excluded. Writes to FOLDER: results.json, CSV tables,
methods.txt, figures/ and report.html.

Exit status: 0 done, 1 some parts could not be analysed (the reasons are printed), 2 the data can't
be used.

Examples:
  smooth-operator study analyze trials.csv tlx.csv --baseline dexpilot --output out
  smooth-operator study analyze my-study/ --output out --exclude P03="an author" \\
      --exclude P09="colour-blind"
  smooth-operator study analyze my-study/ --output out --no-report"""

    study: Annotated[Positional[tuple[str, ...]], arg(metavar="STUDY|CSV...")]
    """Folder, database or tables of the study."""

    baseline: Annotated[str | None, arg(metavar="NAME")] = None
    """Retargeter with which the others are compared. Default: that of the plan, or dexpilot if the
    data have no plan."""

    exclude: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="OPERATOR=REASON")] = ()
    """Operator to exclude, with the reason, which appears in the report."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write; it is created if missing."""

    seed: int = 11
    """Seed of the bootstrap over operators."""

    no_report: bool = False
    """Write the results without a report and figures."""

    json: bool = False
    """Print results.json on standard output instead of the conclusion."""

    quiet: bool = False
    """Print no progress and no conclusion."""


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
"""Subcommands of the group."""


@dataclass(frozen=True, kw_only=True)
class Study(Group):
    """Plan, run and analyse a user study of retargeters."""

    details: ClassVar[str] = """Examples:
  smooth-operator study new my-study
  smooth-operator study power my-study
  smooth-operator study run my-study --open
  smooth-operator study analyze trials.csv tlx.csv --baseline dexpilot --output out
  smooth-operator study simulate my-study
      let virtual operators carry out the plan (first: pip install
      ./packages/smooth_operator_benchmark ./research; see research/docs/study.md)

Each has its own help: smooth-operator study analyze --help"""

    what: Annotated[OmitSubcommandPrefixes[Subcommand], arg(name="")]
    """Subcommand."""

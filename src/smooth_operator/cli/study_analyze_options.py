"""Options of ``smooth-operator study analyze``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction, arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class Analyze(Common):
    """Success, time and workload of a study: models, comparisons, learning, a report."""

    work: ClassVar[str] = "smooth_operator.cli.study_analyze:analyze_command"
    details: ClassVar[str] = """STUDY is the folder of a study that was run, or its study.db; or
a folder with trials.csv, tlx.csv and, if there is one, sim_metrics.csv; or such tables by any name
and in any order; or one JSON file of study export. Every value is checked, and
errors are listed by row and column. Columns:
  trials      operator, task, retargeter, block, trial_in_block, trial_global, score, time_s
  tlx         operator, task, retargeter, block, point, and the six scales; for --workload
              weighted also weight_mental, weight_physical, ... (times chosen, 15 together)
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
    """The data."""

    name: Annotated[str | None, arg(metavar="TEXT")] = None
    """Name of the study, where a study.db holds several."""

    baseline: Annotated[str | None, arg(metavar="NAME")] = None
    """The retargeter that the others are compared with. If left out, the plan's, or dexpilot
    where the data come without a plan."""

    exclude: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="OPERATOR=REASON")] = ()
    """An operator to leave out, with the reason, which is reported; repeatable."""

    second_rater: Annotated[Path | None, arg(metavar="CSV")] = None
    """Scores by another rater: operator, task, block, trial_in_block, score."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write, created if missing."""

    workload: Literal["raw", "weighted"] = "raw"
    """Mean of the six scales, or weighted by the operators' choices between pairs of them, which
    every block must then have."""

    seed: int = 11
    """Seed of the bootstrap over operators."""

    no_report: bool = False
    """Write the results, but no report and no figures."""

    json: bool = False
    """results.json on standard output instead of the tables."""

    quiet: bool = False
    """No progress on standard error, no tables on standard output."""

"""Options of ``smooth-operator study metrics``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import arg

from smooth_operator.cli.study_data_options import Stored


@dataclass(frozen=True, kw_only=True)
class Metrics(Stored):
    """Simulation metrics by operator and retargeter, from the takes of a study."""

    work: ClassVar[str] = "smooth_operator.cli.study_metrics:study_metrics"
    details: ClassVar[str] = """It cuts the recordings of teleop --sink record:STUDY/takes/ to the
trials that count, and writes sim_metrics.csv, which study analyze correlates with success, time and
workload: cosine similarity, scale ratio, motion preservation, flatness, workspace utilisation and
latency.

Examples:
  smooth-operator study metrics my-study
  smooth-operator study metrics my-study --takes other/takes --output data/sim_metrics.csv"""

    takes: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Where the recordings are; STUDY/takes if left out."""

    output: Annotated[Path | None, arg(metavar="CSV")] = None
    """The table; STUDY/sim_metrics.csv if left out."""

"""Options of ``smooth-operator study export`` and ``study erase``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class Stored(Common):
    """Options of commands about stored data."""

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """Folder of the study, or its study.db."""

    name: Annotated[str | None, arg(metavar="TEXT")] = None
    """Name of the study, where a study.db holds several."""


@dataclass(frozen=True, kw_only=True)
class Export(Stored):
    """What was stored, as trials.csv, tlx.csv and one study.json with the whole log."""

    work: ClassVar[str] = "smooth_operator.cli.study_data:export_data"
    details: ClassVar[str] = """Examples:
  smooth-operator study export my-study --output data
  smooth-operator study export my-study --operator P07 --output data-of-P07"""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Where the files go."""

    operator: Annotated[tuple[str, ...], arg(metavar="CODE ...")] = ()
    """Only of these operators; all if left out."""


@dataclass(frozen=True, kw_only=True)
class Erase(Stored):
    """Deletes all that is stored of one operator, for good."""

    work: ClassVar[str] = "smooth_operator.cli.study_data:erase_data"
    details: ClassVar[str] = """The code stays taken, and the operator is taken off the plan. Copies
that were exported are not touched.

Example:
  smooth-operator study erase my-study P07 --yes"""

    operator: Annotated[Positional[str], arg(metavar="CODE")]
    """Whose data."""

    yes: bool = False
    """Don't ask."""

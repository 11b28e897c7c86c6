"""Options of ``smooth-operator demo``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import arg

from smooth_operator.cli.common_options import Common, Meshes, Page, Retargeting, Synthetic


@dataclass(frozen=True, kw_only=True)
class Demo(Common, Page, Meshes, Retargeting, Synthetic):
    """Retarget a synthetic operator, print the metrics, and play the result in the browser."""

    work: ClassVar[str] = "smooth_operator.cli.demo:demo"
    details: ClassVar[str] = """The folder holds commands.npz and commands.json (the resolved
configuration), log.mcap (operator and commands), metrics.json, config.json, plots/.

Examples:
  smooth-operator demo --no-view --duration 5
  smooth-operator demo --side left --noise 1 --landmark-loss 0.02
"""

    output: Annotated[Path, arg(metavar="FOLDER")] = Path("smooth-operator-demo")
    """Folder to write; the files of an earlier demo in it are replaced."""

    overwrite: bool = False
    """Write into the folder even if it holds other things; those stay."""

    no_view: bool = False
    """Don't serve the page: for machines without a browser."""

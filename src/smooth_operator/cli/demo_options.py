"""Options of ``smooth-operator demo``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import arg

from smooth_operator.cli.common_options import Common, HandSide, Meshes, Page, Retargeting


@dataclass(frozen=True, kw_only=True)
class Demo(Common, Page, Meshes, Retargeting):
    """Retarget a built-in operator, print what was measured, and play it in the browser."""

    details: ClassVar[str] = """The folder holds commands.npz and commands.json (the resolved
configuration), log.mcap (operator and commands), metrics.json, config.json, plots/.

Examples:
  smooth-operator demo --no-view --duration 5
  smooth-operator demo --side left --noise 1 --landmark-loss 0.02
"""

    duration: Annotated[float, arg(metavar="SECONDS")] = 20.0
    """How long the operator moves [s]."""

    output: Annotated[Path, arg(metavar="FOLDER")] = Path("smooth-operator-demo")
    """Folder to write; the files of an earlier demo in it are replaced."""

    overwrite: bool = False
    """Write into the folder even if it holds other things; those stay."""

    no_view: bool = False
    """Don't serve the page: for machines without a browser."""

    side: HandSide = "right"
    """Which hand."""

    rate: Annotated[float, arg(metavar="HZ")] = 100.0
    """Frames a second of the operator's tracker [Hz]."""

    noise: Annotated[float, arg(metavar="MM")] = 0.0
    """Noise of the tracker: standard deviation of each coordinate [mm]."""

    frame_loss: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of frames that the tracker loses, in bursts."""

    landmark_loss: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of landmarks that the tracker loses, in bursts; the last good command is then held."""

    def run(self) -> None:
        """Runs the command."""
        from smooth_operator.cli.demo import demo

        demo(self)

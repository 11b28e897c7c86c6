"""Options of ``smooth-operator view``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Meshes, Ordered, Page


@dataclass(frozen=True, kw_only=True)
class View(Common, Page, Ordered, Meshes):
    """Play joint commands with the hand that they came from, in the browser."""

    work: ClassVar[str] = "smooth_operator.cli.view:view"
    details: ClassVar[
        str
    ] = """Commands and frames are matched by their time stamps. Several files of
commands, of the same frames on the same hand, stand side by side, each under its method's name; the
human hand is aligned as the first method saw it.

Examples:
  smooth-operator view out.npz glove.npz
  smooth-operator view smooth.npz dexpilot.npz glove.npz
  smooth-operator view out.npz glove.npz --model vendor/right_hand.xml
  smooth-operator view smooth.npz sbr.npz glove.npz --frames 500:1200 --save clip.gif
  smooth-operator view smooth-operator-demo/commands.npz smooth-operator-demo/log.mcap
"""

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="OUT.npz... RECORDING")]
    """Commands, as retarget writes them, of one method or of several; then the recording that they
    answer."""

    hand: Annotated[str | None, arg(metavar="NAME")] = None
    """Robot hand; as OUT.json says if left out."""

    fingers: Annotated[str | None, arg(metavar="A,B=C")] = None
    """Robot fingers that were driven, as for retarget; as OUT.json says if left out."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; as OUT.json or the recording says if left out."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of a recording without time stamps; as OUT.json says if left out."""

    save: Annotated[Path | None, arg(metavar="CLIP.gif|CLIP.webp")] = None
    """Write a clip instead of serving the page; --model draws the vendor's meshes."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of the commands, as a Python slice: :500, 2600:3100"""

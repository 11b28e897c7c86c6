"""Options of ``smooth-operator retarget``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Retargeting


@dataclass(frozen=True, kw_only=True)
class Retarget(Common, Retargeting):
    """Turn a recording of a human hand into joint commands."""

    details: ClassVar[str] = """OUT.npz holds joint_positions (T, n) [rad], joint_names (n,),
timestamps (T,) [s], latency_ms (T,) and status (T,); the resolved configuration is
written beside it, as OUT.json.

Examples:
  smooth-operator retarget glove.npz --output out.npz
  smooth-operator retarget landmarks.npy --rate 60 --side left --output out.npz
  smooth-operator retarget glove.npz --frames :500 --preset paper --json --output out.npz
"""

    recording: Annotated[Positional[Path], arg(metavar="RECORDING")]
    """MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or this program's .mcap log."""

    output: Annotated[Path, arg(metavar="OUT.npz")]
    """File to write; its folder is made if need be."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; as the recording says if left out."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames a second of a recording that holds no time stamps [Hz]."""

    json: bool = False
    """Print the metrics as one JSON object on standard output, and nothing else there."""

    def run(self) -> None:
        """Runs the command."""
        from smooth_operator.cli.retarget import retarget

        retarget(self)

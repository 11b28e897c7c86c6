"""Options of ``smooth-operator retarget``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Ordered, Retargeting


@dataclass(frozen=True, kw_only=True)
class Retarget(Common, Ordered, Retargeting):
    """Turn a recording of a human hand, or a folder of them, into joint commands."""

    work: ClassVar[str] = "smooth_operator.cli.retarget:retarget"
    details: ClassVar[str] = """OUT.npz holds joint_positions (T, n) [rad], joint_names (n,),
timestamps (T,) [s], latency_ms (T,) and status (T,); the resolved configuration is
written with it, as OUT.json.

Of a folder, every recording in it, however deep, is retargeted to the same path in the folder
named by --output, several in parallel; latency_ms is then NaN, and summary.json has the result
of each. Run the same command again to go on where it was stopped, or to add new recordings:
what is whole and unchanged is kept, and the bytes are the same as if nothing had happened.

Exit status: 0 done, 1 some recordings of the folder failed (the others are done), 2 the
request is invalid, 130 stopped.

Examples:
  smooth-operator retarget glove.npz --output out.npz
  smooth-operator retarget landmarks.npy --rate 60 --side left --output out.npz
  smooth-operator retarget glove.npz --method sbr --preset paper --json --output out.npz
  smooth-operator retarget recordings/ --workers 8 --output commands/
  smooth-operator retarget /nfs/recordings --cluster auto --output /nfs/commands
"""

    recording: Annotated[Positional[Path], arg(metavar="RECORDING|FOLDER")]
    """MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or this program's .mcap log; or a
    folder of such files."""

    output: Annotated[Path, arg(metavar="OUT.npz|FOLDER")]
    """File to write, or folder of a folder's results; created if missing."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; as the recording says if left out."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of a recording without time stamps [Hz]; in a folder, of those."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Of a folder: how many recordings in parallel; one per core if left out, 0 for one
    after the other in this process."""

    cluster: Annotated[str | None, arg(metavar="auto|local|ADDRESS")] = None
    """Of a folder: work on a running Ray cluster (auto finds it), or start Ray here (local); its
    nodes need this package and the same folders."""

    overwrite: bool = False
    """Of a folder: make again what an earlier run has finished."""

    json: bool = False
    """Print the metrics (of a folder: the summary) as one JSON object on standard output, and
    nothing else there."""

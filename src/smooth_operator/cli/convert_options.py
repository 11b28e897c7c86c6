"""Options of ``smooth-operator convert``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Ordered


@dataclass(frozen=True, kw_only=True)
class Convert(Ordered, Common):
    """Turn recordings and their commands into another file format, and back."""

    work: ClassVar[str] = "smooth_operator.cli.convert:convert"
    details: ClassVar[str] = """Formats, of inputs by what they hold and of the output by its name:
  .mcap        this program's log, opens in Foxglove
  .npz         plain arrays, for NumPy
  .h5, .hdf5   HDF5, with units (extra hdf5)
  a folder     a LeRobot dataset, v3.0 (extra lerobot)
A video (.mp4, .mov, .avi, .mkv, .webm), as input only, is tracked (extra webcam).

All hold everything: hand, flags, commands, status, timing, configuration. What a
format can't hold is reported on standard error.

Several inputs, or a folder of them, become the episodes of one LeRobot dataset; or,
with --to mcap|npz|hdf5, a file each in the folder --output.

Examples:
  smooth-operator convert glove.npz --output glove.mcap
  smooth-operator convert glove.npz --commands out.npz --output demo.mcap
  smooth-operator convert recordings --commands results --task "pinch" --output dataset
  smooth-operator convert dataset --episode 3 --output demo.h5
  smooth-operator convert dataset --to npz --output episodes    (there and back)
  smooth-operator convert clip.mp4 --side right --output clip.npz
"""

    inputs: Annotated[Positional[tuple[Path, ...]], arg(metavar="INPUT...")]
    """Recordings, results, logs, HDF5 files, LeRobot datasets, or folders of these."""

    output: Annotated[Path, arg(metavar="OUT")]
    """What to write; its folder is created if missing."""

    commands: Annotated[Path | None, arg(metavar="OUT.npz")] = None
    """Commands to add to the recording: the result of retargeting it. For several recordings
    the folder of their results, each with the name of its recording."""

    to: Annotated[
        Literal["mcap", "npz", "hdf5", "lerobot"] | None, arg(metavar="mcap|npz|hdf5|lerobot")
    ] = None
    """Format of the output; by its name if left out. Of a dataset into a folder it must be said."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of a recording without time stamps [Hz]; of several recordings or a
    folder, of those."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; as the recording says if left out, and in a video the one seen more often."""

    mirrored: bool = False
    """Of a video: it is mirrored, as selfie views are."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each episode, as a Python slice: :500, 2600:3100, -500:"""

    task: Annotated[str | None, arg(metavar="TEXT")] = None
    """What is being done, in words; as the input says if left out."""

    fps: Annotated[int | None, arg(metavar="N")] = None
    """Frames a second of a LeRobot dataset; the median of the recordings, rounded, if left out."""

    episode: Annotated[int | None, arg(metavar="N")] = None
    """Of a LeRobot dataset only this episode."""

    overwrite: bool = False
    """Replace an output that this program wrote."""

    quiet: bool = False
    """Print important messages only."""

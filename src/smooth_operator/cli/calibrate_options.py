"""Options of ``smooth-operator calibrate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Ordered


@dataclass(frozen=True, kw_only=True)
class Calibrate(Ordered, Common):
    """Fit a robot hand to its operator: poses found in a recording, into a file for --operator."""

    work: ClassVar[str] = "smooth_operator.cli.calibrate:calibrate_recording"
    details: ClassVar[
        str
    ] = """With --source the operator is asked for the poses, one after the other.
A recording should show, for some seconds each and in any order, a flat hand, the fingers
spread, a fist, and a pinch of the thumb with each finger. Missing poses are reported, and
the rest is calibrated. With OPERATOR.json come OPERATOR.png (the poses on a time
line; reach and pinches before and after) and OPERATOR.report.json (the same as figures).

Parts of a calibration (--apply names those that the file uses):
  scale    one scale of the palm instead of one a frame
  tips     from the tracker's tip landmark to the pad
  pinch    the distance left in a pinch is closed; latches at the operator's distances
  fingers  each finger's reach to the robot's
  palm     the flat hand's direction to that of the robot's straight fingers
All are found and written in any case.

Examples:
  smooth-operator calibrate glove.npz --output operator.json
  smooth-operator calibrate --source webcam --output operator.json
  smooth-operator retarget glove.npz --operator operator.json --output out.npz
  smooth-operator calibrate glove.npz --hand shadow_hand --frames :2500 --output operator.json
"""

    recording: Annotated[Positional[Path | None], arg(metavar="RECORDING")] = None
    """The operator's hand: MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or .mcap; not with
    --source."""

    source: Annotated[str | None, arg(metavar="NAME[:SETTINGS]")] = None
    """A live source instead of a recording, as for teleop: poses are asked for one after the
    other, under a minute in all."""

    output: Annotated[Path, arg(metavar="OPERATOR.json")]
    """File to write; an earlier calibration there is replaced."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; as the recording says if left out, and right for a source."""

    fingers: Annotated[str | None, arg(metavar="A,B=C")] = None
    """Robot fingers that will be driven, as for retarget; all if left out."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of a recording without time stamps [Hz]."""

    apply: Annotated[str | None, arg(metavar="A,B|all")] = None
    """Parts that the file shall use; see above. The ones that lower pinch error and scale error
    where they were measured, if left out."""

    json: bool = False
    """Print the report as one JSON object on standard output, and nothing else there."""

    quiet: bool = False
    """No progress on standard error."""

"""Settings that all kinds of retargeting share. Commands parse them, and library functions take
them as arguments."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

from tyro.conf import arg

from smooth_operator.errors import HandModelError
from smooth_operator.retargeting.registry import DEFAULT_METHOD, METHODS

METHOD_HELP: Final = (
    f"Retargeting method: {', '.join(METHODS)}; or package.module:NAME for your own method "
    "(docs/how-to/plugins.md)."
)
PRESET_HELP: Final = (
    "Preset of the method. Default: the first one listed here. "
    + "; ".join(f"{name}: {entry.summary}" for name, entry in METHODS.items())
    + ". Any method also accepts a preset file (docs/how-to/tune.md)."
)
PINCH_GAPS_HELP: Final = (
    "Correction of the gap that a tracker reports between thumb and finger when they touch. The "
    "method smooth estimates it while the operator works. tracker: start with the known gaps of "
    "the source's tracker (only webcam and video have some). mediapipe: start with MediaPipe's "
    "gaps. off: use the landmarks unchanged."
)

Scale: TypeAlias = float | Literal["frame", "calibrate"]
"""Ratio of robot size to human size: a number, estimated per frame, or calibrated once per
recording."""

PinchGapChoice: TypeAlias = Literal["tracker", "mediapipe", "off"]
"""Initial values of the estimated pinch gaps: those of the live source's tracker, if they are
known; those of MediaPipe; or off, to use the landmarks unchanged.
"""

WristJointChoice: TypeAlias = Literal["auto", "on", "off"]
"""Whether the wrist joints of a hand follow the operator's wrist; auto: unless the pose of the
wrist as a whole is for an arm."""


@dataclass(frozen=True, kw_only=True)
class MethodRequest:
    """A robot hand and the method that drives it, as the user named them."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Name of the robot hand."""

    method: Annotated[str, arg(metavar="NAME", help=METHOD_HELP)] = DEFAULT_METHOD

    preset: Annotated[str | None, arg(metavar="NAME", help=PRESET_HELP)] = None

    seed: int = 0
    """Seed of all random numbers: the same seed and frames give the same commands."""

    scale: Annotated[Scale | None, arg(metavar="frame|calibrate|FLOAT")] = None
    """Robot/human size ratio: frame (estimated in each frame), calibrate (once per recording), or a
    number. Default: from the preset."""

    fingers: Annotated[str | None, arg(metavar="A,B=C")] = None
    """Robot fingers to drive (two to five, including the thumb). thumb,index,pinky=ring drives the
    robot's pinky with the human ring finger. Default: all."""

    operator: Annotated[Path | None, arg(metavar="OPERATOR.json")] = None
    """Operator file, written by calibrate or teleop."""

    pinch_gaps: Annotated[PinchGapChoice, arg(help=PINCH_GAPS_HELP)] = "tracker"

    def settings(self) -> dict[str, Any]:
        """Returns the settings by name, as arguments for ``make_request``."""
        return {each.name: getattr(self, each.name) for each in fields(MethodRequest)}


def parse_fingers(text: str) -> dict[str, str]:
    """Parses a choice of fingers: in ``thumb,index,pinky=ring``, the human ring finger drives the
    robot's pinky. Raises HandModelError if an entry is empty, or a finger is named twice."""
    choice: dict[str, str] = {}
    for part in text.split(","):
        robot, sign, human = (word.strip() for word in part.partition("="))
        if not robot or (sign and not human):
            raise HandModelError(
                f"{text!r} is not a list of fingers; expected names of robot fingers separated by "
                "commas, each optionally followed by '=' and the human finger that drives it: "
                "thumb,index,pinky=ring"
            )
        if robot in choice:
            raise HandModelError(f"{text!r} names the finger {robot!r} twice")
        choice[robot] = human or robot
    return choice

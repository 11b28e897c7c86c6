"""Settings that every retargeting shares: the commands parse them, and the library takes them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

from tyro.conf import arg

from smooth_operator.retargeting.registry import DEFAULT_METHOD, METHODS

METHOD_HELP: Final = (
    f"Retargeting method: {', '.join(METHODS)}; or package.module:NAME of your own "
    "(docs/how-to/plugins.md)."
)
PRESET_HELP: Final = (
    "Preset of the method. Default: its first one. "
    + "; ".join(f"{name}: {entry.summary}" for name, entry in METHODS.items())
    + ". Any method also accepts a preset file (docs/how-to/tune.md)."
)
PINCH_GAPS_HELP: Final = (
    "smooth closes the gap that a tracker leaves between thumb and finger where they touch, and "
    "estimates it while one works. tracker starts with the gaps of the source's tracker, if they "
    "are known (webcam and video); mediapipe with those of MediaPipe, for a recording of it; off "
    "takes landmarks as they are tracked."
)

Scale: TypeAlias = float | Literal["frame", "calibrate"]
"""Robot size over human size: a number, by frame, or calibrated once on the recording."""

PinchGapChoice: TypeAlias = Literal["tracker", "mediapipe", "off"]
"""Gaps between thumb and finger with which the running estimate starts: those of the live source's
tracker, if they are known; those of MediaPipe; or off, for landmarks as they are tracked."""


@dataclass(frozen=True, kw_only=True)
class MethodRequest:
    """A robot hand and how it is driven, as a user says it."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name."""

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
    """What is known of the operator, as calibrate and teleop write it."""

    pinch_gaps: Annotated[PinchGapChoice, arg(help=PINCH_GAPS_HELP)] = "tracker"

    def settings(self) -> dict[str, Any]:
        """The settings by name, as ``make_request`` takes them."""
        return {each.name: getattr(self, each.name) for each in fields(MethodRequest)}

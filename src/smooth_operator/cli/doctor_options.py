"""Options of ``smooth-operator doctor``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from tyro.conf import arg

from smooth_operator.cli.common_options import METHOD_HELP, PRESET_HELP, Common, HandSide, Quiet
from smooth_operator.methods.registry import DEFAULT_METHOD


@dataclass(frozen=True, kw_only=True)
class Doctor(Common, Quiet):
    """Measure start-up and frame time on this machine, and suggest fixes."""

    work: ClassVar[str] = "smooth_operator.cli.doctor:doctor"
    details: ClassVar[str] = """Prints the machine, versions, extras, priority and the folder of
compiled programs; then measures, for one hand and method, the start of a fresh process, its parts,
and the time of a frame. The exit status is 0 whatever was found.

Examples:
  smooth-operator doctor
  smooth-operator doctor --hand leap_hand --method sbr --json"""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name, or the path of a spec file."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: right, or the side of the spec file."""

    method: Annotated[str, arg(metavar="NAME", help=METHOD_HELP)] = DEFAULT_METHOD

    preset: Annotated[str | None, arg(metavar="NAME", help=PRESET_HELP)] = None

    frames: int = 500
    """Frames that are timed, of the built-in operator."""

    json: bool = False
    """One JSON object on standard output instead of the tables."""

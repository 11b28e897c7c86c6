"""Options of ``smooth-operator doctor``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """Check this machine, its extras and settings, and suggest fixes."""

    work: ClassVar[str] = "smooth_operator.cli.doctor:doctor"
    details: ClassVar[str] = """Prints the machine, versions, extras, priority and the folder of
compiled programs. The exit status is always 0. To measure the time of a frame, use `bench`.

Examples:
  smooth-operator doctor
  smooth-operator doctor --json"""

    json: bool = False
    """Print one JSON object on standard output instead of the table."""

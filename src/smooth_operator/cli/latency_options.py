"""Options of ``smooth-operator latency``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class Latency(Common):
    """Print how long every stage took, from a log that teleop recorded."""

    work: ClassVar[str] = "smooth_operator.cli.latency:latency"
    details: ClassVar[str] = """Stages of a frame:
  tracker  how much later it came than the fastest of the last seconds; the clocks of tracker and
           computer are not compared, so a delay that never changes can't be seen
  receive  from its arrival until the loop took it
  solve    alignment and retargeting, one compiled program
  limit    limits of position, velocity and acceleration, coupled joints
  send     until every sink had the command
The sum of the last four is what the loop adds.

Examples:
  smooth-operator teleop --sink record:take.mcap --duration 60
  smooth-operator latency take.mcap --plot latency.png
  smooth-operator latency take.right.mcap take.left.mcap --json
"""

    logs: Annotated[Positional[tuple[Path, ...]], arg(metavar="RECORD.mcap")]
    """Logs, as the sink record writes them."""

    plot: Annotated[Path | None, arg(metavar="FILE.png")] = None
    """Plot the latencies over time and their distribution."""

    json: bool = False
    """Print one JSON object on standard output, by log, and nothing else there."""

"""``smooth-operator latency``: prints the timing of a recorded run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common
from smooth_operator.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Latency(Common):
    """Print how long each stage of the loop took in a run recorded with teleop."""

    work: ClassVar[str] = "smooth_operator.cli.latency:latency"
    details: ClassVar[str] = """Stages of a frame:
  tracker  delay compared with the fastest frame of the last seconds; a constant delay can't
           be measured, because the clocks of tracker and computer are not compared
  receive  from the arrival of the frame until the loop takes it
  solve    alignment and retargeting, one compiled program
  limit    position, velocity and acceleration limits, coupled joints
  send     until every sink has received the command
  contact  age of the newest finger contact that --feedback sends
The sum of receive, solve, limit and send is the delay that the loop adds.

Examples:
  smooth-operator teleop --sink record:take.mcap --duration 60
  smooth-operator latency take.mcap
  smooth-operator latency take.right.mcap take.left.mcap --json
"""

    logs: Annotated[Positional[tuple[Path, ...]], arg(metavar="RECORD.mcap")]
    """Logs that the sink record of teleop wrote."""

    json: bool = False
    """Print only one JSON object on standard output, with one entry per log."""


_SHOWN: Final = ("p50", "p95", "p99", "max")


def latency(options: Latency) -> None:
    """Prints a table for each log, or JSON."""
    from smooth_operator.io.jsonable import to_json
    from smooth_operator.teleop.recording import read_log
    from smooth_operator.teleop.runtime.statistics import log_timing

    if not options.logs:
        raise ConfigError("name at least one log: smooth-operator latency take.mcap")
    timings = {path: log_timing(read_log(path)) for path in options.logs}
    if options.json:
        print(to_json({str(path): timing for path, timing in timings.items()}))
    else:
        for path, timing in timings.items():
            _print(path, timing)


def _print(path: Path, timing: Mapping[str, Any]) -> None:
    from smooth_operator.cli.console import output_console, plain_table
    from smooth_operator.errors import counted

    console = output_console()
    rows = {**timing["stages_ms"], "added: received to sent": timing.get("added_latency_ms", {})}
    rows["between commands"] = timing.get("interval_ms", {})
    rows = {name: row for name, row in rows.items() if row} or {"method": timing["method_ms"]}
    cells = (
        (name, *(f"{row[key]:.2f}" if key in row else "–" for key in _SHOWN))
        for name, row in rows.items()
    )
    console.print(plain_table(str(path), ("[ms]", *_SHOWN), cells, left=1))
    parts = [counted(timing["commands"], "command")]
    if "rate_hz" in timing:
        parts.append(f"{timing['frames_answered']} of them computed from new frames")
        parts.append(f"{timing['duration_s']:.1f} s at {timing['rate_hz'] or 0:.1f} Hz")
        if "contact_rate_hz" in timing:
            parts.append(f"contact measured at {timing['contact_rate_hz']:.1f} Hz")
        parts += [f"{mode} {100 * share:.1f} %" for mode, share in timing["mode_share"].items()]
    console.print(", ".join(parts), markup=False)
    for event, count in timing.get("events", {}).items():
        console.print(f"  {count:6d} × {event}", markup=False)
    if timing["truncated"]:
        console.print("the end of the log is missing; the times are those of the part that exists")

"""``smooth-operator teleop``: a teleoperation with a page and keys in the terminal."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import ClassVar, Literal

from smooth_operator.cli.common_options import Common, Meshes, Page
from smooth_operator.errors import ConfigError
from smooth_operator.teleop.components import SINKS, SOURCES
from smooth_operator.teleop.request import TeleopRequest


@dataclass(frozen=True, kw_only=True)
class Teleop(Common, Meshes, Page, TeleopRequest):
    """Drive a robot hand from a live source: a tracker, a headset, a webcam, a recording."""

    work: ClassVar[str] = "smooth_operator.cli.teleop:teleop"
    details: ClassVar[str] = f"""Examples:
  smooth-operator teleop
  smooth-operator teleop --source webcam --hand leap_hand --sink mujoco record:take.mcap
  smooth-operator teleop --source replay:glove.npz,speed=2 --sink zmq:tcp://127.0.0.1:5556

Sources:
{SOURCES.describe()}

Sinks, one or several:
{SINKS.describe()}

Space, Esc and x stop the robot; u releases the stop, p pauses and resumes, c releases and
engages the wrist, q or Ctrl-C ends. The page has the same keys."""
    more: ClassVar[str] = """Settings of a source or sink follow its name: replay:glove.npz,speed=2.
Your own class is named package.module:Class in the same way: mylab.driver:MySink,port=7
(docs/how-to/plugins.md).

Without tracker frames the hand holds, then moves to its neutral pose; when the operator
is back it returns smoothly. Joint ranges, velocities and accelerations are always limited.
With a tracker of the wrist, the robot's wrist moves as the operator's has moved since it was
engaged: pause, move back, resume.

Exit status: 0 done, 1 a sink failed (the summary says which), 2 something can't be opened,
130 stopped by Ctrl-C or another signal."""
    rare: ClassVar[frozenset[str]] = frozenset({
        "port", "no_meshes", "model", "debug", "trials", "seed", "fingers", "pinch_gaps",
        "priority", "methods", "control", "blind", "task", "safety", "limits", "wrist", "quiet",
    })  # fmt: skip

    priority: Literal["high", "normal"] = "high"
    """Whether the loop takes real-time priority, if the system allows it; what it got is in
    the summary (docs/how-to/teleoperate.md)."""

    no_view: bool = False
    """Don't serve the page: for machines without a browser."""

    json: bool = False
    """Print the summary as one JSON object on standard output, and nothing else there."""

    quiet: bool = False
    """Print only important messages on standard error."""

    def extras(self) -> dict[str, tuple[str, ...]]:
        """For the page and the arm; sources and sinks name their own."""
        page = () if self.no_view else ("viser", "trimesh", "matplotlib", "jinja2")
        return {"teleop": page} if self.arm is None else {"arm": ("mink", "daqp", *page)}


def teleop(options: Teleop) -> None:
    """Runs a teleoperation, with keys in the terminal and what happens on standard error."""
    from smooth_operator.cli.console import Progressing
    from smooth_operator.compilation.start import start_jax
    from smooth_operator.retargeting.presets import method_config
    from smooth_operator.teleop.run import PageSettings, teleoperate

    if options.no_view and options.model is not None:
        raise ConfigError(
            "--model says what the page draws, and --no-view leaves the page out; leave out one"
        )
    page = PageSettings(
        options.host,
        options.port,
        open_browser=not options.no_browser,
        model=options.model,
        meshes=not options.no_meshes,
    )
    start_jax(one_thread=method_config(options.method, options.preset).one_thread)
    summary = teleoperate(
        options,
        page=None if options.no_view else page,
        keys=True,
        reporter=Progressing(options.quiet),
    )
    if options.json:
        print(json.dumps(summary))
    if summary["interrupted"]:
        raise KeyboardInterrupt
    if any(sink["failed"] for sink in summary["sinks"]):
        raise SystemExit(1)

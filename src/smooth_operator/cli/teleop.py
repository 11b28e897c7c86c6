"""``smooth-operator teleop``: runs a teleoperation with a page, and with keys in the terminal."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import ClassVar, Literal

from smooth_operator.cli.common_options import Common, Meshes, Page
from smooth_operator.errors import ConfigError
from smooth_operator.teleop.components import SINKS, SOURCES
from smooth_operator.teleop.control.bindings import action_table
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

Keys, also on the page: Space, Esc and x stop the robot; u releases the stop; p pauses and resumes;
c toggles the wrist clutch; r records; q or Ctrl-C ends the run. --bind changes and adds inputs."""
    more: ClassVar[str] = f"""Actions for --bind and their inputs:
{action_table()}

Settings of a source or sink follow its name: replay:glove.npz,speed=2.
To use your own class, write package.module:Class instead of a name: mylab.driver:MySink,port=7
(docs/how-to/plugins.md).

Without tracker frames, the hand holds its pose, then moves to its neutral pose; when frames arrive
again, it returns smoothly. Joint positions, velocities and accelerations are always limited. If the
tracker measures the wrist, the robot's wrist repeats the motion that the operator's wrist has made
since the clutch was engaged. To move further than your arm reaches: pause, move your hand back,
resume.

Exit status: 0 done, 1 a sink failed (the summary says which), 2 a source, sink or other part can't
be opened, 130 stopped by Ctrl-C or another signal."""
    rare: ClassVar[frozenset[str]] = frozenset(
        {
            "camera",
            "port",
            "pedal",
            "wrist_source",
            "no_meshes",
            "model",
            "debug",
            "trials",
            "seed",
            "fingers",
            "pinch_gaps",
            "priority",
            "methods",
            "control",
            "blind",
            "task",
            "safety",
            "limits",
            "wrist",
            "wrist_joints",
            "quiet",
        }
    )

    priority: Literal["high", "normal"] = "high"
    """Scheduling priority that the loop requests. The summary says which priority the system
    granted (docs/how-to/teleoperate.md)."""

    no_view: bool = False
    """Do not serve the page."""

    json: bool = False
    """Print only the summary, as one JSON object."""

    quiet: bool = False
    """Print only important messages on standard error."""

    def extras(self) -> dict[str, tuple[str, ...]]:
        """Extras that the page and the arm need; sources and sinks name their own."""
        page = () if self.no_view else ("viser", "trimesh", "matplotlib", "jinja2")
        return {"teleop": page} if self.arm is None else {"arm": ("mink", "daqp", *page)}


def teleop(options: Teleop) -> None:
    """Runs a teleoperation, with keys in the terminal and progress on standard error."""
    if any(camera.partition(",")[0] == "mujoco" for camera in options.camera):
        from smooth_operator.simulation.renderer import draw_off_screen

        draw_off_screen()
    from smooth_operator.cli.console import Progressing
    from smooth_operator.retargeting.preset_files import method_config
    from smooth_operator.retargeting.start import start_jax
    from smooth_operator.teleop.run import PageSettings, teleoperate

    if options.no_view and options.model is not None:
        raise ConfigError(
            "--model sets what the page draws, but --no-view disables the page; remove one of them"
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

"""``smooth-operator teleop``: its options, and their way into a call of ``teleoperate``."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, fields
from inspect import signature
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import arg

from smooth_operator.cli.common_options import (
    METHOD_HELP,
    PINCH_GAPS_HELP,
    Common,
    Meshes,
    Page,
    PinchGapChoice,
)
from smooth_operator.errors import ConfigError
from smooth_operator.retargeting.registry import DEFAULT_METHOD
from smooth_operator.teleop.components import SINKS, SOURCES
from smooth_operator.teleop.runtime.settings import LimitsConfig, SafetyConfig, WristConfig


@dataclass(frozen=True, kw_only=True)
class Teleop(Common, Meshes, Page):
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

    source: Annotated[str, arg(metavar="NAME[:SETTINGS]")] = "synthetic"
    """Where hand frames come from."""

    sink: Annotated[tuple[str, ...], arg(metavar="NAME[:SETTINGS]")] = ()
    """Where commands go; the page shows them in any case."""

    task: Literal["card", "cube", "screwdriver"] | None = None
    """A task of the study, in a simulation around the hand: card pickup, vertical cube rotation,
    screwdriver pivot. Keys: g starts a trial, r puts the object back, d ends it. --control has
    messages for the same."""

    arm: Annotated[str | None, arg(metavar="NAME[:SETTINGS]")] = None
    """An arm that carries the hand and follows the operator's wrist (extra arm): panda, ur5e,
    xarm7 or iiwa14. Settings: adapter=0.02 [m], roll=90 [degrees], spacing=1.0 between two arms,
    table=0.0 [m], no_table=true, collisions=false (docs/robots/arms.md)."""

    trials: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Keep a record of every trial of the task here."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name."""

    side: Annotated[Literal["right", "left", "both"] | None, arg(metavar="right|left|both")] = None
    """Hand side; both drives two robot hands from the operator's two hands. Default: right, or the
    only side that the robot hand has."""

    method: Annotated[str, arg(metavar="NAME", help=METHOD_HELP)] = DEFAULT_METHOD

    preset: Annotated[str | None, arg(metavar="NAME")] = None
    """Preset of the method. Default: its first one."""

    seed: int = 0
    """Seed of all random numbers."""

    scale: Annotated[float | Literal["frame"] | None, arg(metavar="frame|FLOAT")] = None
    """Robot/human size ratio: frame (estimated in each frame) or a number. Default: from the
    preset."""

    fingers: Annotated[str | None, arg(metavar="A,B=C")] = None
    """Robot fingers to drive, each by its own human finger or by another:
    thumb,index,pinky=ring."""

    operator: Annotated[Path | None, arg(metavar="OPERATOR.json")] = None
    """File of what is known of the operator, as calibrate writes it; the run writes it anew at its
    end, and makes it if there is none."""

    pinch_gaps: Annotated[PinchGapChoice, arg(help=PINCH_GAPS_HELP)] = "tracker"

    rate: Annotated[float, arg(metavar="HZ")] = 100.0
    """Commands per second and hand [Hz]: an upper bound with a fast tracker, and the rate
    of held commands without frames."""

    duration: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Length of the run [s]. Default: until the source ends."""

    safety: SafetyConfig = field(default_factory=SafetyConfig)
    """Behaviour when the tracker fails and when the operator comes back."""

    limits: LimitsConfig = field(default_factory=LimitsConfig)
    """Limits of the commands that leave the loop."""

    wrist: WristConfig = field(default_factory=WristConfig)
    """The clutch: how the robot's wrist follows the operator's, with trackers that have one. Its
    pose goes to the sinks with the fingers."""

    priority: Literal["high", "normal"] = "high"
    """Whether the loop takes real-time priority, if the system allows it; what it got is in
    the summary (docs/how-to/teleoperate.md)."""

    methods: Annotated[tuple[str, ...], arg(metavar="METHOD[:PRESET] ...")] = ()
    """Further methods (sbr smooth:precise) compiled before the loop starts, as --method is then: a
    switch then takes no time. Else the loop shows the hand and holds the robot while a method
    is compiled (docs/how-to/teleoperate.md)."""

    control: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Accept messages of other programs on this ZeroMQ address, such as tcp://127.0.0.1:5558 (extra
    zmq): a pedal, a red button, a study's console. They are stop, release, pause, resume, quit,
    status, method, calibration, task, trial and reset."""

    estop: Annotated[str | None, arg(metavar="INPUT")] = None
    """Emergency stop from outside: file:PATH (released while the file begins with 1, as a GPIO
    line), serial:PORT (a normally closed button between RTS and CTS) or udp:PORT (a heartbeat).
    A broken wire stops (docs/robots/index.md)."""

    blind: bool = False
    """Hide the method from the operator: neither the page nor the terminal names it, and
    the page can't change it. The record has it."""

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
    shared = signature(teleoperate).parameters.keys() & {each.name for each in fields(options)}
    summary = teleoperate(
        **{name: getattr(options, name) for name in shared},
        sinks=options.sink,
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

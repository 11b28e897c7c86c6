"""The request of a teleoperation: the command parses it, and ``teleoperate`` takes it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from smooth_operator.request import MethodRequest
from smooth_operator.teleop.runtime.settings import LimitsConfig, SafetyConfig, WristConfig


@dataclass(frozen=True, kw_only=True)
class TeleopRequest(MethodRequest):
    """Source, sinks, robot hand and limits of a teleoperation, in text and numbers."""

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

    side: Annotated[Literal["right", "left", "both"] | None, arg(metavar="right|left|both")] = None
    """Hand side; both drives two robot hands from the operator's two hands. Default: right, or the
    only side that the robot hand has."""

    scale: Annotated[float | Literal["frame"] | None, arg(metavar="frame|FLOAT")] = None
    """Robot/human size ratio: frame (estimated in each frame) or a number. Default: from the
    preset."""

    operator: Annotated[Path | None, arg(metavar="OPERATOR.json")] = None
    """File of what is known of the operator, as calibrate writes it; the run writes it anew at its
    end, and makes it if there is none."""

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

    priority: Literal["high", "normal"] = "normal"
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

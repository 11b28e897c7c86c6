"""Settings of a teleoperation run, which the command line parses and ``teleoperate`` takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from smooth_operator.request import MethodRequest, WristJointChoice
from smooth_operator.teleop.runtime.settings import LimitsConfig, SafetyConfig, WristConfig


@dataclass(frozen=True, kw_only=True)
class TeleopRequest(MethodRequest):
    """Request for a teleoperation: source, sinks, robot hand and limits, as text and numbers."""

    source: Annotated[str, arg(metavar="NAME[:SETTINGS]")] = "synthetic"
    """Source of the hand frames."""

    wrist_source: Annotated[str | None, arg(metavar="NAME[:SETTINGS]")] = None
    """Second source, from which only the wrist is taken, such as a tracker on a glove
    (docs/how-to/trackers.md). The operator file says where that tracker sits on the hand."""

    sink: Annotated[tuple[str, ...], arg(metavar="NAME[:SETTINGS]")] = ()
    """Sinks that receive the commands, besides the page."""

    feedback: Annotated[tuple[str, ...], arg(metavar="NAME[:SETTINGS]")] = ()
    """Where to send finger contacts: zmq:ADDRESS, udp:HOST:PORT, webxr, isaac
    (docs/how-to/feedback.md)."""

    camera: Annotated[tuple[str, ...], arg(metavar="CAMERA[,SETTINGS]")] = ()
    """Cameras whose pictures the page and the headset show (webcam extra): a number or device, the
    address of an MJPEG stream, or mujoco, which looks at the simulated hand
    (docs/how-to/live-page.md)."""

    task: Literal["card", "cube", "screwdriver", "relocate", "hammer", "tongs"] | None = None
    """Task to simulate around the hand: card pickup, vertical cube rotation or screwdriver pivot;
    relocate, hammer and tongs need --arm (docs/how-to/user-study.md). Keys: g starts a trial, r
    resets the object, d ends the trial. --control accepts messages for the same actions."""

    arm: Annotated[str | None, arg(metavar="NAME[:SETTINGS]")] = None
    """Arm that carries the hand and follows the operator's wrist (arm extra): panda, ur5e, xarm7,
    iiwa14, so101, or a URDF or MJCF file with tip=LINK. Settings: adapter=0.02 (thickness [m]),
    roll=90 (of the hand [degrees]), spacing=1.0 (of two arms [m]), table=0.0 (height [m]),
    no_table=true, collisions=false (docs/robots/arms.md)."""

    wrist_joints: WristJointChoice = "auto"
    """Whether the robot hand's wrist joints, if it has any, follow the operator's wrist
    (docs/how-to/teleoperate.md). auto: on, but off with --arm or --task."""

    trials: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder for the records of all trials."""

    side: Annotated[Literal["right", "left", "both"] | None, arg(metavar="right|left|both")] = None
    """Hand side; both drives two robot hands. Default: right, or the robot hand's only side."""

    preset: Annotated[str | None, arg(metavar="NAME")] = None
    """Preset of the method. Default: its first preset."""

    scale: Annotated[float | Literal["frame"] | None, arg(metavar="frame|FLOAT")] = None
    """Robot/human size ratio: frame (estimated in each frame) or a number. Default: from the
    preset."""

    operator: Annotated[Path | None, arg(metavar="OPERATOR.json")] = None
    """Operator file written by calibrate; updated at the end of the run."""

    rate: Annotated[float, arg(metavar="HZ")] = 100.0
    """Maximum command rate for each hand [Hz]; also the rate at which commands are sent while no
    frames arrive."""

    duration: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Length of the run [s]. Default: until the source ends."""

    safety: SafetyConfig = field(default_factory=SafetyConfig)
    """Behaviour when the tracker fails and when the operator comes back."""

    limits: LimitsConfig = field(default_factory=LimitsConfig)
    """Limits on the commands that the loop sends."""

    wrist: WristConfig = field(default_factory=WristConfig)
    """Clutch between the operator's wrist and the robot's, for trackers that measure the wrist. The
    wrist pose is sent to the sinks together with the joint positions."""

    priority: Literal["high", "normal"] = "normal"
    """Scheduling priority that the loop requests. The summary says which priority the system
    granted (docs/how-to/teleoperate.md)."""

    methods: Annotated[tuple[str, ...], arg(metavar="METHOD[:PRESET] ...")] = ()
    """Further methods (sbr smooth:precise) to compile before the loop starts, so that switching to
    them takes no time. The method of --method is then compiled before the start, too. Otherwise the
    loop holds the robot while a method is compiled (docs/how-to/teleoperate.md)."""

    control: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """ZeroMQ address on which to accept messages from other programs, such as tcp://127.0.0.1:5558
    (needs the zmq extra), for example from a pedal, a red button or a study console. The messages
    are stop, release, pause, resume, quit, status, method, calibration, task, trial and reset."""

    bind: Annotated[tuple[str, ...], arg(metavar="ACTION=INPUT")] = ()
    """Input for an action: a key (record=b), a pinch of the other hand (pause=pinch:index), a pedal
    or a button; or a FILE.toml (docs/how-to/teleoperate.md)."""

    pedal: Annotated[Path | None, arg(metavar="DEVICE")] = None
    """Input device of a foot pedal on Linux, such as /dev/input/by-id/usb-...-event-kbd. Its keys
    work whichever window has focus, and do not type anything."""

    estop: Annotated[str | None, arg(metavar="INPUT")] = None
    """External emergency stop: file:PATH (released while the file begins with 1), serial:PORT (a
    normally closed button) or udp:PORT (a heartbeat). A broken wire also stops the robot
    (docs/robots/index.md)."""

    blind: bool = False
    """Hide the method from the operator: the page and the terminal do not name it, and the page
    can't change it. Recordings still contain it."""

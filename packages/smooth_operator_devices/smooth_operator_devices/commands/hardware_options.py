"""Options of ``smooth-operator hardware`` and of its subcommands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, TypeAlias

from tyro.conf import OmitSubcommandPrefixes, Positional, arg, subcommand

from smooth_operator.cli.common_options import Common, Group, HandSide


@dataclass(frozen=True, kw_only=True)
class List(Common):
    """List the drivers of real hands, the tables of their actuators, and the serial ports of this
    machine."""

    work: ClassVar[str] = "smooth_operator_devices.commands.hardware:list_hardware"
    details: ClassVar[str] = """Your own tables are files NAME_SIDE.toml in the folder that is
printed below; they take precedence over the built-in ones.

Example:
  smooth-operator hardware list"""

    json: bool = False
    """Print one JSON object on standard output instead of the tables."""


@dataclass(frozen=True, kw_only=True)
class _OneDevice(Common):
    """Options of the subcommands for one real hand."""

    device: Annotated[Positional[str], arg(metavar="DRIVER:PORT")]
    """The real hand, written as for teleop --sink: leap:/dev/ttyUSB0, orca,
    inspire:192.168.11.210."""

    side: Annotated[HandSide, arg(metavar="right|left")] = "right"
    """Hand side."""

    hand: Annotated[str | None, arg(metavar="NAME")] = None
    """Catalogue name of the robot hand. Default: the hand of the table."""


@dataclass(frozen=True, kw_only=True)
class Check(_OneDevice):
    """Move one actuator after the other slowly, ask which joint moved, and write the table of the
    hand."""

    work: ClassVar[str] = "smooth_operator_devices.commands.hardware:check_hardware"
    details: ClassVar[str] = """For each actuator, the command asks which joint moved, how far it
can move in each direction, and the joint's angle at both ends. Press Enter to keep the value of the
table. An actuator stops if its current stays high. Ctrl-C, SIGTERM or closing the terminal
relaxes the hand, and nothing is written.

Examples:
  smooth-operator hardware check leap:/dev/ttyUSB0
  smooth-operator hardware check orca:mock=true --output my-orca.toml
  smooth-operator hardware check dynamixel:/dev/ttyUSB0 --hand my_hand --ids 1-12 --unit step"""

    output: Annotated[Path | None, arg(metavar="FILE")] = None
    """File to write. Default: DRIVER_SIDE.toml in your folder of tables, where teleop finds it."""

    ids: Annotated[str | None, arg(metavar="1-16")] = None
    """Actuator IDs of a hand that has no table yet, such as 1-12 or 0,3,5."""

    unit: str = "step"
    """Unit of the commands of a hand that has no table yet."""

    ends: Annotated[tuple[float, float], arg(metavar="MIN MAX")] = (1024.0, 3072.0)
    """Minimum and maximum command with which the actuators may be tried, in that unit."""


@dataclass(frozen=True, kw_only=True)
class Monitor(_OneDevice):
    """Show the joints, positions, currents, temperatures and errors of a hand, without moving
    it."""

    work: ClassVar[str] = "smooth_operator_devices.commands.hardware:monitor_hardware"
    details: ClassVar[str] = """The motors are not switched on, so you can move the fingers by hand.

Examples:
  smooth-operator hardware monitor leap:/dev/ttyUSB0
  smooth-operator hardware monitor orca:mock=true --seconds 2 --json"""

    seconds: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Length of the run [s]. Default: until Ctrl-C."""

    json: bool = False
    """Print each measurement as one line of JSON instead of the table."""


What: TypeAlias = (
    Annotated[List, subcommand("list")]
    | Annotated[Check, subcommand("check")]
    | Annotated[Monitor, subcommand("monitor")]
)
"""Subcommands of the group."""


@dataclass(frozen=True, kw_only=True)
class Hardware(Group):
    """List the drivers and actuator tables of real hands, check a hand and write its table, or
    monitor a hand."""

    details: ClassVar[str] = """Examples:
  smooth-operator hardware list
  smooth-operator hardware monitor leap:/dev/ttyUSB0
  smooth-operator hardware check leap:/dev/ttyUSB0

Each has its own help: smooth-operator hardware check --help"""

    what: Annotated[OmitSubcommandPrefixes[What], arg(name="")]
    """Subcommand."""

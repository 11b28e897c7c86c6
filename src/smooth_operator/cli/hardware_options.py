"""Options of ``smooth-operator hardware`` and of its subcommands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, TypeAlias

from tyro.conf import OmitSubcommandPrefixes, Positional, arg, subcommand

from smooth_operator.cli.common_options import Common, Group, HandSide


@dataclass(frozen=True, kw_only=True)
class List(Common):
    """Drivers of real hands, the tables of their actuators, and the serial ports here."""

    work: ClassVar[str] = "smooth_operator.cli.hardware:list_hardware"
    details: ClassVar[str] = """Tables of your own are NAME_SIDE.toml in the folder that is named
below; they go before the built-in ones.

Example:
  smooth-operator hardware list"""

    json: bool = False
    """One JSON object on standard output instead of the tables."""


@dataclass(frozen=True, kw_only=True)
class _OneDevice(Common):
    """Options of the subcommands about one real hand."""

    device: Annotated[Positional[str], arg(metavar="DRIVER:PORT")]
    """The hand, as for teleop --sink: leap:/dev/ttyUSB0, orca, inspire:192.168.11.210."""

    side: Annotated[HandSide, arg(metavar="right|left")] = "right"
    """Which hand."""

    hand: Annotated[str | None, arg(metavar="NAME")] = None
    """Robot hand. Default: the hand of the table."""


@dataclass(frozen=True, kw_only=True)
class Check(_OneDevice):
    """Moves one actuator at a time, slowly, asks what moved, and writes the hand's table."""

    work: ClassVar[str] = "smooth_operator.cli.hardware:check_hardware"
    details: ClassVar[str] = """For each actuator: which joint moved, how far it goes each way, and
the joint's angle at both ends. Enter keeps what the table says. An actuator whose current stays
high stops by itself. Ctrl-C, SIGTERM and a closed terminal relax the hand; nothing is written.

Examples:
  smooth-operator hardware check leap:/dev/ttyUSB0
  smooth-operator hardware check orca:mock=true --output my-orca.toml
  smooth-operator hardware check dynamixel:/dev/ttyUSB0 --hand my_hand --ids 1-12 --unit step"""

    output: Annotated[Path | None, arg(metavar="FILE")] = None
    """File of the table. Default: DRIVER_SIDE.toml in your folder of tables, where teleop looks."""

    ids: Annotated[str | None, arg(metavar="1-16")] = None
    """Ids of the actuators of a hand that has no table yet, such as 1-12 or 0,3,5."""

    unit: str = "step"
    """Unit of the commands of a hand that has no table yet."""

    ends: Annotated[tuple[float, float], arg(metavar="LEAST GREATEST")] = (1024.0, 3072.0)
    """Between which commands its actuators may be tried, in that unit."""


@dataclass(frozen=True, kw_only=True)
class Monitor(_OneDevice):
    """Shows where a hand is: joints, positions, currents, temperatures, errors. Nothing moves."""

    work: ClassVar[str] = "smooth_operator.cli.hardware:monitor_hardware"
    details: ClassVar[str] = """The motors are not switched on, so you can move the fingers by hand.

Examples:
  smooth-operator hardware monitor leap:/dev/ttyUSB0
  smooth-operator hardware monitor orca:mock=true --seconds 2 --json"""

    seconds: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Length of the run [s]. Default: until Ctrl-C."""

    json: bool = False
    """One JSON object a line for each measurement, instead of the table."""


What: TypeAlias = (
    Annotated[List, subcommand("list")]
    | Annotated[Check, subcommand("check")]
    | Annotated[Monitor, subcommand("monitor")]
)
"""The subcommands of the group."""


@dataclass(frozen=True, kw_only=True)
class Hardware(Group):
    """List drivers and tables of real hands, check a hand and write its table, watch it."""

    details: ClassVar[str] = """Examples:
  smooth-operator hardware list
  smooth-operator hardware monitor leap:/dev/ttyUSB0
  smooth-operator hardware check leap:/dev/ttyUSB0

Each has its own help: smooth-operator hardware check --help"""

    what: Annotated[OmitSubcommandPrefixes[What], arg(name="")]
    """What to do."""

"""The commands and their options, as typed dataclasses; tyro makes the parsers and the help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal, TypeAlias

import tyro
from tyro.conf import Positional, arg

HandSide: TypeAlias = Literal["right", "left"]
Scale: TypeAlias = float | Literal["frame", "calibrate"]

_EXAMPLES = """Examples:
  smooth-operator demo
      a built-in operator, retargeted, measured and played in the browser
  smooth-operator retarget glove.npz --output out.npz
      a recording into joint commands, with a table of what was measured
  smooth-operator view out.npz glove.npz
      the two side by side in the browser

Each command has its own help: smooth-operator retarget --help
"""


@dataclass(frozen=True, kw_only=True)
class _Common:
    debug: bool = False
    """Show the traceback of an error (also: SMOOTH_OPERATOR_DEBUG=1)."""


@dataclass(frozen=True, kw_only=True)
class _Retargeting:
    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name."""

    method: Annotated[str, arg(metavar="NAME")] = "sbr"
    """Retargeting method."""

    preset: Annotated[str | None, arg(metavar="NAME")] = None
    """Preset of the method: for sbr realtime (used if left out) or paper."""

    seed: int = 0
    """Of all random numbers: the same seed and frames give the same commands."""

    scale: Annotated[Scale | None, arg(metavar="frame|calibrate|FLOAT")] = None
    """Robot size over human size: found in every frame, once for the recording, or given; as the
    preset says if left out."""

    definition: Literal["sound", "paper"] = "sound"
    """How the metrics are defined; paper is as published, to compare with its table."""

    quiet: bool = False
    """No progress on standard error."""


@dataclass(frozen=True, kw_only=True)
class _Page:
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Where the page listens; 0.0.0.0 lets the whole network in, without a password."""

    port: int = 8080
    """First port to try for the page; 0 for any free one."""

    no_browser: bool = False
    """Serve the page, but open no browser."""


@dataclass(frozen=True, kw_only=True)
class Demo(_Common, _Page, _Retargeting):
    """Retarget a built-in operator, print what was measured, and play it in the browser."""

    details: ClassVar[str] = """The folder holds commands.npz and commands.json (the resolved
configuration), log.mcap (operator and commands), metrics.json, config.json, plots/.

Examples:
  smooth-operator demo --no-view --duration 5
  smooth-operator demo --side left --noise 1 --landmark-loss 0.02
"""

    duration: Annotated[float, arg(metavar="SECONDS")] = 20.0
    """How long the operator moves [s]."""

    output: Annotated[Path, arg(metavar="FOLDER")] = Path("smooth-operator-demo")
    """Folder to write; the files of an earlier demo in it are replaced."""

    overwrite: bool = False
    """Write into the folder even if it holds other things; those stay."""

    no_view: bool = False
    """Don't serve the page: for machines without a browser."""

    side: HandSide = "right"
    """Which hand."""

    rate: Annotated[float, arg(metavar="HZ")] = 100.0
    """Frames a second of the operator's tracker [Hz]."""

    noise: Annotated[float, arg(metavar="MM")] = 0.0
    """Noise of the tracker: standard deviation of each coordinate [mm]."""

    frame_loss: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of frames that the tracker loses, in bursts."""

    landmark_loss: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of landmarks that the tracker loses, in bursts; the last good command is then held."""

    def run(self) -> None:
        """Runs the command."""
        from smooth_operator.cli.demo import demo

        demo(self)


@dataclass(frozen=True, kw_only=True)
class Retarget(_Common, _Retargeting):
    """Turn a recording of a human hand into joint commands."""

    details: ClassVar[str] = """OUT.npz holds joint_positions (T, n) [rad], joint_names (n,),
timestamps (T,) [s], latency_ms (T,) and status (T,); the resolved configuration is
written beside it, as OUT.json.

Examples:
  smooth-operator retarget glove.npz --output out.npz
  smooth-operator retarget landmarks.npy --rate 60 --side left --output out.npz
  smooth-operator retarget glove.npz --frames :500 --preset paper --json --output out.npz
"""

    recording: Annotated[Positional[Path], arg(metavar="RECORDING")]
    """MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or this program's .mcap log."""

    output: Annotated[Path, arg(metavar="OUT.npz")]
    """File to write; its folder is made if need be."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; as the recording says if left out."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames a second of a recording that holds no time stamps [Hz]."""

    json: bool = False
    """Print the metrics as one JSON object on standard output, and nothing else there."""

    def run(self) -> None:
        """Runs the command."""
        from smooth_operator.cli.retarget import retarget

        retarget(self)


@dataclass(frozen=True, kw_only=True)
class View(_Common, _Page):
    """Play joint commands beside the hand that they came from, in the browser."""

    details: ClassVar[str] = """Commands and frames are matched by their time stamps.

Examples:
  smooth-operator view out.npz glove.npz
  smooth-operator view smooth-operator-demo/commands.npz smooth-operator-demo/log.mcap
"""

    commands: Annotated[Positional[Path], arg(metavar="OUT.npz")]
    """Commands, as retarget writes them."""

    recording: Annotated[Positional[Path], arg(metavar="RECORDING")]
    """The recording that they answer."""

    hand: Annotated[str | None, arg(metavar="NAME")] = None
    """Robot hand; as OUT.json says if left out."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; as OUT.json or the recording says if left out."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames a second of a recording that holds no time stamps; as OUT.json says if left out."""

    def run(self) -> None:
        """Runs the command."""
        from smooth_operator.cli.view import view

        view(self)


Command: TypeAlias = Demo | Retarget | View

_COMMANDS: Final[dict[str, type[Command]]] = {"demo": Demo, "retarget": Retarget, "view": View}


def parse(arguments: Sequence[str]) -> Command:
    """The command that the arguments name.

    Raises:
        SystemExit: 0 after printing help, 2 after saying what is wrong with the arguments.
    """
    flags = (tyro.conf.FlagCreatePairsOff,)
    name = arguments[0] if arguments else ""
    if name in _COMMANDS:
        kind = _COMMANDS[name]
        return tyro.cli(
            kind,
            prog=f"smooth-operator {name}",
            description=f"{kind.__doc__}\n\n{kind.details}",
            args=list(arguments[1:]),
            config=flags,
        )
    # All together: for the overview, and for the message about a command that does not exist.
    tyro.extras.subcommand_cli_from_dict(
        dict(_COMMANDS),
        prog="smooth-operator",
        description=f"Retarget a tracked human hand onto a robot hand.\n\n{_EXAMPLES}",
        args=list(arguments) or ["--help"],
        config=flags,
    )
    raise SystemExit(2)  # not reached: what names a command was parsed above

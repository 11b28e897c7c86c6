"""Options that several commands share."""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, TypeAlias, get_args, get_type_hints

from tyro.conf import arg

from smooth_operator.errors import MissingExtraError, require
from smooth_operator.plugins import Entry
from smooth_operator.request import MethodRequest

HandSide: TypeAlias = Literal["right", "left"]

RARE: Final = frozenset(
    {
        "seed",
        "scale",
        "fingers",
        "operator",
        "pinch_gaps",
        "definition",
        "layout",
        "model",
        "no_meshes",
        "debug",
        "port",
        "cluster",
    }
)
"""Shared options that only ``--help-all`` shows."""

INSTALL_RESEARCH: Final = (
    "python -m pip install . ./packages/smooth_operator_benchmark ./packages/smooth_operator_study "
    "./research"
)
"""Command that installs the project's own experiments, in a clone."""


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options that every command has, and the name of the function that does the command's work.

    Attributes:
        work: ``package.module:function``, called with the options. It is imported when the command
            runs, so that ``--help`` loads none of it. It raises ``SmoothOperatorError`` with the
            reason if the command fails (status 2), ``SystemExit`` with the status of a partly
            successful run, and ``KeyboardInterrupt`` if it was stopped (status 130).
        details: help text printed below the first line of the class's docstring.
        more: help text that only ``--help-all`` shows.
        rare: fields that only ``--help-all`` shows.
    """

    work: ClassVar[str]
    details: ClassVar[str]
    more: ClassVar[str] = ""
    rare: ClassVar[frozenset[str]] = frozenset()

    debug: bool = False
    """Show the traceback of an error (also: SMOOTH_OPERATOR_DEBUG=1)."""

    def extras(self) -> dict[str, tuple[str, ...]]:
        """Maps each extra that these options need to its libraries (top-level modules). A command
        that needs several extras names them here, so that one message lists all that are missing.
        """
        return {}

    def run(self) -> None:
        """Imports the function that ``work`` names, and calls it with these options. Raises
        MissingExtraError if a library of one of the ``extras`` is not installed."""
        missing = []
        for extra, libraries in self.extras().items():
            try:
                require("this command", extra, *libraries)
            except MissingExtraError:
                missing.append(extra)
        if missing:
            raise MissingExtraError("this command", *missing)
        Entry(self.work).load()(self)


@dataclass(frozen=True, kw_only=True)
class Ordered:
    """Option of every command that reads recordings of hands: the order of the landmarks."""

    layout: Annotated[str | None, arg(metavar="NAME")] = None
    """Order of the 21 points in a plain .npy or .npz file: mano, minimal_ik, mano_fingers, rhd,
    interhand, fpha, pinky_first or aria (docs/reference/conventions.md). Default: MediaPipe's
    order. Other file formats define their own order."""


@dataclass(frozen=True, kw_only=True)
class Quiet:
    """Option of every command that shows its progress."""

    quiet: bool = False
    """Hide progress output."""


@dataclass(frozen=True, kw_only=True)
class Retargeting(Quiet, MethodRequest):
    """Options of every command that retargets."""

    definition: Literal["sound", "paper"] = "sound"
    """Definition of the metrics. Use paper to compare with the published table."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Option of every command that measures one recording and prints its metrics."""

    all: bool = False
    """Print all metrics instead of the main five."""


@dataclass(frozen=True, kw_only=True)
class Synthetic:
    """Options of every command that records the synthetic operator."""

    duration: Annotated[float, arg(metavar="SECONDS")] = 20.0
    """Length of the recording [s]."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: right, or the only side that the robot hand has."""

    tracker: Annotated[
        Literal["glove", "headset", "camera"] | None, arg(metavar="glove|headset|camera")
    ] = None
    """Simulated tracker, with the noise, rate, delay and pinch gaps of a real one. Default: a
    perfect tracker."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate [Hz]. Default: the rate of the tracker; 100 for a perfect tracker."""

    frame_loss: Annotated[float | None, arg(metavar="SHARE")] = None
    """Fraction of frames that the tracker loses, in bursts. Default: that of the tracker."""

    landmark_loss: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Fraction of landmarks that the tracker loses, in bursts. A retargeter then holds its last
    good command."""


@dataclass(frozen=True, kw_only=True)
class Meshes:
    """Options of every command that draws a robot hand."""

    model: Annotated[Path | None, arg(metavar="PATH|menagerie")] = None
    """Model to draw instead of simple shapes: your copy of the vendor's MJCF or URDF with its
    meshes; joint names must be those of the hand. Or the word menagerie, which
    downloads the model from MuJoCo Menagerie (menagerie extra; Allegro, LEAP, Shadow, DEX-EE,
    Sharpa Wave).
    """

    no_meshes: bool = False
    """Draw simple shapes. By default the vendor's meshes are drawn if they are already on this
    machine, in your own model or in the download of the menagerie extra; nothing is downloaded."""


@dataclass(frozen=True, kw_only=True)
class Page:
    """Options of every command that serves a page."""

    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address on which the page listens. With 0.0.0.0, other machines can connect with the
    token in the printed address."""

    port: int = 8080
    """First port to try for the page; 0 chooses any free port."""

    no_browser: bool = False
    """Serve the page without opening a browser."""


def unwrapped(text: str) -> str:
    """Joins each paragraph of a text into one line; indented lines stay as they are.

    tyro joins every line that begins with a letter to the line before it, even an indented one. An
    empty line after an indented block keeps them apart.
    """
    joined = re.sub(r"(?m)^(\S.*)\n(?=\S)", r"\1 ", text)
    return re.sub(r"(?m)^( .*)\n(?=\S)", r"\1\n\n", joined)


def described(kind: Any, whole: bool = True) -> str:
    """Help text of a command: the docstring of its class and the details. If ``whole``, also the
    parts that only ``--help-all`` shows."""
    text = f"{inspect.getdoc(kind)}\n\n{kind.details}"
    if getattr(kind, "rare", ()):
        text += f"\n\n{kind.more}" if whole else "\n\nMore options and explanations: --help-all"
    return unwrapped(text)


class Group:
    """Options of a command with subcommands. Its field ``what`` holds the options of the chosen
    subcommand."""

    what: Any

    @classmethod
    def members(cls) -> dict[str, type]:
        """Maps the name of each subcommand to the class of its options."""
        union = get_args(get_type_hints(cls, include_extras=True)["what"])[0]
        members = {}
        for member in get_args(union):
            (name,) = (one.name for one in member.__metadata__ if hasattr(one, "name"))
            members[name] = get_args(member)[0]
        return members

    @property
    def debug(self) -> bool:
        """True if a traceback is printed for an error."""
        return bool(self.what.debug)

    def run(self) -> None:
        """Runs the subcommand."""
        self.what.run()

"""Options of ``smooth-operator hands`` and of its subcommands.

A further subcommand: write its options as a dataclass like ``Show`` below (in a file of its
own, as ``hands_check_options.py``) and its work in another (``hands_check.py``), then add one line
to ``What``.
The group itself is one line in ``cli/options.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, TypeAlias

from tyro.conf import OmitSubcommandPrefixes, Positional, arg, subcommand

from smooth_operator.cli.common_options import Common, HandSide, Meshes, Page
from smooth_operator.cli.hands_add_options import Add
from smooth_operator.cli.hands_check_options import Check
from smooth_operator.cli.subcommands import Group, described


@dataclass(frozen=True, kw_only=True)
class List(Common):
    """The hands that can be named: the built-in ones and your own."""

    work: ClassVar[str] = "smooth_operator.cli.hands:list_hands"
    details: ClassVar[str] = """Your own are spec files NAME.right.toml and NAME.left.toml in the
folder that is named below the table (SMOOTH_OPERATOR_HANDS names another)."""

    json: bool = False
    """One JSON object on standard output instead of the table."""


@dataclass(frozen=True, kw_only=True)
class _OneHand(Common, Meshes):
    """Options of the subcommands about one hand."""

    hand: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of a hand, or path of a spec file (.toml)."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; right, or as the spec file says, if left out."""


@dataclass(frozen=True, kw_only=True)
class Show(_OneHand, Page):
    """Joints, limits and couplings of a hand, and the hand in the browser with a slider a joint."""

    work: ClassVar[str] = "smooth_operator.cli.hands_show:show_hand"
    details: ClassVar[str] = """Examples:
  smooth-operator hands show shadow_hand
  smooth-operator hands show ability_hand --side left --no-view
  smooth-operator hands show shadow_hand --model menagerie
  smooth-operator hands show my-hand.right.toml --json"""

    no_view: bool = False
    """Print the tables, serve no page."""

    json: bool = False
    """One JSON object on standard output, and no page."""


@dataclass(frozen=True, kw_only=True)
class Render(_OneHand):
    """A picture of a hand: shape, landmarks, palm frame, joint ranges. Needs no display."""

    work: ClassVar[str] = "smooth_operator.cli.hands_show:render_hand"
    details: ClassVar[str] = """Example:
  smooth-operator hands render leap_hand --output leap.png"""

    output: Annotated[Path | None, arg(metavar="PNG")] = None
    """The picture; NAME_SIDE.png in the current folder if left out."""


@dataclass(frozen=True, kw_only=True)
class Remove(Common):
    """Takes one of your own hands out of the list: its spec files and the copies of its model."""

    work: ClassVar[str] = "smooth_operator.cli.hands_remove:remove_hand_command"
    details: ClassVar[str] = """The model that you added stays where it is. Built-in hands can't be
removed.

Examples:
  smooth-operator hands remove my_hand
  smooth-operator hands remove my_hand --side left --yes"""

    hand: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of a hand of your own, as in smooth-operator hands list."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Only this side of it; both if left out."""

    yes: bool = False
    """Don't ask."""


What: TypeAlias = (
    Annotated[List, subcommand("list", description=described(List))]
    | Annotated[Show, subcommand("show", description=described(Show))]
    | Annotated[Render, subcommand("render", description=described(Render))]
    | Annotated[Add, subcommand("add", description=described(Add))]
    | Annotated[Remove, subcommand("remove", description=described(Remove))]
    | Annotated[Check, subcommand("check", description=described(Check))]
)
"""The subcommands of the group."""


@dataclass(frozen=True, kw_only=True)
class Hands(Group):
    """The robot hands: list them, show one, draw one, add your own, check or remove it."""

    details: ClassVar[str] = """Examples:
  smooth-operator hands list
  smooth-operator hands show shadow_hand
  smooth-operator hands render leap_hand --side left --output leap.png

Each has its own help: smooth-operator hands show --help"""

    what: Annotated[OmitSubcommandPrefixes[What], arg(name="")]
    """What to do."""

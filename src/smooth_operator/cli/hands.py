"""``smooth-operator hands``: its subcommands, and the work of ``list`` and ``remove``.

To add a subcommand, write a dataclass of options like ``List`` below and a function that takes
them, and add a line to ``What``. The group itself is one line in ``cli/options.py``.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, TypeAlias

from tyro.conf import OmitSubcommandPrefixes, Positional, arg, subcommand

from smooth_operator.cli.common_options import Common, Group, HandSide
from smooth_operator.cli.hands_add import Add
from smooth_operator.cli.hands_check import Check
from smooth_operator.cli.hands_show import Render, Show
from smooth_operator.errors import ConfigError, SmoothOperatorError

if TYPE_CHECKING:
    from smooth_operator.types import Side


@dataclass(frozen=True, kw_only=True)
class List(Common):
    """List the built-in hands and your own."""

    work: ClassVar[str] = "smooth_operator.cli.hands:list_hands"
    details: ClassVar[str] = """Your own hands are spec files NAME.right.toml and NAME.left.toml in
the folder that is printed below the table (set SMOOTH_OPERATOR_HANDS to use another folder)."""

    json: bool = False
    """Print one JSON object on standard output instead of the table."""


@dataclass(frozen=True, kw_only=True)
class Remove(Common):
    """Remove one of your own hands: delete its spec files and the copies of its model."""

    work: ClassVar[str] = "smooth_operator.cli.hands:remove_hand_command"
    details: ClassVar[str] = """The original model file is not deleted. Built-in hands can't be
removed.

Examples:
  smooth-operator hands remove my_hand
  smooth-operator hands remove my_hand --side left --yes"""

    hand: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of one of your own hands, as listed by smooth-operator hands list."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Remove only this side. Default: both sides."""

    yes: bool = False
    """Delete without asking for confirmation."""


What: TypeAlias = (
    Annotated[List, subcommand("list")]
    | Annotated[Show, subcommand("show")]
    | Annotated[Render, subcommand("render")]
    | Annotated[Add, subcommand("add")]
    | Annotated[Remove, subcommand("remove")]
    | Annotated[Check, subcommand("check")]
)
"""Subcommands of the group."""


@dataclass(frozen=True, kw_only=True)
class Hands(Group):
    """List, show and draw robot hands; add, check or remove your own."""

    details: ClassVar[str] = """Examples:
  smooth-operator hands list
  smooth-operator hands show shadow_hand
  smooth-operator hands render leap_hand --side left --output leap.png

Each subcommand has its own help: smooth-operator hands show --help"""

    what: Annotated[OmitSubcommandPrefixes[What], arg(name="")]
    """Subcommand."""


_SIDES: Final[tuple[Side, ...]] = ("right", "left")


def list_hands(options: List) -> None:
    """Prints the list of hands."""
    from rich.text import Text

    from smooth_operator.cli.console import output_console, plain_table
    from smooth_operator.hands.registry import MAKERS_HANDS, hand_names, user_hands_folder

    rows = [_row(name) for name in hand_names()]
    makers = [
        {key: entry[key] for key in ("maker", "repository", "commit")}
        | {"name": name, "sides": [side for side in _SIDES if side in entry]}
        for name, entry in MAKERS_HANDS.items()
        if name not in hand_names()
    ]
    folder = user_hands_folder()
    if options.json:
        print(json.dumps({"folder": str(folder), "hands": rows, "makers_hands": makers}))
        return
    console = output_console()
    table = plain_table()
    for header in ("hand", "sides", "fingers", "actuated/all", "coupled", "source"):
        table.add_column(header, no_wrap=header in ("hand", "actuated/all"))
    for row in rows:
        if "error" in row:
            table.add_row(row["name"], *[""] * 4, Text(f"can't be used: {row['error']}"))
            continue
        sides = (f"{side} (mirrored)" if side in row["mirrored"] else side for side in _SIDES)
        table.add_row(
            row["name"],
            ", ".join(sides),
            str(len(row["fingers"])),
            f"{row['actuated']}/{row['joints']}",
            str(row["coupled"] or ""),
            Text(", ".join([row["source"], *([] if row["builtin"] else row["files"])])),
        )
    console.print(table)
    if makers:
        table = plain_table(
            "The model is in the maker's repository: smooth-operator hands add NAME"
        )
        for header in ("name", "sides", "maker", "repository"):
            table.add_column(header, no_wrap=header == "name")
        for row in makers:
            table.add_row(row["name"], ", ".join(row["sides"]), row["maker"], row["repository"])
        console.print(table)
    console.print(f"Your own hands are in {folder}", markup=False, soft_wrap=True)


def _row(name: str) -> dict[str, Any]:
    """Describes a hand as plain values, with an ``error`` if it can't be used."""
    from smooth_operator.hands.registry import HANDS, find_hand, load_hand

    row: dict[str, Any] = {"name": name, "builtin": name in HANDS.built_in}
    row |= {"files": [], "mirrored": []}
    try:
        entry = find_hand(name)  # fails for a name that two hands have
        row |= {"files": list(map(str, entry.files.values())), "mirrored": list(entry.mirrored)}
        hand = load_hand(name, entry.default_side)
    except SmoothOperatorError as error:
        return row | {"error": str(error)}
    return row | {
        "fingers": list(hand.fingers),
        "actuated": len(hand.actuated),
        "joints": len(hand.joint_names),
        "coupled": len(hand.couplings),
        "source": hand.spec.source,
    }


def remove_hand_command(options: Remove) -> None:
    """Asks for confirmation, then deletes the spec files of a hand and the copies of its model."""
    from smooth_operator.hand_files.user_hands import removable, remove_hand

    files = ", ".join(str(path) for path in removable(options.hand, options.side))
    if not options.yes:
        if not sys.stdin.isatty():
            raise ConfigError(f"this would delete {files}; confirm with --yes")
        if input(f"Delete {files}? [y/N] ").strip().lower() not in ("y", "yes"):
            raise ConfigError("nothing was deleted")
    gone = remove_hand(options.hand, options.side)
    print(f"deleted: {', '.join(str(path) for path in gone)}")

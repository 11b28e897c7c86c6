"""``smooth-operator hands list``: the hands by name."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any, Final

from rich.text import Text

from smooth_operator.cli.console import output_console, plain_table
from smooth_operator.cli.hands_options import List
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hands.registry import HANDS, find_hand, hand_names, load_hand
from smooth_operator.hands.user_folder import user_hands_folder
from smooth_operator.types import Side

_SIDES: Final[tuple[Side, ...]] = ("right", "left")


@dataclass(frozen=True)
class Row:
    """A hand in the list.

    Attributes:
        name: by which it is loaded.
        builtin: whether it comes with the program.
        files: its spec files.
        mirrored: sides that are the mirror image of the other.
        facts: what is known of it; empty if it can't be used.
        error: why it can't be used.
    """

    name: str
    builtin: bool
    files: list[str]
    mirrored: list[str]
    facts: dict[str, Any] = field(default_factory=dict)
    error: str = ""

    def as_json(self) -> dict[str, Any]:
        """The row as plain values."""
        own = {
            "name": self.name,
            "builtin": self.builtin,
            "files": self.files,
            "mirrored": self.mirrored,
        }
        return own | self.facts | ({"error": self.error} if self.error else {})


def list_hands(options: List) -> None:
    """Prints the catalogue."""
    rows = [_row(name) for name in hand_names()]
    folder = user_hands_folder()
    if options.json:
        print(json.dumps({"folder": str(folder), "hands": [row.as_json() for row in rows]}))
        return
    console = output_console()
    table = plain_table()
    for header in ("hand", "sides", "fingers", "actuated/all", "coupled", "source"):
        table.add_column(header, no_wrap=header in ("hand", "actuated/all"))
    for row in rows:
        if row.error:
            table.add_row(row.name, *[""] * 4, Text(f"can't be used: {row.error}"))
            continue
        sides = ", ".join(f"{side} (mirrored)" if side in row.mirrored else side for side in _SIDES)
        facts = row.facts
        table.add_row(
            row.name,
            sides,
            str(len(facts["fingers"])),
            f"{facts['actuated']}/{facts['joints']}",
            str(facts["coupled"] or ""),
            Text(facts["source"] if row.builtin else ", ".join([facts["source"], *row.files])),
        )
    console.print(table)
    console.print(f"Your own hands are in {folder}", markup=False, soft_wrap=True)


def _row(name: str) -> Row:
    try:
        entry = find_hand(name)  # refuses a name that two claim
    except SmoothOperatorError as error:
        return Row(name, name in HANDS.built_in, [], [], error=str(error))
    row = Row(
        entry.name,
        entry.builtin,
        [str(file) for file in entry.files.values()],
        list(entry.mirrored),
    )
    try:
        hand = load_hand(entry.name, "right" if "right" in entry.files else "left")
    except SmoothOperatorError as error:
        return Row(row.name, row.builtin, row.files, row.mirrored, error=str(error))
    row.facts.update(
        fingers=list(hand.fingers),
        actuated=len(hand.actuated),
        joints=len(hand.joint_names),
        coupled=len(hand.couplings),
        source=hand.spec.source,
    )
    return row

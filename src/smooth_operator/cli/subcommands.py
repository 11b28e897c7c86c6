"""Base class of groups of subcommands: ``smooth-operator hands``, ``smooth-operator study``."""

from __future__ import annotations

import inspect
from typing import Any, get_args, get_type_hints

from smooth_operator.cli.help_text import unwrapped


def described(kind: Any, whole: bool = True) -> str:
    """Help of a command: its class's docstring and details; all of them if ``whole``."""
    text = f"{inspect.getdoc(kind)}\n\n{kind.details}"
    if getattr(kind, "rare", ()):
        text += f"\n\n{kind.more}" if whole else "\n\nMore options and explanations: --help-all"
    return unwrapped(text)


class Group:
    """Options of a group: a field ``what``, the options of the subcommand that was chosen."""

    what: Any

    @classmethod
    def members(cls) -> dict[str, type]:
        """Name -> options of each subcommand."""
        union = get_args(get_type_hints(cls, include_extras=True)["what"])[0]
        members = {}
        for member in get_args(union):
            (name,) = (one.name for one in member.__metadata__ if hasattr(one, "name"))
            members[name] = get_args(member)[0]
        return members

    @property
    def debug(self) -> bool:
        """True if an error shows its traceback."""
        return bool(self.what.debug)

    def run(self) -> None:
        """Runs the subcommand."""
        self.what.run()

"""Base class of groups of subcommands: ``smooth-operator hands``, ``smooth-operator study``."""

from __future__ import annotations

import inspect
from typing import Any

from smooth_operator.cli.help_text import unwrapped


def described(kind: Any) -> str:
    """Help of a subcommand: docstring and details of its class."""
    return unwrapped(f"{inspect.getdoc(kind)}\n\n{kind.details}")


class Group:
    """Options of a group: a field ``what``, the options of the subcommand that was chosen."""

    what: Any

    @property
    def debug(self) -> bool:
        """True if an error shows its traceback."""
        return bool(self.what.debug)

    def run(self) -> None:
        """Runs the subcommand."""
        self.what.run()

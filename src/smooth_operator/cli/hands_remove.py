"""``smooth-operator hands remove``: takes a hand out of the user's folder."""

from __future__ import annotations

import sys

from smooth_operator.cli.hands_options import Remove
from smooth_operator.errors import ConfigError
from smooth_operator.hand_files.user_hands import removable, remove_hand


def remove_hand_command(options: Remove) -> None:
    """Deletes spec files and copies of models, after asking.

    Raises:
        UnknownNameError: the user has no such hand.
        HandModelError: the hand is built in, or has no such side.
        ConfigError: it may not ask, or the answer was no.
        OutputError: a file can't be deleted.
    """
    files = ", ".join(str(path) for path in removable(options.hand, options.side))
    if not options.yes:
        if not sys.stdin.isatty():
            raise ConfigError(f"this would delete {files}; say --yes")
        if input(f"Delete {files}? [y/N] ").strip().lower() not in ("y", "yes"):
            raise ConfigError("nothing was deleted")
    gone = remove_hand(options.hand, options.side)
    print(f"deleted: {', '.join(str(path) for path in gone)}")

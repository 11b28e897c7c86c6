"""Makes untrusted text safe for a terminal: control characters are shown, not executed.

Names of files, keys of messages and texts of recordings may hold control characters, which a
terminal interprets as commands: they set its title, clear the screen, or hide earlier output.
"""

from __future__ import annotations

import re
import sys
from typing import Final

_COMMANDS: Final = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # C0 but for tab and line feed, DEL, C1
    "\u200e\u200f\u202a-\u202e\u2066-\u2069"  # the direction of writing
    "\u2028\u2029\ud800-\udfff\ufeff]"  # other ends of lines; halves of characters
)


def printable(text: str) -> str:
    """Returns the text with control characters replaced by escapes, such as ``\\x1b``."""
    return _COMMANDS.sub(_escape, text)


def print_note(text: str) -> None:
    """Prints a line on standard error."""
    print(printable(text), file=sys.stderr, flush=True)


def _escape(match: re.Match[str]) -> str:
    code = ord(match[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"

"""Text for a terminal: control characters of foreign text are shown without effect.

Names of files, keys of messages and texts of recordings may hold control characters, which a
terminal interprets as commands: they set its title, clear the screen, or hide earlier output.
"""

from __future__ import annotations

import functools
import re
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

_COMMANDS: Final = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # C0 but for tab and line feed, DEL, C1
    "\u200e\u200f\u202a-\u202e\u2066-\u2069"  # the direction of writing
    "\u2028\u2029\ud800-\udfff\ufeff]"  # other ends of lines; halves of characters
)


def printable(text: str) -> str:
    """Returns the text with control characters replaced by escapes, such as ``\\x1b``."""
    return _COMMANDS.sub(_escape, text)


def print_note(text: str) -> None:
    """Print a line on standard error."""
    print(printable(text), file=sys.stderr, flush=True)


def open_console(*, stderr: bool = False) -> Console:
    """Opens a rich console that ignores markup in text and escapes control characters."""
    return _console_class()(
        file=sys.stderr if stderr else None, highlight=False, markup=False, emoji=False
    )


@functools.cache
def _console_class() -> type[Console]:
    from rich.console import Console
    from rich.segment import Segment

    class PrintableConsole(Console):
        """Escapes control characters in all rendered text; rich's own codes are kept."""

        def render_str(self, text: str, **options: Any) -> Text:
            return super().render_str(printable(text), **options)  # before it is measured

        def render(self, *args: Any, **options: Any) -> Iterable[Segment]:
            for segment in super().render(*args, **options):
                if segment.control is None:
                    segment = segment._replace(text=printable(segment.text))
                yield segment

    return PrintableConsole


def _escape(match: re.Match[str]) -> str:
    code = ord(match[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"

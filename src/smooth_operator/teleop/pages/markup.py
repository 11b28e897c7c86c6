"""Text from elsewhere, made fit to stand in a page."""

from __future__ import annotations

import re
from typing import Final

_SIGNS: Final = re.compile(r"^(?:i(?=mport)|e(?=xport))|[!-/:-@\[-`{-~]")


def plain(text: str) -> str:
    """Any text as Markdown that shows it letter by letter, in one line.

    viser compiles Markdown as MDX, which holds HTML, and JavaScript in braces or after ``import``
    and ``export`` at the beginning of a line. What people write into a file (a name, a source, a
    note) is none of that, so every sign that could mean something goes in as its number.
    """
    return _SIGNS.sub(lambda found: f"&#{ord(found[0])};", " ".join(text.split()))

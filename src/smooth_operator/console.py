"""A rich console that prints untrusted text safely: control characters are shown, not executed."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.segment import Segment
from rich.text import Text

from smooth_operator.terminal import printable


class _PrintableConsole(Console):
    """Escapes control characters in all rendered text; rich's own codes are kept."""

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(printable(text), **options)  # before it is measured

    def render(self, *args: Any, **options: Any) -> Iterable[Segment]:
        for segment in super().render(*args, **options):
            if segment.control is None:
                segment = segment._replace(text=printable(segment.text))
            yield segment


def open_console(*, stderr: bool = False) -> Console:
    """Opens a rich console that ignores markup in text and escapes control characters."""
    return _PrintableConsole(
        file=sys.stderr if stderr else None, highlight=False, markup=False, emoji=False
    )

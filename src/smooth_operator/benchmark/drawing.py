"""How plots look: colours of methods, ink that fits light and dark, PNG and SVG of one figure."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.recording import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK: Final = "#20262d"
"""Text and axes; on a page it becomes the colour of the text around."""
GRID: Final = "#8a939c"

METHOD_COLORS: Final = {
    "sbr": "#0072b2",
    "dexpilot": "#d55e00",
    "geort": "#009e73",
    "hybrid": "#cc79a7",
    "keyvector": "#e69f00",
    "ako": "#56b4e9",
    "joint_angle": "#8c6d4f",
}
"""One colour for a method in every report; most of them Okabe and Ito's safe palette."""
_MORE: Final = ("#7a68c7", "#6b9c2f", "#c2455f", "#3f8f9b", "#a0843c", "#7f8790")

MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*", "h", "p")
"""Shapes, so that nothing is told by colour alone."""

FINGER_COLORS: Final = ("#d55e00", "#56b4e9", "#009e73", "#cc79a7", "#0072b2")
"""Of the live page's palette, thumb first."""

_DPI: Final = 150


def colors_of(methods: Iterable[str]) -> dict[str, str]:
    """A colour for each method; presets that are no default get colours of their own."""
    chosen: dict[str, str] = {}
    spare = iter(_MORE * 8)
    for method in methods:
        if method not in chosen:
            chosen[method] = METHOD_COLORS.get(method) or next(spare)
    return chosen


@contextmanager
def styled() -> Iterator[None]:
    """Settings of the figures drawn inside."""
    import matplotlib as mpl

    settings: Any = {
        "axes.edgecolor": GRID,
        "axes.grid": True,
        "axes.labelcolor": INK,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlecolor": INK,
        "axes.titlesize": 10.0,
        "font.size": 9.0,
        "grid.alpha": 0.28,
        "grid.color": GRID,
        "legend.frameon": False,
        "legend.labelcolor": INK,
        "path.simplify_threshold": 0.2,
        "svg.fonttype": "none",  # text stays text
        "svg.hashsalt": "smooth-operator",  # the same figure is the same file
        "text.color": INK,
        "text.parse_math": False,  # names of files may hold a dollar
        "xtick.color": GRID,
        "xtick.labelcolor": INK,
        "ytick.color": GRID,
        "ytick.labelcolor": INK,
    }
    with mpl.rc_context(settings):
        yield


def write_figure(figure: Figure, stem: Path) -> str:
    """Writes ``STEM.png`` and ``STEM.svg``.

    Returns:
        The SVG without a background, whose text has the colour of the text around it.

    Raises:
        OutputError: a file can't be written.
    """
    with styled():
        with atomic_write(stem.with_name(stem.name + ".png")) as file:
            figure.savefig(file, format="png", dpi=_DPI)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    alone = text.replace("<svg ", '<svg style="background:#fff" ', 1)
    with atomic_write(stem.with_name(stem.name + ".svg")) as file:
        file.write(b'<?xml version="1.0" encoding="utf-8"?>\n' + alone.encode())
    return _for_page(text, re.sub(r"\W", "-", stem.name))


def _for_page(text: str, prefix: str) -> str:
    """An SVG that may stand in a page beside others: no size, no names that clash, no links."""
    head = text.index(">")
    tag = re.sub(r'\s(?:width|height|version|xmlns(?::\w+)?)="[^"]*"', "", text[:head])
    body = re.sub(r'id="([^"]+)"', rf'id="{prefix}-\1"', text[head:])
    body = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", body)
    body = re.sub(r'(?:xlink:)?href="#([^"]+)"', rf'href="#{prefix}-\1"', body)
    body = body.replace(INK, "currentColor")
    body = re.sub(r"(\d+(?:\.\d+)?)px [^;\"]*?sans-serif", r"\1px sans-serif", body)
    return f"{tag}{body}".strip()

"""Style of plots: colours of methods, colours for light and dark pages, output as PNG and SVG."""

from __future__ import annotations

import html
import io
import re
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.retargeting.presets import PRESETS
from smooth_operator.retargeting.registry import METHODS, as_presets

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK: Final = "#20262d"
"""Colour of text and axes; on a page, these have the colour of the surrounding text."""
GRID: Final = "#8a939c"
_SPARE: Final = ("#6b9c2f", "#c2455f", "#3f8f9b", "#a0843c", "#7f8790", "#4a4fa3", "#b05fb8")
"""Colours of names that have no colour of their own, such as presets other than the default."""
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*", "h", "p")
"""Shapes of markers, which distinguish series without colour."""
_DPI: Final = 150
_CLOSE: Final = (1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)


def colors_of(methods: Iterable[str]) -> dict[str, str]:
    """Chooses a colour for each method: the method's own colour, or one derived from its name.

    It does not depend on the order of the names. Names without a colour get different spare
    colours, as long as there are enough.
    """
    names = list(dict.fromkeys(methods))
    chosen: dict[str, str] = {}
    for name in sorted(names):
        chosen[name] = method_color(name) or _spare_color(name, chosen.values())
    return {name: chosen[name] for name in names}


def _spare_color(name: str, taken: Iterable[str]) -> str:
    """The first free spare colour, starting from a position derived from the name."""
    start = zlib.crc32(name.encode()) % len(_SPARE)
    turned = (*_SPARE[start:], *_SPARE[:start])
    used = set(taken)
    return next((color for color in turned if color not in used), turned[0])


@contextmanager
def styled() -> Iterator[None]:
    """Sets matplotlib's style for the figures that are drawn inside the block."""
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


def new_figure(size: tuple[float, float]) -> Figure:
    """Makes an empty figure of some width and height [inches]."""
    from matplotlib.figure import Figure  # not pyplot: no display, no global list of figures

    return Figure(figsize=size)


def legend_entry(color: str, label: str, marker: str = "", line: str = "") -> Any:
    """Makes an entry of a legend: a marker, a line or the text alone."""
    from matplotlib.lines import Line2D

    style: dict[str, Any] = {"marker": marker, "markersize": 6, "linestyle": line, "linewidth": 1.3}
    return Line2D([], [], color=color, label=label, **style)


def series(name: str, label: str = "") -> str:
    """Value of ``gid`` for the parts of a series in a plot. While the user hovers over one series,
    the page dims the others.

    Args:
        name: name of the series, as in ``data-series`` of the page's tables.
    """
    return f"series|{name.replace('|', ' ')}|{label}"


def plain_logs(ax: Axes, both: bool = True) -> None:
    """Labels logarithmic axes with plain numbers instead of powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in (ax.xaxis, ax.yaxis) if both else (ax.xaxis,):
        low, high = sorted(axis.get_view_interval())
        if axis.get_scale() != "log" or low <= 0:  # an axis without points has arbitrary limits
            continue
        decades = np.log10(high / low)
        subs = (1.0,) if decades > 3 else (1.0, 2.0, 5.0) if decades > 0.7 else _CLOSE
        axis.set_major_locator(LogLocator(subs=subs, numticks=12))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def write_figure(figure: Figure, stem: Path) -> str:
    """Writes ``STEM.png`` and ``STEM.svg``.

    Returns:
        The SVG without a background; its text has the colour of the surrounding text.

    Raises:
        OutputError: a file can't be written.
    """
    with styled():
        with atomic_write(stem.with_name(stem.name + ".png")) as file:
            figure.savefig(file, format="png", dpi=_DPI)
        figure.set_layout_engine("none")  # keeps the layout of the PNG, whose search takes long
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"""<g id=(["'])(series\|.*?)\1>""", _series_group, text)
    alone = text.replace("<svg ", '<svg style="background:#fff" ', 1)
    with atomic_write(stem.with_name(stem.name + ".svg")) as file:
        file.write(b'<?xml version="1.0" encoding="utf-8"?>\n' + alone.encode())
    return _for_page(text, re.sub(r"\W", "-", stem.name))


def _series_group(match: re.Match[str]) -> str:
    _, name, label = html.unescape(match.group(2)).split("|", 2)
    title = f"<title>{html.escape(label)}</title>" if label else ""
    return f'<g class="series" data-series="{html.escape(name)}">{title}'


def _for_page(text: str, prefix: str) -> str:
    """Prepares an SVG for a page with several SVGs: no fixed size, unique names and links."""
    head = text.index(">")
    tag = re.sub(r'\s(?:height|version|xmlns(?::\w+)?)="[^"]*"', "", text[:head])
    body = re.sub(r'id="([^"]+)"', rf'id="{prefix}-\1"', text[head:])
    body = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", body)
    body = re.sub(r'(?:xlink:)?href="#([^"]+)"', rf'href="#{prefix}-\1"', body)
    body = body.replace(INK, "currentColor")
    body = re.sub(r"(\d+(?:\.\d+)?)px [^;\"]*?sans-serif", r"\1px sans-serif", body)
    return f"{tag}{body}".strip()


COLORS: Final = {
    "sbr": "#0072b2",
    "smooth": "#7a68c7",
    "joint_angle": "#8c6d4f",
    "keyvector": "#e69f00",
    "hybrid": "#cc79a7",
    "dexpilot": "#d55e00",
    "ako": "#56b4e9",
    "geort": "#009e73",
}
"""Method of this distribution -> its colour in every report, most from Okabe and Ito's safe
palette. The key is the name: the settings of keyvector, hybrid, dexpilot and ako have one class."""


def method_color(name: str) -> str | None:
    """Returns the colour ``#rrggbb`` that reports use for a method; None if the method has none.

    The colour of a plugin's method is ``MethodConfig.color``.
    """
    if name in COLORS or name not in METHODS:
        return COLORS.get(name)
    try:
        presets = as_presets(METHODS.load(name))
    except SmoothOperatorError:  # a report needs no broken plugin
        return None
    color: str | None = next(iter(presets.values())).color
    return color


def method_label(method: str, preset: str) -> str:
    """Name of a method in tables; the default preset is not shown."""
    try:
        default = next(iter(PRESETS[method]))
    except SmoothOperatorError:  # a method of older results, or of a missing plugin
        default = ""
    return method if preset == default else f"{method}:{preset}"

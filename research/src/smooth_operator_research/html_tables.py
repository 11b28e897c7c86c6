"""Tables, unfoldable parts and players of clips for the pages of the research."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from smooth_operator.metrics import Metric
from smooth_operator.reporting.report_page import Html, element, escape
from smooth_operator_benchmark.page.report import macros


def table(
    headers: Sequence[Html],
    rows: Iterable[Iterable[Html]],
    class_: str = "",
) -> Html:
    """A table that scrolls if it is too wide; the first column names its rows.

    Args:
        headers: headers of the columns, either bare HTML or whole ``<th>`` elements.
        rows: cells, either bare HTML or whole ``<td>`` elements.
    """

    def row(cells: Iterable[Html]) -> str:
        written = [c if c.startswith("<t") else f"<td>{c}</td>" for c in cells]
        return f"<tr>{''.join(written)}</tr>"

    head = "".join(
        header if header.startswith("<th") else element("th", header, scope="col")
        for header in headers
    )
    body = "".join(row(cells) for cells in rows)
    inside = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return element("div", element("table", Html(inside), class_=class_), class_="scroll")


def text_table(headers: Iterable[object], rows: Iterable[Sequence[object]]) -> Html:
    """A table of plain text; the first column names its rows."""
    body = ([name_cell(row[0]), *map(escape, row[1:])] for row in rows)
    return table([escape(header) for header in headers], body)


def dot(color: str) -> Html:
    """The marker of a series in the colour that it has in the plots."""
    return Html(f"<i class='dot' style='background:{escape(color)}'></i>")


def name_cell(text: object, color: str = "", note: str = "") -> Html:
    """The cell that names a row. A colour marks the row of a series in the plots."""
    mark = dot(color) if color else ""
    small = f" <small>{escape(note)}</small>" if note else ""
    series = {"data_series": str(text)} if color else {}
    return element("th", Html(f"{mark}{escape(text)}{small}"), scope="row", **series)


def details(title: str, content: Html) -> Html:
    """An element that can be unfolded."""
    return Html(f"<details><summary>{escape(title)}</summary>{content}</details>")


def header(metric: Metric) -> Html:
    """Heading of a column: name, unit and direction of a metric. Clicking it sorts the table."""
    return Html(str(macros().header(metric)))


def facts_table(facts: Mapping[str, Any]) -> Html:
    """Table of names and values."""
    return Html(str(macros().facts(facts)))


def player(clip: Mapping[str, object]) -> Html:
    """Player of a clip with one pane per method, a play button, a slider and a choice of speed.

    Args:
        clip: result of ``make_clip``.
    """
    return Html(str(macros().player(clip)))

"""Pieces of HTML; whatever comes from a file is escaped here."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Sequence
from typing import NewType

Html = NewType("Html", str)
"""Text that is HTML; other text is escaped before it is put on a page."""


def escape(text: object) -> Html:
    """Escape text for an element or a quoted attribute."""
    return Html(html.escape(str(text), quote=True))


def element(tag: str, content: Html | str, **attributes: str) -> Html:
    """``<tag attributes>content</tag>``; attributes are escaped, the content must be HTML.

    ``class`` and ``for`` are written ``class_`` and ``for_``, underscores elsewhere hyphens.
    """
    written = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for name, value in attributes.items()
    )
    return Html(f"<{tag}{written}>{content}</{tag}>")


def paragraph(text: object, class_: str = "") -> Html:
    """A paragraph of plain text."""
    return element("p", escape(text), **({"class_": class_} if class_ else {}))


def join(parts: Iterable[Html | str]) -> Html:
    """HTML after HTML."""
    return Html("\n".join(parts))


def table(
    headers: Sequence[Html],
    rows: Iterable[Iterable[Html]],
    class_: str = "",
) -> Html:
    """A table that scrolls by itself where it is too wide; the first column names its rows.

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


def text_table(
    headers: Iterable[object], rows: Iterable[Sequence[object]], class_: str = ""
) -> Html:
    """A table of plain text; the first column names its rows."""
    body = ([name_cell(row[0]), *map(escape, row[1:])] for row in rows)
    return table([escape(header) for header in headers], body, class_)


def dot(color: str) -> Html:
    """The mark of a series, in the colour that the plots draw it in."""
    return Html(f"<i class='dot' style='background:{escape(color)}'></i>")


def name_cell(text: object, color: str = "", note: str = "") -> Html:
    """The cell that names a row; with a colour, the row of a series that the plots draw in it."""
    mark = dot(color) if color else ""
    small = f" <small>{escape(note)}</small>" if note else ""
    series = {"data_series": str(text)} if color else {}
    return element("th", Html(f"{mark}{escape(text)}{small}"), scope="row", **series)


def data(content: object) -> Html:
    """JSON in a script element; no text in it can end the element."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Html(f'<script type="application/json">{text}</script>')


def figure(svg: str, caption: str, label: str) -> Html:
    """An inline picture with its caption."""
    picture = svg.replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1)
    return element("figure", Html(f"{picture}{element('figcaption', escape(caption))}"))


def details(title: str, content: Html, *, opened: bool = False, class_: str = "") -> Html:
    """An element that folds away."""
    state = (f' class="{escape(class_)}"' if class_ else "") + (" open" if opened else "")
    return Html(f"<details{state}><summary>{escape(title)}</summary>{content}</details>")

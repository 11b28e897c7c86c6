"""Makes the HTML of reports: elements, plots and the page, which needs no other files."""

from __future__ import annotations

import base64
import html
import io
import json
import re
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Final, NewType

from smooth_operator.atomic_files import atomic_write, file_name, output_error
from smooth_operator.errors import require
from smooth_operator.reporting.drawing import write_figure

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure
    from PIL.Image import Image

Html = NewType("Html", str)
"""Text that is HTML; other text is escaped before it is put on a page."""


def escape(text: object) -> Html:
    """Escapes text for an element or a quoted attribute."""
    return Html(html.escape(str(text), quote=True))


def element(tag: str, content: Html | str, **attributes: str) -> Html:
    """Makes ``<tag attributes>content</tag>``. Attributes are escaped; the content must be HTML.

    Write ``class_`` and ``for_`` for ``class`` and ``for``; other underscores become hyphens.
    """
    written = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for name, value in attributes.items()
    )
    return Html(f"<{tag}{written}>{content}</{tag}>")


def paragraph(text: object, class_: str = "") -> Html:
    """Makes a paragraph of plain text."""
    return element("p", escape(text), **({"class_": class_} if class_ else {}))


def join(parts: Iterable[Html | str]) -> Html:
    """Joins pieces of HTML."""
    return Html("\n".join(parts))


def data(content: object) -> Html:
    """Makes a script element that contains JSON, escaped so that no text in it can end the
    element."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Html(f'<script type="application/json">{text}</script>')


def figure(svg: str, caption: str, label: str) -> Html:
    """Makes an inline SVG picture with its caption."""
    picture = svg.replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1)
    return element("figure", Html(f"{picture}{element('figcaption', escape(caption))}"))


_HOME: Final = files("smooth_operator.reporting")
STYLE: Final = _HOME / "report.css"
"""The style of every report."""
SORTING: Final = _HOME / "interact.js"
"""Script that sorts tables of class ``sortable`` by column; hovering a row highlights its series in
plots.
"""
Section = tuple[str, str, Html]
"""Title, anchor and content of a section of a report."""


@cache
def templates(package: str) -> Environment:
    """Loads the Jinja2 templates in the folder of a package; inserted values are escaped. Raises
    MissingExtraError if Jinja2 is not installed."""
    require("a report", "teleop", "jinja2")
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader(package, "."),
        autoescape=True,
        undefined=StrictUndefined,
        keep_trailing_newline=True,
    )


def write_report_page(
    path: Path,
    title: str,
    header: Html,
    sections: Sequence[Section],
    footer: str,
    *,
    styles: Sequence[Traversable | str] = (),
    scripts: Sequence[Traversable] = (),
    without_scripts: str = "",
) -> Path:
    """Writes a report that needs no other files and loads nothing from the network.

    Args:
        header: HTML above the sections, such as a heading.
        sections: parts in their order; the navigation has a link to each.
        styles: files or strings with CSS that follow the style of every report.
        scripts: files of JavaScript at the end of the page.
        without_scripts: CSS for browsers that run no scripts.

    Returns:
        ``path``.

    Raises:
        OutputError: the file can't be written.
    """
    page = templates("smooth_operator.reporting").get_template("page.html.j2")
    text = page.render(
        title=title,
        header=header,
        sections=sections,
        footer=footer,
        style="".join(_text(part) for part in (STYLE, *styles)),
        script="".join(_text(part) for part in scripts),
        without_scripts=without_scripts,
    )
    with atomic_write(path) as file:
        file.write(text.encode())
    return path


class Plots:
    """The figures of a report, stored as files in a folder and embedded in the page.

    Args:
        folder: the folder, which is created in an existing one if it is missing.

    Raises:
        OutputError: the folder can't be created.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise output_error(folder, error) from error

    def element(self, drawn: Figure | None, stem: str, caption: str) -> Html:
        """Returns the HTML of a figure with its caption, and writes ``STEM.png`` and ``STEM.svg``.

        The element is empty for None.

        Raises:
            OutputError: a file can't be written.
        """
        if drawn is None:
            return Html("")
        return figure(write_figure(drawn, self.folder / plot_name(stem)), caption, caption)

    def picture(self, drawn: Image | None, stem: str, caption: str) -> Html:
        """Returns the HTML of a picture with its caption, and writes ``STEM.webp``.

        The element is empty for None.

        Raises:
            OutputError: the file can't be written.
        """
        if drawn is None:
            return Html("")
        content = io.BytesIO()
        drawn.save(content, format="WEBP", quality=85, method=6)
        with atomic_write(self.folder / f"{plot_name(stem)}.webp") as file:
            file.write(content.getvalue())
        source = f"data:image/webp;base64,{base64.b64encode(content.getvalue()).decode()}"
        inside = f'<img src="{source}" alt="{escape(caption)}" width="{drawn.width}">'
        return element("figure", Html(f"{inside}{element('figcaption', escape(caption))}"))


def plot_name(stem: str) -> str:
    """Converts a plot's name, which may contain the path of a hand, to a valid file name."""
    return stem if re.fullmatch(r"[\w.-]+", stem) else file_name(stem, (stem,))


def _text(part: Traversable | str) -> str:
    return part if isinstance(part, str) else part.read_text(encoding="utf-8")

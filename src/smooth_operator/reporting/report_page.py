"""The page of a report: one HTML file with everything in it, and its plots as files."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from smooth_operator.atomic_files import atomic_write, file_name, output_error
from smooth_operator.errors import require
from smooth_operator.reporting.drawing import write_figure
from smooth_operator.reporting.html import Html, element, escape, figure

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure
    from PIL.Image import Image

_HOME: Final = files("smooth_operator.reporting")
STYLE: Final = _HOME / "report.css"
"""The style of every report."""
SORTING: Final = _HOME / "interact.js"
"""Tables of class ``sortable`` sort by their columns; a row shows its series in the plots."""
Section = tuple[str, str, Html]
"""Title, anchor and content of a part of a report."""


@cache
def templates(package: str) -> Environment:
    """Jinja2 templates of a package, next to its modules; what they insert is escaped.

    Raises:
        MissingExtraError: Jinja2 is not installed.
    """
    require("a report", "lab", "jinja2")
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
    """Writes a report. It needs no other file, and nothing from the network.

    Args:
        header: HTML above the sections: a heading, and what comes first.
        sections: parts in their order; the navigation has a link to each.
        styles: files or texts of CSS after that of every report.
        scripts: files of JavaScript at the end of the page.
        without_scripts: CSS for browsers that run no scripts.

    Returns:
        ``path``.

    Raises:
        OutputError: it can't be written.
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
    """The figures of a report: files in a folder, and elements of the page.

    Args:
        folder: made if need be, in one that exists.

    Raises:
        OutputError: it can't be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise output_error(folder, error) from error

    def element(self, drawn: Figure | None, stem: str, caption: str) -> Html:
        """A figure with its caption, written as ``STEM.png`` and ``STEM.svg``; nothing for None.

        Raises:
            OutputError: a file can't be written.
        """
        if drawn is None:
            return Html("")
        return figure(write_figure(drawn, self.folder / plot_name(stem)), caption, caption)

    def picture(self, drawn: Image | None, stem: str, caption: str) -> Html:
        """A picture with its caption, written as ``STEM.webp``; nothing for None.

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
    """A stem as a file's name; one that holds the path of a hand becomes harmless."""
    return stem if re.fullmatch(r"[\w.-]+", stem) else file_name(stem, (stem,))


def _text(part: Traversable | str) -> str:
    return part if isinstance(part, str) else part.read_text(encoding="utf-8")

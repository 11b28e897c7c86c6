"""The page of a report: one HTML file with everything in it, and its plots as files."""

from __future__ import annotations

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
from smooth_operator.reporting.html import Html, figure

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure

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
        path: where to.
        title: title of the window.
        header: HTML above the sections: a heading, and what comes first.
        sections: parts in their order; the navigation has a link to each.
        footer: one line of text.
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

        A stem that holds the path of a hand becomes a name that is harmless as a file's.

        Raises:
            OutputError: a file can't be written.
        """
        if drawn is None:
            return Html("")
        if not re.fullmatch(r"[\w.-]+", stem):
            stem = file_name(stem, (stem,))
        return figure(write_figure(drawn, self.folder / stem), caption, caption)


def _text(part: Traversable | str) -> str:
    return part if isinstance(part, str) else part.read_text(encoding="utf-8")

"""Hook of mkdocs: the section of evidence, equations, lists of the API, cards of the hands.

- Files of ``research/`` become pages in ``evidence/``. Links between the two folders are written
  as they are in the repository and are changed to those of the site.
- Equations between dollar signs become MathML, so no page loads a script.
- A page of ``docs/reference/api`` has the line ``{{ public smooth_operator.hands }}`` or
  ``{{ modules smooth_operator.hands }}``. The first becomes one mkdocstrings block for each public
  name of the package, the second a table of its modules with the first line of their docstrings.
- ``{{ hands }}`` becomes one card for each built-in hand.

All of it is read from the source files: nothing of the package is imported.
"""

from __future__ import annotations

import ast
import html
import os
import posixpath
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File

_PROJECT = Path(__file__).resolve().parents[1]
SOURCES = (
    _PROJECT / "src",
    _PROJECT / "packages" / "smooth_hand_datasets",
    _PROJECT / "packages" / "smooth_operator_benchmark",
    _PROJECT / "packages" / "smooth_operator_study",
    _PROJECT / "packages" / "smooth_operator_devices",
)
"""Folders that the packages are in."""
ROOT = "smooth_operator"
EVIDENCE = {
    "research/README.md": "evidence/index.md",
    "research/benchmarks/README.md": "evidence/programs.md",
}
"""Files of the repository outside ``docs`` and ``research/docs`` that are pages of the site."""
# A title counts a thousand times as much as text, and each name of the API is a title.
_BOOST = {
    "tutorials": 4.0,
    "how-to": 4.0,
    "robots": 2.0,
    "reference": 2.0,
    "explanation": 2.0,
    "evidence": 0.3,
}
_LINE = re.compile(r"^\{\{ (public|modules|hands) ?([\w.]*) \}\}$", re.MULTILINE)
_LINK = re.compile(r"(?<=\]\()([^)\s:#]+)(?=[#)])")
_PATH = re.compile(r"<code>((?:research/)?docs/[\w/-]+\.md)</code>")
_MATH = re.compile(r'<(span|div) class="arithmatex">\\[([](.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Any, config: Any) -> Any:
    """Called by mkdocs with the files of ``docs``: adds those of ``research``."""
    for path in sorted((_PROJECT / "research").rglob("*")):
        name = path.relative_to(_PROJECT).as_posix()
        if path.is_file() and (name in EVIDENCE or name.startswith("research/docs/")):
            files.append(File.generated(config, site_name(name), abs_src_path=str(path)))
    return files


def site_name(name: str) -> str:
    """The source name in the site of a file of the repository; empty if it is not a page."""
    for folder, section in (("docs/", ""), ("research/docs/", "evidence/")):
        if name.startswith(folder):
            return section + name.removeprefix(folder)
    return EVIDENCE.get(name, "")


def _with_links_of_the_site(markdown: str, page: File) -> str:
    """Links between ``docs`` and ``research``, which are relative to the page's file."""
    folder = Path(os.path.relpath(page.abs_src_path or "", _PROJECT)).parent.as_posix()

    def link(match: re.Match[str]) -> str:
        target = site_name(posixpath.normpath(posixpath.join(folder, match[1])))
        start = posixpath.dirname(page.src_uri) or "."
        return posixpath.relpath(target, start) if target else match[1]

    return _LINK.sub(link, markdown)


def on_page_content(content: str, page: Any, files: Any, **_: Any) -> str:
    """Called by mkdocs with the HTML of each page: equations become MathML.

    Paths of pages, which docstrings of the API name, become links.
    """

    def mathml(match: re.Match[str]) -> str:
        latex = html.unescape(match[2])
        if match[1] == "div":  # a wide one scrolls inside its box
            return f'<div class="equation">{convert(latex, display="block")}</div>'
        return convert(latex)

    def link(match: re.Match[str]) -> str:
        target = files.get_file_from_path(site_name(match[1]))
        return (
            f'<a href="{target.url_relative_to(page.file)}">{match[0]}</a>' if target else match[0]
        )

    return _PATH.sub(link, _MATH.sub(mathml, content))


def _folder(package: str) -> Path:
    """The folder of a package, or the path of a module without its suffix."""
    top = package.split(".")[0]
    source = next((each for each in SOURCES if (each / top).is_dir()), SOURCES[0])
    return source.joinpath(*package.split("."))


def public_names(package: str) -> dict[str, str]:
    """Name -> the module that defines it: what a package imports as ``X as X``.

    An import of a whole module (``from package import module as module``) is left out.
    """
    stub = _folder(package) / "__init__.pyi"
    source = stub if stub.is_file() else stub.with_suffix(".py")
    tree = ast.parse(source.read_text(encoding="utf-8"))
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                is_module = _folder(f"{node.module}.{alias.name}")
                if is_module.is_dir() or is_module.with_suffix(".py").is_file():
                    continue
                if alias.asname == alias.name:
                    found[alias.name] = _home(node.module, alias.name)
    return found


def _home(module: str, name: str) -> str:
    """The module that defines a name which ``module`` may only pass on."""
    folder = _folder(module)
    if folder.is_dir():
        return public_names(module).get(name, module)
    return module


def _modules(package: str) -> Iterator[tuple[str, str]]:
    """(dotted name, first line of the docstring) of every module in a package."""
    folder = _folder(package)
    for path in sorted(folder.rglob("*.py")):
        doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
        parts = path.relative_to(folder).with_suffix("").parts
        if parts[-1] == "__init__":
            parts = parts[:-1]
        name = ".".join((package, *parts))
        if doc and name != package:
            yield name, doc.split("\n\n")[0].replace("\n", " ").replace("|", "\\|")


def _rows(text: str, heading: str) -> dict[str, dict[str, str]]:
    """The rows of the first table below a heading: `name` -> header of a column -> cell.

    A first cell with several names gives a row to each.
    """
    table = re.findall(r"^\|(.+)\|$", text.split(heading, 1)[1].split("\n\n")[0], re.MULTILINE)
    header, _, *rows = [[cell.strip() for cell in line.split("|")] for line in table]
    return {
        name: dict(zip(header[1:], cells, strict=True))
        for first, *cells in rows
        for name in re.findall(r"`(\w+)`", first)
    }


def _drivers() -> dict[str, str]:
    """Hand -> the driver whose table of actuators names it."""
    tables = _folder("smooth_operator_devices.hands.tables").glob("*.toml")
    found = {path.name: tomllib.loads(path.read_text(encoding="utf-8")) for path in sorted(tables)}
    return {
        table["hand"]: (found[table["base"]] if "base" in table else table)["driver"]
        for table in found.values()
        if "hand" in table
    }


def _hands() -> str:
    """One card for each built-in hand: picture, joints, driver, figures, licence."""
    page = (_PROJECT / "docs" / "reference" / "hands.md").read_text(encoding="utf-8")
    figures = _rows(page, "## Built-in hands\n\n")
    notices = (_PROJECT / "NOTICES.md").read_text(encoding="utf-8")
    licences = _rows(notices, "The figures come from these works:\n\n")
    drivers = _drivers()
    cards = []
    for spec in sorted(_folder(f"{ROOT}.hands.models").glob("*.right.toml")):
        name = spec.name.split(".")[0]
        row = figures[name]
        driver = f"driver [`{drivers[name]}`](robots/index.md)" if name in drivers else "no driver"
        lines = [
            f"[![{name}](img/hands/{name}.png){{ loading=lazy }}](reference/hands.md)",
            f"**`{name}`**",
            f"{row['fingers']} fingers, {row['actuated']} of {row['all joints']} joints driven",
            driver,
            *(f"{key} {row[key]}" for key in row if re.match("thumb|touch", key)),
            "licence: " + re.split("[;(]", licences[name]["licence of the work"])[0].strip(),
        ]
        cards.append("-   " + "<br>\n    ".join(lines))
    return '<div class="cards hands" markdown>\n\n' + "\n\n".join(cards) + "\n\n</div>"


def _expanded(match: re.Match[str]) -> str:
    kind, package = match.groups()
    if kind == "hands":
        return _hands()
    if kind == "public":
        names = public_names(package)
        elsewhere = set() if package == ROOT else names.keys() & public_names(ROOT).keys()
        links = (f"[`{name}`][{names[name]}.{name}]" for name in sorted(elsewhere))
        blocks = [f"::: {names[name]}.{name}" for name in sorted(names.keys() - elsewhere)]
        if elsewhere:
            blocks.insert(0, f"Also in `{ROOT}`, and described there: {', '.join(links)}.")
        return "\n\n".join(blocks)
    rows = [f"| `{name}` | {doc} |" for name, doc in _modules(package)]
    return "\n".join(["| module | content |", "|---|---|", *rows])


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Called by mkdocs for each page: lists names; guides rank before the API in the search."""
    path = page.file.src_uri
    boost = _BOOST.get(path.split("/")[0], 1.0)
    page.meta["search"] = {"boost": 0.0005 if path.startswith("reference/api/") else boost}
    return _with_links_of_the_site(_LINE.sub(_expanded, markdown), page.file)

"""Limits on the size to which a small model file can expand.

MuJoCo can't be interrupted while it makes the copies that a file asks for, so ``hands add`` counts
them first.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Final

from smooth_operator.errors import HandModelError, brief
from smooth_operator.hands.model_assets import (
    DOCUMENTS,
    document_places,
    model_path,
    read_model_files,
    read_model_xml,
)

MOST_ELEMENTS: Final = 20_000
"""Largest number of XML elements, copies included; a body counts as ``BODY``. Hands have 1,000 to
4,000. The limit is 500 bodies; a humanoid with two hands has 150. MuJoCo takes 4 s for a chain of
1,000 bodies, and 20 s for 50,000 shapes."""
BODY: Final = 40
_MOST_ROOM: Final = 10_000
"""Largest value of the attributes ``_ROOM``, for which MuJoCo allocates memory without a bound."""
_MOST_FACETS: Final = 512
"""Largest resolution of a generated shape; its number of facets is up to the square of it."""
_MOST_HEIGHTS: Final = 4_000_000
"""Points of the largest terrain."""
_ROOM: Final = ("nkey", "nuserdata", "width", "height", "numeric size")
_DEEPEST: Final = 20  # depth of files that include or attach each other


def check_model_limits(path: Path) -> None:
    """Refuses an MJCF or URDF file that MuJoCo would take too long to read. Raises HandModelError
    if the model expands to more than ``MOST_ELEMENTS``, has an attribute that is too large, or has
    files that include each other without end."""
    model = model_path(path)
    roots = {file: read_model_xml(file) for file in read_model_files(path).documents}
    sizes: dict[Path, float] = {}

    def size(file: Path, above: tuple[Path, ...]) -> float:
        """Number of elements of a file and of all that it includes and attaches."""
        if file in above or len(above) > _DEEPEST:
            raise HandModelError(
                f"{file} includes itself, or files include each other more than {_DEEPEST} deep; "
                "write the model into one file"
            )
        if file not in sizes:
            sizes[file] = total(file, (*above, file))
        return sizes[file]

    def total(file: Path, above: tuple[Path, ...]) -> float:
        count, pending = 0.0, [(roots[file], 1.0)]
        while pending:
            element, times = pending.pop()
            _check_room(element, file)
            copies = _copies(element)
            body = element.tag in ("body", "link", "composite", "flexcomp")
            count += times * (BODY * copies if body else 1)
            inner = attached.get(element.get("model", "")) if element.tag == "attach" else None
            if element.tag == "include":
                inner = named(element, file)
            if inner is not None:
                count += times * size(inner, above)
            if count > MOST_ELEMENTS:
                raise HandModelError(
                    f"{model} has more than {MOST_ELEMENTS // BODY} bodies or {MOST_ELEMENTS} "
                    "elements, counting the copies that replicate, composite, flexcomp and attach "
                    "make; use a model of the hand alone"
                )
            pending += [(child, times * copies) for child in element]
        return count

    def named(element: ElementTree.Element, file: Path) -> Path | None:
        places = document_places(element.get("file", ""), model, file)
        return next((place for place in places if place in roots), None)

    attached = {
        element.get("name") or place.stem: place
        for file, root in roots.items()
        for element in root.iter(DOCUMENTS[1])
        if (place := named(element, file)) is not None
    }
    size(model, ())


def _check_room(element: ElementTree.Element, file: Path) -> None:
    """Refuses attributes that make MuJoCo allocate or compute without a bound."""
    most = _MOST_FACETS if element.tag == "mesh" else math.inf
    for key, text in element.items():
        if key in _ROOM or key.startswith("nuser_") or f"{element.tag} {key}" in _ROOM:
            limit: float = _MOST_ROOM
        else:
            limit = most if key == "params" else math.inf
        if any(abs(number) > limit for number in _numbers(text)):
            raise HandModelError(
                f"{file}: {key}={brief(text)} of <{element.tag}> is too large; expected at most "
                f"{limit}"
            )
    points = math.prod(_numbers(f"{element.get('nrow', '0')} {element.get('ncol', '0')}"))
    if element.tag == "hfield" and abs(points) > _MOST_HEIGHTS:
        raise HandModelError(
            f"{file} has a terrain (hfield) of {points:.0e} points; expected at most "
            f"{_MOST_HEIGHTS}: remove it, because a hand does not need terrain"
        )


def _copies(element: ElementTree.Element) -> float:
    """Number of copies that an element makes of its content."""
    if element.tag not in ("replicate", "composite", "flexcomp"):
        return 1.0
    if element.tag == "flexcomp" and element.get("file"):
        return MOST_ELEMENTS  # a body for each point of the file
    counts = [max(number, 1.0) for number in _numbers(element.get("count", ""))]
    return max(math.prod(counts), len(element.get("point", "").split()) / 3)


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []  # MuJoCo reports it

"""Places where the files that a model names may be."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final
from urllib.parse import unquote

_TAILS: Final = 8  # number of last parts of a path with which a file is looked for


_NEAR: Final = 4  # folders above the model in which a file is looked for by its bare name


def possible_places(
    name: str, model: Path, folders: Iterable[Path], listings: dict[Path, dict[str, str]]
) -> Iterator[Path]:
    """Possible places of a file, the most likely first.

    First the places where MuJoCo looks for it. Then the last parts of its path, the most parts
    first, in the folders above the model: this finds ``package://NAME/rest``, whether or not the
    package's folder has that name, and paths of another machine. The same without percent escapes,
    and finally without regard to upper and lower case.
    """
    plain = re.sub(r"^[A-Za-z][A-Za-z0-9+.-]+:(//)?", "", name.replace("\\", "/"))
    plain = re.sub(r"^/(?=[A-Za-z]:/)", "", plain)  # file:///C:/...
    spellings = tuple(dict.fromkeys((name, plain, unquote(plain))))
    near: list[tuple[Path, str]] = []
    for text in spellings:
        last = os.path.basename(text)
        near += [(folder, each) for each in (text, last) for folder in folders]
        parts = [p for p in os.path.normpath(text).split(os.sep) if p not in ("", ".", "..")]
        for k in range(max(len(parts) - _TAILS, 0), len(parts)):
            above = model.parents if len(parts) - k > 1 else model.parents[:_NEAR]
            near += [(folder, os.path.join(*parts[k:])) for folder in above]
    yield from (folder / text for folder, text in near)
    for folder, text in near:
        if (spelled := _spelled(folder, text, listings)) is not None:
            yield spelled


def _spelled(folder: Path, text: str, listings: dict[Path, dict[str, str]]) -> Path | None:
    """The existing path that differs only in upper and lower case."""
    for part in Path(text).parts:
        if folder not in listings:
            entries = os.listdir(folder) if os.access(folder, os.R_OK) and folder.is_dir() else ()
            listings[folder] = {name.casefold(): name for name in entries} | {"..": ".."}
        if part.casefold() not in listings[folder]:
            return None
        folder = folder / listings[folder][part.casefold()]
    return folder

"""The files that a model file names: what it includes, its meshes and its textures.

ROS packages name meshes ``package://NAME/meshes/link.stl``, exporters by paths of the machine they
ran on. Names are resolved here, once, for all that reads models; and what a small file can make
large is counted before MuJoCo, which can't be interrupted, sees it.
"""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from urllib.parse import unquote

from smooth_operator.errors import DocumentError, HandModelError, brief
from smooth_operator.hands.model_xml import read_model_xml
from smooth_operator.io.documents import check_plain_file

MOST_ELEMENTS: Final = 20_000
"""XML elements of a model, copies included, where a body counts as ``BODY``: hands have 1,000 to
4,000. So 500 bodies are the most; a humanoid with two hands has 150. MuJoCo takes 4 s for a chain
of 1,000 bodies, and 20 s for 50,000 shapes."""
BODY: Final = 40
MOST_NAMES: Final = 2_000
"""Different files that a model names."""
MOST_MESH_BYTES: Final = 50_000_000
"""A larger mesh or texture is left out. Hands' have 0.01 to 10 MB; MuJoCo reads 4 MB a second."""
_MOST_ROOM: Final = 10_000
"""What ``_ROOM`` may ask for: MuJoCo allocates it, whatever it is."""
_MOST_FACETS: Final = 512
"""Resolution of a shape that MuJoCo makes; its facets are up to the square of it."""
_ROOM: Final = ("nkey", "nuserdata", "width", "height", "numeric size")
_DEEPEST: Final = 20  # files that include or attach each other
_TAILS: Final = 8  # last parts of a path that are looked for near the model
_NEAR: Final = 4  # folders above the model's in which a mesh is looked for by its own name alone
_FILES: Final = ("file", "filename", "fileright", "fileleft", "fileup", "filedown", "filefront",
                 "fileback")  # fmt: skip
_FOLDERS: Final = ("meshdir", "texturedir", "assetdir")
_DOCUMENTS: Final = ("include", "model")


@dataclass(frozen=True)
class ModelFiles:
    """What a model consists of.

    Attributes:
        root: root element of the model file.
        documents: the model file, and what it includes or attaches.
        assets: mesh, texture or terrain as the model names it -> the file, where it is there.
        attaches: whether the model attaches others, which have folders for their own names.
    """

    root: ElementTree.Element
    documents: tuple[Path, ...]
    assets: dict[str, Path]
    attaches: bool


def read_model_files(path: Path) -> ModelFiles:
    """Reads a model file and finds the files that it names.

    Args:
        path: MJCF or URDF file.

    Raises:
        HandModelError: it is no such file, it names a pipe or a device, or it asks for more than
            ``MOST_ELEMENTS`` or ``MOST_NAMES``.
    """
    reader = _Reader(Path(os.path.abspath(path)))
    for document in reader.pending:  # grows while it is read
        reader.read(document)
    for name in reader.names:
        reader.find(name)
    reader.check(reader.total(reader.model, ()))
    documents = reader.documents
    return ModelFiles(
        documents[reader.model].root, tuple(documents), reader.assets, bool(reader.models)
    )


@dataclass
class _Document:
    """A file, how much is in it, and how often it has which other one.

    ``inner`` are files that it includes, and names of models that it attaches.
    """

    root: ElementTree.Element
    count: float = 0.0
    inner: list[tuple[Path | str, float]] = field(default_factory=list)
    total: float | None = None


@dataclass
class _Reader:
    model: Path
    documents: dict[Path, _Document] = field(default_factory=dict)
    models: dict[str, Path] = field(default_factory=dict)
    listings: dict[Path, dict[str, str]] = field(default_factory=dict)  # read once for all names
    assets: dict[str, Path] = field(default_factory=dict)
    names: dict[str, None] = field(default_factory=dict)
    folders: dict[Path, None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.pending = [self.model]

    def read(self, path: Path) -> None:
        if path in self.documents:
            return
        root = read_model_xml(path)
        document = self.documents[path] = _Document(root)
        own = [c.get(key, "") for c in root.iter("compiler") for key in _FOLDERS]
        bases = (self.model.parent, path.parent)
        self.folders |= {base / folder: None for folder in (*own, "") for base in bases}
        pending = [(root, 1.0)]
        while pending:
            element, times = pending.pop()
            copies = _copies(element)
            body = element.tag in ("body", "link", "composite", "flexcomp")
            document.count += times * (BODY * copies if body else 1)
            self.check(document.count)
            self._check_room(element)
            for key in _FILES:
                if name := element.get(key):
                    self._name(element, name, path, times)
            if element.tag == "attach":
                document.inner.append((element.get("model", ""), times))
            pending += [(child, times * copies) for child in reversed(element)]

    def total(self, path: Path, above: tuple[Path, ...]) -> float:
        """How much is in a document, and in what it includes and attaches."""
        if path in above or len(above) > _DEEPEST:
            raise HandModelError(
                f"{path} includes itself, or files include each other more than {_DEEPEST} deep; "
                "write the model into one file"
            )
        document = self.documents[path]
        if document.total is None:
            document.total = document.count
            for inner, times in document.inner:
                file = inner if isinstance(inner, Path) else self.models.get(inner)
                if file is not None:
                    document.total += times * self.total(file, (*above, path))
        return document.total

    def check(self, count: float) -> None:
        if count > MOST_ELEMENTS or len(self.names) > MOST_NAMES:
            raise HandModelError(
                f"{self.model} has more than {MOST_ELEMENTS // BODY} bodies, {MOST_ELEMENTS} "
                f"elements or {MOST_NAMES} names of files, with the copies that replicate, "
                "composite, flexcomp and attach make; give a model of the hand alone"
            )

    def _name(self, element: ElementTree.Element, name: str, path: Path, times: float) -> None:
        """A file that an element names."""
        if element.tag not in _DOCUMENTS:
            self.names[name] = None
            return
        for place in (self.model.parent / name, path.parent / name):
            if self._is_plain(place, name):  # else MuJoCo says that it is missing
                inner = Path(os.path.normpath(place))
                self.pending.append(inner)
                if element.tag == "model":
                    self.models[element.get("name") or inner.stem] = inner
                else:
                    self.documents[path].inner.append((inner, times))
                return

    def _check_room(self, element: ElementTree.Element) -> None:
        """Refuses what makes MuJoCo allocate or compute without bound."""
        for key, text in element.items():
            most = math.inf
            if key == "params" and element.tag == "mesh":
                most = _MOST_FACETS
            elif key in _ROOM or key.startswith("nuser_") or f"{element.tag} {key}" in _ROOM:
                most = _MOST_ROOM
            if any(abs(number) > most for number in _numbers(text)):
                raise HandModelError(
                    f"{self.model}: {key}={brief(text)} of <{element.tag}> is too large; expected "
                    f"at most {most}"
                )

    def find(self, name: str) -> None:
        """Adds the file of that name to the assets, if it is there."""
        for place in _places(name, self.model, self.folders, self.listings):
            if self._is_plain(place, name):
                if place.stat().st_size <= MOST_MESH_BYTES:
                    self.assets[name] = Path(os.path.normpath(place))
                return

    def _is_plain(self, place: Path, name: str) -> bool:
        """Whether a file is there; opening a pipe or a device might never end."""
        try:
            check_plain_file(place)
        except OSError:
            return False
        except ValueError as error:
            if place.is_dir() or not isinstance(error, DocumentError):
                return False
            raise HandModelError(
                f"{self.model} names {brief(name)}: {error}; expected a mesh, texture or model "
                "file: put one there, or take the name out of the model"
            ) from error
        return True


def _places(
    name: str, model: Path, folders: Iterable[Path], listings: dict[Path, dict[str, str]]
) -> Iterator[Path]:
    """Where a file may be, likeliest first.

    That is where MuJoCo looks for it; then the end of its path, the longest first, in the folders
    above the model: ``package://NAME/rest`` is the folder of that name or, as it may be called
    otherwise, what the model is in, and a path of another machine may have its end here. The same
    again without percent escapes, and then with upper case taken for lower.
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
    """The entry that differs in upper and lower case only."""
    for part in Path(text).parts:
        if folder not in listings:
            entries = os.listdir(folder) if os.access(folder, os.R_OK) and folder.is_dir() else ()
            listings[folder] = {name.casefold(): name for name in entries} | {"..": ".."}
        if part.casefold() not in listings[folder]:
            return None
        folder = folder / listings[folder][part.casefold()]
    return folder


def _copies(element: ElementTree.Element) -> float:
    """How often what is in an element is there."""
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
        return []  # MuJoCo says what is wrong with it

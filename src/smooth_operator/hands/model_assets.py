"""Reads robot model files (MJCF, URDF) and the names of their meshes and textures.

ROS packages name meshes ``package://NAME/meshes/link.stl``; exporters write paths of the machine
they ran on. This module resolves the names.
"""

from __future__ import annotations

import codecs
import itertools
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final
from urllib.parse import unquote

import numpy as np

from smooth_operator.errors import DocumentError, HandModelError, brief
from smooth_operator.io.plain_files import check_plain_file

MOST_NAMES: Final = 2_000
"""Largest number of different files that a model names."""
MOST_MESH_BYTES: Final = 50_000_000
"""Largest mesh or texture; a larger one is left out. Hands' have 0.01 to 10 MB; MuJoCo reads 4 MB
a second."""
_TAILS: Final = 8  # number of last parts of a path with which a file is looked for
_NEAR: Final = 4  # folders above the model in which a file is looked for by its bare name
_MOST_BELOW: Final = 10_000  # files below the model's folder among which one is looked for
_LFS: Final = b"version https://git-lfs"  # first bytes of a file that Git LFS has not downloaded
_FILES: Final = (
    "file",
    "filename",
    "fileright",
    "fileleft",
    "fileup",
    "filedown",
    "filefront",
    "fileback",
)
_FOLDERS: Final = ("meshdir", "texturedir", "assetdir")
DOCUMENTS: Final = ("include", "model")
"""Elements that name another file of the model."""


@dataclass(frozen=True)
class ModelFiles:
    """The files that make up a model.

    Attributes:
        root: root element of the model file.
        documents: the model file, and the files that it includes or attaches.
        assets: name of a mesh, texture or terrain in the model -> its file, if that exists.
        attaches: True if the model attaches others, whose names start at their own folders.
        pointers: names whose file is a pointer that Git LFS has not replaced by the content.
        inertias: links of a URDF whose inertia MuJoCo refuses; ``root`` is without them.
        changed: True if ``root`` differs from the content of the file.
    """

    root: ElementTree.Element
    documents: tuple[Path, ...]
    assets: dict[str, Path]
    attaches: bool
    pointers: frozenset[str] = frozenset()
    inertias: tuple[str, ...] = ()
    changed: bool = False


def model_path(path: Path) -> Path:
    """The absolute path of a model file, without ``..``; HandModelError if it is not UTF-8. Links
    to its folder are followed; a link to the file is not, because its meshes lie beside the link.
    """
    whole = Path(os.path.realpath(path.parent), path.name)
    try:
        str(whole).encode("utf-8")
    except UnicodeEncodeError:
        raise HandModelError(
            f"the path {brief(str(whole))} is not UTF-8 text; rename the file or its folder"
        ) from None
    return whole


def read_model_files(path: Path) -> ModelFiles:
    """Reads an MJCF or URDF file and finds the files that it names; HandModelError if it does not
    exist, its path is not UTF-8, or it names a pipe, a device or more than ``MOST_NAMES`` files."""
    reader = _Reader(model_path(path))
    for document in reader.pending:  # grows during the loop
        reader.read(document)
    for name in reader.names:
        reader.find(name)
    root = reader.documents[reader.model]
    inertias: tuple[str, ...] = ()
    changed = False
    if root.tag == "robot":
        inertias = _drop_inertias(root)
        changed = _drop_colours(root) or bool(inertias)
    return ModelFiles(
        root,
        tuple(reader.documents),
        reader.assets,
        reader.attaches,
        frozenset(reader.pointers),
        inertias,
        changed,
    )


def _drop_inertias(root: ElementTree.Element) -> tuple[str, ...]:
    """Removes the inertias of a URDF that MuJoCo refuses, and returns the names of their links."""
    names = []
    for link in root.iter("link"):
        inertial = link.find("inertial")
        if inertial is not None and not _is_physical(inertial):
            link.remove(inertial)
            names.append(link.get("name", ""))
    return tuple(names)


def _is_physical(inertial: ElementTree.Element) -> bool:
    """True if a URDF's inertia has a mass and a matrix with positive eigenvalues."""
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        return False
    try:
        xx, xy, xz, yy, yz, zz = (
            float(inertia.get(key, "nan")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
    except ValueError:
        return False
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return bool(np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix)[0] > 0)


def _drop_colours(root: ElementTree.Element) -> bool:
    """Removes the colours of a URDF that have no ``rgba``, which MuJoCo refuses; True if any."""
    colours = [
        (material, colour)
        for material in root.iter("material")
        for colour in material.findall("color")
        if not colour.get("rgba")
    ]
    for material, colour in colours:
        material.remove(colour)
    return bool(colours)


@dataclass
class _Reader:
    model: Path
    documents: dict[Path, ElementTree.Element] = field(default_factory=dict)
    attaches: bool = False
    listings: dict[Path, dict[str, str]] = field(default_factory=dict)  # read once for all names
    assets: dict[str, Path] = field(default_factory=dict)
    pointers: set[str] = field(default_factory=set)
    names: dict[str, None] = field(default_factory=dict)
    folders: dict[Path, None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.pending = [self.model]

    def read(self, path: Path) -> None:
        if path in self.documents:
            return
        root = self.documents[path] = read_model_xml(path)
        own = [c.get(key, "") for c in root.iter("compiler") for key in _FOLDERS]
        bases = (self.model.parent, path.parent)
        self.folders |= {base / folder: None for folder in (*own, "") for base in bases}
        for element in root.iter():
            for key in _FILES:
                if name := element.get(key):
                    self._name(element, name, path)
        if len(self.names) > MOST_NAMES:
            raise HandModelError(
                f"{self.model} names more than {MOST_NAMES} files; use a model of the hand alone"
            )

    def _name(self, element: ElementTree.Element, name: str, path: Path) -> None:
        """Adds a file that an element names."""
        if element.tag not in DOCUMENTS:
            self.names[name] = None
            return
        for place in document_places(name, self.model, path):
            if self._is_plain(place, name):  # MuJoCo reports a missing one
                self.pending.append(place)
                self.attaches |= element.tag == "model"
                return

    def find(self, name: str) -> None:
        """Adds the file of that name to the assets if it exists."""
        places = _places(name, self.model, self.folders, self.listings)
        for place in itertools.chain(places, self._only_below(name)):
            if self._is_plain(place, name):
                if is_pointer(place):
                    self.pointers.add(name)
                elif place.stat().st_size <= MOST_MESH_BYTES:
                    self.assets[name] = Path(os.path.normpath(place))
                return

    def _only_below(self, name: str) -> Iterator[Path]:
        """The file below the model's folder if just one has that name; read when all else fails."""
        files = self.below.get(re.split(r"[/\\]", name)[-1].casefold(), [])
        if len(files) == 1:
            yield files[0]

    @cached_property
    def below(self) -> dict[str, list[Path]]:
        """Files in folders below the model's, by name in lower case: a last resort."""
        walk = os.walk(self.model.parent)
        files = (Path(folder, name) for folder, _, names in walk for name in names)
        out: dict[str, list[Path]] = {}
        for file in itertools.islice(files, _MOST_BELOW):
            out.setdefault(file.name.casefold(), []).append(file)
        return out

    def _is_plain(self, place: Path, name: str) -> bool:
        """True if a regular file exists; refuses a pipe or device, whose reading may never end."""
        try:
            check_plain_file(place)
        except OSError:
            return False
        except ValueError as error:
            if place.is_dir() or not isinstance(error, DocumentError):
                return False
            raise HandModelError(
                f"{self.model} names {brief(name)}: {error}; expected a mesh, texture or "
                "model file: put the file there, or remove its name from the model"
            ) from error
        return True


def is_pointer(path: Path) -> bool:
    """True if a file is a Git LFS pointer, as in a clone made without git-lfs."""
    try:
        with path.open("rb") as file:
            return file.read(len(_LFS)) == _LFS
    except OSError:
        return False  # reading it reports why


def document_places(name: str, model: Path, path: Path) -> tuple[Path, Path]:
    """Places to look for a file that a document of a model includes or attaches."""
    one, other = (Path(os.path.normpath(file.parent / name)) for file in (model, path))
    return one, other


_MOST_BYTES: Final = 50_000_000
"""Size of the largest model file; they have 5 to 500 kB, since meshes are separate files."""
_DECLARED: Final = re.compile(rb"""^\s*<\?xml[^>]*?encoding\s*=\s*["']([A-Za-z0-9._-]{1,40})["']""")
_DECLARATION: Final = re.compile(r"^\s*<\?xml[^>]*\?>")
_MARKS: Final = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}


def read_model_xml(path: Path) -> ElementTree.Element:
    """The root element of a model file; HandModelError if it can't be read, or is not a model."""
    if not os.path.isfile(path):  # unlike Path.is_file, False for a name that is too long
        raise HandModelError(f"no hand model at {path}; expected an MJCF (.xml) or URDF file")
    try:
        size = path.stat().st_size
        data = path.read_bytes() if size <= _MOST_BYTES else b""
    except OSError as error:
        raise HandModelError(f"can't read the model {path}: {error.strerror}") from error
    if size > _MOST_BYTES:
        raise HandModelError(
            f"{path} has {size} bytes; expected an MJCF or URDF file of at most {_MOST_BYTES}: put "
            "meshes and terrain into separate files"
        )
    if data.startswith(_LFS):
        raise HandModelError(
            f"{path} is a pointer of Git LFS, not a model; run 'git lfs pull' in its clone"
        )
    try:
        root = ElementTree.fromstring(decode_xml(data, path))
    except (ElementTree.ParseError, RecursionError) as error:
        raise HandModelError(
            f"{path} is not well-formed XML ({error}); correct it there, or export the model again"
        ) from error
    if root.tag not in ("mujoco", "robot", "mujocoinclude"):
        raise HandModelError(
            f"{path} starts with <{root.tag[:40]}>; expected <mujoco> (MJCF) or <robot> (URDF)"
        )
    return root


def decode_xml(data: bytes, path: Path) -> str:
    """Returns the text of an XML file without its declaration, decoded with the encoding that it
    declares. Raises HandModelError if that encoding is unknown or does not fit the bytes."""
    declared = _DECLARED.match(data)
    encoding = declared.group(1).decode("ascii") if declared else "utf-8"
    encoding = next((name for mark, name in _MARKS.items() if data.startswith(mark)), encoding)
    for attempt in (encoding, "utf-8"):  # some exporters declare GB 2312 and write UTF-8
        try:
            text = data.decode(attempt)
            break
        except LookupError as error:
            raise HandModelError(
                f"{path} declares the encoding {encoding!r}, which is unknown; save the file "
                "as UTF-8"
            ) from error
        except ValueError:  # UnicodeDecodeError, and what some codecs raise in its place
            continue
    else:
        raise HandModelError(
            f"{path} is not in its declared encoding, {encoding}; save it as UTF-8"
        )
    return _DECLARATION.sub("", text, count=1)


def _places(
    name: str, model: Path, folders: Iterable[Path], listings: dict[Path, dict[str, str]]
) -> Iterator[Path]:
    """Possible places of a file, the most likely first: those where MuJoCo looks for it, then the
    last parts of its path in the folders above the model, as for ``package://NAME/rest``. The same
    without percent escapes, and finally without regard to upper and lower case."""
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

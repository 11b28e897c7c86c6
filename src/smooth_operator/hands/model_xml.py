"""The XML of a robot model file: MJCF or URDF, in any encoding that Python knows."""

from __future__ import annotations

import codecs
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Final

from smooth_operator.errors import HandModelError

_MOST_BYTES: Final = 50_000_000
"""Model files have 5 to 500 kB, since meshes are separate files."""
_MOST_HEIGHTS: Final = 4_000_000
"""Points of a terrain; MuJoCo allocates what a file asks for, whatever that is."""
_DECLARED: Final = re.compile(rb"""^\s*<\?xml[^>]*?encoding\s*=\s*["']([A-Za-z0-9._-]{1,40})["']""")
_DECLARATION: Final = re.compile(r"^\s*<\?xml[^>]*\?>")
_MARKS: Final = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that no file can have is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def read_model_xml(path: Path) -> ElementTree.Element:
    """The root element of a model file.

    Args:
        path: MJCF or URDF file.

    Raises:
        HandModelError: there is no such file, it can't be read, or it is no MJCF or URDF.
    """
    if not is_file(path):
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
    try:
        root = ElementTree.fromstring(decode_xml(data, path))
    except (ElementTree.ParseError, RecursionError) as error:
        raise HandModelError(
            f"{path} is not well-formed XML ({error}); mend it there, or export the model again"
        ) from error
    if root.tag not in ("mujoco", "robot", "mujocoinclude"):
        raise HandModelError(
            f"{path} starts with <{root.tag[:40]}>; expected <mujoco> (MJCF) or <robot> (URDF)"
        )
    for terrain in root.iter("hfield"):
        try:
            count = int(terrain.get("nrow", "0")) * int(terrain.get("ncol", "0"))
        except ValueError:
            continue  # MuJoCo says what is wrong with it
        if abs(count) > _MOST_HEIGHTS:
            raise HandModelError(
                f"{path} has a terrain (hfield) of {count:.0e} points; expected {_MOST_HEIGHTS} at "
                "most: take it out, a hand needs none"
            )
    return root


def decode_xml(data: bytes, path: Path) -> str:
    """The text of an XML file without its declaration, by the encoding that it declares.

    Args:
        data: the file's bytes.
        path: of the file, for messages.

    Raises:
        HandModelError: the encoding is unknown, or the bytes are not of it.
    """
    declared = _DECLARED.match(data)
    encoding = declared.group(1).decode("ascii") if declared else "utf-8"
    encoding = next((name for mark, name in _MARKS.items() if data.startswith(mark)), encoding)
    for attempt in (encoding, "utf-8"):  # some exporters declare gb2312 and write UTF-8
        try:
            text = data.decode(attempt)
            break
        except LookupError as error:
            raise HandModelError(
                f"{path} declares the encoding {encoding!r}, which is not known; save it as UTF-8"
            ) from error
        except ValueError:  # UnicodeDecodeError, and what some codecs raise in its place
            continue
    else:
        raise HandModelError(
            f"{path} is not text in the encoding that it declares, {encoding}; save it as UTF-8"
        )
    return _DECLARATION.sub("", text, count=1)

"""Writing spec files, in the order and layout that a person would write them."""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import HandModelError
from smooth_operator.hands.spec import HandSpec, Point
from smooth_operator.hands.spec_file import FORMAT, POINTS, check_hand_name

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}


def write_hand_spec(spec: HandSpec, path: str | Path, *, comment: str = "") -> None:
    """Writes a spec file that ``read_hand_spec`` reads back.

    Args:
        spec: the hand. A model in the file's folder, or below it, is named relative to it, so that
            the folder can be moved; any other by its whole path.
        path: the file; it is replaced whole or not at all.
        comment: lines to put first.

    Raises:
        HandModelError: the hand's name can't be one, or a number is not finite.
        OutputError: the file can't be written.
    """
    path = Path(path)
    text = "\n".join(_lines(spec, path.absolute().parent, comment)) + "\n"
    try:
        with atomic_write(path) as file:
            file.write(text.encode("utf-8"))
    except OSError as error:
        raise output_error(path, error) from error


@contextmanager
def temporary_spec(hand: str | HandSpec) -> Iterator[str]:
    """A hand as text, for another process: its name, or the path of a file with its description.

    Yields:
        The text, for ``load_hand``; the file is deleted at the end.
    """
    if isinstance(hand, str):
        yield hand
        return
    with tempfile.TemporaryDirectory(prefix="smooth-operator-") as folder:
        file = Path(folder) / "hand.toml"
        write_hand_spec(hand.mirrored if hand.mirror else hand, file)
        yield str(file)


def _lines(spec: HandSpec, folder: Path, comment: str) -> Iterator[str]:
    for line in comment.splitlines():
        yield f"# {line}".rstrip()
    yield f"format = {FORMAT}"
    yield f"name = {_text(check_hand_name(spec.name))}"
    yield f"side = {_text(spec.side)}"
    if spec.source:
        yield f"source = {_text(spec.source)}"
    yield f"model = {_text(_model(spec.model, folder))}"
    if spec.mirror:
        yield "mirror = true"
    yield f"palm = {_text(spec.palm)}"
    yield f"wrist = {_point(spec.wrist)}"
    yield f"align = [{', '.join(_text(name) for name in spec.align)}]"
    if isinstance(spec.torque, float | int):
        yield f"torque = {_number(spec.torque)} # N m"
    for finger in spec.fingers:
        yield ""
        yield f"[fingers.{finger.name}]"
        for name, point in zip(POINTS[finger.name], finger.points, strict=True):
            if point is not None:
                yield f"{name} = {_point(point)}"
    if spec.neutral:
        yield ""
        yield "[neutral] # rad"
        for joint, position in spec.neutral.items():
            yield f"{_key(joint)} = {_number(position)}"
    if isinstance(spec.torque, Mapping):
        yield ""
        yield "[torque] # N m"
        for joint, torque in spec.torque.items():
            yield f"{_key(joint)} = {_number(torque)}"
    for row in spec.joint_map:
        yield ""
        yield f"[joint_map.{_key(row.joint)}]"
        yield f"offset = {_number(row.offset)}"
        if row.gains:
            yield f"gains = {_inline(row.gains)}"


def _model(model: Path, folder: Path) -> str:
    # A link is kept as it is: only what the paths say counts, not where they lead.
    whole = model.absolute()
    return (whole.relative_to(folder) if whole.is_relative_to(folder) else whole).as_posix()


def _point(point: Point) -> str:
    offset = ", ".join(_number(value) for value in point.offset)
    more = f", offset = [{offset}]" if any(point.offset) else ""
    return f"{{ body = {_text(point.body)}{more} }}"


def _inline(gains: Mapping[str, float]) -> str:
    return f"{{ {', '.join(f'{_key(a)} = {_number(g)}' for a, g in gains.items())} }}"


def _key(name: str) -> str:
    return name if _BARE_KEY.fullmatch(name) else _text(name)


def _text(value: str) -> str:
    escaped = "".join(_ESCAPES.get(c) or (c if c.isprintable() else _unicode(c)) for c in value)
    return f'"{escaped}"'


def _unicode(character: str) -> str:
    if 0xD800 <= ord(character) <= 0xDFFF:  # half of a pair; a file name of broken bytes has it
        raise HandModelError(f"the character {character!r} can't be written to a spec file")
    return f"\\U{ord(character):08X}"


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise HandModelError(f"a spec file can't hold the number {value}")
    return repr(float(value))  # shortest text that reads back as the same number

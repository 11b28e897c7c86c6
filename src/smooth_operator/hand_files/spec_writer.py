"""Writes spec files in the same order and layout as a hand-written file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import DocumentError, HandModelError
from smooth_operator.formats.toml_writer import toml_key, toml_value
from smooth_operator.hands.spec import HandSpec, Point
from smooth_operator.hands.spec_file import FORMAT, POINTS, check_hand_name


def write_hand_spec(spec: HandSpec, path: str | Path, *, comment: str = "") -> None:
    """Writes a spec file that ``read_hand_spec`` can read.

    Args:
        spec: the hand. The path of a model in the file's folder or below is written as a relative
            path, so that the folder can be moved; any other path is absolute.
        path: the file; it is replaced atomically.
        comment: lines of a comment at the top.

    Raises:
        HandModelError: the hand's name is not valid, or a number is not finite.
        OutputError: the file can't be written.
    """
    path = Path(path)
    try:
        text = "\n".join(_lines(spec, path.absolute().parent, comment)) + "\n"
        with atomic_write(path) as file:
            file.write(text.encode("utf-8"))
    except DocumentError as error:
        raise HandModelError(f"{path}: {error}") from error
    except OSError as error:
        raise output_error(path, error) from error


@contextmanager
def temporary_spec(hand: str | HandSpec) -> Iterator[str]:
    """Yields the name of a hand, or the path of a temporary spec file, that another process can
    load.

    Yields:
        an argument for ``load_hand``; the file is deleted at the end.
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
    yield f"name = {toml_value(check_hand_name(spec.name))}"
    yield f"side = {toml_value(spec.side)}"
    if spec.source:
        yield f"source = {toml_value(spec.source)}"
    yield f"model = {toml_value(_model(spec.model, folder))}"
    if spec.mirror:
        yield "mirror = true"
    if spec.gripper:
        yield "gripper = true"
    yield f"palm = {toml_value(spec.palm)}"
    yield f"wrist = {_point(spec.wrist)}"
    yield f"align = {toml_value(spec.align)}"
    if spec.wrist_joints:
        yield f"wrist_joints = {toml_value(spec.wrist_joints)}"
    if isinstance(spec.torque, float | int):
        yield f"torque = {toml_value(float(spec.torque))} # N m"
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
            yield f"{toml_key(joint)} = {toml_value(position)}"
    if isinstance(spec.torque, Mapping):
        yield ""
        yield "[torque] # N m"
        for joint, torque in spec.torque.items():
            yield f"{toml_key(joint)} = {toml_value(torque)}"
    for coupling in spec.couplings:
        yield ""
        yield f"[couplings.{toml_key(coupling.joint)}]"
        yield f"follows = {toml_value(coupling.follows)}"
        if coupling.higher:
            yield f"coefficients = {toml_value(coupling.coefficients)} # rad, constant first"
            continue
        yield f"multiplier = {toml_value(coupling.multiplier)}"
        yield f"offset = {toml_value(coupling.offset)} # rad"
    for row in spec.joint_map:
        yield ""
        yield f"[joint_map.{toml_key(row.joint)}]"
        yield f"offset = {toml_value(row.offset)}"
        if row.gains:
            yield f"gains = {toml_value(row.gains)}"


def _model(model: Path, folder: Path) -> str:
    # Symbolic links are not resolved.
    whole = model.absolute()
    return (whole.relative_to(folder) if whole.is_relative_to(folder) else whole).as_posix()


def _point(point: Point) -> str:
    offset = {"offset": [float(value) for value in point.offset]} if any(point.offset) else {}
    return toml_value({"body": point.body, **offset})

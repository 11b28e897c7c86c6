"""The user's folder of hands: descriptions and models are put into it and taken out of it."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import DocumentError, HandModelError, UnknownNameError
from smooth_operator.formats.toml_writer import toml_key, toml_value
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.model_assets import read_model_files
from smooth_operator.hands.registry import HANDS, origin, shadowing
from smooth_operator.hands.spec import HandSpec, Point
from smooth_operator.hands.spec_file import FORMAT, POINTS, check_hand_name
from smooth_operator.hands.user_folder import find_specs, model_folder, spec_name, user_hands_folder
from smooth_operator.types import Side


def save_hand(spec: HandSpec, *, comment: str = "", copy: bool = False) -> Path:
    """Puts a description into the user's folder, where ``load_hand`` finds it by name.

    Args:
        spec: the hand; a description of the same name and side is replaced.
        comment: lines to put first in the file.
        copy: put a copy of the model and its meshes there, too, so that the hand survives when the
            model is moved; where that can't be done, the model stays where it is.

    Returns:
        The file.

    Raises:
        HandModelError: the name can't be one, or is that of a built-in hand or a plugin's.
        OutputError: the file can't be written.
    """
    folder = user_hands_folder()
    file = folder / spec_name(check_hand_name(spec.name), spec.side)
    if spec.name in HANDS:
        raise shadowing(spec.name, file)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error
    # A relative path would count from the new file.
    model = spec.model.absolute()
    if copy and not model.is_relative_to(folder.absolute()):
        model = copy_model(model, model_folder(spec.name, spec.side)) or model
    write_hand_spec(replace(spec, model=model), file, comment=comment)
    return file


def remove_hand(name: str, side: Side | None = None) -> tuple[Path, ...]:
    """Takes a hand out of the user's folder.

    Args:
        name: of the hand.
        side: which of its sides; both if left out.

    Returns:
        what was deleted: spec files, and the folders with copies of their models. A model anywhere
        else stays.

    Raises:
        UnknownNameError: the user's folder has no such hand.
        HandModelError: the hand is built in or a plugin's, or has no description of that side.
        OutputError: something can't be deleted.
    """
    gone = removable(name, side)
    for path in gone:
        try:
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
        except OSError as error:
            raise output_error(path, error) from error
    return gone


def removable(name: str, side: Side | None = None) -> tuple[Path, ...]:
    """What ``remove_hand`` would delete.

    Raises:
        UnknownNameError: the user's folder has no such hand.
        HandModelError: the hand is built in or a plugin's, or has no description of that side.
    """
    own = find_specs(user_hands_folder())
    if name not in own:
        if name in HANDS:
            raise HandModelError(
                f"{name!r} is {origin(name)} and can't be removed; yours are: "
                f"{', '.join(own) or 'none'}"
            )
        raise UnknownNameError("hand of your own", name, own)
    files = own[name]
    if side is not None and side not in files:
        raise HandModelError(
            f"{name!r} has no description of its {side} hand to remove, only of its "
            f"{' and '.join(files)}"
        )
    sides = [one for one in files if side in (None, one)]
    copies = [folder for one in sides if (folder := model_folder(name, one)).is_dir()]
    return (*(files[one] for one in sides), *copies)


MOST_BYTES: Final = 500_000_000
"""Models with their meshes have 0.1 to 100 MB; what is larger is left where it is."""
_HIGHEST: Final = 4
"""Folders above the model's own from which files are taken; what lies further away is not part of
the model's package, and stays where it is."""


def model_files(path: Path) -> tuple[Path, ...]:
    """The model file, what it includes, and its meshes and textures, as far as they are there.

    Args:
        path: MJCF or URDF file.

    Raises:
        HandModelError: the file is no model.
    """
    files = read_model_files(path)
    return tuple(dict.fromkeys([*files.documents, *files.assets.values()]))


def copy_model(path: Path, folder: Path) -> Path | None:
    """Copies a model with all its files, so that it no longer depends on the original.

    The files keep their places relative to each other. The folder is replaced as a whole, and only
    if the copy can be loaded.

    Args:
        path: MJCF or URDF file that can be loaded.
        folder: where to; what is there is replaced.

    Returns:
        the copy of the model file; None if the files are too large, or the copy is not the same
        model, as where files are named by absolute paths. Then nothing was changed.

    Raises:
        HandModelError: the file is no model.
        OutputError: the copy can't be written.
    """
    path = path.absolute()
    top = path.parents[min(_HIGHEST, len(path.parents) - 1)]
    files = [file for file in model_files(path) if file.is_relative_to(top)]
    if sum(file.stat().st_size for file in files) > MOST_BYTES:
        return None
    root = Path(os.path.commonpath([file.parent for file in files]))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        trial = Path(tempfile.mkdtemp(prefix=".copying-", dir=folder.parent))
    except OSError as error:
        raise output_error(folder, error) from error
    try:
        for file in files:
            target = trial / file.relative_to(root)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
        if not _same_model(path, trial / path.relative_to(root)):
            return None
        if folder.exists():
            shutil.rmtree(folder)
        trial.replace(folder)
    except OSError as error:
        raise output_error(folder, error) from error
    finally:
        shutil.rmtree(trial, ignore_errors=True)
    return folder / path.relative_to(root)


def _same_model(one: Path, other: Path) -> bool:
    try:
        ours, theirs = load_model(one), load_model(other)
    except HandModelError:
        return False
    return (
        ours.model.nq == theirs.model.nq
        and ours.model.ngeom == theirs.model.ngeom
        and ours.unreadable == theirs.unreadable
    )


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
    yield f"name = {toml_value(check_hand_name(spec.name))}"
    yield f"side = {toml_value(spec.side)}"
    if spec.source:
        yield f"source = {toml_value(spec.source)}"
    yield f"model = {toml_value(_model(spec.model, folder))}"
    if spec.mirror:
        yield "mirror = true"
    yield f"palm = {toml_value(spec.palm)}"
    yield f"wrist = {_point(spec.wrist)}"
    yield f"align = {toml_value(spec.align)}"
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
    for row in spec.joint_map:
        yield ""
        yield f"[joint_map.{toml_key(row.joint)}]"
        yield f"offset = {toml_value(row.offset)}"
        if row.gains:
            yield f"gains = {toml_value(row.gains)}"


def _model(model: Path, folder: Path) -> str:
    # A link is kept as it is: only what the paths say counts, not where they lead.
    whole = model.absolute()
    return (whole.relative_to(folder) if whole.is_relative_to(folder) else whole).as_posix()


def _point(point: Point) -> str:
    offset = {"offset": [float(value) for value in point.offset]} if any(point.offset) else {}
    return toml_value({"body": point.body, **offset})

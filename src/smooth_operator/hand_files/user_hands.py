"""Adds and removes descriptions and models of hands in the user's folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Final

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.model_assets import model_path, read_model_files
from smooth_operator.hands.registry import HANDS, find_specs, origin, shadowing, user_hands_folder
from smooth_operator.hands.spec import HandSpec
from smooth_operator.hands.spec_file import check_hand_name
from smooth_operator.types import Side


def save_hand(spec: HandSpec, *, comment: str = "", copy: bool = False) -> Path:
    """Writes a description into the user's folder, where ``load_hand`` finds it by name.

    Args:
        spec: the hand; a description of the same name and side is replaced.
        comment: lines of a comment at the top of the file.
        copy: True to copy the model and its meshes there too, so that the original can be moved;
            if they can't be copied, the description refers to the original.

    Returns:
        the file.

    Raises:
        HandModelError: the name is not valid, or is that of a built-in hand or a plugin's; or the
            model's path is not UTF-8.
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
    model = model_path(spec.model)
    if copy and not model.is_relative_to(folder.resolve()):
        model = copy_model(model, model_folder(spec.name, spec.side)) or model
    write_hand_spec(replace(spec, model=model), file, comment=comment)
    return file


def remove_hand(name: str, side: Side | None = None) -> tuple[Path, ...]:
    """Removes a hand from the user's folder.

    Args:
        side: its side; by default both.

    Returns:
        the deleted spec files, and folders with copies of their models. A model in any other place
        is kept.

    Raises:
        UnknownNameError: the user's folder has no such hand.
        HandModelError: the hand is built in or a plugin's, or has no description of that side.
        OutputError: a file can't be deleted.
    """
    paths = removable(name, side)
    for path in paths:
        try:
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
        except OSError as error:
            raise output_error(path, error) from error
    return paths


def removable(name: str, side: Side | None = None) -> tuple[Path, ...]:
    """Returns the files and folders that ``remove_hand`` would delete.

    Raises:
        UnknownNameError: the user's folder has no such hand.
        HandModelError: the hand is built in or a plugin's, or has no description of that side.
    """
    own = find_specs(user_hands_folder())
    if name not in own:
        if name in HANDS:
            raise HandModelError(
                f"{name!r} is {origin(name)} and can't be removed; your own hands: "
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
"""Largest size of a model with its meshes that is copied; typical sizes are 0.1 to 100 MB."""
_HIGHEST: Final = 4
"""Number of folders above the model's own from which files are copied; files further away are not
part of the model's package."""


def model_files(path: Path) -> tuple[Path, ...]:
    """Returns the model file, the files that it includes, and those of its meshes and textures that
    exist.

    Args:
        path: MJCF or URDF file.

    Raises:
        HandModelError: the file is not a model.
    """
    files = read_model_files(path)
    return tuple(dict.fromkeys([*files.documents, *files.assets.values()]))


def copy_model(path: Path, folder: Path) -> Path | None:
    """Copies a model with all its files, so that it no longer depends on the original.

    The files keep their relative paths. The folder is replaced as a whole, and only if the copy can
    be loaded.

    Args:
        path: MJCF or URDF file that can be loaded.
        folder: target folder; its content is replaced.

    Returns:
        the copy of the model file; None, with nothing changed, if the files are too large or the
        copy is not the same model, for example because it names files by absolute paths.

    Raises:
        HandModelError: the file is not a model.
        OutputError: the copy can't be written.
    """
    path = model_path(path)
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


def spec_name(name: str, side: Side) -> str:
    """File name of a hand's spec: ``NAME.SIDE.toml``."""
    return f"{name}.{side}.toml"


def model_folder(name: str, side: Side) -> Path:
    """Folder to which ``hands add`` copies a hand's model."""
    return user_hands_folder() / "models" / f"{name}.{side}"

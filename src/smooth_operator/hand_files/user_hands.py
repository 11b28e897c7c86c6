"""The user's folder of hands: descriptions and models are put into it and taken out of it."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hand_files.model_files import copy_model
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.registry import HANDS, origin, shadowing
from smooth_operator.hands.spec import HandSpec
from smooth_operator.hands.spec_file import check_hand_name
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

"""The hands that can be named: the built-in ones, and the user's own.

A built-in hand is data: a spec file and a compact kinematic model beside it in ``models``. Where
only one side is published, the other is its mirror image.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.model_files import copy_model
from smooth_operator.hands.model_xml import is_file
from smooth_operator.hands.selection import FingerChoice, select_fingers
from smooth_operator.hands.spec import HandSpec
from smooth_operator.hands.spec_file import check_hand_name, read_hand_spec
from smooth_operator.hands.spec_writer import write_hand_spec
from smooth_operator.hands.user_folder import (
    find_specs,
    model_folder,
    spec_name,
    user_hands_folder,
)
from smooth_operator.io.atomic import output_error
from smooth_operator.types import Side, as_side

MODELS: Final = Path(__file__).parent / "models"
"""Folder of the built-in spec files and models."""


@dataclass(frozen=True)
class Entry:
    """A hand of the catalogue.

    Attributes:
        name: by which it is loaded.
        files: the spec files, by side; a side without one is mirrored.
        builtin: whether it comes with the program.
    """

    name: str
    files: dict[Side, Path]
    builtin: bool

    @property
    def mirrored(self) -> tuple[Side, ...]:
        """The sides that have no description of their own."""
        sides: tuple[Side, ...] = ("right", "left")
        return tuple(side for side in sides if side not in self.files)

    def spec(self, side: Side) -> HandSpec:
        """The description of one side.

        Raises:
            HandModelError: its file can't be used.
        """
        mirrored = side in self.mirrored
        own = next(iter(self.files)) if mirrored else side
        spec = read_hand_spec(self.files[own])
        if (spec.name, spec.side) != (self.name, own):
            raise HandModelError(
                f"{self.files[own]} describes the {spec.side} hand {spec.name!r}; expected the "
                f"{own} hand {self.name!r}, as the file is called"
            )
        if not is_file(spec.model):
            raise HandModelError(
                f"the model of hand {self.name!r} is not at {spec.model} any more; if it was "
                f"moved: smooth-operator hands add NEWPATH --name {self.name} --side {own} "
                f"--overwrite, or correct 'model' in {self.files[own]}"
            )
        return spec.mirrored if mirrored else spec


def catalogue() -> dict[str, Entry]:
    """All hands by name, the built-in ones first.

    The user's are looked for anew each time. One that has a built-in hand's name is left out here;
    ``load_hand`` refuses the name while it is there.
    """
    entries = dict(_builtin())
    for name, files in find_specs(user_hands_folder()).items():
        entries.setdefault(name, Entry(name, files, builtin=False))
    return entries


def hand_names() -> tuple[str, ...]:
    """Names of the hands that can be loaded: the built-in ones, then the user's own."""
    return tuple(catalogue())


def find_hand(name: str) -> Entry:
    """A hand of the catalogue.

    Raises:
        UnknownNameError: there is none of that name.
        HandModelError: a file of the user's claims the name of a built-in hand.
    """
    builtin = _builtin().get(name)
    own = find_specs(user_hands_folder()).get(name)
    if builtin is not None:
        if own is not None:
            raise _shadowing(name, next(iter(own.values())))
        return builtin
    if own is None:
        raise UnknownNameError("hand", name, catalogue())
    return Entry(name, own, builtin=False)


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
        HandModelError: the name can't be one, or is that of a built-in hand.
        OutputError: the file can't be written.
    """
    folder = user_hands_folder()
    file = folder / spec_name(check_hand_name(spec.name), spec.side)
    if spec.name in _builtin():
        raise _shadowing(spec.name, file)
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
        HandModelError: the hand is built in, or has no description of that side.
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
        HandModelError: the hand is built in, or has no description of that side.
    """
    own = find_specs(user_hands_folder())
    if name not in own:
        if name in _builtin():
            raise HandModelError(
                f"{name!r} is a built-in hand and can't be removed; yours are: "
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


def load_hand(
    hand: str | Path | HandSpec = "mimic_p050",
    side: str | None = None,
    *,
    fingers: FingerChoice | None = None,
) -> Hand:
    """Load a robot hand.

    Args:
        hand: name of a built-in hand or of one in the user's folder; the path of a spec file (a
            text that ends in ``.toml`` is one); or a description of your own.
        side: ``right`` or ``left``. Of a name it is ``right`` if left out. A spec file brings its
            own side, and is mirrored if the other is asked for; a description keeps its own.
        fingers: to drive fewer fingers, or by other human fingers; see
            ``select_fingers``.

    Raises:
        UnknownNameError: if there is no hand of that name, or it has no such finger.
        HandModelError: if the description or the model can't be used.
    """
    if isinstance(hand, HandSpec):
        spec = hand
    elif isinstance(hand, Path) or hand.endswith(".toml"):
        spec = read_hand_spec(hand)
        spec = spec if side is None or as_side(side) == spec.side else spec.mirrored
    else:
        wanted, entry = as_side(side or "right"), find_hand(hand)
        if entry.builtin and fingers is None:
            return _load_builtin(hand, wanted)
        spec = entry.spec(wanted)
    return load_hand_spec(spec if fingers is None else select_fingers(spec, fingers))


@cache
def _builtin() -> dict[str, Entry]:
    return {n: Entry(n, files, builtin=True) for n, files in sorted(find_specs(MODELS).items())}


@cache
def _load_builtin(name: str, side: Side) -> Hand:
    return load_hand_spec(_builtin()[name].spec(side))


def _shadowing(name: str, file: Path) -> HandModelError:
    return HandModelError(
        f"{name!r} is a built-in hand, so {os.fspath(file)} can't describe another of that name; "
        "give your hand a name of its own, in the file and as the file's name"
    )

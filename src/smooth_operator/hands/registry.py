"""Registry of hands: the built-in ones, those of plugins, and the user's own.

A built-in hand is data: a spec file and a compact kinematic model in ``models``. If only one side
is published, the other is its mirror image. A plugin gives the path of such a spec file, or of a
folder of them.
"""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from smooth_operator.errors import ConfigError, HandModelError, UnknownNameError, brief, listed
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.loading import MODELS
from smooth_operator.hands.spec import FingerChoice, HandSpec, select_fingers
from smooth_operator.hands.spec_file import read_hand_spec
from smooth_operator.plugins import Entry, Registry, is_target
from smooth_operator.types import Side, as_side
from smooth_operator.user_folders import program_folder

SWITCH: Final = "SMOOTH_OPERATOR_HANDS"
"""Environment variable that names another folder for the user's hands."""


def user_hands_folder() -> Path:
    """Folder of the user's spec files, which may not exist yet: the one named by ``SWITCH``, or
    else ``hands`` in the program's settings folder (``program_folder``)."""
    path = os.environ.get(SWITCH, "").strip()
    if path:
        return Path(path).expanduser()
    return program_folder("settings") / "hands"


def find_specs(folder: Path) -> dict[str, dict[Side, Path]]:
    """Spec files of a folder by name and side; empty if there is no such folder."""
    specs: dict[str, dict[Side, Path]] = {}
    sides: tuple[Side, ...] = ("right", "left")
    try:
        names = sorted(entry.name for entry in folder.iterdir())
    except OSError:
        return specs
    for file in names:
        for side in sides:
            name = file.removesuffix(f".{side}.toml")
            if name and name != file:
                specs.setdefault(name, {})[side] = folder / file
    return specs


HANDS: Final = Registry(
    "hand", {name: Entry(f"{__name__}:MODELS", "built-in") for name in sorted(find_specs(MODELS))}
)
"""Name -> path of a spec file, or of a folder with ``NAME.right.toml`` or ``NAME.left.toml``."""
MAKERS_HANDS: Final = tomllib.loads((MODELS.parent / "makers_hands.toml").read_text("utf-8"))
"""Hands whose models stay in the repositories of their makers, by name (see the file)."""


@dataclass(frozen=True)
class HandEntry:
    """One hand in the registry.

    Attributes:
        name: name by which it is loaded.
        files: spec files by side; a side without one is mirrored.
        builtin: True if it comes with the program.
    """

    name: str
    files: dict[Side, Path]
    builtin: bool

    @property
    def default_side(self) -> Side:
        """Side that is loaded by default: right, or the only side that has a spec file."""
        return "right" if "right" in self.files else "left"

    @property
    def mirrored(self) -> tuple[Side, ...]:
        """Sides that have no spec file and are loaded as mirror images."""
        sides: tuple[Side, ...] = ("right", "left")
        return tuple(side for side in sides if side not in self.files)

    def spec(self, side: Side) -> HandSpec:
        """Description of one side; HandModelError if its file can't be used."""
        mirrored = side in self.mirrored
        own = next(iter(self.files)) if mirrored else side
        spec = read_hand_spec(self.files[own])
        if (spec.name, spec.side) != (self.name, own):
            raise HandModelError(
                f"{self.files[own]} describes the {spec.side} hand {spec.name!r}, but its "
                f"file name says the {own} hand {self.name!r}"
            )
        if not os.path.isfile(spec.model):  # False for a name that is too long, too
            raise HandModelError(
                f"the model of hand {self.name!r} is no longer at {spec.model}; if it was "
                f"moved: smooth-operator hands add NEWPATH --name {self.name} --side {own} "
                f"--overwrite, or correct 'model' in {self.files[own]}"
            )
        return spec.mirrored if mirrored else spec


def known_hands() -> dict[str, HandEntry]:
    """All hands by name: the built-in ones, those of plugins that can be loaded, and those of the
    user whose names are not taken."""
    entries = HANDS.loadable(_registered)
    for name, files in find_specs(user_hands_folder()).items():
        entries.setdefault(name, HandEntry(name, files, builtin=False))
    return entries


def hand_names() -> tuple[str, ...]:
    """Names of the hands: first the built-in ones, then those of plugins and the user's own."""
    return tuple(dict.fromkeys([*HANDS, *find_specs(user_hands_folder())]))


def find_hand(name: str) -> HandEntry:
    """Returns the hand of the registry with a name, or the hand at ``package.module:attribute``.

    Raises:
        UnknownNameError: there is no hand of that name.
        HandModelError: a user's file has the name of another hand, or ``name`` is a model's path.
        ConfigError: the plugin that offers it can't be loaded.
    """
    own = find_specs(user_hands_folder()).get(name)
    if name in HANDS:
        if own is not None:
            raise shadowing(name, next(iter(own.values())))
        return _registered(name)
    if own is not None:
        return HandEntry(name, own, builtin=False)
    if is_target(name):
        return _described(name, HANDS.load(name))
    if name in MAKERS_HANDS or name.lower().endswith((".urdf", ".xml", ".mjcf", ".xacro")):
        raise HandModelError(
            f"{name} is a model that you have to add first: smooth-operator hands add {name}"
        )
    raise UnknownNameError("hand", name, hand_names())


def load_hand(
    hand: str | Path | HandSpec = "mimic_p050",
    side: str | None = None,
    *,
    fingers: FingerChoice | None = None,
) -> Hand:
    """Loads a robot hand.

    Args:
        hand: name of a hand that is built in, of a plugin or in the user's folder, or
            ``package.module:attribute``; path of a spec file (a string that ends in ``.toml``);
            or a description.
        side: ``right`` or ``left``; by default ``default_side``. A spec file of the other side is
            mirrored; a description keeps its side.
        fingers: choice of driven fingers and of the human fingers that drive them; see
            ``select_fingers``.

    Raises:
        UnknownNameError: there is no hand of that name, or it has no such finger.
        HandModelError: the description or the model can't be used.
    """
    if isinstance(hand, HandSpec):
        spec = hand
    elif isinstance(hand, Path) or hand.endswith(".toml"):
        spec = read_hand_spec(hand)
        spec = spec if side is None or as_side(side) == spec.side else spec.mirrored
    else:
        entry = find_hand(hand)
        chosen = as_side(side or entry.default_side)
        if entry.builtin and fingers is None:
            return _load_builtin(hand, chosen)
        spec = entry.spec(chosen)
    if fingers is not None:
        spec = select_fingers(spec, fingers)
    return load_hand_spec(spec)


def default_side(hand: str | Path | HandSpec) -> Side:
    """Side that ``load_hand`` loads by default: for a name, ``right`` or the only side with a spec
    file; for a description, its own side. Raises the same errors as ``load_hand``."""
    if isinstance(hand, HandSpec):
        return hand.side
    if isinstance(hand, Path) or hand.endswith(".toml"):
        return read_hand_spec(hand).side
    return find_hand(hand).default_side


@cache
def _load_builtin(name: str, side: Side) -> Hand:
    return load_hand_spec(_registered(name).spec(side))


@cache
def _registered(name: str) -> HandEntry:
    entry = _described(name, HANDS.load(name))
    if entry.name != name:
        raise HandModelError(
            f"{HANDS[name].target} describes the hand {entry.name!r}; expected {name!r}, the "
            "name of the plugin's entry point"
        )
    return entry


def _described(name: str, place: object) -> HandEntry:
    """Entry of a spec file or folder that a plugin offers under a name."""
    target = HANDS.find(name).target
    if not isinstance(place, str | os.PathLike):
        raise ConfigError(
            f"{target} can't be a hand: it must be the path of a spec file, or of a folder with "
            f"NAME.right.toml or NAME.left.toml, not {brief(place)}"
        )
    path = Path(place)
    if not path.is_dir():
        spec = read_hand_spec(path)
        return HandEntry(spec.name, {spec.side: path}, builtin=False)
    specs = find_specs(path)
    if name not in specs and (name in HANDS or len(specs) != 1):
        expectation = f"{name}.right.toml or {name}.left.toml" if name in HANDS else "one hand"
        raise HandModelError(f"{target}: expected {expectation} in {path}, not {listed(specs)}")
    own = name if name in specs else next(iter(specs))
    return HandEntry(own, specs[own], builtin=name in HANDS.built_in)


def origin(name: str) -> str:
    """Where a hand of the registry comes from, for messages, such as ``a built-in hand``."""
    owner = HANDS[name].distribution
    return f"a hand of {owner}" if owner else "a built-in hand"


def shadowing(name: str, file: Path) -> HandModelError:
    """Error for a user's file whose hand has the same name as another hand."""
    return HandModelError(
        f"{name!r} is {origin(name)}, so {os.fspath(file)} can't describe another hand of "
        "that name; choose a different name, in the file and for the file"
    )

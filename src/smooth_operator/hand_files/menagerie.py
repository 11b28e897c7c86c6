"""Hands with their real meshes from MuJoCo Menagerie, by its package: the extra ``menagerie``.

The package holds no models itself: it fetches a hand's archive (0.3 to 1.5 MB) when it is first
asked for and keeps it in its own cache; its environment variable ``MENAGERIE_ROOT`` names a
checkout of Menagerie to use instead.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import mujoco

from smooth_operator.errors import HandModelError, MissingExtraError
from smooth_operator.hand_files.vendor_model import on_model
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.stand_ins import stand_in_links
from smooth_operator.types import Side

MENAGERIE: Final = "menagerie"
"""The word that stands for a file of the package, where a model file can be named."""

_ENTRIES: Final[dict[tuple[str, Side], tuple[str, str]]] = {
    ("allegro_hand", "right"): ("wonik_allegro", "right_hand"),
    ("allegro_hand", "left"): ("wonik_allegro", "left_hand"),
    ("leap_hand", "right"): ("leap_hand", "right_hand"),
    ("leap_hand", "left"): ("leap_hand", "left_hand"),
    ("shadow_dexee", "right"): ("shadow_dexee", "shadow_dexee"),
    ("shadow_hand", "right"): ("shadow_hand", "right_hand"),
    ("shadow_hand", "left"): ("shadow_hand", "left_hand"),
    ("sharpa_wave", "right"): ("sharpa_wave", "right_hand"),
    ("sharpa_wave", "left"): ("sharpa_wave", "left_hand"),
}
"""Hand and side of the catalogue -> robot and entry point of the package."""


def drawn_on(hand: Hand, model: str | Path) -> Hand:
    """The same hand on a model with its real meshes.

    Args:
        hand: a hand, not a mirrored one.
        model: MJCF or URDF file of that hand, or ``MENAGERIE`` for the package's.

    Raises:
        HandModelError: there is no such model, or it is not of this hand.
        MissingExtraError: the package is asked for and is not installed.
    """
    return on_model(hand, menagerie_file(hand) if str(model) == MENAGERIE else model)


def hand_with_meshes(hand: Hand, model: str | Path | None = None) -> Hand | None:
    """The same hand on the model with its real meshes that is here; nothing is fetched.

    Args:
        hand: the robot hand.
        model: MJCF or URDF file of that hand, or ``MENAGERIE``, which may be fetched; if left out,
            the hand's own model if it has meshes, or else the package's copy, where there is one.

    Returns:
        the hand; None where no meshes of it are here.

    Raises:
        HandModelError: there is no such model, it can't be read, or it is not of this hand.
        MissingExtraError: the package is asked for and is not installed.
    """
    if model is not None:
        return drawn_on(hand, model)
    if has_meshes(hand):
        return hand
    path = None if hand.spec.mirror else menagerie_copy(hand)
    if path is None:
        return None
    there = on_model(hand, path)
    if lost := stand_in_links(there):
        raise HandModelError(f"{path}: the meshes of {', '.join(lost)} can't be read")
    return there


def has_meshes(hand: Hand) -> bool:
    """Whether the hand's own model has meshes."""
    own = hand.bodies[hand.model.geom_bodyid]
    return bool((hand.model.geom_type[own] == mujoco.mjtGeom.mjGEOM_MESH).any())


def menagerie_copy(hand: Hand) -> Path | None:
    """The package's model of a hand that is on this machine already; None if there is none."""
    entry = _ENTRIES.get((hand.name, hand.spec.side))
    if entry is None or find_spec("mujoco_menagerie") is None:
        return None
    package = _package()
    try:
        robot, cache = package.get(entry[0]), package.Cache()
        here = (cache.root / robot.name).is_dir() if cache.root else cache.is_cached(robot)
        return Path(robot.xml(entry[1])) if here else None
    except (package.MenagerieError, OSError):
        return None


def menagerie_file(hand: Hand) -> Path:
    """The package's model of a hand; fetched if need be.

    Raises:
        HandModelError: it has none of this hand and side, or it can't be fetched.
        MissingExtraError: the package is not installed.
    """
    entry = _ENTRIES.get((hand.name, hand.spec.side))
    if entry is None:
        names = ", ".join(f"{name} ({side})" for name, side in _ENTRIES)
        raise HandModelError(
            f"Menagerie has no model of the {hand.spec.side} hand {hand.name!r}, only of {names}; "
            "name a file of yours instead of the word menagerie"
        )
    package = _package()
    robot, xml = entry
    try:
        return Path(package.get(robot).xml(xml))
    except (package.MenagerieError, OSError) as error:
        raise HandModelError(
            f"the model {robot!r} of Menagerie can't be had: {error}. Try again with a network, "
            "or set MENAGERIE_ROOT to a checkout of github.com/google-deepmind/mujoco_menagerie"
        ) from error


def _package() -> Any:
    try:
        import mujoco_menagerie
    except ImportError as error:
        raise MissingExtraError("a model of Menagerie", "menagerie") from error
    return mujoco_menagerie

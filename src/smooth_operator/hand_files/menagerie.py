"""Hands with their real meshes from MuJoCo Menagerie, by its package: the extra ``menagerie``.

The package holds no models itself: it fetches a hand's archive (0.3 to 1.5 MB) when it is first
asked for and keeps it in its own cache; its environment variable ``MENAGERIE_ROOT`` names a
checkout of Menagerie to use instead.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import HandModelError, MissingExtraError
from smooth_operator.hand_files.vendor_model import on_model
from smooth_operator.hands.hand import Hand
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


def menagerie_file(hand: Hand) -> Path:
    """The package's model of a hand; fetched if need be.

    Raises:
        HandModelError: it has none of this hand and side, or it can't be fetched.
        MissingExtraError: the package is not installed.
    """
    entry = _ENTRIES.get((hand.name, hand.spec.side))
    if entry is None:
        known = ", ".join(f"{name} ({side})" for name, side in _ENTRIES)
        raise HandModelError(
            f"Menagerie has no model of the {hand.spec.side} hand {hand.name!r}, only of {known}; "
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

"""The built-in hands."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Final

from smooth_operator.errors import UnknownNameError
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.spec import FingerSpec, HandSpec, Point
from smooth_operator.types import Side, as_side

_MODELS: Final = Path(__file__).parent / "models"


def _mimic_p050(side: Side) -> HandSpec:
    """mimic P0.50: 16 actuated and 4 coupled joints; a right hand is published."""
    thumb = FingerSpec(
        "thumb",
        (
            Point("thumb_cmc"),
            Point("thumb_pp"),
            Point("thumb_dp"),
            Point("thumb_dp", (-0.00179, 0.000188, 0.027)),
        ),
    )
    # Neutral pose of the authors' released configuration; the paper's text says zero angles.
    neutral = {
        "thumb_base2cmc": 0.524,
        "thumb_cmc2mcp": -0.349,
        "thumb_mcp2pp": 0.873,
        "thumb_pp2dp_actuated": 0.873,
    }
    fingers = [thumb]
    for name, spread in (("index", 0.148), ("middle", 0.218), ("ring", 0.305), ("pinky", 0.393)):
        fingers.append(
            FingerSpec(
                name,
                (
                    Point(f"{name}_mcp"),
                    Point(f"{name}_mp"),
                    Point(f"{name}_dp"),
                    Point(f"{name}_dp", (0.019, 0.0, -0.005)),
                ),
            )
        )
        neutral |= {f"{name}_base2mcp": spread, f"{name}_mcp2pp": 0.262, f"{name}_pp2mp": 0.262}
    return HandSpec(
        name="mimic_p050",
        side=side,
        model=_MODELS / "mimic_p050.xml",
        palm="base_link",
        wrist=Point("base_link", (-0.00051, -0.00885, 0.12186)),
        fingers=tuple(fingers),
        neutral=neutral,
        mirror=side == "left",
    )


_CATALOGUE: Final[dict[str, Callable[[Side], HandSpec]]] = {"mimic_p050": _mimic_p050}


def hand_names() -> tuple[str, ...]:
    """Names of the built-in hands."""
    return tuple(sorted(_CATALOGUE))


@cache
def _load_builtin(name: str, side: Side) -> Hand:
    return load_hand_spec(_CATALOGUE[name](side))


def load_hand(hand: str | HandSpec = "mimic_p050", side: str = "right") -> Hand:
    """Load a robot hand.

    Args:
        hand: name of a built-in hand, or a description of your own.
        side: ``right`` or ``left``; a description brings its own side.

    Raises:
        UnknownNameError: if there is no built-in hand of that name.
        HandModelError: if the model can't be used.
    """
    if isinstance(hand, HandSpec):
        return load_hand_spec(hand)
    if hand not in _CATALOGUE:
        raise UnknownNameError("hand", hand, _CATALOGUE)
    return _load_builtin(hand, as_side(side))

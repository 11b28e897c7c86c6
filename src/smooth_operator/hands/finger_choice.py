"""Choice of the fingers of a hand that are driven, and of the human fingers that drive them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hands.spec import FingerChoice, HandSpec, JointMap
from smooth_operator.landmarks import FINGERS


def select_fingers(spec: HandSpec, fingers: FingerChoice) -> HandSpec:
    """Returns a hand's description with some of its fingers; other joints stay at neutral.

    The alignment keeps its landmarks if all remain. Otherwise it uses the thumb and the first
    and last of the other fingers, or, with two fingers, these and the wrist.

    Raises:
        UnknownNameError: the hand, or a human, has no such finger.
        HandModelError: fewer than two fingers, no thumb, or one human finger drives two.
    """
    choice = dict(fingers) if isinstance(fingers, Mapping) else {name: name for name in fingers}
    own = {finger.name: finger for finger in spec.fingers}
    for robot, human in choice.items():
        if robot not in own:
            raise UnknownNameError("finger", robot, own)
        if human not in FINGERS:
            raise UnknownNameError("human finger", human, FINGERS)
    if choice.get("thumb") != "thumb":
        raise HandModelError(
            f"hand {spec.name!r}: the thumb must be among the fingers, driven by the human thumb, "
            f"not {choice}"
        )
    chosen = sorted(
        (replace(own[robot], name=human) for robot, human in choice.items()),
        key=lambda finger: FINGERS.index(finger.name),
    )
    names = [finger.name for finger in chosen]
    if all(name == "wrist" or name in choice for name in spec.align):
        align = tuple(choice.get(name, name) for name in spec.align)
    elif len(names) > 2:
        align = (names[0], names[1], names[-1])
    else:
        align = ("wrist", *names)
    return replace(
        spec,
        fingers=tuple(chosen),
        align=align,
        joint_map=tuple(row for old in spec.joint_map for row in _renamed(old, choice)),
    )


def _renamed(row: JointMap, choice: Mapping[str, str]) -> list[JointMap]:
    """The map with the angles of the new driver; empty if its finger is left out."""
    gains: dict[str, float] = {}
    for angle, gain in row.gains.items():
        finger, _, rest = angle.partition("_")
        if finger not in choice:
            return []
        gains[f"{choice[finger]}_{rest}"] = gain
    return [replace(row, gains=gains)]

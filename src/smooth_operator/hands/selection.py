"""Fewer fingers, or others: which of a robot's fingers are driven, and by which human finger."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hands.spec import HandSpec, JointMap
from smooth_operator.landmarks import FINGERS

FingerChoice: TypeAlias = Mapping[str, str] | Sequence[str]
"""Robot finger -> human finger that drives it; or names of fingers, driven by their own."""


def parse_fingers(text: str) -> dict[str, str]:
    """A choice as text: ``thumb,index,pinky=ring`` has the human ring drive the robot's pinky.

    Raises:
        HandModelError: a part of it is empty, or a finger is named twice.
    """
    choice: dict[str, str] = {}
    for part in text.split(","):
        robot, sign, human = (word.strip() for word in part.partition("="))
        if not robot or (sign and not human):
            raise HandModelError(
                f"{text!r} is no choice of fingers; expected robot fingers with commas between, "
                "each with '=' and a human finger if another drives it: thumb,index,pinky=ring"
            )
        if robot in choice:
            raise HandModelError(f"{text!r} names the finger {robot!r} twice")
        choice[robot] = human or robot
    return choice


def select_fingers(spec: HandSpec, fingers: FingerChoice) -> HandSpec:
    """The same hand with some of its fingers; the joints of the others stay at neutral.

    Where all landmarks that the alignment uses are kept, it uses the same; else the thumb and the
    first and last of the other fingers, or, with two fingers, these and the wrist.

    Args:
        spec: the hand.
        fingers: which; the thumb must be among them, driven by the human thumb.

    Raises:
        UnknownNameError: the hand has no such finger, or a human hasn't.
        HandModelError: fewer than two fingers, no thumb, or one human finger for two.
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
    """A row with the angles of the new driver; none if the finger it follows is left out."""
    gains: dict[str, float] = {}
    for angle, gain in row.gains.items():
        finger, _, rest = angle.partition("_")
        if finger not in choice:
            return []
        gains[f"{choice[finger]}_{rest}"] = gain
    return [replace(row, gains=gains)]

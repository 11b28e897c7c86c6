"""Options of a user that overrule findings of the analysis."""

from __future__ import annotations

from dataclasses import dataclass

from smooth_operator.errors import HandModelError
from smooth_operator.hands.spec import Point
from smooth_operator.landmarks import FINGERS


@dataclass(frozen=True)
class Overrules:
    """Findings that are given, not found.

    Attributes:
        palm: body from which the fingers branch.
        thumb: a body or joint of the thumb.
        fingers: (human finger, a body or joint of the robot finger that it drives) pairs; of a
            model with more than five fingers only these are used.
        tips: (human finger, fingertip) pairs.
        wrist: the wrist point.

    Raises:
        HandModelError: if a finger is not a human one, or is named twice.
    """

    palm: str | None = None
    thumb: str | None = None
    fingers: tuple[tuple[str, str], ...] = ()
    tips: tuple[tuple[str, Point], ...] = ()
    wrist: Point | None = None

    def __post_init__(self) -> None:
        for what, pairs in (("finger", self.fingers), ("tip", self.tips)):
            names = [name for name, _ in pairs]
            for name in names:
                if name not in FINGERS:
                    raise HandModelError(
                        f"--{what} names the finger {name!r}; expected one of {', '.join(FINGERS)}"
                    )
                if names.count(name) > 1:
                    raise HandModelError(
                        f"--{what} names {name!r} twice; give each finger one {what}"
                    )

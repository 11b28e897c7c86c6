"""Uses an operator's pinches as inputs, for example those of a hand that drives no robot."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from smooth_operator.errors import ConfigError
from smooth_operator.landmarks import BASES, FINGERS, TIPS, WRIST
from smooth_operator.types import HandFrame, Side

_CLOSED: Final = 0.25  # largest distance between the tips of a pinch [palm lengths]
_BEYOND: Final = 0.08  # the same, beyond the gap that the tracker reports in a pinch
_OPEN: Final = 0.2  # distance beyond both, after which the next pinch counts
_FIST: Final = 0.9  # a fingertip nearer to the wrist than this is bent into the palm
_HOLD_S: Final = 0.1  # shortest pinch
_LOST_S: Final = 0.3  # time without frames after which the hand has to open again


def sides_of(bindings: Iterable[str], driven: Sequence[Side]) -> dict[Side, dict[str, str]]:
    """Maps side and finger to the input, for the pinches in a table of inputs.

    Args:
        driven: sides of the hands that drive a robot.

    Raises:
        ConfigError: both hands drive a robot, and a pinch has no side.
    """
    found: dict[Side, dict[str, str]] = {}
    other: Side = "left" if driven[0] == "right" else "right"
    for name in bindings:
        if not name.startswith("pinch:"):
            continue
        *named, finger = name.removeprefix("pinch:").split("-")
        if not named and len(driven) > 1:
            raise ConfigError(
                f"{name}: both hands drive a robot; to let a pinch of one of them act too, write "
                f"pinch:left-{finger} or pinch:right-{finger}"
            )
        side: Side = "left" if named == ["left"] else "right" if named else other
        found.setdefault(side, {})[finger] = name
    return found


def watched(
    pinches: Mapping[Side, Mapping[str, str]],
    press: Callable[[str], None],
    gaps: Mapping[str, float],
) -> Callable[[HandFrame, float], None]:
    """Returns a function that takes each frame and its time, and recognises the pinches of
    ``sides_of``."""
    hands = {side: Pinches(inputs, press, gaps) for side, inputs in pinches.items()}

    def see(frame: HandFrame, now: float) -> None:
        if (hand := hands.get(frame.side)) is not None:
            hand.see(frame, now)

    return see


class Pinches:
    """Recognises the pinches of one hand.

    A pinch counts once, after thumb and finger have touched for 0.1 s. The next one counts after
    the hand has opened in view of the tracker. A fist does not count.

    Args:
        inputs: finger -> input.
        press: called with the input of a pinch.
        gaps: finger -> distance from the thumb that the tracker reports at a touch [palm lengths].
    """

    def __init__(
        self, inputs: Mapping[str, str], press: Callable[[str], None], gaps: Mapping[str, float]
    ) -> None:
        self._inputs, self._press = inputs, press
        known = np.array([gaps.get(finger, 0.0) for finger in FINGERS[1:]])
        self._closed = np.maximum(known + _BEYOND, _CLOSED)
        self._ready = False  # True after the hand was open
        self._since: tuple[int, float] | None = None  # finger and start of a touch
        self._last = 0.0

    def see(self, frame: HandFrame, now: float) -> None:
        """Processes a frame that was received at a time [s]."""
        points = frame.landmarks
        with np.errstate(invalid="ignore"):
            palm = np.linalg.norm(points[BASES[2]] - points[WRIST])
            tips, bases = points[list(TIPS[1:])], points[list(BASES[1:])]
            gaps = np.linalg.norm(tips - points[TIPS[0]], axis=1) / palm - self._closed
            reach = np.linalg.norm(tips - points[WRIST], axis=1)
            fist = reach < _FIST * np.linalg.norm(bases - points[WRIST], axis=1)
        late, self._last = now - self._last > _LOST_S, now
        if late or not np.isfinite(gaps).all():
            self._ready, self._since = False, None
            return
        finger = int(gaps.argmin())
        if gaps[finger] > _OPEN:
            self._ready = True
        if gaps[finger] > 0.0 or fist[finger] or not self._ready:
            self._since = None
        elif self._since is None or self._since[0] != finger:
            self._since = finger, now
        elif now - self._since[1] >= _HOLD_S:
            self._ready, self._since = False, None
            if (name := self._inputs.get(FINGERS[1 + finger])) is not None:
                self._press(name)

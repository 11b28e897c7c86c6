"""Steps of a person who does a task: where fingertips go, until when, as what is seen says."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.state import SceneState

THUMB: Final = 0
PAD_M: Final = 0.004
"""From a fingertip's landmark to the surface of its pad [m]."""

PRESS_M: Final = 0.002
"""How far beyond the object's surface a person presses in the first attempt [m]; ours."""

OPEN_M: Final = 0.010
"""Width by which open fingers are away from a surface [m]; people open 10 to 20 mm wider than the
object when they reach for it (Jeannerod 1984)."""

CLOSING_S: Final = 1.0
"""Duration of a grip's closing [s]: slow, so that little is overshot within the visual delay."""

_SEEK_M: Final = 0.006  # so far beyond the place where contact is expected fingers look for it [m]

STROKE_S: Final = 1.0
"""Least duration of a movement with the object [s]; ours."""

Aims: TypeAlias = dict[int, Float[np.ndarray, "3"]]
"""Finger -> where its tip is to go, in the world [m]; fingers that are left out relax."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What a person sees at one moment.

    Attributes:
        state: the object.
        scorer: how far the task is.
        tips: (f, 3) the robot's fingertips in the world [m], thumb first.
        sent: (f, 3) where the person had sent them.
    """

    state: SceneState
    scorer: Any
    tips: Float[np.ndarray, "f 3"]
    sent: Float[np.ndarray, "f 3"]

    def touches(self, *fingers: int) -> bool:
        """Whether all of these fingers touch the object."""
        return bool((self.state.force[list(fingers)] > 0.0).all())


@dataclass(frozen=True, eq=False)
class Step:
    """What a person does next.

    Attributes:
        aims: share of the movement from 0 to 1, and what is seen -> where fingertips go.
        until: the step is over as soon as this is seen; None: when the fingertips are in place.
        presses: fingers that press on the object; their place is not corrected.
        longest_s: a wait for ``until`` or for fingertips that do not arrive ends after this [s].
        seconds: least duration of the movement [s].
        via: only passed on the way: the person does not wait and does not correct.
        path: whether the aims go from start to end with the share; otherwise the person goes
            straight to them.
        attempt: whether another attempt begins with it.
        reset: ask for the object to be put back, as the step begins.
    """

    aims: Callable[[float, Seen], Aims]
    until: Callable[[Seen], bool] | None = None
    presses: tuple[int, ...] = ()
    longest_s: float = 2.0
    seconds: float = 0.0
    via: bool = False
    path: bool = False
    attempt: bool = False
    reset: bool = False


Strategy: TypeAlias = Generator[Step, Seen, None]
"""Steps of a person; it ends when the person gives up."""


def still(aims: Aims) -> Callable[[float, Seen], Aims]:
    """Aims that do not change."""
    return lambda share, seen: aims


class Closing:
    """Fingers close on an object; each stops where it is seen to touch, and presses from there.

    Args:
        wide: where fingers begin.
        inward: finger -> direction in which it closes.
        press: how far fingers press beyond the place of the contact [m].
        opened: how far fingers are from the surface at first [m].
    """

    def __init__(self, wide: Aims, inward: Aims, press: float, opened: float = OPEN_M) -> None:
        self._opened = opened
        self._wide, self._inward, self._press = wide, inward, press
        self.contact: Aims = {}

    def __call__(self, share: float, seen: Seen) -> Aims:
        """Aims of the step; remembers what is seen to touch."""
        for finger in self._wide:
            if finger not in self.contact and seen.touches(finger):
                self.contact[finger] = seen.tips[finger].copy()
        found = self.pressed(self._press)
        return found | {
            finger: place + share * (self._opened + _SEEK_M) * self._inward[finger]
            for finger, place in self._wide.items()
            if finger not in self.contact
        }

    @property
    def complete(self) -> bool:
        """Whether all fingers have touched."""
        return len(self.contact) == len(self._wide)

    def pressed(self, press: float) -> Aims:
        """Where fingers go to press so far beyond the contact [m], seen or expected."""
        expected = {f: p + self._opened * self._inward[f] for f, p in self._wide.items()}
        return {f: p + press * self._inward[f] for f, p in (expected | self.contact).items()}

    def step(self) -> Step:
        """The step: slow, until all fingers have been seen to touch."""
        return Step(
            self, lambda seen: self.complete, presses=tuple(self._wide), longest_s=0.5,
            seconds=CLOSING_S, path=True,
        )  # fmt: skip


def along(start: Aims, end: Aims) -> Callable[[float, Seen], Aims]:
    """A straight way of fingertips; for steps with ``path``."""
    return lambda share, seen: {f: place + share * (end[f] - place) for f, place in start.items()}


def turned(aims: Aims, centre: Float[np.ndarray, "3"], angle: float) -> Aims:
    """Fingertips turned about the vertical through a place."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return {finger: centre + turn @ (place - centre) for finger, place in aims.items()}


def moved(aims: Aims, by: Float[np.ndarray, "3"]) -> Aims:
    """The aims, moved [m]."""
    return {finger: place + by for finger, place in aims.items()}


def again(seen: Seen, reset: bool = False) -> Generator[Step, Seen, Seen]:
    """Open the hand after an attempt, and ask for a reset if the object can't be worked on."""
    reset = reset or bool(seen.scorer.standing.stuck)
    return (yield Step(lambda share, s: {}, longest_s=0.5, attempt=True, reset=reset))

"""What the synthetic operator does: gestures in a new random order each round, without end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.synthetic.motion import Segment, Trajectory, draw_wander, least_duration
from smooth_operator.synthetic.poses import (
    CURLED,
    FIST,
    FLAT,
    FREE_LOWER,
    FREE_UPPER,
    PINCHES,
    RELAXED,
    SPREAD,
    Posture,
    pinch_postures,
)

GESTURES: Final = ("open_close", *PINCHES, "spread", "gait", "wander")
"""Names of the gestures, in the order in which they are made by default (about 20 s)."""

_ALL = (np.zeros(16), np.ones(16))
_LOOSE = np.deg2rad(2.0)  # a posture is never taken twice in quite the same way
_REACH = np.deg2rad([12, 10, 14, 16, *(5, 30, 38) * 4])  # of wandering, per joint


class Programme:
    """An endless sequence of gestures as a function of time, the same for the same arguments.

    Args:
        seed: draws the person (for the pinches), the timing, the amplitudes and the wandering.
        gestures: which, in which order; repeated for ever with new draws.
        speed: 1 is the natural tempo; 2 is twice as fast where ``max_jerk`` lets it.
        max_jerk: bound on every free joint angle's jerk [rad/s^3]; moves take longer to keep it.
    """

    def __init__(self, seed: int, gestures: tuple[str, ...], speed: float, max_jerk: float) -> None:
        self._rng = np.random.default_rng([seed, 0x60])
        self._seed = seed
        self._speed = speed
        self._max_jerk = max_jerk
        self._posture = self._loosely(FLAT)
        self._segments = self._endless(gestures)
        self._now: Trajectory | None = None

    def at(self, times: Float[np.ndarray, " T"]) -> tuple[Float[np.ndarray, "T 16"], list[str]]:
        """Free joint angles [rad] and the gesture's name at increasing times >= 0 [s].

        Each call must ask for times after those of the call before.
        """
        while self._now is None or self._now.end <= times[-1]:
            self._now = self._extended(float(times[0]))
        angles, which = self._now.at(times)
        labels = [segment.label for segment in self._now.segments]
        return angles, [labels[k] for k in which]

    def _extended(self, needed_from: float) -> Trajectory:
        old, origin = [], 0.0
        if self._now is not None:  # keep what the coming frames can still see
            first = int(np.searchsorted(self._now.starts[1:-1], needed_from, side="right"))
            old, origin = self._now.segments[first:], float(self._now.starts[first])
        return Trajectory([*old, *(next(self._segments) for _ in range(16))], origin)

    def _endless(self, gestures: tuple[str, ...]) -> Iterator[Segment]:
        while True:
            for name in gestures:
                make = _MAKERS[name.partition("_")[0]]
                yield from make(self, name)

    def _loosely(self, posture: Posture, loose: float = _LOOSE) -> Posture:
        noise = np.clip(self._rng.normal(0.0, loose, 16), -2.0 * loose, 2.0 * loose)
        return np.clip(posture + noise, FREE_LOWER, FREE_UPPER)

    def _time(self, seconds: float) -> float:
        return seconds * float(self._rng.uniform(0.85, 1.15)) / self._speed

    def _move(
        self,
        label: str,
        posture: Posture,
        seconds: float,
        windows: tuple[Float[np.ndarray, "16"], Float[np.ndarray, "16"]] = _ALL,
    ) -> Segment:
        least = least_duration(self._posture, posture, *windows, self._max_jerk)
        duration = max(self._time(seconds), least)
        segment = Segment(label, duration, self._posture, posture, *windows)
        self._posture = posture
        return segment

    def _hold(self, label: str, seconds: float) -> Segment:
        return Segment(label, self._time(seconds), self._posture, self._posture, *_ALL)

    # Each gesture sets off from the posture that the one before left and ends open.

    def _open_close(self, label: str) -> Iterator[Segment]:
        depth = self._rng.uniform(0.94, 1.0)  # how tightly this fist is made
        fist = self._loosely(FLAT + depth * (FIST - FLAT), _LOOSE / 2.0)
        fist[:4] = FIST[:4] + np.clip(fist[:4] - FIST[:4], -_LOOSE, _LOOSE)
        curled = fist.copy()
        curled[:4] = CURLED[:4]
        # The thumb closes over fingers already curled, and leaves before they open.
        yield self._move(label, curled, 0.8)
        yield self._move(label, fist, 0.5)
        yield self._hold(label, 0.3)
        opening = curled.copy()
        opening[4:] = fist[4:]
        yield self._move(label, opening, 0.4)
        yield self._move(label, self._loosely(FLAT), 0.8)
        yield self._hold(label, 0.2)

    def _pinch(self, label: str) -> Iterator[Segment]:
        finger = PINCHES.index(label)
        exact = pinch_postures(self._seed)[finger]
        pinch = self._loosely(exact)
        moving = [*range(4), *range(4 + 3 * finger, 7 + 3 * finger)]
        pinch[moving] = exact[moving]  # what makes the tips meet
        yield self._move(label, pinch, 0.9)
        yield self._hold(label, 0.4)
        yield self._move(label, self._loosely(0.5 * (FLAT + RELAXED)), 0.7)

    def _spread(self, label: str) -> Iterator[Segment]:
        yield self._move(label, self._loosely(SPREAD), 0.7)
        yield self._hold(label, 0.2)
        yield self._move(label, self._loosely(FLAT), 0.6)
        yield self._hold(label, 0.1)

    def _gait(self, label: str) -> Iterator[Segment]:
        inward = bool(self._rng.integers(2))
        for _ in range(2):
            # Fingers follow one another; the thumb stays clear of them.
            order = np.arange(4) if inward else np.arange(4)[::-1]
            begins, ends = np.zeros(16), np.ones(16)
            for finger, place in enumerate(order):
                joints = slice(4 + 3 * finger, 7 + 3 * finger)
                begins[joints], ends[joints] = 0.16 * place, 0.52 + 0.16 * place
            curled = self._loosely(FLAT + self._rng.uniform(0.75, 0.95) * (CURLED - FLAT))
            curled[:4] = self._loosely(CURLED)[:4]
            yield self._move(label, curled, 1.1, (begins, ends))
            yield self._move(label, self._loosely(RELAXED * 0.4 + FLAT * 0.6), 1.1, (begins, ends))

    def _wander(self, label: str) -> Iterator[Segment]:
        centre = self._loosely(RELAXED, 2.0 * _LOOSE)
        yield self._move(label, centre, 0.6)
        wander = draw_wander(self._rng, centre, _REACH, self._speed, self._max_jerk)
        yield Segment(label, self._time(3.5), centre, centre, *_ALL, wander)
        yield self._move(label, self._loosely(FLAT), 0.6)


_MAKERS: dict[str, Callable[[Programme, str], Iterator[Segment]]] = {
    "open": Programme._open_close,
    "pinch": Programme._pinch,
    "spread": Programme._spread,
    "gait": Programme._gait,
    "wander": Programme._wander,
}

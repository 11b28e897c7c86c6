"""Gestures of the synthetic operator: minimum-jerk movements and random wandering in joint space.

A minimum-jerk move (T. Flash and N. Hogan, "The Coordination of Arm Movements", Journal of
Neuroscience 5(7), 1985) starts and ends without velocity and acceleration, so successive moves are
twice continuously differentiable, and stay between their two postures. Wandering adds slow sines
under an envelope of the same shape, so it starts and ends as smoothly.

A posture is 16 free joint angles (see ``FREE``): the thumb's CMC flexion, CMC abduction, MCP and
IP, then MCP abduction, MCP and PIP of index .. pinky.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.landmarks import TIPS
from smooth_operator.synthetic.hand_anatomy import (
    FREE,
    LOWER,
    UPPER,
    couple,
    dorsal,
    draw_anatomy,
    pose_hand,
)

FREE_LOWER: Float[np.ndarray, "16"] = LOWER[list(FREE)]
FREE_UPPER: Float[np.ndarray, "16"] = UPPER[list(FREE)]
FREE_LOWER.setflags(write=False)
FREE_UPPER.setflags(write=False)

PINCHES: Final = ("pinch_index", "pinch_middle", "pinch_ring", "pinch_pinky")
"""Names of the four pinches, in the order of ``pinch_postures``."""

Posture = Float[np.ndarray, "16"]


def _posture(thumb: tuple[float, ...], *fingers: tuple[float, float, float]) -> Posture:
    posture = np.deg2rad([*thumb, *(angle for finger in fingers for angle in finger)])
    posture.setflags(write=False)
    return posture


# Chosen by eye and against recordings of real hands; degrees.
FLAT = _posture((-13, -9, 3, 2), (-2, 4, 6), (0, 4, 6), (3, 4, 7), (6, 5, 8))
RELAXED = _posture((0, 4, 12, 14), (2, 22, 26), (0, 26, 30), (0, 28, 32), (-2, 28, 30))
SPREAD = _posture((-18, 6, 0, -4), (15, -4, 4), (1, -6, 4), (-11, -5, 5), (-24, -4, 5))
CURLED = _posture((-8, 12, 10, 12), (-4, 74, 92), (0, 78, 96), (2, 80, 96), (4, 80, 94))
"""Posture with all four fingers curled and the thumb out of their way."""
FIST = _posture((-14, 13, 40, 63), (-4, 78, 96), (0, 82, 98), (2, 84, 98), (4, 84, 96))
"""Posture with the thumb closed over the curled fingers."""

# Natural posture in each pinch, from which the solution deviates as little as possible: the thumb,
# then the pinching finger.
_PINCH_THUMB = np.deg2rad([[4, 18, 18, 22], [14, 22, 20, 24], [23, 25, 24, 28], [30, 28, 30, 34]])
_PINCH_FINGER = np.deg2rad([[4, 46, 50], [2, 50, 50], [2, 52, 50], [6, 50, 48]])
_PINCH_SPREAD = np.deg2rad([10.0, 10.0, 14.0, 16.0, 5.0, 14.0, 14.0])
# Pulp of the fingertips between the two tip landmarks, over hand length: 1.5 mm on a 0.19 m hand.
_PINCH_GAP = 0.008
_CONTACT_SPREAD = 0.0005
_FACING_SPREAD = 0.9
_LIMIT_MARGIN = np.deg2rad(1.0)


@lru_cache(maxsize=64)
def pinch_postures(seed: int) -> Float[np.ndarray, "4 16"]:
    """Postures in which the tip of the thumb meets the tip of the index, middle, ring or pinky
    finger.

    They follow from inverse kinematics of the person's own hand within the joint ranges: the
    finger's tip lies on the thumb's pad, 0.8 % of the hand length (1.5 mm) from the thumb's tip,
    the pads face each other, and the joints stay near a natural pinch. The other fingers are
    relaxed, and neighbours follow in part. The angles don't depend on the hand's length.

    Args:
        seed: seed of the person, as for ``draw_anatomy``.

    Returns:
        (4, 16) read-only postures [rad].
    """
    anatomy = draw_anatomy(1.0, seed)
    which = np.arange(4)
    moving = np.concatenate(
        [np.tile(np.arange(4), (4, 1)), 4 + 3 * which[:, None] + np.arange(3)], 1
    )
    natural = np.concatenate([_PINCH_THUMB, _PINCH_FINGER], 1)
    lower = FREE_LOWER[moving] + _LIMIT_MARGIN
    upper = FREE_UPPER[moving] - _LIMIT_MARGIN
    postures = np.array([_around(finger) for finger in range(4)])

    def residual(x: Float[np.ndarray, "n 4 7"]) -> Float[np.ndarray, "n 4 11"]:
        free = np.broadcast_to(postures, (*x.shape[:2], 16)).copy()
        np.put_along_axis(free, np.broadcast_to(moving, x.shape), x, -1)
        poses = pose_hand(anatomy, couple(free.reshape(-1, 16)))
        tips = poses.landmarks[:, TIPS].reshape(-1, 4, 5, 3)
        nails = dorsal(poses.orientations[:, TIPS]).reshape(-1, 4, 5, 3)
        thumb, finger = nails[:, :, 0], nails[:, which, which + 1]
        gap = tips[:, which, which + 1] - (tips[:, :, 0] - _PINCH_GAP * thumb)
        facing = 1.0 + (thumb * finger).sum(-1, keepdims=True)
        return np.concatenate(
            [gap / _CONTACT_SPREAD, (x - natural) / _PINCH_SPREAD, facing / _FACING_SPREAD], -1
        )

    solution = _least_squares(residual, np.clip(natural, lower, upper), lower, upper)
    np.put_along_axis(postures, moving, solution, -1)
    postures.setflags(write=False)
    return postures


def _around(finger: int) -> Posture:
    """Posture of the other fingers while one pinches; the neighbours of that finger are more
    flexed.
    """
    posture = RELAXED.copy()
    for other in range(4):
        follow = 1.0 if abs(other - finger) == 1 else 0.7
        posture[5 + 3 * other : 7 + 3 * other] *= follow
    return posture


def _least_squares(
    residual: Callable[[Float[np.ndarray, "n P K"]], Float[np.ndarray, "n P R"]],
    x: Float[np.ndarray, "P K"],
    lower: Float[np.ndarray, "P K"],
    upper: Float[np.ndarray, "P K"],
    steps: int = 40,
) -> Float[np.ndarray, "P K"]:
    """Levenberg-Marquardt within bounds, for P problems in parallel.

    SciPy's ``least_squares`` does the same for one problem, but its import takes longer than all
    other work of the synthetic operator.
    """
    n = x.shape[-1]
    nudge = 1e-6
    damping = np.full((len(x), 1, 1), 1e-2)
    nudges = nudge * np.eye(n)[:, None]
    for _ in range(steps):
        values = residual(np.concatenate([x[None], x[None] + nudges]))
        r = values[0]
        jacobian = np.moveaxis((values[1:] - r) / nudge, 0, -1)
        gradient = np.einsum("pri,pr->pi", jacobian, r)
        # a joint at its limit with a step beyond the limit is held
        free = ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0)))
        jacobian = jacobian * free[:, None]
        hessian = np.einsum("pri,prj->pij", jacobian, jacobian)
        hessian += (damping + ~free[:, None]) * np.eye(n)
        step = np.linalg.solve(hessian, -(gradient * free)[..., None])[..., 0]
        trial = np.clip(x + step, lower, upper)
        better = (residual(trial[None])[0] ** 2).sum(-1) < (r**2).sum(-1)
        if np.abs(trial - x).max() < 1e-9:
            break
        x = np.where(better[:, None], trial, x)
        damping = np.where(better[:, None, None], damping / 5.0, damping * 5.0)
    return x


GESTURES: Final = ("open_close", *PINCHES, "spread", "gait", "wander")
"""Names of the gestures in their default order (about 20 s)."""

_ALL = (np.zeros(16), np.ones(16))
_LOOSE = np.deg2rad(2.0)  # standard deviation of a posture between repetitions
_REACH = np.deg2rad([12, 10, 14, 16, *(5, 30, 38) * 4])  # excursion of each joint in wandering


class Programme:
    """An endless sequence of gestures as a function of time, determined by its arguments.

    Args:
        seed: seed of the person (for the pinches), the timing, the amplitudes and the wandering.
        gestures: names of the gestures in order; repeated without end, with new draws.
        speed: 1 is a natural tempo; 2 is twice as fast as far as ``max_jerk`` allows.
        max_jerk: bound on the jerk of every free joint angle [rad/s^3]; moves are slowed to it.
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
        """Free joint angles [rad] and the name of the gesture, at increasing times >= 0 [s].

        The times of each call must be later than those of the previous call.
        """
        while self._now is None or self._now.end <= times[-1]:
            self._now = self._extended(float(times[0]))
        angles, which = self._now.at(times)
        labels = [segment.label for segment in self._now.segments]
        return angles, [labels[k] for k in which]

    def _extended(self, needed_from: float) -> Trajectory:
        old, origin = [], 0.0
        if self._now is not None:  # segments that the coming frames still need
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

    # Each gesture starts at the last posture of the previous one and ends with an open hand.

    def _open_close(self, label: str) -> Iterator[Segment]:
        depth = self._rng.uniform(0.94, 1.0)  # 1 is a tight fist
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
        pinch[moving] = exact[moving]  # without noise, so that the tips meet
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


# Largest derivatives of a minimum-jerk move over distance 1 in time 1.
_PEAK_JERK = 60.0
_PEAK_ACCELERATION = 10.0 / np.sqrt(3.0)
_PEAK_VELOCITY = 1.875


@dataclass(frozen=True, eq=False)
class Wander:
    """Random motion about a posture, a sum of sines: ``sum_m amplitude * sin(2 pi frequency t +
    phase)`` per joint.

    Attributes:
        amplitude: (16, M) amplitudes [rad].
        frequency: (16, M) frequencies [Hz].
        phase: (16, M) phases [rad].
        ramp: time in which the envelope rises at the start and falls at the end [s].
    """

    amplitude: Float[np.ndarray, "16 M"]
    frequency: Float[np.ndarray, "16 M"]
    phase: Float[np.ndarray, "16 M"]
    ramp: float


@dataclass(frozen=True, eq=False)
class Segment:
    """A movement between two postures, or a hold (equal postures), with optional wandering.

    Attributes:
        label: name of its gesture.
        duration: duration [s].
        start: (16,) first posture [rad].
        end: (16,) last posture [rad].
        begins: (16,) start of each joint's motion as a share of the duration.
        ends: (16,) end of each joint's motion as a share of the duration.
        wander: motion that is added to the postures.
    """

    label: str
    duration: float
    start: Posture
    end: Posture
    begins: Float[np.ndarray, "16"]
    ends: Float[np.ndarray, "16"]
    wander: Wander | None = None


def least_duration(
    start: Posture,
    end: Posture,
    begins: Float[np.ndarray, "16"],
    ends: Float[np.ndarray, "16"],
    max_jerk: float,
) -> float:
    """Shortest duration [s] of a movement in which no joint's jerk exceeds ``max_jerk``
    [rad/s^3]."""
    alone = np.cbrt(_PEAK_JERK * np.abs(end - start) / max_jerk)
    return float((alone / (ends - begins)).max())


def draw_wander(
    rng: np.random.Generator, centre: Posture, reach: Posture, speed: float, max_jerk: float
) -> Wander:
    """Draws random motion about a posture, within the joint ranges and the jerk bound.

    The four PIPs and MCPs share part of their motion, as fingers of a hand do.

    Args:
        centre: (16,) posture [rad].
        reach: (16,) largest excursion of each joint [rad].
        speed: 1 is a natural tempo, 0.15 to 0.75 Hz.
        max_jerk: bound on the jerk of each joint [rad/s^3]; amplitudes are reduced to keep it.
    """
    terms, ramp = 3, 0.8 / speed
    share = rng.dirichlet(np.full(terms, 2.0), 16)
    frequency = speed * rng.uniform(0.15, 0.75, (16, terms))
    phase = rng.uniform(0.0, 2.0 * np.pi, (16, terms))
    for first in (5, 6):  # the first term is common to all MCPs, and to all PIPs
        together = slice(first, 16, 3)
        frequency[together, 0] = frequency[first, 0]
        phase[together, 0] = phase[first, 0]
    room = np.minimum(np.minimum(centre - FREE_LOWER, FREE_UPPER - centre), reach)
    amplitude = share * room[:, None]

    # (envelope * sines)''' by Leibniz' rule, with the largest value of each factor
    omega = 2.0 * np.pi * frequency
    sines = [(amplitude * omega**k).sum(-1) for k in range(4)]
    jerk = (
        _PEAK_JERK / ramp**3 * sines[0]
        + 3.0 * _PEAK_ACCELERATION / ramp**2 * sines[1]
        + 3.0 * _PEAK_VELOCITY / ramp * sines[2]
        + sines[3]
    )
    amplitude *= np.minimum(1.0, max_jerk / np.maximum(jerk, 1e-12))[:, None]
    return Wander(amplitude, frequency, phase, ramp)


class Trajectory:
    """Joint angles over time, made of successive segments.

    Args:
        segments: segments in order; each starts at the last posture of the previous one.
        origin: start of the first segment [s].
    """

    def __init__(self, segments: list[Segment], origin: float = 0.0) -> None:
        self.segments = segments
        self.starts = origin + np.cumsum([0.0, *(s.duration for s in segments)])
        self._duration = np.array([s.duration for s in segments])
        self._start = np.array([s.start for s in segments])
        self._change = np.array([s.end - s.start for s in segments])
        self._begins = np.array([s.begins for s in segments])
        self._span = np.array([s.ends - s.begins for s in segments])

    @property
    def end(self) -> float:
        """Time at which the last segment ends [s]."""
        return float(self.starts[-1])

    def at(
        self, times: Float[np.ndarray, " T"]
    ) -> tuple[Float[np.ndarray, "T 16"], Int[np.ndarray, " T"]]:
        """Free joint angles [rad] and the index of the active segment at each time [s]."""
        which = np.searchsorted(self.starts[1:-1], times, side="right")
        share = (times - self.starts[which]) / self._duration[which]
        progress = (share[:, None] - self._begins[which]) / self._span[which]
        angles = self._start[which] + self._change[which] * minimum_jerk(progress)
        for k in np.unique(which):
            wander = self.segments[k].wander
            if wander is not None:
                rows = which == k
                since = times[rows] - self.starts[k]
                angles[rows] += _wandering(wander, since, self._duration[k])
        return angles, which


def minimum_jerk(progress: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Position, from 0 to 1, of a minimum-jerk movement; constant before 0 and after 1."""
    s = np.clip(progress, 0.0, 1.0)
    position: np.ndarray = s**3 * (10.0 + s * (6.0 * s - 15.0))
    return position


def _wandering(
    wander: Wander, since: Float[np.ndarray, " T"], duration: float
) -> Float[np.ndarray, "T 16"]:
    nearest_end = np.minimum(since, duration - since)
    envelope = minimum_jerk(nearest_end / wander.ramp)
    angle = 2.0 * np.pi * wander.frequency * since[:, None, None] + wander.phase
    excursion: np.ndarray = envelope[:, None] * (wander.amplitude * np.sin(angle)).sum(-1)
    return excursion

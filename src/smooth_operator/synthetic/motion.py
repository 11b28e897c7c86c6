"""Joint-space motion: minimum-jerk moves and wandering, as one function of time.

A minimum-jerk move (T. Flash and N. Hogan, "The Coordination of Arm Movements", Journal of
Neuroscience 5(7), 1985) starts and ends with no velocity and no acceleration, so moves joined end
to end are twice continuously differentiable, and stay between their two postures. Wandering adds
slow sines under an envelope of the same shape, so it joins as smoothly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.synthetic.poses import FREE_LOWER, FREE_UPPER, Posture

_PEAK_JERK = 60.0  # of a minimum-jerk move, over distance / duration^3
_PEAK_ACCELERATION = 10.0 / np.sqrt(3.0)
_PEAK_VELOCITY = 1.875


@dataclass(frozen=True, eq=False)
class Wander:
    """Sines about a posture: ``sum_m amplitude * sin(2 pi frequency t + phase)`` per joint.

    Attributes:
        amplitude: (16, M) [rad].
        frequency: (16, M) [Hz].
        phase: (16, M) [rad].
        ramp: time in which the envelope rises at the start and falls at the end [s].
    """

    amplitude: Float[np.ndarray, "16 M"]
    frequency: Float[np.ndarray, "16 M"]
    phase: Float[np.ndarray, "16 M"]
    ramp: float


@dataclass(frozen=True, eq=False)
class Segment:
    """A move from one posture to another, or a stay (equal postures), perhaps wandering.

    Attributes:
        label: gesture that it belongs to.
        duration: [s].
        start: (16,) posture [rad].
        end: (16,) posture [rad].
        begins: (16,) share of the duration after which each joint sets off.
        ends: (16,) share of the duration at which it has arrived.
        wander: what is added to the postures.
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
    """Shortest duration [s] of a move in which no joint's jerk exceeds ``max_jerk`` [rad/s^3]."""
    alone = np.cbrt(_PEAK_JERK * np.abs(end - start) / max_jerk)
    return float((alone / (ends - begins)).max())


def draw_wander(
    rng: np.random.Generator, centre: Posture, reach: Posture, speed: float, max_jerk: float
) -> Wander:
    """Random motion about a posture within the joint ranges and the jerk bound.

    The four PIPs and MCPs share part of their motion, as fingers of a hand do.

    Args:
        rng: the source of randomness.
        centre: (16,) posture [rad].
        reach: (16,) largest excursion wanted of each joint [rad].
        speed: 1 is a natural tempo, 0.15 to 0.75 Hz.
        max_jerk: bound on the jerk of each joint [rad/s^3]; where it binds, amplitudes shrink.
    """
    terms, ramp = 3, 0.8 / speed
    share = rng.dirichlet(np.full(terms, 2.0), 16)
    frequency = speed * rng.uniform(0.15, 0.75, (16, terms))
    phase = rng.uniform(0.0, 2.0 * np.pi, (16, terms))
    # The first term of all MCPs is the same, and that of all PIPs: fingers tend to go together.
    for first in (5, 6):
        together = slice(first, 16, 3)
        frequency[together, 0] = frequency[first, 0]
        phase[together, 0] = phase[first, 0]
    room = np.minimum(np.minimum(centre - FREE_LOWER, FREE_UPPER - centre), reach)
    amplitude = share * room[:, None]

    # (envelope * sines)''' by Leibniz' rule, each factor at its greatest.
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
    """Segments end to end from time 0, evaluated at any times that they cover.

    Args:
        segments: in order; each starts at the posture where the one before ended.
        origin: time at which the first begins [s].
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
        """Free joint angles [rad] and index of the active segment at each time [s]."""
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
    """Position from 0 to 1 of a minimum-jerk move; constant before 0 and after 1."""
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

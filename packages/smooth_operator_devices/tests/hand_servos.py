"""Motors of a simulated hand, for simulators of wire protocols: they move towards a target."""

import itertools
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np


class Servos:
    """Motors that move towards their targets at a bounded speed, in the units of the wire.

    The clock is read whenever somebody looks, so there is no thread. A stuck motor stays where it
    is and draws current; so does one that an obstacle stops.

    Args:
        start: where the motors are.
        speed: in units per second.
        lower, upper: ends of travel; a target beyond them is recorded and refused.
        slack: how far beyond them the resolution of the wire may bring a target.
        clock: seconds.
    """

    def __init__(
        self,
        start: Sequence[float],
        *,
        speed: float,
        lower: Sequence[float] | float,
        upper: Sequence[float] | float,
        slack: float = 1e-6,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._position = np.array(start, float)
        self.target = self._position.copy()
        self.speed = speed
        self.lower, self.upper = (
            np.broadcast_to(np.asarray(end, float), self._position.shape) for end in (lower, upper)
        )
        self._slack = slack
        self._clock, self._last = clock, clock()
        self.lock = threading.RLock()
        self.stuck: set[int] = set()
        self.outside: list[np.ndarray] = []
        """Targets beyond the ends of travel. A driver must never send one."""
        self.targets: list[np.ndarray] = []
        """Every target that came, in order."""
        self.powered = True

    def moves_when_looked_at(self, seconds: float) -> None:
        """From now on each look is so much later than the one before [s], whatever a clock says."""
        with self.lock:
            looks = itertools.count(1)
            self._clock, self._last = lambda: next(looks) * seconds, 0.0

    def aim(self, target: Sequence[float]) -> None:
        """Take new targets; NaN leaves a motor's as it is."""
        with self.lock:
            self.positions()
            new = np.array(target, float)
            new = np.where(np.isnan(new), self.target, new)
            self.targets.append(new)
            if (new < self.lower - self._slack).any() or (new > self.upper + self._slack).any():
                self.outside.append(new)
            self.target = np.clip(new, self.lower, self.upper)

    def positions(self) -> np.ndarray:
        """Current positions of the motors."""
        with self.lock:
            now = self._clock()
            step = self.speed * max(now - self._last, 0.0) if self.powered else 0.0
            self._last = now
            move = np.clip(self.target - self._position, -step, step)
            for motor in self.stuck:
                move[motor] = 0.0
            self._position = self._position + move
            return self._position.copy()

    def load(self) -> np.ndarray:
        """Load of each motor: its distance to the target, in units."""
        with self.lock:
            return self.target - self.positions()

    def at_rest(self, tolerance: float) -> bool:
        """True if all motors are at their targets."""
        return bool((np.abs(self.load()) <= tolerance).all())


class Faults:
    """Faults of a simulated device. A test sets the fields at any time."""

    def __init__(self) -> None:
        self.mute = False
        """It takes everything and answers nothing."""
        self.delay_s = 0.0
        """It answers so late [s]."""
        self.garble = False
        """Its answers are damaged: wrong checksum, length or values, as the protocol allows."""
        self.refuse = False
        """It answers with the protocol's own error."""

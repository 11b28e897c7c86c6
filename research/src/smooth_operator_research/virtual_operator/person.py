"""Parameters of a virtual operator, drawn from published distributions of human movement.

Each value is from the cited literature, or marked as our choice. None was fitted to outcomes of a
study of retargeters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.landmarks import FINGERS
from smooth_operator.synthetic.hand_anatomy import HandAnatomy, draw_anatomy

PHASE_MARGIN: Final = np.radians(35.0)
"""Smallest phase margin of the visual loop [rad]. People lower their gain if the delay is long
(McRuer and Jex 1967); 35 degrees is the lower end of what they keep in tracking."""

_EXTRA_DELAY_S: Final = 0.05
"""Delay of retargeting and servos that a person considers when choosing the gain [s]; our
choice."""


@dataclass(frozen=True, eq=False)
class Person:
    """One person in front of the robot hand.

    Attributes:
        number: number of the person, from 0.
        delay_s: time from an image to the correction that it causes [s]. 0.20 +- 0.025 (Keele and
            Posner 1968: 190 to 260 ms; Saunders and Knill 2003: 160 to 200 ms).
        crossover: gain of the correction [rad/s]: Y_p Y_c = crossover exp(-delay s) / s. 3.0 +- 0.7
            (McRuer and Jex 1967: 2 to 5 rad/s), and never beyond a phase margin of 35 degrees.
        threshold_m: errors smaller than this are not corrected [m]. 0.5 to 1.5 mm; our choice:
            several times the acuity of the eye at half a metre (0.15 mm), because depth is harder
            to see.
        tolerance_m: seen distance at which a fingertip has reached its goal [m]. 3 +- 0.5 mm; our
            choice, a third of the width of a fingertip's pad.
        pace: duration of a movement over that of Fitts' law with lag (MacKenzie and Ware 1993).
            Log-normal with a spread of 20 % (Fitts' intercepts and slopes between persons).
        motor_noise: standard deviation of a movement over its length. 3 to 6 % (Harris and
            Wolpert 1998; Schmidt et al. 1979: 3 to 6 % of the distance in fast movements).
        tremor_m: root mean square of the tremor of a fingertip along an axis [m], in 8 to 12 Hz.
            0.03 to 0.15 mm (Stiles and Randall 1967; Elble and Koller 1990).
        map_error: (5, 3) error of the person's estimate of where the robot's fingertips will go,
            after free movement and before any trial [m]. 4 mm along each axis, half of the variance
            shared by all fingers: the sense of position of finger joints is good to 2 to 4 degrees
            (Ferrell, Gandevia and McCloskey 1987), which is that much at the tip.
        practice: exponent of the power law of practice. 0.2 +- 0.05 (Newell and Rosenbloom 1981;
            Crossman 1959).
        bone_factors: (5, 3) length of each finger bone over the expected one. 5 %, at most 10 %;
            our choice.
        anatomy: anatomy of the hand. Length 190 +- 10 mm for one half, 175 +- 9 mm for the other
            (Pheasant and Haslegrave 2006: British men and women); bones as ``draw_anatomy``.
    """

    number: int
    delay_s: float
    crossover: float
    threshold_m: float
    tolerance_m: float
    pace: float
    motor_noise: float
    tremor_m: float
    map_error: Float[np.ndarray, "5 3"]
    practice: float
    bone_factors: Float[np.ndarray, "5 3"]
    anatomy: HandAnatomy

    def practised(self, trials: float) -> float:
        """Fraction of a beginner's time or error that remains after a number of trials.

        This is the power law of practice with earlier experience, (1 + n / E)^-a, where E is the
        experience before the first trial, in trials. E is 5 (our choice), for two minutes of free
        movement.
        """
        return float((1.0 + trials / 5.0) ** -self.practice)


def largest_crossover(delay_s: float) -> float:
    """Gain at which the visual loop has its smallest phase margin [rad/s]."""
    return float((np.pi / 2 - PHASE_MARGIN) / (delay_s + _EXTRA_DELAY_S))


def draw_person(number: int, seed: int = 0) -> Person:
    """Draws a person, who depends only on number and seed."""
    if number < 0 or seed < 0:
        raise ConfigError(f"number and seed of a person must be 0 or more, not {number} and {seed}")
    rng = np.random.default_rng([seed, number, 0x0E])
    delay = float(np.clip(rng.normal(0.20, 0.025), 0.14, 0.28))
    wish = float(np.clip(rng.normal(3.0, 0.7), 1.0, 5.0))
    mean, spread = ((0.190, 0.010), (0.175, 0.009))[int(rng.integers(2))]
    length = float(np.clip(rng.normal(mean, spread), 0.15, 0.22))
    shared = rng.normal(0.0, 0.004 * np.sqrt(0.5), (1, 3))
    return Person(
        number=number,
        delay_s=delay,
        crossover=min(wish, largest_crossover(delay)),
        threshold_m=float(rng.uniform(0.0005, 0.0015)),
        tolerance_m=float(np.clip(rng.normal(0.003, 0.0005), 0.002, 0.005)),
        pace=float(np.exp(np.clip(rng.normal(0.0, 0.2), -0.5, 0.5))),
        motor_noise=float(rng.uniform(0.03, 0.06)),
        tremor_m=float(rng.uniform(3e-5, 1.5e-4)),
        map_error=shared + rng.normal(0.0, 0.004 * np.sqrt(0.5), (len(FINGERS), 3)),
        practice=float(np.clip(rng.normal(0.2, 0.05), 0.05, 0.4)),
        bone_factors=1.0 + np.clip(rng.normal(0.0, 0.05, (len(FINGERS), 3)), -0.1, 0.1),
        anatomy=draw_anatomy(length, int(rng.integers(1 << 31))),
    )


def movement_time(distance_m: float, width_m: float, lag_s: float) -> float:
    """Duration of an aimed movement [s] by Fitts' law with lag.

    MT = 230 + (169 + 1.03 LAG) ID in milliseconds (MacKenzie and Ware 1993), with ID =
    log2(distance / width + 1).

    Args:
        distance_m: length of the movement [m].
        width_m: width of its goal [m].
        lag_s: lag of the machine, from hand to image [s].
    """
    difficulty = float(np.log2(distance_m / width_m + 1.0))
    return 0.230 + (0.169 + 1.03 * lag_s) * difficulty


TREMOR_HZ: Final = (8.0, 12.0)
"""Band of physiological tremor of the finger (Elble and Koller 1990)."""

_CORRELATED_S: Final = 0.1
"""Correlation time of the noise of a movement [s]; our choice: about one submovement."""

_FORGOTTEN_S: Final = 1.0
"""Time constant with which proprioception corrects such an error [s]; our choice."""

_TONES: Final = 4  # of the tremor, for each finger and axis


class MotorNoise:
    """Displacement of fingertips from the person's goals.

    Args:
        share: standard deviation at the end of a movement over its length.
        tremor: root mean square of the tremor along an axis [m].
        rng: source of random numbers.
    """

    def __init__(self, share: float, tremor: float, fingers: int, rng: np.random.Generator) -> None:
        self._share, self._rng = share, rng
        self._drift = np.zeros((fingers, 3))
        self._colour = rng.normal(size=(fingers, 3))
        shape = (_TONES, fingers, 3)
        self._hertz = rng.uniform(*TREMOR_HZ, shape)
        self._phase = rng.uniform(0.0, 2 * np.pi, shape)
        self._tremor = tremor * np.sqrt(2.0 / _TONES)

    def update(
        self, time: float, moved: Float[np.ndarray, "f 3"], seconds: float
    ) -> Float[np.ndarray, "f 3"]:
        """Advances the noise; returns the displacement.

        Args:
            time: current time [s].
            moved: (f, 3) intended motion of each fingertip since the last call [m].
            seconds: time since the last call [s].
        """
        keep = np.exp(-seconds / _CORRELATED_S)
        self._colour = keep * self._colour + np.sqrt(1 - keep**2) * self._rng.normal(
            size=self._colour.shape
        )
        length = np.linalg.norm(moved, axis=-1, keepdims=True)
        self._drift *= np.exp(-seconds / _FORGOTTEN_S)
        self._drift += self._share * length * self._colour
        tones = np.sin(2 * np.pi * self._hertz * time + self._phase)
        return np.asarray(self._drift + self._tremor * tones.sum(axis=0))

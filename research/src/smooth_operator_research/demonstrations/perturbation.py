"""Perturbed worlds: the same task with another object pose, friction, mass, operator and tracker.

A world is drawn from its seed and number alone, so that every method is judged in the same worlds.
World 0 is the unperturbed one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import BASES, NUM_LANDMARKS, WRIST
from smooth_operator.settings import check_numbers
from smooth_operator.simulation.scenes.physics import (
    FRICTION,
    MASS_SHARE,
    SHIFT_M,
    TURN_RAD,
    ObjectVariation,
    ScenePhysics,
)
from smooth_operator.simulation.scenes.scene import SceneState
from smooth_operator.synthetic.tracker import TrackerModel, TrackerStream
from smooth_operator_research.demonstrations.trial_loop import RATE_HZ, LandmarkSource


@dataclass(frozen=True)
class PerturbationRanges:
    """Ranges of worlds; each quantity is uniform in its range, and 0 leaves it out.

    Attributes:
        shift: shift of the object, along x and along y of the world, at most [m].
        turn: turn of the object about the vertical, at most [rad].
        friction: share by which the object's friction differs, sliding and torsional alike.
        mass: share by which its mass and inertia differ.
        hand: share by which all the operator's bones differ from the demonstration's.
        finger: share by which the bones of each finger differ further.
        noise: largest standard deviation of the tracker's noise, of each coordinate [m].
        noise_time: largest correlation time of that noise [s]; 0 is white noise.
        frame_loss: largest share of dropped frames.
        frame_loss_burst: largest mean length of a gap [s]; the least is a frame.
    """

    shift: float = SHIFT_M
    turn: float = TURN_RAD
    friction: float = FRICTION
    mass: float = MASS_SHARE
    hand: float = 0.07
    finger: float = 0.03
    noise: float = 0.001
    noise_time: float = 0.05
    frame_loss: float = 0.1
    frame_loss_burst: float = 0.05

    def __post_init__(self) -> None:
        check_numbers(
            self,
            not_negative=("shift", "turn", "friction", "mass", "hand", "finger", "noise",
                          "noise_time", "frame_loss", "frame_loss_burst"),
        )  # fmt: skip


RANGES: Final = PerturbationRanges()
"""Those of the benchmark."""


def _ones() -> Float[np.ndarray, "5"]:
    return np.ones(len(BASES))


@dataclass(frozen=True, eq=False, kw_only=True)
class Perturbation(ObjectVariation):
    """One world: an object's variation, an operator, a tracker. The defaults change nothing.

    Attributes:
        number: number of the world; 0 for the unperturbed one.
        palm: factor of the operator's palm, from the wrist to the bases of the fingers.
        bones: (5,) factor of the bones of each human finger, thumb first.
        tracker: its noise and dropped frames.
    """

    number: int = 0
    palm: float = 1.0
    bones: Float[np.ndarray, "5"] = field(default_factory=_ones)
    tracker: TrackerModel = field(default_factory=TrackerModel)

    def operator(self, landmarks: Float[np.ndarray, "21 3"]) -> Float[np.ndarray, "21 3"]:
        """(21, 3) the same joint angles with this operator's bones."""
        wrist = landmarks[WRIST]
        out: np.ndarray = wrist + self.palm * (landmarks - wrist)
        for first, factor in zip(BASES, self.bones, strict=True):
            steps = factor * np.diff(landmarks[first : first + 4], axis=0)
            out[first + 1 : first + 4] = out[first] + np.cumsum(steps, axis=0)
        return out


def draw_perturbation(
    number: int, seed: int = 0, ranges: PerturbationRanges = RANGES
) -> Perturbation:
    """World ``number`` of a seed; number 0 is the unperturbed world.

    What is drawn does not depend on the ranges: a range of 0 leaves its quantity out and changes
    no other one.
    """
    if number == 0:
        return Perturbation()
    rng = np.random.default_rng([seed, number])
    unit = rng.uniform(-1.0, 1.0, 5 + len(BASES) + 1)
    amount = rng.uniform(0.0, 1.0, 4)
    hand = 1.0 + ranges.hand * float(unit[5])
    tracker = TrackerModel(
        noise=ranges.noise * float(amount[0]),
        noise_time=ranges.noise_time * float(amount[1]),
        frame_loss=ranges.frame_loss * float(amount[2]),
        frame_loss_burst=ranges.frame_loss_burst * float(amount[3]),
        seed=int(rng.integers(2**31)),
    )
    return Perturbation(
        number=number,
        shift=ranges.shift * unit[:2],
        turn=ranges.turn * float(unit[2]),
        friction=1.0 + ranges.friction * float(unit[3]),
        mass=1.0 + ranges.mass * float(unit[4]),
        palm=hand,
        bones=hand + ranges.finger * unit[6:],
        tracker=tracker,
    )


class PerturbedLandmarks:
    """Another operator's bones and a tracker's noise and dropped frames. A ``LandmarkSource``.

    For one trial: its noise goes on from frame to frame.

    Args:
        rate_hz: frames a second [Hz].
    """

    def __init__(
        self, source: LandmarkSource, world: Perturbation, rate_hz: float = RATE_HZ
    ) -> None:
        self._source, self._world = source, world
        self._tracker = TrackerStream(world.tracker, rate_hz)

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"] | None:
        """See ``LandmarkSource``."""
        points = self._source.landmarks(time, state, physics)
        tick = self._tracker.next(1)
        if points is None or not tick.arrives[0]:
            return None
        points = self._world.operator(points)
        return points if tick.noise is None else points + tick.noise[0, :NUM_LANDMARKS]

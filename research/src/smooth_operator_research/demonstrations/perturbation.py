"""Perturbed worlds: the same task with another object pose, friction, mass, operator and tracker.

A world is drawn from its seed and number alone, so that every method is judged in the same worlds.
World 0 is the unperturbed one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import BASES, WRIST
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
from smooth_operator.synthetic.tracker import (
    Ticks,
    TrackerModel,
    TrackerStream,
    tracker_model,
)
from smooth_operator_research.demonstrations.trial_loop import LandmarkSource


@dataclass(frozen=True)
class PerturbationRanges:
    """Ranges of the perturbations; each quantity is uniform in its range, and 0 disables it.

    Attributes:
        shift: largest shift of the object along x and y of the world [m].
        turn: largest rotation of the object about the vertical [rad].
        friction: largest relative change of the object's sliding and torsional friction.
        mass: largest relative change of its mass and inertia.
        hand: largest relative change of all the operator's bones from the demonstration's.
        finger: largest additional relative change of the bones of each finger.
        gap: largest relative difference of the tracker's pinch gaps between people.
    """

    shift: float = SHIFT_M
    turn: float = TURN_RAD
    friction: float = FRICTION
    mass: float = MASS_SHARE
    hand: float = 0.07
    finger: float = 0.03
    gap: float = 0.2

    def __post_init__(self) -> None:
        names = ("shift", "turn", "friction", "mass", "hand", "finger", "gap")
        check_numbers(self, not_negative=names)


RANGES: Final = PerturbationRanges()
"""Ranges of the benchmark."""


def _ones() -> Float[np.ndarray, "5"]:
    return np.ones(len(BASES))


@dataclass(frozen=True, eq=False, kw_only=True)
class Perturbation(ObjectVariation):
    """One world: variation of the object, operator and tracker. The defaults change nothing.

    Attributes:
        number: number of the world; 0 for the unperturbed one.
        palm: factor of the operator's palm, from the wrist to the bases of the fingers.
        bones: (5,) factor of the bones of each human finger, thumb first.
        tracker: tracker that sees the operator; a perfect one by default.
    """

    number: int = 0
    palm: float = 1.0
    bones: Float[np.ndarray, "5"] = field(default_factory=_ones)
    tracker: TrackerModel = field(default_factory=TrackerModel)

    def operator(self, landmarks: Float[np.ndarray, "21 3"]) -> Float[np.ndarray, "21 3"]:
        """Landmarks (21, 3) with the same joint angles and this operator's bones."""
        wrist = landmarks[WRIST]
        out: np.ndarray = wrist + self.palm * (landmarks - wrist)
        for first, factor in zip(BASES, self.bones, strict=True):
            steps = factor * np.diff(landmarks[first : first + 4], axis=0)
            out[first + 1 : first + 4] = out[first] + np.cumsum(steps, axis=0)
        return out


def draw_perturbation(
    number: int, seed: int = 0, ranges: PerturbationRanges = RANGES, tracker: str = "glove"
) -> Perturbation:
    """Draws world ``number`` of a seed; number 0 is the unperturbed world, with a perfect tracker.

    The random numbers do not depend on the ranges: a range of 0 disables its quantity and does not
    change the others.

    Args:
        tracker: kind of tracker: ``glove``, ``headset`` or ``camera``.
    """
    model = tracker_model(tracker)
    if number == 0:
        return Perturbation()
    rng = np.random.default_rng([seed, number])
    unit = rng.uniform(-1.0, 1.0, 5 + len(BASES) + 1)
    hand = 1.0 + ranges.hand * float(unit[5])
    noise_seed = int(rng.integers(2**31))
    gap = 1.0 + ranges.gap * float(rng.uniform(-1.0, 1.0))
    first, second, third, fourth = (gap * own for own in model.pinch_gaps)
    return Perturbation(
        number=number,
        shift=ranges.shift * unit[:2],
        turn=ranges.turn * float(unit[2]),
        friction=1.0 + ranges.friction * float(unit[3]),
        mass=1.0 + ranges.mass * float(unit[4]),
        palm=hand,
        bones=hand + ranges.finger * unit[6:],
        tracker=replace(model, seed=noise_seed, pinch_gaps=(first, second, third, fourth)),
    )


class TrackerClock:
    """Tracker frames for a loop with another clock; if two frames are due, the last one counts.

    It serves one trial: the tracker starts with the first call and continues frame by frame.
    """

    def __init__(self, model: TrackerModel) -> None:
        self._stream = TrackerStream(model)
        self._next = self._stream.next(1)
        self._start: float | None = None

    def due(self, time: float) -> Ticks | None:
        """Frame that arrived since the last call; None without a new frame."""
        if self._start is None:
            self._start = time
        tick = None
        while self._next.stamps[0] <= time - self._start + 1e-9:
            tick, self._next = self._next, self._stream.next(1)
        return tick


class PerturbedLandmarks:
    """Landmarks with another operator's bones, seen through a tracker; a ``LandmarkSource``.

    Between the tracker's frames there are no landmarks, so a loop holds its last command.
    """

    def __init__(self, source: LandmarkSource, world: Perturbation) -> None:
        self._source, self._world = source, world
        self._clock = TrackerClock(world.tracker)

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"] | None:
        """See ``LandmarkSource``."""
        tick = self._clock.due(time)
        if tick is None or not tick.arrives[0]:
            return None
        points = self._source.landmarks(time - tick.model.delay, state, physics)
        return None if points is None else tick.shown(self._world.operator(points)[None])[0]

"""Tasks with a fixed wrist on any robot hand, from the demonstrations that were made for mimic.

The human has mimic's kinematics at the size of the world's operator. What a tracker records of this
human is the same for every robot hand and method; each hand works in the scene that fits it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes import ScenePhysics, SceneState
from smooth_operator.simulation.tasks import task_named
from smooth_operator.synthetic.tracker import TrackerStream
from smooth_operator.types import HandRecording
from smooth_operator_research.cross_hand.scenes import scene_of
from smooth_operator_research.demonstrations.demonstration import (
    DemonstrationLandmarks,
    load_demonstration,
    own_commands,
)
from smooth_operator_research.demonstrations.perturbation import Perturbation, draw_perturbation
from smooth_operator_research.demonstrations.trial_loop import Commands, Moment, perform

STAYS_S: Final = 2.0
"""Time for which the human stays in the last pose [s], as in the measure ``demonstrations``."""

Watch = Callable[[ScenePhysics], None]
"""Function that receives the physics before the first moment of a trial."""


@dataclass(frozen=True, eq=False)
class FixedWristDemonstration:
    """Recording of a human who does a task in a world, without seeing the robot.

    Attributes:
        task: name of the task.
        world: object, human and tracker.
        recording: the frames that the tracker delivers.
        seconds: length of the trial [s].
    """

    task: str
    world: Perturbation
    recording: HandRecording
    seconds: float


def record(task: str, world: int, tracker: str) -> FixedWristDemonstration:
    """Records the human of a world once.

    Args:
        world: number of the world, from 0; its object is that of ``object_of``.
        tracker: kind of tracker: ``glove``, ``headset`` or ``camera``.
    """
    perturbation = draw_perturbation(world + 1, tracker=tracker)
    landmarks, model = _landmarks(task, tracker), perturbation.tracker
    seconds = landmarks.seconds + STAYS_S
    ticks = TrackerStream(model).next(int(seconds * model.rate_hz))
    moments = ticks.stamps - model.delay  # a frame shows the past
    points = np.stack([perturbation.operator(landmarks.at(float(t))) for t in moments])
    recording = HandRecording(ticks.shown(points)[ticks.arrives], ticks.stamps[ticks.arrives])
    return FixedWristDemonstration(task, perturbation, recording, seconds)


def object_of(world: int) -> Perturbation:
    """Object of a world. World 0 is number 1 of the measure ``demonstrations``, whose number 0 is
    unperturbed."""
    return draw_perturbation(world + 1)


@lru_cache
def _landmarks(task: str, tracker: str) -> DemonstrationLandmarks:
    return DemonstrationLandmarks(load_demonstration(task, tracker=tracker))


def play(
    hand: Hand,
    demonstration: FixedWristDemonstration,
    joints: Float[np.ndarray, "t n"],
    watch: Watch = lambda physics: None,
) -> Iterator[Moment]:
    """Plays retargeted joints open loop, in the world of the demonstration.

    A command is sent when its frame arrives, and held until the next one.

    Args:
        joints: (t, n) retargeted positions of all joints for the recording's frames [rad].
        watch: receives the physics before the first moment.

    Yields:
        the moments of the trial.
    """
    stamps = demonstration.recording.stamps

    def commands(time: float, state: SceneState, physics: ScenePhysics) -> np.ndarray | None:
        last = int(np.searchsorted(stamps, time + 1e-9)) - 1
        return None if last < 0 else joints[last]

    yield from _perform(
        hand, demonstration.task, demonstration.world, commands, watch, demonstration.seconds
    )


def play_own(
    hand: Hand, task: str, world: int, watch: Watch = lambda physics: None
) -> Iterator[Moment]:
    """Plays the joint positions of the hand's own demonstration, which were searched in physics:
    the ceiling of every retargeter in that world.

    Raises:
        StudyError: the hand has no demonstration of the task.
    """
    own = load_demonstration(task, hand.name)
    seconds = float(own.times[-1]) + STAYS_S
    yield from _perform(hand, task, object_of(world), own_commands(own), watch, seconds)


def _perform(
    hand: Hand, task: str, world: Perturbation, commands: Commands, watch: Watch, seconds: float
) -> Iterator[Moment]:
    physics = ScenePhysics(hand, world.scene(scene_of(task, hand)))
    world.prepare(physics)
    watch(physics)
    yield from perform(physics, task_named(task), commands, seconds=seconds)

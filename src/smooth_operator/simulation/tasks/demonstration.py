"""Trajectories that are known to do the tasks: key poses found by search, shipped as JSON.

They show that a hand can do a scene with its fingers alone, and hold that in the
tests. ``docs/how-to/user-study.md`` says how they were found.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene_registry import scene_for
from smooth_operator.simulation.scenes.state import SceneState
from smooth_operator.simulation.tasks.task_registry import TASKS, task_named
from smooth_operator.simulation.tasks.trial import TaskRun
from smooth_operator.simulation.tasks.trial_loop import RATE_HZ, perform
from smooth_operator.types import as_side

PERIOD_S: Final = 1.0 / RATE_HZ
"""Between commands [s]; a command is the pose of the end of its period."""


@dataclass(frozen=True, eq=False)
class Demonstration:
    """Key poses of a hand and when it is in them.

    Attributes:
        task: what it does.
        hand: the robot hand's name.
        side: its side.
        times: (k,) [s], from 0.
        poses: (k, m) actuated joint positions [rad].
    """

    task: str
    hand: str
    side: str
    times: Float[np.ndarray, " k"]
    poses: Float[np.ndarray, "k m"]

    def pose(self, time: float) -> Float[np.ndarray, " m"]:
        """(m,) actuated joint positions at a time [s]; smooth from one key pose to the next."""
        last = len(self.times) - 2
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, last))
        share = np.clip((time - self.times[k]) / (self.times[k + 1] - self.times[k]), 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        return np.asarray(self.poses[k] + (self.poses[k + 1] - self.poses[k]) * share)


def load_demonstration(task: str) -> Demonstration:
    """The demonstration of a task.

    Raises:
        UnknownNameError: there is no such task.
        StudyError: its file does not fit the hand.
    """
    if task not in TASKS:
        raise UnknownNameError("task", task, TASKS)
    file = files("smooth_operator.simulation.tasks") / "demonstrations" / f"{task}.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    hand = load_hand(content["hand"], content["side"])
    if tuple(content["joints"]) != hand.actuated_names:
        raise StudyError(f"the demonstration of {task!r} was made for other joints of {hand.name}")
    return Demonstration(
        task, hand.name, hand.spec.side, np.array(content["times"]), np.array(content["poses"])
    )


def play(
    demonstration: Demonstration,
    *,
    disturb: Callable[[ScenePhysics], None] | None = None,
    seen: Callable[[ScenePhysics, SceneState], None] | None = None,
) -> Iterator[tuple[SceneState, TaskRun]]:
    """Perform a demonstration in physics.

    Args:
        demonstration: what is done.
        disturb: changes the scene before it starts, as to see how much it bears.
        seen: called at each moment, as to draw it.

    Yields:
        the scene and the trial, a hundred times a second, until the trial is done or the
        demonstration at its end.
    """
    hand = load_hand(demonstration.hand, as_side(demonstration.side))
    physics = ScenePhysics(hand, scene_for(demonstration.task, hand))
    if disturb is not None:
        disturb(physics)

    def commands(time: float, state: SceneState, physics: ScenePhysics) -> Float[np.ndarray, " n"]:
        return hand.full_configuration(demonstration.pose(time + PERIOD_S))

    task, end = task_named(demonstration.task), float(demonstration.times[-1])
    for moment in perform(physics, task, commands, seconds=end):
        if seen is not None:
            seen(physics, moment.state)
        yield moment.state, moment.run

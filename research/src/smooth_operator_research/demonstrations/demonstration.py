"""Demonstrations: trajectories that solve the tasks, as key poses from a search, in JSON files.

They show that a hand can do a task with its fingers alone, and the tests check this.
``research/docs/physics-measures.md`` explains how they were found.
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
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene import SceneState
from smooth_operator.simulation.scenes.task_scenes import scene_for
from smooth_operator.simulation.tasks.catalogue import FIXED_WRIST, task_named
from smooth_operator.simulation.tasks.trial import TaskRun
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.types import as_side
from smooth_operator_research.demonstrations.trial_loop import RATE_HZ, Commands, perform

DEFAULT_HAND: Final = "mimic_p050"
"""Default hand of the demonstrations."""

_FOLDER: Final = files("smooth_operator_research.demonstrations") / "data"

PERIOD_S: Final = 1.0 / RATE_HZ
"""Period of the commands [s]; a command is the pose at the end of its period."""


@dataclass(frozen=True, eq=False)
class Demonstration:
    """Key poses of a hand, and their times.

    Attributes:
        task: name of the task.
        hand: name of the robot hand.
        side: side of the hand.
        times: (k,) times of the key poses [s], from 0.
        poses: (k, m) actuated joint positions [rad].
    """

    task: str
    hand: str
    side: str
    times: Float[np.ndarray, " k"]
    poses: Float[np.ndarray, "k m"]

    @property
    def robot(self) -> Hand:
        """The robot hand, loaded."""
        return load_hand(self.hand, as_side(self.side))

    def pose(self, time: float) -> Float[np.ndarray, " m"]:
        """(m,) actuated joint positions at a time [s]; smooth from one key pose to the next."""
        last = len(self.times) - 2
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, last))
        share = np.clip((time - self.times[k]) / (self.times[k + 1] - self.times[k]), 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        return np.asarray(self.poses[k] + (self.poses[k + 1] - self.poses[k]) * share)


def demonstrated_hands(task: str) -> list[str]:
    """Names of the hands that have a demonstration of a task, the default hand first."""
    if task not in FIXED_WRIST:
        raise UnknownNameError("task", task, FIXED_WRIST)
    hands = [hand.name for hand in _FOLDER.iterdir() if (hand / f"{task}.json").is_file()]
    return sorted(hands, key=lambda name: (name != DEFAULT_HAND, name))


def load_demonstration(
    task: str, hand: str | None = None, tracker: str | None = None
) -> Demonstration:
    """Loads the demonstration of a task.

    Args:
        hand: name of the robot hand; None for the default one.
        tracker: kind of the operator's tracker, because some tasks have a separate demonstration
            for it; None for the common one.
    """
    names = demonstrated_hands(task)
    name = DEFAULT_HAND if hand is None else hand
    if name not in names:
        raise StudyError(
            f"hand {name!r} has no demonstration of task {task!r}; the hands with one are "
            f"{', '.join(names)} (smooth_operator_research.demonstrations.search makes one)"
        )
    own, common = (_FOLDER / name / f"{stem}.json" for stem in (f"{task}-{tracker}", task))
    return read_demonstration((own if own.is_file() else common).read_text(encoding="utf-8"))


def read_demonstration(text: str) -> Demonstration:
    """Reads a demonstration from the text of its JSON file."""
    content = json.loads(text)
    task, hand = content["task"], load_hand(content["hand"], content["side"])
    if tuple(content["joints"]) != hand.actuated_names:
        raise StudyError(f"the demonstration of {task!r} was made for other joints of {hand.name}")
    return Demonstration(
        task, hand.name, hand.spec.side, np.array(content["times"]), np.array(content["poses"])
    )


def demonstration_text(demonstration: Demonstration) -> str:
    """Text of the JSON file of a demonstration, with poses to 0.001 rad, one per line."""
    hand = demonstration.robot
    head = {
        "task": demonstration.task,
        "hand": demonstration.hand,
        "side": demonstration.side,
        "joints": list(hand.actuated_names),
        "times": [round(float(time), 3) for time in demonstration.times],
    }
    lines = [f" {json.dumps(key)}: {json.dumps(value)}," for key, value in head.items()]
    poses = [json.dumps([round(float(q), 3) for q in pose]) for pose in demonstration.poses]
    return "\n".join(
        [
            "{",
            *lines,
            ' "poses": [',
            *[f"  {p}," for p in poses[:-1]],
            f"  {poses[-1]}",
            " ]",
            "}",
            "",
        ]
    )


def own_commands(
    demonstration: Demonstration, off: Float[np.ndarray, "t m"] | None = None
) -> Commands:
    """The demonstration's own joint positions as commands.

    Args:
        off: (t, m) offset of each actuated joint in each period [rad]; the last one stays. None
            for no offset.
    """
    hand = demonstration.robot

    def commands(time: float, state: SceneState, physics: ScenePhysics) -> Float[np.ndarray, " n"]:
        pose = demonstration.pose(time + PERIOD_S)
        if off is not None:
            pose = pose + off[min(round(time / PERIOD_S), len(off) - 1)]
        return hand.full_configuration(pose)

    return commands


def play(
    demonstration: Demonstration, *, disturb: Callable[[ScenePhysics], None] | None = None
) -> Iterator[tuple[SceneState, TaskRun]]:
    """Performs a demonstration in physics.

    Args:
        disturb: changes the scene before it starts, to test what the demonstration tolerates.

    Yields:
        the scene and the trial, a hundred times per second, until the trial is done or the
        demonstration ends.
    """
    hand = demonstration.robot
    physics = ScenePhysics(hand, scene_for(demonstration.task, hand))
    if disturb is not None:
        disturb(physics)
    task, end = task_named(demonstration.task), float(demonstration.times[-1])
    for moment in perform(physics, task, own_commands(demonstration), seconds=end):
        yield moment.state, moment.run


_STEP_S: Final = 0.001  # between two computed frames


class DemonstrationLandmarks:
    """Landmarks of a perfect operator with the robot's geometry, who does not watch the scene.

    A frame shows the pose one period later, because a command is the pose at the end of its
    period. Before the start and after the end, the hand does not move. A ``LandmarkSource``.

    Attributes:
        seconds: duration [s].
    """

    def __init__(self, demonstration: Demonstration) -> None:
        hand = demonstration.robot
        self.seconds = float(demonstration.times[-1])
        count = int(np.ceil(self.seconds / _STEP_S)) + 1
        poses = np.stack([demonstration.pose(k * _STEP_S) for k in range(count)])
        self._frames = human_landmarks(hand, poses)

    def at(self, time: float) -> Float[np.ndarray, "21 3"]:
        """Landmarks (21, 3) at a time since 'go' [m], in the robot's palm frame."""
        k = round((time + PERIOD_S) / _STEP_S)
        return np.asarray(self._frames[int(np.clip(k, 0, len(self._frames) - 1))])

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"]:
        """See ``LandmarkSource``; the scene is ignored."""
        return self.at(time)

"""A human demonstration on a robot hand: retargeted, and played open loop in physics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.arm import HandMount
from smooth_operator.simulation.scenes import ScenePhysics, SceneState
from smooth_operator.simulation.scenes.table_scene import TableScene
from smooth_operator.simulation.tasks import Outcome, task_named
from smooth_operator_research.cross_hand.human import HumanDemonstration
from smooth_operator_research.cross_hand.scenes import SCALED, scene_of
from smooth_operator_research.demonstrations.trial_loop import RATE_HZ, Moment, perform

STAYS_S: Final = 1.0
"""Time for which the last command is held after the demonstration [s]."""


def grip_of(hand: Hand, joints: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3"]:
    """Returns the (3,) middle between the tips of the thumb and the next two fingers, in the wrist
    frame [m].

    Args:
        joints: (n,) positions of all joints [rad].
    """
    tips = hand.tips(joints)
    middle = (tips[0] + tips[1:3].mean(axis=0)) / 2
    to_wrist = np.linalg.inv(HandMount(hand).palm_to_wrist)
    return np.asarray(to_wrist[:3, :3] @ middle + to_wrist[:3, 3])


def wrist_path(
    hand: Hand,
    demonstration: HumanDemonstration,
    joints: Float[np.ndarray, "t n"],
    scene: TableScene,
) -> Float[np.ndarray, "t 7"]:
    """Returns the (t, 7) poses of the robot's wrist in the world: those of the human, shifted so
    that when the human touches the object, the middle between the robot's thumb and fingers is
    where the human's is. In a scaled scene the human's way from the object is scaled, too.

    Args:
        joints: (t, n) retargeted positions of all joints [rad].
    """
    index = min(int(np.searchsorted(demonstration.times, demonstration.touch)), len(joints) - 1)
    shift = scene.scale * demonstration.centre - grip_of(hand, joints[index])
    human = demonstration.wrist * np.repeat([scene.scale, 1.0], [3, 4])
    wrist = poses.compose(np.concatenate(scene.start), human)
    wrist[:, :3] += poses.rotate(wrist[:, 3:], shift)
    return wrist


def play(
    hand: Hand,
    demonstration: HumanDemonstration,
    joints: Float[np.ndarray, "t n"],
    watch: Callable[[ScenePhysics], None] | None = None,
    *,
    scaled: bool = False,
) -> Iterator[Moment]:
    """Plays retargeted joints and the wrist open loop, in the world of the demonstration.

    Args:
        joints: (t, n) retargeted positions of all joints [rad].
        watch: called with the physics before the first moment.
        scaled: True for a scene whose lengths are scaled by the length of the robot hand.

    Yields:
        the moments of the trial.
    """
    task = task_named(demonstration.task)
    own = scene_of(demonstration.task + SCALED * scaled, hand)
    scene = demonstration.variation.scene(own)
    wrist = scene.free_wrist(hand)
    physics = ScenePhysics(hand, scene, carried=wrist)
    demonstration.variation.prepare(physics)
    if watch is not None:
        watch(physics)
    path, times = wrist_path(hand, demonstration, joints, scene), demonstration.times
    everywhere = [wrist.targets(path[0], wrist.home, np.inf)]
    for pose in path[1:]:
        everywhere.append(wrist.targets(pose, everywhere[-1], np.inf))
    rows = np.concatenate([joints, everywhere], axis=1)
    target = wrist.home

    def commands(time: float, state: SceneState, physics: ScenePhysics) -> Float[np.ndarray, " n"]:
        nonlocal target
        row = np.array([np.interp(time, times, column) for column in rows.T])
        target = wrist.targets(wrist.pose(row[-6:]), target, 1.0 / RATE_HZ)
        physics.command_arm(target)
        return row[:-6]

    seconds = min(float(times[-1]) + STAYS_S, task.seconds)
    yield from perform(physics, task, commands, seconds=seconds)


def replay(
    hand: Hand, demonstration: HumanDemonstration, joints: Float[np.ndarray, "t n"]
) -> Outcome:
    """Plays retargeted joints open loop and returns the score of the trial; see ``play``."""
    *_, last = play(hand, demonstration, joints)
    run = last.run
    outcome = run.outcome or run.finish(last.state.time).outcome
    assert outcome is not None
    return outcome

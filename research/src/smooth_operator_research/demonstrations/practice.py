"""An operator who has practised with a retargeter and a tracker.

The commands of a retargeter differ from the motion that it sees: cameras show fingers too far
apart, pinches are pressed, and filters lag. People who have watched the robot for a while
compensate for this. Here, the key poses that the operator shows are corrected in several rounds by
the error of the commands, until these equal the demonstration's key poses: iterative learning
control (Arimoto, Kawamura and Miyazaki 1984, doi:10.1002/rob.4620010203). Practice
uses nothing from the trials: there is no object, no shake and no lost frame, and the operators are
different people.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.synthetic.tracker import TrackerStream
from smooth_operator.types import HandRecording
from smooth_operator_research.demonstrations.demonstration import Demonstration
from smooth_operator_research.demonstrations.perturbation import Perturbation, draw_perturbation

ROUNDS: Final = 6
"""Number of attempts after which the motion is corrected."""

OPERATORS: Final = 4
"""Number of operators whose mean error is corrected; all make the same motion."""

BEYOND: Final = 0.3
"""Amount by which the operator may exceed the robot's joint limits [rad]."""

_SEED: Final = 3000  # of the operators; the benchmark's and the search's worlds have others
_GAIN: Final = 0.7  # share of an error that is corrected in a round
_RATE_HZ: Final = 30.0  # frames a second while practising
_HOLD_S: Final = 1.0  # a pose that is held for longer is practised for so long


def practised(demonstration: Demonstration, retargeter: Retargeter, tracker: str) -> Demonstration:
    """Motion of an operator with which a retargeter commands the key poses of a demonstration.

    Args:
        demonstration: motion that the robot should make.
        retargeter: the retargeter, which is called frame by frame.
        tracker: kind of tracker.

    Returns:
        the operator's key poses at the same times; they may exceed the joints' limits.
    """
    hand = demonstration.robot
    lasts = np.minimum(np.diff(demonstration.times), _HOLD_S)
    quick = replace(demonstration, times=np.concatenate([[0.0], np.cumsum(lasts)]))
    people = [_without_noise(number, tracker) for number in range(1, OPERATORS + 1)]
    bounds = hand.limits + np.array([-BEYOND, BEYOND])
    goal = np.clip(demonstration.poses, *hand.limits.T)
    shown = best = demonstration.poses
    least = np.inf
    for _ in range(ROUNDS):
        motion = replace(quick, poses=shown)
        error = np.mean([goal - _commands(motion, retargeter, one) for one in people], axis=0)[1:]
        if np.abs(error).mean() < least:
            best, least = shown, np.abs(error).mean()
        moved = np.clip(shown[1:] + _GAIN * error, *bounds.T)
        shown = np.concatenate([shown[:1], moved])
    return replace(demonstration, poses=best)


def _without_noise(number: int, tracker: str) -> Perturbation:
    """An operator whose tracker shows the same motion in the same way every time."""
    person = draw_perturbation(number, _SEED, tracker=tracker)
    still = replace(person.tracker, shake=0.0, frame_loss=0.0, rate_jitter=0.0)
    return replace(person, tracker=still)


def _commands(
    motion: Demonstration, retargeter: Retargeter, operator: Perturbation
) -> Float[np.ndarray, "k m"]:
    """Actuated joints (k, m) that a retargeter commands at the times of the key poses [rad]."""
    hand = motion.robot
    stamps = np.arange(0.0, motion.times[-1] + 2.0 / _RATE_HZ, 1.0 / _RATE_HZ)
    points = human_landmarks(hand, np.stack([motion.pose(float(time)) for time in stamps]))
    seen = np.stack([operator.operator(frame) for frame in points])
    seen = TrackerStream(operator.tracker).next(len(seen)).shown(seen)
    commands, _ = retargeter.run(HandRecording(seen, stamps, hand.spec.side))
    joints = [hand.joint_names.index(name) for name in hand.actuated_names]
    positions = commands.joint_positions[:, joints].T
    return np.stack([np.interp(motion.times, stamps, one) for one in positions], axis=1)

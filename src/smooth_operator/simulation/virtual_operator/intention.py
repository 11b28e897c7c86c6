"""What a person intends in a task: where the robot's fingertips and the object should go.

Taken from a demonstration that is performed once in physics, undisturbed: its key poses divide it
into phases, its commands are where the fingertips are sent, and what happened is what the person
expects to see.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene_registry import scene_for
from smooth_operator.simulation.tasks.cube_scorer import GOAL, TOLERANCE
from smooth_operator.simulation.tasks.demonstration import Demonstration
from smooth_operator.simulation.tasks.screwdriver_scorer import DOWN

_PERIOD_S: Final = 0.01
_TOUCHES_N: Final = 0.05
_BEFORE_M: Final = 0.010
"""Before they close on something, fingers pause so far from it [m]: people slow down in the last
part of a reach, and close the grip under sight (Jeannerod 1984). The distance is ours."""
_APART_S: Final = 0.08  # keys are further apart than this [s]


@dataclass(frozen=True, eq=False)
class Expected:
    """What a person expects at one moment of a demonstration.

    Attributes:
        sent: (f, 3) where fingertips are sent, in the palm frame [m]; into the object where they
            press.
        tips: (f, 3) where they are then seen [m].
        position: (3,) of the object in the world [m].
        quaternion: (4,) of the object.
        touching: (f,) which fingers press on it.
    """

    sent: Float[np.ndarray, "f 3"]
    tips: Float[np.ndarray, "f 3"]
    position: Float[np.ndarray, "3"]
    quaternion: Float[np.ndarray, "4"]
    touching: Bool[np.ndarray, " f"]


@dataclass(frozen=True, eq=False)
class Intention:
    """A demonstration as a person has it in mind.

    Attributes:
        task: its name.
        keys: (k,) times of the key poses [s], from 0, and of pauses before fingers touch.
        sent: (t, f, 3) see ``Expected``, 100 times a second.
        tips: (t, f, 3).
        positions: (t, 3).
        quaternions: (t, 4).
        touching: (t, f).
    """

    task: str
    keys: Float[np.ndarray, " k"]
    sent: Float[np.ndarray, "t f 3"]
    tips: Float[np.ndarray, "t f 3"]
    positions: Float[np.ndarray, "t 3"]
    quaternions: Float[np.ndarray, "t 4"]
    touching: Bool[np.ndarray, "t f"]

    @property
    def fingers(self) -> Bool[np.ndarray, " f"]:
        """(f,) fingers that touch the object at some time: those that a person attends to."""
        return np.asarray(self.touching.any(axis=0))

    def at(self, time: float) -> Expected:
        """What is expected at a time of the demonstration [s]."""
        place = float(np.clip(time / _PERIOD_S, 0, len(self.sent) - 1))
        low = min(int(place), len(self.sent) - 2)
        share = place - low

        def between(rows: Float[np.ndarray, "t *n"]) -> Float[np.ndarray, "*n"]:
            return np.asarray(rows[low] + share * (rows[low + 1] - rows[low]))

        near = low + round(share)
        return Expected(
            between(self.sent), between(self.tips), between(self.positions),
            self.quaternions[near], self.touching[near],
        )  # fmt: skip

    def matters(self, phase: int) -> Bool[np.ndarray, " f"]:
        """(f,) fingers that press at key pose ``phase`` or before the next one.

        Before fingers close on something, a person looks whether they are in place.
        """
        first = round(self.keys[phase] / _PERIOD_S)
        last = round(self.keys[min(phase + 1, len(self.keys) - 1)] / _PERIOD_S)
        return np.asarray(self.touching[max(first - 1, 0) : last + 1].any(axis=0))

    def travel(self, phase: int) -> float:
        """Longest way of a fingertip between key pose ``phase`` - 1 and ``phase`` [m]."""
        ends = [round(self.keys[k] / _PERIOD_S) for k in (phase - 1, phase)]
        first, last = (self.sent[min(end, len(self.sent) - 1)] for end in ends)
        return float(np.linalg.norm(last - first, axis=-1).max())


def intention_for(demonstration: Demonstration, hand: Hand) -> Intention:
    """Perform a demonstration in physics, and remember what happened.

    Args:
        demonstration: what is done.
        hand: the robot hand that it was made for.
    """
    physics = ScenePhysics(hand, scene_for(demonstration.task, hand))
    sent, tips, states = [], [], []
    time = 0.0
    while time <= demonstration.times[-1] + 1e-9:
        every = hand.full_configuration(demonstration.pose(time))
        sent.append(hand.tips(every))
        physics.command(every)
        physics.advance(_PERIOD_S)
        tips.append(hand.tips(physics.positions))
        states.append(physics.observe())
        time += _PERIOD_S
    touching = np.array([state.force > _TOUCHES_N for state in states])
    return Intention(
        demonstration.task,
        _with_pauses(demonstration.times, np.array(tips), touching),
        np.array(sent),
        np.array(tips),
        np.array([state.position for state in states]),
        np.array([state.quaternion for state in states]),
        touching,
    )


def _with_pauses(
    keys: Float[np.ndarray, " k"],
    tips: Float[np.ndarray, "t f 3"],
    touching: Bool[np.ndarray, "t f"],
) -> Float[np.ndarray, " j"]:
    """The times, and those at which a finger is the last time 10 mm from where it will touch.

    Only where no finger is on the object: what is held does not wait.
    """
    found = list(keys)
    for finger in range(touching.shape[1]):
        (onsets,) = np.nonzero(touching[1:, finger] & ~touching[:-1, finger])
        for onset in onsets + 1:
            away = np.linalg.norm(tips[:onset, finger] - tips[onset, finger], axis=-1)
            (far,) = np.nonzero(away >= _BEFORE_M)
            held = touching[far[-1] : onset].any() if len(far) else True
            time = far[-1] * _PERIOD_S if len(far) else 0.0
            if not held and np.abs(np.array(found) - time).min() > _APART_S:
                found.append(time)
    return np.sort(np.array(found))


def _card(scorer: Any) -> bool:
    return scorer.pinched is not None and bool(scorer.over)


def _cube(scorer: Any) -> bool:
    return bool(abs(abs(scorer.turned) - GOAL) <= TOLERANCE)


def _screwdriver(scorer: Any) -> bool:
    return bool(scorer.held and scorer.angle <= DOWN)


GOAL_SEEN: Final[dict[str, Callable[[Any], bool]]] = {
    "card": _card,
    "cube": _cube,
    "screwdriver": _screwdriver,
}
"""Task -> whether its scorer shows what the instruction asks for, so that a person stops there."""

"""A person at the tracker: intends, looks with a delay, corrects, waits, and tries again.

The parts are: the intention (``intention.py``), the delay and the correction
(``visual_feedback.py``), tremor and motor noise (``motor_noise.py``), the hand (``hand_model.py``)
and the person's figures (``person.py``). This file is the sequence: a phase of the demonstration
takes the time of Fitts' law; at its end the person looks whether what is seen fits, corrects for a
while if the fingertips do not, and begins again where the object did not follow.

Simplifications: a person attends to the fingertips that touch the object and leaves the others to
the intention; the object's displacement shifts where fingers reach for it, its rotation does not;
nothing is felt, as in the paper's study.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.state import SceneState
from smooth_operator.simulation.tasks.scorer import Scorer, rotation
from smooth_operator.simulation.tasks.task_registry import SimulatedTask
from smooth_operator.simulation.virtual_operator.familiarisation import InternalModel
from smooth_operator.simulation.virtual_operator.hand_model import HandModel, ReachingHand
from smooth_operator.simulation.virtual_operator.intention import (
    GOAL_SEEN,
    Expected,
    Intention,
)
from smooth_operator.simulation.virtual_operator.motor_noise import MotorNoise
from smooth_operator.simulation.virtual_operator.person import Person, movement_time
from smooth_operator.simulation.virtual_operator.points_on_hand import SeenTips
from smooth_operator.simulation.virtual_operator.visual_feedback import (
    CrossoverCorrection,
    DelayedView,
)

WAIT_S: Final = 2.0
"""Longest look at fingertips that do not get where they should [s]; ours."""

_OBJECT_M: Final = 0.006  # an object this far from where it is expected has not followed [m]
_OBJECT_RAD: Final = np.radians(25.0)  # or turned this far from it [rad]
_SHIFT_M: Final = 0.025  # farthest that a person follows a displaced object with the fingers [m]
_TRACKS_S: Final = 0.3  # time constant of following it [s]
_HARDER: Final = 0.5  # after an attempt in which the object slipped, press so much harder
_HARDEST: Final = 2.0
_PRESS_M: Final = 0.015  # most that a finger on the object is corrected further [m]
_OPENS_M: Final = 0.04  # way of the fingertips when the hand opens for another attempt [m]


@dataclass(frozen=True, eq=False)
class _Image:
    """What there was to see at one moment, and what was expected."""

    tips: Float[np.ndarray, "f 3"]
    wanted: Float[np.ndarray, "f 3"]
    expected: Expected
    state: SceneState


class VirtualOperator:
    """The hand of a person who does a trial; a ``LandmarkSource``.

    Args:
        person: who.
        hand: the robot hand.
        body: the person's hand.
        model: what the person has learnt of the retargeter.
        intention: what is to be done.
        task: the same, with its scorer: the person knows the instruction.
        physics: the scene of the trial.
        practised: trials of the task before this one, with any retargeter.
        practised_here: trials before this one with this retargeter.
        lag_s: from the hand to the robot's motion [s], which slows a person down.
        seed: of the noise.

    Attributes:
        gave_up: the person can do no more.
        wants_reset: the object is where the fingers can't work on it, and the person asks for it to
            be put back.
        attempt: number of the attempt, from 1.
    """

    def __init__(
        self,
        person: Person,
        hand: Hand,
        body: HandModel,
        model: InternalModel,
        intention: Intention,
        task: SimulatedTask,
        physics: ScenePhysics,
        *,
        practised: int = 0,
        practised_here: int = 0,
        lag_s: float = 0.05,
        seed: int = 0,
    ) -> None:
        self._person, self._hand, self._intention, self._task = person, hand, intention, task
        self.gave_up = self.wants_reset = False
        self.attempt = 1
        self._rows = [FINGERS.index(name) for name in hand.fingers]
        self._attends = intention.fingers
        self._to_palm = physics.scene.mount.palm[1].T
        self._pace = person.pace * person.practised(practised)
        self._tolerance = person.tolerance_m
        self._lag = lag_s
        self._tips = SeenTips(physics)
        self._misjudged = person.map_error[self._rows] * person.practised(practised_here)
        count = len(self._rows)
        rng = np.random.default_rng([seed, person.number, 0x07])
        self._noise = MotorNoise(person.motor_noise, person.tremor_m, count, rng)
        self._correction = CrossoverCorrection(person.crossover, person.threshold_m, (count, 3))
        self._view: DelayedView[_Image] = DelayedView(person.delay_s)
        self._scorer: Scorer = task.scorer(physics.scene)
        self._scored = float("-inf")
        self._shift = np.zeros((count, 3))
        self._harder = 0.0
        self._body = ReachingHand(body)
        self._model = model
        self._last = self._looked = float("nan")
        self._goal = self._in_place = np.zeros((count, 3))
        self._foreseen: Float[np.ndarray, "f 3"] | None = None
        self._phase, self._since, self._at, self._duration = 1, float("nan"), 0.0, 0.0
        self._from: Float[np.ndarray, "f 3"] | None = None
        self._begin_phase(1, float("nan"))
        self._body.reach(self._targets(self._sent(intention.at(0.0))), np.inf, rounds=40)

    def observe(self, time: float, state: SceneState, physics: ScenePhysics) -> None:
        """Look at the robot; to be called as often as the scene is scored.

        Args:
            time: since 'go' [s].
            state: the scene.
            physics: the hand in it.
        """
        if time > self._looked or np.isnan(self._looked):
            seconds = 0.0 if np.isnan(self._looked) else time - self._looked
            self._looked = time
            expected, tips = self._intention.at(self._at), self._tips.read()
            # People foresee the lag of what they move (Miall and Wolpert 1996).
            late = expected.tips if self._foreseen is None else self._foreseen
            late = late + (1.0 - np.exp(-seconds / self._lag)) * (expected.tips - late)
            self._foreseen = late if self._from is None else tips - self._shift
            self._view.show(time, _Image(tips, self._foreseen + self._shift, expected, state))

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"]:
        """(21, 3) of the person's hand [m], the wrist at the origin; see ``LandmarkSource``."""
        if time < 0.0:  # before 'go' the hand is held open
            return self._rest(time)
        self.observe(time, state, physics)
        seconds = 0.0 if np.isnan(self._last) else max(0.0, time - self._last)
        self._last = time
        if np.isnan(self._since):
            self._since = time
        image = self._view.seen(time)
        if image is not None:
            self._correct(image, seconds)
        self._proceed(time, image)
        expected = self._intention.at(self._at)
        goal = self._sent(expected)
        if self._from is not None:  # the hand opens for another attempt
            goal = self._from + _smooth(self._progress(time)) * (goal - self._from)
        moved, self._goal = goal - self._goal, goal
        wanted = goal + self._noise.update(time, moved, seconds)
        return self._body.reach(self._targets(wanted), max(seconds, 1e-3))

    def _rest(self, time: float) -> Float[np.ndarray, "21 3"]:
        still = np.zeros_like(self._shift)
        self._goal = self._sent(self._intention.at(0.0))
        targets = self._targets(self._goal + self._noise.update(time, still, 0.01))
        return self._body.reach(targets, 0.01)

    def restart(self) -> None:
        """The object was put back: the person begins again."""
        self.wants_reset = False
        self._shift[:] = 0.0
        self._scored = float("inf")  # what is seen for a moment is still the old object
        self._begin_again(self._last)

    def _sent(self, expected: Expected) -> Float[np.ndarray, "f 3"]:
        """(f, 3) where the person wants the robot's fingertips to be sent, in the palm frame."""
        press = (1.0 + self._harder) * (expected.sent - expected.tips)
        return np.asarray(expected.tips + press + self._shift + self._correction.value)

    def _targets(self, tips: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, "5 3"]:
        """(5, 3) where the person's own fingertips go for that; the others are left."""
        return self._model.own_tips(tips + self._misjudged)

    def _correct(self, image: _Image, seconds: float) -> None:
        # Fingers go where they are wanted; those on the object take it where it is wanted.
        lacks = self._to_palm @ (image.expected.position - image.state.position)
        on = image.expected.touching[:, None] & (self._from is None)
        error = np.where(on, lacks, image.wanted - image.tips)
        error = np.where(self._attends[:, None], error, 0.0)
        value = self._correction.update(error, seconds)
        beyond = value - self._in_place
        size = np.linalg.norm(beyond, axis=-1, keepdims=True)
        kept = self._in_place + beyond * np.minimum(1.0, _PRESS_M / np.maximum(size, 1e-9))
        self._correction.value = np.where(on, kept, value)
        # Fingers that reach for the object follow it; those that hold it move it.
        state = image.state
        away = self._to_palm @ (state.position - image.expected.position)
        away *= min(1.0, _SHIFT_M / max(float(np.linalg.norm(away)), 1e-9))
        free = ~self._intention.at(self._at).touching
        follow = (1.0 - np.exp(-seconds / _TRACKS_S)) * (free & state.placed)
        self._shift += follow[:, None] * (away - self._shift)
        if state.placed and state.time > self._scored:
            self._scored = state.time
            self._scorer = self._scorer.observe(state)
        elif np.isinf(self._scored) and self._scored > 0 and not state.fixed:
            self._scored = state.time

    def _progress(self, time: float) -> float:
        return float(np.clip((time - self._since) / self._duration, 0.0, 1.0))

    def _proceed(self, time: float, image: _Image | None) -> None:
        """Go on in the demonstration, wait, go back, or give up."""
        if GOAL_SEEN[self._task.name](self._scorer):
            return  # what was asked for is seen: the person stops there
        keys, progress = self._intention.keys, self._progress(time)
        if self._from is not None:  # opening
            if progress >= 1.0:
                self._begin_phase(1, time)
            return
        self._at = float(keys[self._phase - 1] + progress * np.diff(keys)[self._phase - 1])
        if progress < 1.0 or image is None:
            return
        waited = time - self._since - self._duration
        if waited < self._person.delay_s:  # what is seen is not yet of the phase's end
            return
        matters = self._intention.matters(self._phase) & ~image.expected.touching
        far = np.linalg.norm(image.wanted - image.tips, axis=-1)[matters]
        reached = not len(far) or bool(far.max() <= self._tolerance)
        followed = _follows(image)
        last = self._phase == len(keys) - 1
        if reached and not image.expected.touching.any():
            self._in_place = self._correction.value
        if reached and followed and not last:
            self._begin_phase(self._phase + 1, time)
        elif waited < WAIT_S and not (reached and followed and not last):
            return
        elif followed and not last:
            self._begin_phase(self._phase + 1, time)
        else:
            self._fail(time, image)

    def _fail(self, time: float, image: _Image) -> None:
        """The attempt did not work."""
        last = self._phase == len(self._intention.keys) - 1
        lies = image.state.support > 0.0 or image.state.fixed
        if not lies and not last:  # it is in the hand: opening would drop it
            self._begin_phase(self._phase + 1, time)
        elif not lies or self.attempt >= self._person.attempts:
            self.gave_up = True
        else:
            self._harder = min(self._harder + _HARDER, _HARDEST)
            start = self._intention.positions[0]
            if self._scorer.standing.stuck or _far(image.state.position, start):
                self.wants_reset = True
            self.attempt += 1
            self._correction.value = self._in_place
            self._begin_again(time)

    def _begin_again(self, time: float) -> None:
        self._begin_phase(1, time)
        self._at = 0.0
        self._from = self._goal
        self._duration = self._time_for(_OPENS_M)

    def _begin_phase(self, phase: int, time: float) -> None:
        """Set out for a key pose."""
        keys = self._intention.keys
        self._phase, self._since = phase, time
        self._at = float(keys[phase - 1])
        self._from = None
        shortest = float(keys[phase] - keys[phase - 1])
        self._duration = max(shortest, self._time_for(self._intention.travel(phase)))

    def _time_for(self, distance: float) -> float:
        return self._pace * movement_time(distance, 2 * self._tolerance, self._lag)


def _follows(image: _Image) -> bool:
    """Whether the object is about where it is expected."""
    apart = np.linalg.norm(image.state.position - image.expected.position)
    turn = rotation(image.state.quaternion) @ rotation(image.expected.quaternion).T
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0))
    return bool(apart <= _OBJECT_M and angle <= _OBJECT_RAD)


def _far(position: Float[np.ndarray, "3"], start: Float[np.ndarray, "3"]) -> bool:
    return bool(np.linalg.norm(position - start) > _SHIFT_M)


def _smooth(share: float) -> float:
    return share * share * (3.0 - 2.0 * share)

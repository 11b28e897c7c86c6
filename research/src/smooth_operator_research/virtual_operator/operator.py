"""A person at the tracker, who plans, watches with a delay, corrects, and tries again.

``strategies.py`` defines what the person does with the object, ``person.py`` tremor, motor noise
and the person's parameters, and ``hand_model.py`` the hand. This module adds delay, correction and
movement: a step of the strategy takes the time of Fitts' law; the person checks by eye whether its
goal is reached, corrects fingertips that are not where they should be, and continues.

The correction is McRuer's crossover model: near the frequency at which the open loop's gain is 1, a
person's correction and the machine together behave as omega_c exp(-tau s) / s, whatever the machine
is (McRuer and Jex 1967). The machine here follows the fingers with little dynamics of its own, so
the person integrates the seen error.

Simplifications: a pressing finger is not corrected by vision (this made grips slip in trials); the
person feels nothing, as in the paper's study.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene import Scene, SceneState
from smooth_operator.simulation.tasks.task import Scorer, SimulatedTask
from smooth_operator_research.virtual_operator.hand_model import (
    GripReach,
    HandModel,
    InternalModel,
    ReachingHand,
    SeenTips,
)
from smooth_operator_research.virtual_operator.person import MotorNoise, Person, movement_time
from smooth_operator_research.virtual_operator.strategies import (
    STRATEGIES,
    Observation,
    Step,
    Strategy,
)

T = TypeVar("T")

SPEED_LIMIT: Final = 0.10
"""Highest speed of a fingertip's correction [m/s]: corrective submovements of 10 to 20 mm last 150
to 200 ms (Meyer et al. 1988)."""

REACH_LIMIT: Final = 0.015
"""Largest correction [m]; our choice: a fingertip that does not follow that far can't reach the
goal."""


class DelayedView(Generic[T]):
    """Queue of images that delays them.

    Args:
        delay_s: delay of the images [s].
    """

    def __init__(self, delay_s: float) -> None:
        self._delay = delay_s
        self._waiting: deque[tuple[float, T]] = deque()
        self._latest: T | None = None

    def show(self, time: float, image: T) -> None:
        """Adds the image of a moment, later than the last one."""
        self._waiting.append((time, image))

    def latest(self, time: float) -> T | None:
        """Newest image that is at least as old as the delay; None before the first."""
        while self._waiting and self._waiting[0][0] <= time - self._delay + 1e-9:
            self._latest = self._waiting.popleft()[1]
        return self._latest


class CrossoverCorrection:
    """A correction that integrates the seen error.

    Args:
        gain: crossover frequency [rad/s].
        threshold: length that is subtracted from each error [m]; shorter errors count as none.
        shape: shape of the correction, (..., 3).
        speed_limit: fastest change of each point [m/s].
        reach_limit: largest offset of each point [m].
    """

    def __init__(
        self,
        gain: float,
        threshold: float,
        shape: tuple[int, ...],
        speed_limit: float = SPEED_LIMIT,
        reach_limit: float = REACH_LIMIT,
    ) -> None:
        self._gain, self._threshold = gain, threshold
        self._speed, self._reach = speed_limit, reach_limit
        self.value: Float[np.ndarray, "*n 3"] = np.zeros(shape)

    def update(self, error: Float[np.ndarray, "*n 3"], seconds: float) -> Float[np.ndarray, "*n 3"]:
        """Integrates over an interval.

        Args:
            error: (..., 3) wanted minus seen position [m], as old as the person's delay.
            seconds: time since the last call [s].

        Returns:
            (..., 3) correction [m].
        """
        size = np.linalg.norm(error, axis=-1, keepdims=True)
        felt = error * np.maximum(size - self._threshold, 0.0) / np.maximum(size, 1e-12)
        velocity = _at_most(self._gain * felt, self._speed)
        self.value = _at_most(self.value + velocity * seconds, self._reach)
        return self.value


def _at_most(vector: Float[np.ndarray, "*n 3"], most: float) -> Float[np.ndarray, "*n 3"]:
    size = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector * np.minimum(1.0, most / np.maximum(size, 1e-12)))


@dataclass(frozen=True, eq=False)
class _Image:
    """Scene and goals of the fingertips at one moment."""

    time: float
    obs: Observation
    targets: Float[np.ndarray, "f 3"]
    error: Float[np.ndarray, "f 3"]


class VirtualOperator:
    """Hand of a person in a trial; a ``LandmarkSource``.

    Args:
        practised: number of earlier trials of the task, with any retargeter.
        practised_here: number of earlier trials with this retargeter.
        lag_s: lag from the hand to the robot's motion [s], which slows a person down.

    Attributes:
        gave_up: True if the person can do no more.
        wants_reset: True if the fingers can't work on the object where it is, and the person asks
            for it to be put back.
        attempts: number of attempts.
        body: the person's hand.
    """

    def __init__(
        self,
        person: Person,
        hand: Hand,
        body: HandModel,
        model: InternalModel,
        task: SimulatedTask,
        scene: Scene,
        reach: GripReach,
        *,
        practised: int = 0,
        practised_here: int = 0,
        lag_s: float = 0.05,
        seed: int = 0,
    ) -> None:
        self._person, self._hand, self._task, self._scene = person, hand, task, scene
        self._reach = reach
        self.gave_up = self.wants_reset = False
        self.attempts = 1
        rows = [FINGERS.index(name) for name in hand.fingers]
        self._at, self._turn = scene.mount.palm
        self._pace = person.pace * person.practised(practised)
        self._lag = lag_s
        self._misjudged = person.map_error[rows] * person.practised(practised_here)
        count = len(rows)
        rng = np.random.default_rng([seed, person.number, 0x07])
        self._noise = MotorNoise(person.motor_noise, person.tremor_m, count, rng)
        self._correction = CrossoverCorrection(person.crossover, person.threshold_m, (count, 3))
        self._view: DelayedView[_Image] = DelayedView(person.delay_s)
        self._scorer: Scorer = task.scorer(scene)
        self.body, self._model = ReachingHand(body), model
        self._tips: SeenTips | None = None
        self._strategy: Strategy | None = None
        self._step: Step | None = None
        self._last = self._observed = float("nan")
        # The robot's fingertips in the world: where they are wanted, and where they then are.
        self._goal = self._foreseen = np.array(reach.relaxed)
        self._from = self._goal
        self._since, self._duration = 0.0, 1.0
        self.body.reach(self._own(self._goal), np.inf, rounds=40)

    def observe(self, time: float, state: SceneState, physics: ScenePhysics) -> None:
        """Observes the robot; call it whenever the scene is scored.

        Args:
            time: time since 'go' [s].
        """
        if self._tips is None:
            self._tips = SeenTips(physics)
        seconds = 0.0 if np.isnan(self._observed) else time - self._observed
        self._observed = time
        if state.placed:
            self._scorer = self._scorer.observe(state)
        # People foresee the lag of what they move (Miall and Wolpert 1996).
        share = 1.0 - np.exp(-seconds / self._lag)
        self._foreseen = self._foreseen + share * (self._goal - self._foreseen)
        tips = self._tips.read() @ self._turn.T + self._at
        obs = Observation(state, self._scorer, tips, self._goal)
        self._view.show(time, _Image(time, obs, self._foreseen, self._error(obs)))

    def _error(self, obs: Observation) -> Float[np.ndarray, "f 3"]:
        """Errors (f, 3) of the fingertips that the person corrects."""
        error, step = np.zeros_like(obs.tips), self._step
        if step is None or step.via:
            return error
        free = [finger for finger in step.aims(1.0, obs) if finger not in step.presses]
        error[free] = self._foreseen[free] - obs.tips[free]
        return error

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"]:
        """(21, 3) landmarks of the person's hand [m], with the wrist at the origin; see
        ``LandmarkSource``."""
        seconds = 0.0 if np.isnan(self._last) else max(0.0, time - self._last)
        self._last = time
        before = self._goal
        image = self._view.latest(time) if time >= 0.0 else None
        if image is not None:
            self._correction.update(image.error @ self._turn, seconds)
            self._proceed(time, image)
        moved = (self._goal - before) @ self._turn
        noise = self._noise.update(time, moved, seconds)
        return self.body.reach(self._own(self._goal, noise), max(seconds, 1e-3))

    def restart(self) -> None:
        """Restarts after a reset of the object."""
        self._scorer = self._task.scorer(self._scene)

    def _own(
        self, goal: Float[np.ndarray, "f 3"], noise: Float[np.ndarray, "f 3"] | float = 0.0
    ) -> Float[np.ndarray, "5 3"]:
        """Goals (5, 3) of the person's own fingertips for those of the robot, in the world."""
        palm = (goal - self._at) @ self._turn
        return self._model.own_tips(palm + self._correction.value + self._misjudged + noise)

    def _proceed(self, time: float, image: _Image) -> None:
        """Continues the step, or begins the next."""
        if self._strategy is None:
            self._strategy = STRATEGIES[self._task.name](self._scene, self._reach, image.obs)
            self._begin(next(self._strategy), time, image.obs)
        assert self._step is not None
        step, share = self._step, self._share(time)
        aims = step.aims(share, image.obs)
        goal = self._from + share * (self._reach.relaxed - self._from)
        for finger, aim in aims.items():
            start = self._from[finger]
            goal[finger] = aim if step.path else start + share * (aim - start)
        self._goal = goal
        if self._over(step, time, image, list(aims)):
            try:
                self._begin(self._strategy.send(image.obs), time, image.obs)
            except StopIteration:
                self.gave_up = True

    def _over(self, step: Step, time: float, image: _Image, used: list[int]) -> bool:
        """True if the person sees the goal of the step, or stops waiting."""
        waited = time - self._since - self._duration
        if step.until is not None and image.time >= self._since and step.until(image.obs):
            return True
        if waited < 0.0:
            return False
        if step.via or waited >= step.longest_s:
            return True
        if step.until is not None or step.presses or image.time < self._since + self._duration:
            return False
        apart = np.linalg.norm(image.targets - image.obs.tips, axis=-1)[used]
        return bool(np.all(apart <= self._person.tolerance_m))

    def _share(self, time: float) -> float:
        share = float(np.clip((time - self._since) / self._duration, 0.0, 1.0))
        return share * share * (3.0 - 2.0 * share)

    def _begin(self, step: Step, time: float, obs: Observation) -> None:
        """Starts moving to the aims of a step."""
        self._step, self._since, self._from = step, time, self._goal
        ends = step.aims(1.0, obs)
        ways = [float(np.linalg.norm(aim - self._goal[finger])) for finger, aim in ends.items()]
        if not ways:
            ways = np.linalg.norm(self._reach.relaxed - self._goal, axis=1).tolist()
        width = 2 * self._person.tolerance_m
        needed = self._pace * movement_time(max(ways), width, self._lag)
        self._duration = max(needed, self._pace * step.seconds)
        if step.attempt:
            self.attempts += 1
        self.wants_reset = step.reset

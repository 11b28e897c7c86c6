"""A person at the tracker: intends, looks with a delay, corrects, and tries again.

The parts are: what the person does with the object (``strategies.py``), the delay and the
correction (``visual_feedback.py``), tremor and motor noise (``motor_noise.py``), the hand
(``hand_model.py``) and the person's figures (``person.py``). This file is the movement: a step of
the strategy takes the time of Fitts' law; the person looks whether what is wanted is seen, corrects
fingertips that are not where they should be, and goes on.

Simplifications: a finger that presses is not corrected by what is seen of it (that made grips slip
in trials); nothing is felt, as in the paper's study.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene import Scene, SceneState
from smooth_operator.simulation.tasks.task import Scorer, SimulatedTask
from smooth_operator_research.virtual_operator.familiarisation import InternalModel
from smooth_operator_research.virtual_operator.hand_model import (
    GripReach,
    HandModel,
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
from smooth_operator_research.virtual_operator.visual_feedback import (
    CrossoverCorrection,
    DelayedView,
)


@dataclass(frozen=True, eq=False)
class _Image:
    """What there was to see at one moment, and where fingertips were wanted."""

    time: float
    obs: Observation
    targets: Float[np.ndarray, "f 3"]
    error: Float[np.ndarray, "f 3"]


class VirtualOperator:
    """The hand of a person who does a trial; a ``LandmarkSource``.

    Args:
        person: who.
        hand: the robot hand.
        body: the person's hand.
        model: what the person has learnt of the retargeter.
        task: what is to be done: the person knows the instruction.
        scene: of the trial.
        reach: what the robot's fingertips reach in it.
        practised: trials of the task before this one, with any retargeter.
        practised_here: trials before this one with this retargeter.
        lag_s: from the hand to the robot's motion [s], which slows a person down.
        seed: of the noise.

    Attributes:
        gave_up: the person can do no more.
        wants_reset: the object is where the fingers can't work on it, and the person asks for it to
            be put back.
        attempts: how often the person began.
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
        """Look at the robot; to be called as often as the scene is scored.

        Args:
            time: since 'go' [s].
            state: the scene.
            physics: the hand in it.
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
        """(f, 3) how far fingertips are from where they should be, as far as it is corrected."""
        error, step = np.zeros_like(obs.tips), self._step
        if step is None or step.via:
            return error
        free = [finger for finger in step.aims(1.0, obs) if finger not in step.presses]
        error[free] = self._foreseen[free] - obs.tips[free]
        return error

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"]:
        """(21, 3) of the person's hand [m], the wrist at the origin; see ``LandmarkSource``."""
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
        """The object was put back."""
        self._scorer = self._task.scorer(self._scene)

    def _own(
        self, goal: Float[np.ndarray, "f 3"], noise: Float[np.ndarray, "f 3"] | float = 0.0
    ) -> Float[np.ndarray, "5 3"]:
        """(5, 3) where the person's own fingertips go for the robot's, in the world."""
        palm = (goal - self._at) @ self._turn
        return self._model.own_tips(palm + self._correction.value + self._misjudged + noise)

    def _proceed(self, time: float, image: _Image) -> None:
        """Go on with the step, or begin the next."""
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
        """Whether what the step is for is seen, or the person waits no longer."""
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
        """Set out for the aims of a step."""
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

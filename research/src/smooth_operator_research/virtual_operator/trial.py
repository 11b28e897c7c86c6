"""Trial of a virtual operator: combines person, tracker, retargeter and physics."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene import Scene, SceneState
from smooth_operator.simulation.scenes.task_scenes import scene_for
from smooth_operator.simulation.tasks.task import SimulatedTask
from smooth_operator.simulation.tasks.trial import Outcome
from smooth_operator.synthetic.tracker import TrackerModel
from smooth_operator_research.demonstrations.perturbation import TrackerClock
from smooth_operator_research.demonstrations.trial_loop import TrialTrace, run_trial
from smooth_operator_research.virtual_operator.hand_model import (
    Body,
    GripReach,
    HandModel,
    InternalModel,
    familiarise,
    hand_model,
)
from smooth_operator_research.virtual_operator.operator import VirtualOperator
from smooth_operator_research.virtual_operator.person import Person

LOOKS_HZ: Final = 100.0
"""Rate at which scorer and person look at the scene [Hz]."""

LEAD_S: Final = 1.0
"""Time for which the person holds the open hand before 'go' [s]."""

_SERVO_LAG_S: Final = 0.016
"""Lag of a critically damped servo of 20 Hz: 2 / (2 pi 20 Hz) [s]."""


@dataclass(frozen=True, eq=False)
class Familiar:
    """A person who has learnt a retargeter by free movement.

    Attributes:
        person: the person.
        retargeter: retargeter for the robot hand.
        body: the person's hand.
        model: the internal model that the person has learnt.
    """

    person: Person
    retargeter: Retargeter
    body: HandModel
    model: InternalModel


def make_familiar(
    person: Person,
    retargeter: Retargeter,
    tracker: TrackerModel,
    body: Body = "matched",
    seed: int = 0,
) -> Familiar:
    """Lets a person move freely with a retargeter and a tracker."""
    model = hand_model(person, retargeter.hand, body)
    learnt = familiarise(model, retargeter, tracker, seed)
    return Familiar(person, retargeter, model, learnt)


@dataclass(frozen=True)
class OperatorTrial:
    """Result of a trial of a virtual operator.

    Attributes:
        outcome: score, time and reason.
        attempts: number of attempts.
        frames: number of frames that the retargeter received.
        diverged: number of times that the physics diverged and was reset.
        trace: record of the trial at ``LOOKS_HZ``; None unless requested.
    """

    outcome: Outcome
    attempts: int
    frames: int
    diverged: int
    trace: TrialTrace | None = None


def simulate_trial(
    familiar: Familiar,
    task: SimulatedTask,
    *,
    tracker: TrackerModel,
    practised: int = 0,
    practised_here: int = 0,
    resets: int = 1,
    seconds: float | None = None,
    seed: int = 0,
    trace: bool = False,
) -> OperatorTrial:
    """Simulates a trial of a person with a retargeter.

    Args:
        tracker: tracker that sees the person; its seed does not matter.
        practised: number of earlier trials of the task, with any retargeter.
        practised_here: number of earlier trials with this retargeter.
        resets: number of times that the object may be put back: 0 or 1.
        seconds: time limit [s]; None for the task's own.
        trace: True to record the trial.
    """
    scene, reach = _prepared(task.name, familiar.retargeter.hand)
    source = _Tracked(
        familiar, task, scene, reach, tracker, practised, practised_here, resets, seed
    )
    result = run_trial(
        familiar.retargeter,
        scene,
        task,
        source,
        rate_hz=LOOKS_HZ,
        seconds=seconds,
        lead_s=LEAD_S,
        seed=seed,
        interventions=source.intervention,
        trace=trace,
    )
    outcome = Outcome(
        result.score, result.line, result.seconds, result.ended, result.reason, result.resets
    )
    return OperatorTrial(
        outcome, source.operator.attempts, result.frames, result.diverged, result.trace
    )


class _Tracked:
    """A person observed by a tracker."""

    def __init__(
        self,
        familiar: Familiar,
        task: SimulatedTask,
        scene: Scene,
        reach: GripReach,
        tracker: TrackerModel,
        practised: int,
        practised_here: int,
        resets: int,
        seed: int,
    ) -> None:
        own = int(np.random.default_rng([seed, familiar.person.number, 0x7A]).integers(1 << 31))
        self._clock = TrackerClock(replace(tracker, seed=own))
        self._coming: deque[tuple[float, Float[np.ndarray, "21 3"]]] = deque()
        self._resets = resets
        self.operator = VirtualOperator(
            familiar.person,
            familiar.retargeter.hand,
            familiar.body,
            familiar.model,
            task,
            scene,
            reach,
            practised=practised,
            practised_here=practised_here,
            lag_s=tracker.delay + 0.5 / tracker.rate_hz + _SERVO_LAG_S,
            seed=seed,
        )

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"] | None:
        """See ``LandmarkSource``; a frame comes when it is as old as the tracker's delay."""
        if time >= 0.0:
            self.operator.observe(time, state, physics)
        tick = self._clock.due(time)
        if tick is not None:
            points = self.operator.landmarks(time, state, physics)
            if tick.arrives[0]:
                self._coming.append((time + tick.model.delay, tick.shown(points[None])[0]))
        if not self._coming or self._coming[0][0] > time + 1e-9:
            return None
        return self._coming.popleft()[1]

    def intervention(self) -> Literal["reset", "finish"] | None:
        """See ``perform``."""
        if self.operator.gave_up:
            return "finish"
        if self.operator.wants_reset:
            self.operator.wants_reset = False
            if self._resets:
                self._resets -= 1
                self.operator.restart()
                return "reset"
        return None


@lru_cache(maxsize=16)
def _prepared(task: str, hand: Hand) -> tuple[Scene, GripReach]:
    scene = scene_for(task, hand)
    return scene, GripReach(hand, scene)

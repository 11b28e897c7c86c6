"""A trial that a virtual operator does: the person, the tracker, a retargeter, the physics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.simulation.scenes.physics import ObjectVariation, ScenePhysics
from smooth_operator.simulation.scenes.scene import Scene, SceneState
from smooth_operator.simulation.scenes.task_scenes import scene_for
from smooth_operator.simulation.tasks.task import SimulatedTask
from smooth_operator.simulation.tasks.trial import Outcome
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
"""Looks of scorer and person at the scene a second [Hz]."""

LEAD_S: Final = 1.0
"""So long the person holds the open hand before 'go' [s]."""

_SERVO_LAG_S: Final = 0.016
"""Lag of a critically damped servo of 20 Hz: 2 / (2 pi 20 Hz) [s]."""


@dataclass(frozen=True, eq=False)
class Familiar:
    """A person who knows a retargeter from free movement.

    Attributes:
        person: who.
        retargeter: for the robot hand.
        body: the person's hand.
        model: what the person has learnt.
    """

    person: Person
    retargeter: Retargeter
    body: HandModel
    model: InternalModel


def make_familiar(
    person: Person, retargeter: Retargeter, body: Body = "matched", seed: int = 0
) -> Familiar:
    """Have a person move freely with a retargeter."""
    model = hand_model(person, retargeter.hand, body)
    learnt = familiarise(model, retargeter, seed)
    return Familiar(person, retargeter, model, learnt)


@dataclass(frozen=True)
class OperatorTrial:
    """Result of a trial of a virtual operator.

    Attributes:
        outcome: score, time, reason.
        attempts: how often the person began.
        frames: that the retargeter received.
        diverged: how often the physics diverged and was reset.
        trace: what happened, at ``LOOKS_HZ``; None unless asked for.
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
    rate_hz: float = 100.0,
    practised: int = 0,
    practised_here: int = 0,
    resets: int = 1,
    seconds: float | None = None,
    seed: int = 0,
    variation: ObjectVariation | None = None,
    trace: bool = False,
) -> OperatorTrial:
    """Have a person do a trial with a retargeter.

    Args:
        rate_hz: frames of the tracker and commands a second [Hz].
        practised: trials of the task before this one, with any retargeter.
        practised_here: trials before this one with this retargeter.
        resets: how often the object may be put back: 0 or 1.
        seconds: time limit [s]; None for the task's own.
        variation: variation of the object; None for the nominal one.
        trace: keep what happened.

    Raises:
        HandModelError: the hand can't do the task.
    """
    scene, reach = _prepared(task.name, familiar.retargeter.hand)
    if variation is not None:
        scene = variation.scene(scene)
    source = _Tracked(familiar, task, scene, reach, rate_hz, practised, practised_here, resets,
                      seed)  # fmt: skip
    result = run_trial(
        familiar.retargeter, scene, task, source, rate_hz=LOOKS_HZ, seconds=seconds, lead_s=LEAD_S,
        seed=seed, interventions=source.intervention, trace=trace,
        prepare=None if variation is None else variation.prepare,
    )  # fmt: skip
    outcome = Outcome(
        result.score, result.line, result.seconds, result.ended, result.reason, result.resets
    )
    return OperatorTrial(
        outcome, source.operator.attempts, result.frames, result.diverged, result.trace
    )


class _Tracked:
    """A person before a tracker, which has noise, a frame rate and lost frames."""

    def __init__(
        self, familiar: Familiar, task: SimulatedTask, scene: Scene, reach: GripReach,
        rate_hz: float, practised: int, practised_here: int, resets: int,
        seed: int,
    ) -> None:  # fmt: skip
        self._person, self._period = familiar.person, 1.0 / rate_hz
        self._rng = np.random.default_rng([seed, self._person.number, 0x7A])
        self._resets = resets
        self._due = float("-inf")
        self.operator = VirtualOperator(
            familiar.person, familiar.retargeter.hand, familiar.body, familiar.model, task, scene,
            reach, practised=practised, practised_here=practised_here,
            lag_s=0.5 / rate_hz + _SERVO_LAG_S, seed=seed,
        )  # fmt: skip

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"] | None:
        """See ``LandmarkSource``; None also between the frames of the tracker."""
        if time >= 0.0:
            self.operator.observe(time, state, physics)
        if time < self._due - 1e-9:
            return None
        self._due = max(self._due, time) + self._period
        self.operator.landmarks(time, state, physics)
        body = self.operator.body
        noise = self._rng.normal(0.0, self._person.tracker_noise, len(body.angles))
        return None if self._rng.random() < self._person.frame_loss else body.tracked(noise)

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

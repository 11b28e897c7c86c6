"""A trial that a virtual operator does: the person, the tracker, a retargeter, the physics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene import Scene
from smooth_operator.simulation.scenes.scene_registry import scene_for
from smooth_operator.simulation.tasks.demonstration import load_demonstration
from smooth_operator.simulation.tasks.task_registry import SimulatedTask
from smooth_operator.simulation.tasks.trial import Outcome, Phase, TaskRun
from smooth_operator.simulation.tasks.trial_loop import FrameRetargeter
from smooth_operator.simulation.virtual_operator.familiarisation import (
    InternalModel,
    familiarise,
)
from smooth_operator.simulation.virtual_operator.hand_model import (
    Body,
    HandModel,
    hand_model,
)
from smooth_operator.simulation.virtual_operator.intention import Intention, intention_for
from smooth_operator.simulation.virtual_operator.operator import VirtualOperator
from smooth_operator.simulation.virtual_operator.person import Person
from smooth_operator.types import HandFrame

_LOOK_S: Final = 0.01
"""Between two looks of scorer and person at the scene [s]."""

LEAD_S: Final = 1.0
"""So long the person holds the open hand before 'go' [s]."""

_SERVO_LAG_S: Final = 0.016
"""Of a critically damped servo of 20 Hz: 2 / (2 pi 20 Hz) [s]."""


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
    retargeter: FrameRetargeter
    body: HandModel
    model: InternalModel


def make_familiar(
    person: Person, retargeter: FrameRetargeter, body: Body = "matched", seed: int = 0
) -> Familiar:
    """Have a person move freely with a retargeter.

    Args:
        person: who.
        retargeter: for the robot hand.
        body: whose kinematics the person's hand has.
        seed: of the movements.
    """
    model = hand_model(person, retargeter.hand, body)
    learnt = familiarise(model, retargeter, seed)
    return Familiar(person, retargeter, model, learnt)


@dataclass(frozen=True)
class OperatorTrial:
    """How a trial of a virtual operator ended.

    Attributes:
        outcome: score, time, reason.
        attempts: how often the person began.
        frames: that the retargeter received.
        diverged: how often the physics diverged and was reset.
    """

    outcome: Outcome
    attempts: int
    frames: int
    diverged: int


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
) -> OperatorTrial:
    """Have a person do a trial with a retargeter.

    Args:
        familiar: the person, and the retargeter.
        task: what is done.
        rate_hz: frames of the tracker and commands a second [Hz].
        practised: trials of the task before this one, with any retargeter.
        practised_here: trials before this one with this retargeter.
        resets: how often the object may be put back.
        seconds: time limit [s]; None for the task's own.
        seed: of all noise of this trial.

    Raises:
        HandModelError: the hand can't do the task.
        StudyError: there is no demonstration of the task for the hand.
    """
    person, retargeter = familiar.person, familiar.retargeter
    hand = retargeter.hand
    scene, intention = _prepared(task.name, hand)
    physics = ScenePhysics(hand, scene)
    limit = task.seconds if seconds is None else seconds
    operator = VirtualOperator(
        person, hand, familiar.body, familiar.model, intention, task, physics, practised=practised,
        practised_here=practised_here, lag_s=0.5 / rate_hz + _SERVO_LAG_S, seed=seed,
    )  # fmt: skip
    rng = np.random.default_rng([seed, person.number, 0x7A])
    state, frames, put_back, due = retargeter.init(seed), 0, 0, -LEAD_S
    run = TaskRun(task, scene)
    start, seen = physics.time + LEAD_S, physics.observe()
    while run.phase is not Phase.DONE:
        time = physics.time - start
        if run.phase is Phase.READY and time >= -1e-9:
            physics.reset_object()
            seen = physics.observe()
            run = run.go(physics.time)
        if time >= limit or operator.gave_up:
            run = run.finish(physics.time)
            break
        if time >= -1e-9:
            operator.observe(time, seen, physics)
        if time >= due - 1e-9:
            due += 1.0 / rate_hz
            points = operator.landmarks(time, seen, physics)
            points = points + rng.normal(0.0, person.tracker_noise_m, points.shape)
            if rng.random() >= person.frame_loss:
                frame = HandFrame(points, time, hand.spec.side)
                state, result = retargeter.step(state, frame)
                physics.command(result.command.positions)
                frames += 1
            if operator.wants_reset and put_back < resets:
                put_back += 1
                run = run.reset()
                physics.reset_object()
                operator.restart()
            operator.wants_reset = False
        physics.advance(_LOOK_S)
        seen = physics.observe()
        run = run.observe(seen)
    assert run.outcome is not None  # it is done
    return OperatorTrial(run.outcome, operator.attempt, frames, physics.resets)


@lru_cache(maxsize=16)
def _prepared(task: str, hand: Hand) -> tuple[Scene, Intention]:
    return scene_for(task, hand), intention_for(load_demonstration(task, hand.name), hand)

"""A trial of a task as an immutable value: from 'go' to success, a lost object or the time limit.

Its only clock is that of the scene's states, so a recorded trial scores the same again.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, Self

from smooth_operator.errors import StudyError
from smooth_operator.simulation.scenes.scene import Scene, SceneState
from smooth_operator.simulation.tasks.scorers import NOT_DONE, Assessment, Scorer
from smooth_operator.simulation.tasks.task import SimulatedTask

RESET_CAP: Final = 0.5
"""Highest score of a trial with a reset."""


class Phase(enum.Enum):
    """Phase of a trial."""

    READY = "ready"
    RUNNING = "running"
    DONE = "done"


@dataclass(frozen=True)
class Outcome:
    """Result of a trial.

    Attributes:
        score: 0, 0.5 or 1.
        line: line of the task's rubric that gave the score.
        seconds: time from 'go' to the end [s].
        ended: ``success``, ``drop``, ``timeout`` or ``finished`` (by the operator).
        reason: the reason in a few words.
        resets: number of resets of the object.
    """

    score: float
    line: str
    seconds: float
    ended: str
    reason: str
    resets: int


@dataclass(frozen=True, eq=False)
class TaskRun:
    """A trial of a task.

    Attributes:
        task: the task.
        scene: the scene.
        phase: ready, running or done.
        started: time of its start [s]; NaN before.
        resets: number of resets of the object; one is allowed.
        was_stuck: True if only the reset could help.
        scorer: scorer since 'go', or since the reset.
        outcome: result; None until it is done.
    """

    task: SimulatedTask
    scene: Scene
    phase: Phase = Phase.READY
    started: float = float("nan")
    resets: int = 0
    was_stuck: bool = False
    scorer: Scorer | None = None
    outcome: Outcome | None = None

    @property
    def assessment(self) -> Assessment:
        """Score of the trial if it ended now, with the cap for a reset."""
        if self.scorer is None:
            return Assessment(0.0, NOT_DONE, "ready")
        now = self.scorer.assessment
        if not self.resets or now.score <= RESET_CAP:
            return now
        after = self.task.after_stuck if self.was_stuck else self.task.after_reset
        return replace(now, score=RESET_CAP, line=after)

    def go(self, time: float) -> Self:
        """The trial after its start, which needs the object at its own start.

        Raises:
            StudyError: the trial has started already.
        """
        if self.phase is not Phase.READY:
            raise StudyError(f"the trial is {self.phase.value}; make a new one")
        scorer = self.task.scorer(self.scene)
        return replace(self, phase=Phase.RUNNING, started=time, scorer=scorer)

    def reset(self) -> Self:
        """The trial after the one reset of its object; the clock goes on.

        Raises:
            StudyError: the trial does not run, or had its reset.
        """
        if self.phase is not Phase.RUNNING:
            raise StudyError(f"the trial is {self.phase.value}; only one that runs has a reset")
        if self.resets:
            raise StudyError("a trial has one reset, and it is used; finish the trial")
        return replace(
            self,
            resets=1,
            was_stuck=self.assessment.stuck,
            scorer=self.task.scorer(self.scene),
        )

    def observe(self, state: SceneState) -> Self:
        """The trial after a state of the scene; done when complete, lost or out of time."""
        if self.phase is not Phase.RUNNING or self.scorer is None:
            return self
        # While the object waits for the hand to leave its place nothing can happen to it.
        run = replace(self, scorer=self.scorer.observe(state)) if state.placed else self
        assessment = run.assessment
        if assessment.complete:
            return run._done(state.time, "success", assessment)
        if assessment.dropped:
            return run._done(state.time, "drop", assessment)
        if state.time - self.started >= self.task.seconds:
            return run._done(state.time, "timeout", assessment)
        return run

    def finish(self, time: float) -> Self:
        """The trial after the operator ended it.

        Raises:
            StudyError: the trial does not run.
        """
        if self.phase is not Phase.RUNNING:
            raise StudyError(f"the trial is {self.phase.value}; it can't be finished")
        return self._done(time, "finished", self.assessment)

    def _done(self, time: float, ended: str, assessment: Assessment) -> Self:
        outcome = Outcome(
            assessment.score,
            assessment.line,
            time - self.started,
            ended,
            assessment.reason,
            self.resets,
        )
        return replace(self, phase=Phase.DONE, outcome=outcome)


def rescore(
    task: SimulatedTask,
    scene: Scene,
    states: Iterable[SceneState],
    events: Iterable[tuple[float, str]],
) -> TaskRun:
    """Score a recorded trial again.

    Args:
        states: recorded states of the scene, in order.
        events: (time, ``go``, ``reset`` or ``finish``) in order. An event applies after the state
            of the same time.
    """
    run, pending = TaskRun(task, scene), list(events)
    for state in states:
        while pending and pending[0][0] < state.time:
            run = _after_event(run, *pending.pop(0))
        run = run.observe(state)
    for time, word in pending:
        run = _after_event(run, time, word)
    return run


def _after_event(run: TaskRun, time: float, word: str) -> TaskRun:
    if word == "go":
        return run.go(time)
    if word == "reset":
        return run.reset()
    if word == "finish":
        return run.finish(time)
    raise StudyError(f"an event of a trial is go, reset or finish, not {word!r}")

"""One trial: from 'go' until the object is where it should be, or lost, or time is up.

A value that is replaced, never changed, and knows no clock but that of the scene it is shown: a
trial that was recorded scores again the same.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, Self

from smooth_operator.errors import StudyError
from smooth_operator.simulation.scenes.scene import Scene
from smooth_operator.simulation.scenes.state import SceneState
from smooth_operator.simulation.tasks.scorer import NOT_DONE, Scorer, Standing
from smooth_operator.simulation.tasks.task_registry import SimulatedTask

RESET_CAP: Final = 0.5
"""Most that a trial with a reset is worth."""


class Phase(enum.Enum):
    """Where a trial is."""

    READY = "ready"
    RUNNING = "running"
    DONE = "done"


@dataclass(frozen=True)
class Outcome:
    """What a trial came to.

    Attributes:
        score: 0, 0.5 or 1.
        line: of the task's rubric, by which.
        seconds: from 'go' to the end [s].
        ended: ``success``, ``drop``, ``timeout`` or ``finished`` (the operator's word).
        reason: in a few words.
        resets: how often the object was put back.
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
        task: which.
        scene: where.
        phase: ready, running or done.
        started: time of its start [s]; NaN before.
        resets: how often the object was put back; once is allowed.
        was_stuck: only the reset had helped.
        scorer: what has happened since 'go', or since the reset.
        outcome: what it came to; None until it is done.
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
    def standing(self) -> Standing:
        """How it stands; the score is what it would be if it ended now."""
        if self.scorer is None:
            return Standing(0.0, NOT_DONE, "ready")
        now = self.scorer.standing
        if not self.resets or now.score <= RESET_CAP:
            return now
        after = self.task.after_stuck if self.was_stuck else self.task.after_reset
        return replace(now, score=RESET_CAP, line=after)

    def go(self, time: float) -> Self:
        """Start; the object is at its start.

        Raises:
            StudyError: it has started already.
        """
        if self.phase is not Phase.READY:
            raise StudyError(f"the trial is {self.phase.value}; make a new one")
        scorer = self.task.scorer(self.scene)
        return replace(self, phase=Phase.RUNNING, started=time, scorer=scorer)

    def reset(self) -> Self:
        """The object is put back to its start, once; the clock goes on.

        Raises:
            StudyError: it does not run, or the reset is used up.
        """
        if self.phase is not Phase.RUNNING:
            raise StudyError(f"the trial is {self.phase.value}; only one that runs has a reset")
        if self.resets:
            raise StudyError("a trial has one reset, and it is used; finish the trial")
        return replace(
            self,
            resets=1,
            was_stuck=self.standing.stuck,
            scorer=self.task.scorer(self.scene),
        )

    def observe(self, state: SceneState) -> Self:
        """What happened; ends the trial when it is complete, lost or out of time."""
        if self.phase is not Phase.RUNNING or self.scorer is None:
            return self
        # While the object waits for the hand to leave its place nothing can happen to it.
        run = replace(self, scorer=self.scorer.observe(state)) if state.placed else self
        standing = run.standing
        if standing.complete:
            return run._done(state.time, "success", standing)
        if standing.dropped:
            return run._done(state.time, "drop", standing)
        if state.time - self.started >= self.task.seconds:
            return run._done(state.time, "timeout", standing)
        return run

    def finish(self, time: float) -> Self:
        """The operator can do no more.

        Raises:
            StudyError: it does not run.
        """
        if self.phase is not Phase.RUNNING:
            raise StudyError(f"the trial is {self.phase.value}; it can't be finished")
        return self._done(time, "finished", self.standing)

    def _done(self, time: float, ended: str, standing: Standing) -> Self:
        outcome = Outcome(
            standing.score, standing.line, time - self.started, ended, standing.reason, self.resets
        )
        return replace(self, phase=Phase.DONE, outcome=outcome)


def rescore(
    task: SimulatedTask,
    scene: Scene,
    states: Iterable[SceneState],
    events: Iterable[tuple[float, str]],
) -> TaskRun:
    """A trial again, from its record.

    Args:
        task: which.
        scene: where.
        states: what the scene showed, in order.
        events: (time, ``go``, ``reset`` or ``finish``) in order; each comes after the state of its
            time, if there is one.
    """
    run, pending = TaskRun(task, scene), list(events)
    for state in states:
        while pending and pending[0][0] < state.time:
            run = _told(run, *pending.pop(0))
        run = run.observe(state)
    for time, word in pending:
        run = _told(run, time, word)
    return run


def _told(run: TaskRun, time: float, word: str) -> TaskRun:
    if word == "go":
        return run.go(time)
    if word == "reset":
        return run.reset()
    if word == "finish":
        return run.finish(time)
    raise StudyError(f"an event of a trial is go, reset or finish, not {word!r}")

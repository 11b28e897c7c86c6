"""Trials of a task on one hand of a running simulation, each of them recorded."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError, StudyError
from smooth_operator.simulation.live import LiveSimulation
from smooth_operator.simulation.scenes.scene import SceneState
from smooth_operator.simulation.tasks.task import task_named
from smooth_operator.simulation.tasks.trial import Outcome, Phase, TaskRun
from smooth_operator.simulation.tasks.trial_record import TrialRecord, write_trial
from smooth_operator.types import Side

_PERIOD_S: Final = 0.01
"""Time between two recorded states of the scene [s], by its own clock."""

CLEAR_S: Final = 0.5
"""Time for which the object must be at its start untouched before a trial with ``when_clear``
begins [s]."""

WAITING: Final = "waiting"
"""Phase of a trial that begins when the hand is clear of the object."""


class TaskSession:
    """Successive trials on one hand of a simulation. Safe from any thread.

    The simulation must be open and have the task. Between trials the object stays where it is;
    ``go`` puts it back and starts the clock.

    Attributes:
        task: the task.
        outcomes: results of the trials so far, in order.
        failed: reason why a record could not be written; empty if all were.

    Args:
        simulation: the sink ``mujoco:task=...``.
        side: side of the hand.
        folder: folder of the trials' records; None writes none.
        done: called with each outcome, from the thread of the physics; it must return quickly.
        begun: called from the same thread when a trial with ``when_clear`` begins.
    """

    def __init__(
        self,
        simulation: LiveSimulation,
        side: Side,
        folder: str | Path | None = None,
        done: Callable[[Outcome], None] | None = None,
        begun: Callable[[], None] = lambda: None,
    ) -> None:
        self.task = task_named(simulation.task_now)
        self.outcomes: list[Outcome] = []
        self._simulation, self._side, self._done, self._begun = simulation, side, done, begun
        self._folder = None if folder is None else Path(folder)
        self._lock = threading.RLock()  # ``done`` may read the trial from within a call
        self._run = TaskRun(self.task, simulation.scene_of(side))
        self._record = self._fresh()
        self._last = float("-inf")
        self._now = 0.0
        self._since = 0
        self._number = 0
        self._trials = 0
        self._state: SceneState | None = None
        self._waiting = self._paused = False
        self._pauses = 0
        self._clear_since: float | None = None
        self._written: Path | None = None  # record of the last trial that ended
        self._disk = threading.Lock()
        self.failed = ""
        simulation.watch(side, self.observe)

    @property
    def run(self) -> TaskRun:
        """The current trial."""
        with self._lock:
            return self._run

    @property
    def number(self) -> int:
        """Number of the current trial, counted from 1; 0 before the first."""
        return self._trials

    @property
    def seconds(self) -> float:
        """Time since 'go' [s]; the length of a trial that is done; 0 before 'go'."""
        with self._lock:
            if self._run.outcome is not None:
                return self._run.outcome.seconds
            return self._now - self._run.started if self._run.phase is Phase.RUNNING else 0.0

    @property
    def active(self) -> bool:
        """True while a trial runs or waits for the hand to be clear."""
        with self._lock:
            return self._waiting or self._run.phase is Phase.RUNNING

    @property
    def paused(self) -> bool:
        """True while the scene is stopped."""
        with self._lock:
            return self._paused

    def go(self, *, when_clear: bool = False, limit_s: float | None = None, **about: Any) -> None:
        """Start a trial, with the object at its start.

        Args:
            when_clear: start the clock once the object was at its start, untouched, for
                ``CLEAR_S``; an object that is touched before is put back.
            limit_s: time limit [s]; None for the task's own.
            about: further entries of the record: operator, condition, number.

        Raises:
            StudyError: a trial is running.
        """
        with self._lock:
            if self.active:
                raise StudyError("a trial is running; finish it first")
            self._freeze(False)
            self._pauses = 0
            self._since = self._simulation.reset_object(self._side)
            task = self.task if limit_s is None else replace(self.task, seconds=limit_s)
            self._run = TaskRun(task, self._run.scene)
            self._record = self._fresh()
            self._record.about = about
            self._written = None
            self._trials += 1
            self._waiting, self._clear_since = when_clear, None
            if not when_clear:
                self._start()

    def _start(self) -> None:
        self._waiting = False
        self._run = self._run.go(self._now)
        self._record.events.append((self._now, "go"))

    def reset(self) -> None:
        """Put the object back to its start, at most once in a trial; the score is then up to 0.5.

        Raises:
            StudyError: no trial runs, or it had its reset.
        """
        with self._lock:
            self._run = self._run.reset()
            self._since = self._simulation.reset_object(self._side)
            self._record.events.append((self._now, "reset"))

    def pause(self, paused: bool) -> None:
        """Stop the scene of the current trial and its clock, or let them go on.

        Raises:
            StudyError: no trial is active that could be paused.
        """
        with self._lock:
            if paused == self._paused:
                return
            if paused and not self.active:
                raise StudyError("no trial is running that could be paused; begin one first")
            self._freeze(paused)
            self._pauses += paused

    def _freeze(self, frozen: bool) -> None:
        if frozen != self._paused:
            self._simulation.freeze(self._side, frozen)
            self._paused = frozen

    def finish(self) -> None:
        """End the trial for an operator who can do no more.

        Raises:
            StudyError: no trial runs.
        """
        with self._lock:
            self._run = self._run.finish(self._now)
            self._record.events.append((self._now, "finish"))
            self._end()

    def cancel(self) -> None:
        """Discard the current trial without counting or writing it; does nothing if none runs."""
        with self._lock:
            self._freeze(False)
            if self.active:
                self._waiting = False
                self._run = TaskRun(self.task, self._run.scene)

    def mark(self, word: str, about: Mapping[str, Any]) -> bool:
        """Mark the record of the last trial, which has ended, as one that does not count.

        The word is put before the name of its file, and ``"marked": word`` among its entries.

        Args:
            word: ``undone`` or ``void``.
            about: entries that the record must have; a record without them stays as it is.

        Returns:
            True if the record was marked.
        """
        with self._lock:
            record, path = self._record, self._written
            if path is None or any(record.about.get(k) != v for k, v in about.items()):
                return False
            self._written = None
            record.about = {**record.about, "marked": word}
        target = path.with_name(f"{word}-{path.name}")
        threading.Thread(target=self._write, args=(target, record, path), name="trial").start()
        return True

    def report(self) -> dict[str, Any]:
        """State of the current trial, ready for JSON.

        Returns:
            ``task``; ``side``; ``number`` of the trial, from 1; ``phase``: waiting (for the hand to
            be clear), ready, running or done; ``elapsed_s`` since 'go', by the scene's clock;
            ``score``, ``line`` of the rubric, its ``text`` and the ``reason``, final only for a
            trial that is done; its ``time_s`` and ``ended``, None before; ``resets``; ``placed``,
            False while the object waits for the hand to leave its place; ``limit_s``; ``about``,
            the entries from ``go``; ``paused``; ``pauses``, the number of pauses.
        """
        with self._lock:
            run, outcome = self._run, self._run.outcome
            assessment = run.assessment
            line = assessment.line if outcome is None else outcome.line
            placed = self._state is None or self._state.placed
            return {
                "task": self.task.name,
                "side": self._side,
                "number": self._trials,
                "phase": WAITING if self._waiting else run.phase.value,
                "elapsed_s": self.seconds,
                "score": assessment.score if outcome is None else outcome.score,
                "line": line,
                "text": next((r.text for r in self.task.task.rubric if r.name == line), ""),
                "reason": assessment.reason if outcome is None else outcome.reason,
                "time_s": None if outcome is None else outcome.seconds,
                "ended": None if outcome is None else outcome.ended,
                "resets": run.resets,
                "placed": placed,
                "limit_s": run.task.seconds,
                "paused": self._paused,
                "pauses": self._pauses,
                "about": dict(self._record.about),
            }

    def close(self) -> None:
        """Stop following the simulation, which may be closed. A running trial is not counted."""
        with contextlib.suppress(SinkError):
            self._freeze(False)
            self._simulation.watch(self._side, None)

    def observe(self, state: SceneState, positions: Float[np.ndarray, " n"]) -> None:
        """Follow a state of the simulation, which calls this after each step.

        Args:
            positions: (n,) joint positions of the hand [rad].
        """
        with self._lock:
            if state.time - self._last < _PERIOD_S - 1e-6:
                return
            self._last = self._now = state.time
            self._state = state
            if self._waiting:
                self._wait(state)
                return
            if self._run.phase is not Phase.RUNNING or state.starts < self._since:
                return  # no trial runs, or the object is not back at its start yet
            if state.starts > self._since:
                self._record.about["physics_came_apart"] = True
            self._record.add(state, positions)
            self._run = self._run.observe(state)
            if self._run.phase is Phase.DONE:
                self._end()

    def _wait(self, state: SceneState) -> None:
        """Begin the trial once the hand is clear; put back an object that the hand touches."""
        if state.starts < self._since:
            return
        if not state.placed:
            self._clear_since = None
        elif state.force.any() or state.palm > 0.0:
            self._since, self._clear_since = self._simulation.reset_object(self._side), None
        elif self._clear_since is None:
            self._clear_since = state.time
        elif state.time - self._clear_since >= CLEAR_S:
            self._since = state.starts
            self._start()
            self._begun()

    def _end(self) -> None:
        outcome = self._run.outcome
        assert outcome is not None  # it is done
        self._freeze(False)
        self._record.outcome = outcome
        if self._pauses:
            self._record.about["pauses"] = self._pauses
        self.outcomes.append(outcome)
        if self._folder is not None:
            record, path = self._record, self._folder / self._name()
            self._written = path
            # In a thread: the physics must not wait for the disk.
            threading.Thread(target=self._write, args=(path, record), name="trial").start()
        if self._done is not None:
            self._done(outcome)

    def _write(self, path: Path, record: TrialRecord, old: Path | None = None) -> None:
        try:
            with self._disk:
                path.parent.mkdir(parents=True, exist_ok=True)
                write_trial(path, record)
                if old is not None:
                    old.unlink(missing_ok=True)
        except OSError as error:
            self.failed = str(error)

    def _name(self) -> str:
        assert self._folder is not None
        while True:
            self._number += 1
            name = f"{self.task.name}-{self._number:03d}.npz"
            if not (self._folder / name).exists():
                return name

    def _fresh(self) -> TrialRecord:
        hand = self._simulation.hand_of(self._side)
        return TrialRecord(self.task.name, hand.name, hand.spec.side, hand.joint_names)

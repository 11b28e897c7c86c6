"""Runs and records trials of a task on the hands of a running simulation."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError, StudyError
from smooth_operator.simulation.live import LiveSimulation
from smooth_operator.simulation.scenes.scene import SceneState
from smooth_operator.simulation.tasks.catalogue import task_named
from smooth_operator.simulation.tasks.task import SimulatedTask
from smooth_operator.simulation.tasks.trial import Outcome, Phase, TaskRun, TrialRecord, write_trial
from smooth_operator.types import Side

_PERIOD_S: Final = 0.01
"""Time between two recorded states of the scene [s], on the scene's clock."""

CLEAR_S: Final = 0.5
"""Time for which the object must be untouched at its start before a trial with ``when_clear``
begins [s].
"""

WAITING: Final = "waiting"
"""Phase of a trial that begins when the hand is clear of the object."""


class TaskSession:
    """Runs trials on one hand of a simulation, one after another. Safe from any thread.

    The simulation must be open and have the task. Between trials the object stays where it is;
    ``go`` puts it back and starts the clock.

    Attributes:
        task: the task.
        outcomes: results of the trials so far, in order.
        failed: reason why a record could not be written; empty if all were written.

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
        self._writing: threading.Thread | None = None
        self.failed = ""
        simulation.watch(side, self.observe)

    @property
    def run(self) -> TaskRun:
        """The current trial, as an immutable value."""
        with self._lock:
            return self._run

    @property
    def number(self) -> int:
        """Number of the current trial, counted from 1; 0 before the first."""
        return self._trials

    @property
    def seconds(self) -> float:
        """Time since 'go' [s]; 0 before 'go', and the length of the trial after its end."""
        with self._lock:
            if self._run.outcome is not None:
                return self._run.outcome.seconds
            return self._now - self._run.started if self._run.phase is Phase.RUNNING else 0.0

    @property
    def active(self) -> bool:
        """True while a trial runs, or waits for the hand to move away from the object's start."""
        with self._lock:
            return self._waiting or self._run.phase is Phase.RUNNING

    @property
    def paused(self) -> bool:
        """True while the scene is stopped."""
        with self._lock:
            return self._paused

    def go(self, *, when_clear: bool = False, limit_s: float | None = None, **about: Any) -> None:
        """Starts a trial, with the object at its start.

        Args:
            when_clear: start the clock once the object was untouched at its start for ``CLEAR_S``;
                an object that is touched earlier is put back.
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
        """Puts the object back to its start, at most once in a trial; the score is then at most
        0.5. StudyError if no trial is running, or its reset was already used."""
        with self._lock:
            self._run = self._run.reset()
            self._since = self._simulation.reset_object(self._side)
            self._record.events.append((self._now, "reset"))

    def pause(self, paused: bool) -> None:
        """Stops or resumes the scene of the current trial and its clock; StudyError if no trial is
        active that could be paused."""
        with self._lock:
            if paused == self._paused:
                return
            if paused and not self.active:
                raise StudyError("no trial is running; start one before you pause it")
            self._freeze(paused)
            self._pauses += paused

    def _freeze(self, frozen: bool) -> None:
        if frozen != self._paused:
            self._simulation.freeze(self._side, frozen)
            self._paused = frozen

    def finish(self) -> None:
        """Ends the trial of an operator who gives up; StudyError if no trial is running."""
        with self._lock:
            self._run = self._run.finish(self._now)
            self._record.events.append((self._now, "finish"))
            self._end()

    def cancel(self) -> None:
        """Discards the current trial without counting or writing it; does nothing if none runs."""
        with self._lock:
            self._freeze(False)
            if self.active:
                self._waiting = False
                self._run = TaskRun(self.task, self._run.scene)

    def mark(self, word: str, about: Mapping[str, Any]) -> bool:
        """Marks the record of the last trial, which has ended, as one that does not count.

        The word becomes a prefix of the file's name, and the entry ``"marked": word`` is added.

        Args:
            word: ``undone`` or ``void``.
            about: entries that the record must have; a record without them is not changed.

        Returns:
            True if the record was marked.
        """
        with self._lock:
            record, path = self._record, self._written
            if path is None or any(record.about.get(k) != v for k, v in about.items()):
                return False
            self._written = None
            record.about = {**record.about, "marked": word}
            self._write(path.with_name(f"{word}-{path.name}"), record, path)
        return True

    def report(self) -> dict[str, Any]:
        """State of the current trial, ready for JSON.

        Returns:
            ``task``; ``side``; ``number`` of the trial, from 1; ``phase``: waiting (for the hand to
            be clear), ready, running or done; ``elapsed_s`` since 'go', on the scene's clock;
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
        """Stops following the simulation, which may be closed. A running trial is not counted."""
        with contextlib.suppress(SinkError):
            self._freeze(False)
            self._simulation.watch(self._side, None)

    def observe(self, state: SceneState, positions: Float[np.ndarray, " n"]) -> None:
        """Processes a new state of the simulation, which calls this after each step.

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
            self._write(path, record)
        if self._done is not None:
            self._done(outcome)

    def _write(self, path: Path, record: TrialRecord, old: Path | None = None) -> None:
        """Writes a record in a thread, because the physics must not wait for the disk; after the
        record before, so that a mark finds it."""
        before = self._writing

        def write() -> None:
            if before is not None:
                before.join()
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                write_trial(path, record)
                if old is not None:
                    old.unlink(missing_ok=True)
            except OSError as error:
                self.failed = str(error)

        self._writing = threading.Thread(target=write, name="trial")
        self._writing.start()

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


class TrialRunner:
    """Runs trials on each hand of a simulation, and changes the scenes. Safe from any thread.

    Args:
        simulation: an open sink, with or without a task.
        sides: sides of the driven hands.
        folder: folder of the trials' records; None writes none.
        about: returns further entries of a record; called when a trial begins.
        on_outcome: called with each outcome, from the thread of the physics; it must return
            quickly.
        note: called with each event of a trial, without its score, for a recording of the hand.
    """

    def __init__(
        self,
        simulation: LiveSimulation,
        sides: Sequence[Side],
        folder: str | Path | None = None,
        about: Callable[[], Mapping[str, Any]] = dict,
        on_outcome: Callable[[Side, Outcome], None] = lambda side, outcome: None,
        note: Callable[[Side, str], None] = lambda side, text: None,
    ) -> None:
        self._simulation, self._sides, self._folder = simulation, tuple(sides), folder
        self._about, self._on_outcome, self._note = about, on_outcome, note
        self._sessions: dict[Side, TaskSession] = {}
        self._past: dict[Side, list[Outcome]] = {side: [] for side in sides}
        self._lock = threading.RLock()
        self._changing = threading.Lock()  # apart from ``_lock``: a scene takes long to build
        self._attend()

    @property
    def task(self) -> SimulatedTask | None:
        """The current task; None if there is none."""
        name = self._simulation.task_now
        return None if name == "none" else task_named(name)

    @property
    def outcomes(self) -> dict[Side, list[Outcome]]:
        """Results of all trials so far, in the order in which they ended."""
        with self._lock:
            return {
                side: [*past, *(self._sessions[side].outcomes if side in self._sessions else ())]
                for side, past in self._past.items()
            }

    @property
    def failures(self) -> list[str]:
        """Reasons why records could not be written."""
        return [session.failed for session in self._sessions.values() if session.failed]

    @property
    def object_there(self) -> bool:
        """True if the object is present in a scene; False in free movement."""
        states = [self._simulation.scene_state(side) for side in self._sides]
        return any(state is not None and not state.away for state in states)

    def change(self, task: str | None, with_object: bool = True) -> SimulatedTask | None:
        """Loads the scene of a task, or removes the task, and discards a running trial.

        If the scene is already the current one, it is kept and its object is put back to its start.

        Args:
            task: name of the task here or in the paper (A, B, C); None for the hand alone.
            with_object: False leaves the object out until a trial begins or it is put back, as
                for free movement.

        Raises:
            UnknownNameError: there is no such task.
            HandModelError: a hand can't do the task; nothing changes.
            SinkError: the simulation is closed.
        """
        chosen = None if task is None else task_named(task)
        with self._changing:
            now = self.task
            if now is not None and chosen is not None and now.name == chosen.name:
                self.cancel()
                self._put(with_object)
                return chosen
            self._simulation.change_task("none" if chosen is None else chosen.name)
            with self._lock:
                self.cancel()
                for side, session in self._sessions.items():
                    self._past[side] += session.outcomes
                self._sessions = {}
                self._attend()
            if chosen is not None and not with_object:
                self._put(with_object)
        return chosen

    def go(self, *, when_clear: bool = False, limit_s: float | None = None, **about: Any) -> None:
        """Starts a trial on every hand.

        Args:
            when_clear: start each clock when the hand is clear of its object; see TaskSession.
            limit_s: time limit [s]; None for the task's own.

        Raises:
            StudyError: a trial is running, or there is no task.
        """
        with self._lock:
            sessions = self._all()
            if any(session.active for session in sessions):
                raise StudyError("a trial is running; finish or cancel it first")
            for side, session in self._sessions.items():
                entries = {**self._about(), **about}
                session.go(when_clear=when_clear, limit_s=limit_s, **entries)
                self._say(
                    side, "waits until the hand is clear of the object" if when_clear else "begins"
                )

    def reset(self) -> None:
        """Uses the one reset that each running trial has; if no trial is running, only puts the
        objects back. StudyError if the reset of a trial was already used, or there is no task."""
        with self._lock:
            running = self._running()
            for side, session in running.items():
                session.reset()
                self._say(side, "the object is put back")
            if not running:
                self.put_back()

    def put_back(self) -> None:
        """Puts the objects back to their start, whether or not a trial is running; SinkError if the
        simulation is closed."""
        self._put(True)

    def _put(self, there: bool) -> None:
        for side in self._sessions:
            if there:
                self._simulation.reset_object(side)
            else:
                self._simulation.put_away(side)

    def finish(self) -> None:
        """Ends the running trials of an operator who gives up; StudyError if no trial is
        running."""
        with self._lock:
            running = self._running()
            if not running:
                raise StudyError("no trial is running; start one first")
            for session in running.values():
                session.finish()

    def pause(self, paused: bool = True) -> None:
        """Stops or resumes the scenes of running trials and their clocks; StudyError if there is no
        trial to pause, or no task."""
        with self._lock:
            sessions = self._all()
            if paused and not any(session.active for session in sessions):
                raise StudyError("no trial is running; start one before you pause it")
            for side, session in self._sessions.items():
                if paused != session.paused and (session.active or not paused):
                    session.pause(paused)
                    self._say(side, "is paused" if paused else "goes on")

    def cancel(self, mark: str | None = None, **about: Any) -> None:
        """Discards the running trials.

        Args:
            mark: ``undone`` or ``void``, to mark trials that have just ended and do not count.
            about: entries that the records of these must have.
        """
        with self._lock:
            for side, session in self._sessions.items():
                if session.active:
                    session.cancel()
                    self._say(side, "is forgotten")
                elif mark is not None and session.mark(mark, about):
                    self._say(side, f"is {mark}")

    def report(self, side: Side | None = None) -> dict[str, Any]:
        """State of the trial on one hand, by default the first; see ``TaskSession.report``.
        StudyError if there is no such hand, or no task."""
        with self._lock:
            sessions = self._all()
            if side is None:
                return sessions[0].report()
            if side not in self._sessions:
                raise StudyError(f"there is no {side} hand in this run")
            return self._sessions[side].report()

    def end(self) -> None:
        """Stops following the simulation, which may be closed."""
        with self._lock:
            for session in self._sessions.values():
                session.close()

    def _all(self) -> list[TaskSession]:
        if not self._sessions:
            raise StudyError("there is no task; load one first: card, cube or screwdriver")
        return list(self._sessions.values())

    def _attend(self) -> None:
        """Open a session for each hand of the current scene."""
        if self._simulation.task_now != "none":
            for side in self._sides:
                self._sessions[side] = TaskSession(
                    self._simulation,
                    side,
                    self._folder,
                    lambda outcome, side=side: self._ended(side, outcome),  # type: ignore[misc]
                    lambda side=side: self._say(side, "begins"),  # type: ignore[misc]
                )

    def _running(self) -> dict[Side, TaskSession]:
        self._all()
        return {s: one for s, one in self._sessions.items() if one.run.phase is Phase.RUNNING}

    def _ended(self, side: Side, outcome: Outcome) -> None:
        self._say(side, "ends")
        self._on_outcome(side, outcome)

    def _say(self, side: Side, what: str) -> None:
        session = self._sessions[side]
        self._note(side, f"trial {session.number} of {session.task.name}: {what}")

"""Trials of a task on all hands of a running simulation, with changes of the task."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from smooth_operator.errors import StudyError
from smooth_operator.simulation.live import LiveSimulation
from smooth_operator.simulation.tasks.task import SimulatedTask, task_named
from smooth_operator.simulation.tasks.task_session import TaskSession
from smooth_operator.simulation.tasks.trial import Outcome, Phase
from smooth_operator.types import Side


class TrialRunner:
    """Trials on each hand of a simulation, and the scenes around them. Safe from any thread.

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
        """The current task; None without one."""
        name = self._simulation.task_now
        return None if name == "none" else task_named(name)

    @property
    def outcomes(self) -> dict[Side, list[Outcome]]:
        """Results of all trials so far, in order."""
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
        """True if a scene has its object; False in free movement."""
        states = [self._simulation.scene_state(side) for side in self._sides]
        return any(state is not None and not state.away for state in states)

    def change(self, task: str | None, with_object: bool = True) -> SimulatedTask | None:
        """Load the scene of a task, or none, and discard a trial that runs.

        If the scene is the current one, it is kept and its object put back to its start.

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
        """Start a trial on every hand.

        Args:
            when_clear: start each clock when the hand is clear of its object; see TaskSession.
            limit_s: time limit [s]; None for the task's own.

        Raises:
            StudyError: a trial runs, or there is no task.
        """
        with self._lock:
            sessions = self._all()
            if any(session.active for session in sessions):
                raise StudyError("a trial is running; finish or cancel it first")
            for side, session in self._sessions.items():
                entries = {**self._about(), **about}
                session.go(when_clear=when_clear, limit_s=limit_s, **entries)
                self._say(side, "waits for the hand to be clear" if when_clear else "begins")

    def reset(self) -> None:
        """Use the one reset of the trials that run; if none runs, only put the objects back.

        Raises:
            StudyError: a trial has had its reset, or there is no task.
        """
        with self._lock:
            running = self._running()
            for side, session in running.items():
                session.reset()
                self._say(side, "the object is put back")
            if not running:
                self.put_back()

    def put_back(self) -> None:
        """Put the objects back to their start, whether or not a trial runs.

        Raises:
            SinkError: the simulation is closed.
        """
        self._put(True)

    def _put(self, there: bool) -> None:
        for side in self._sessions:
            if there:
                self._simulation.reset_object(side)
            else:
                self._simulation.put_away(side)

    def finish(self) -> None:
        """End the running trials for an operator who can do no more.

        Raises:
            StudyError: no trial runs.
        """
        with self._lock:
            running = self._running()
            if not running:
                raise StudyError("no trial is running; begin one first")
            for session in running.values():
                session.finish()

    def pause(self, paused: bool = True) -> None:
        """Stop the scenes of running trials and their clocks, or let them go on.

        Raises:
            StudyError: there is no trial to pause, or no task.
        """
        with self._lock:
            sessions = self._all()
            if paused and not any(session.active for session in sessions):
                raise StudyError("no trial is running that could be paused; begin one first")
            for side, session in self._sessions.items():
                if paused != session.paused and (session.active or not paused):
                    session.pause(paused)
                    self._say(side, "is paused" if paused else "goes on")

    def cancel(self, mark: str | None = None, **about: Any) -> None:
        """Discard the trials that run.

        Args:
            mark: ``undone`` or ``void``: mark of trials that have just ended and do not count.
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
        """State of the trial of a hand, by default the first one's; see ``TaskSession.report``.

        Raises:
            StudyError: there is no such hand, or no task.
        """
        with self._lock:
            sessions = self._all()
            if side is None:
                return sessions[0].report()
            if side not in self._sessions:
                raise StudyError(f"there is no {side} hand in this run")
            return self._sessions[side].report()

    def end(self) -> None:
        """Stop following the simulation, which may be closed."""
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

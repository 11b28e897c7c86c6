"""``smooth-operator teleop --task``: trials of a study's task, told by keys."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from smooth_operator.cli.console import Progressing
from smooth_operator.cli.teleop_options import Teleop
from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.sinks.sink import Sink
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.study.tasks import Outcome, TaskSession


class TaskTrials:
    """Trials on each hand that is driven; nothing at all without ``--task``.

    Args:
        options: of the command.
        sinks: among them the simulation.
        sides: that are driven.
        progress: where outcomes are said.
    """

    def __init__(
        self, options: Teleop, sinks: Sequence[Sink], sides: Sequence[Side], progress: Progressing
    ) -> None:
        self._options, self._sinks, self._sides = options, sinks, sides
        self._progress = progress
        self._sessions: dict[Side, TaskSession] = {}

    @property
    def keys(self) -> dict[str, Callable[[], None]]:
        """Key -> what it does."""
        if self._options.task is None:
            return {}
        return {"g": self._go, "r": lambda: self._each("reset"), "d": lambda: self._each("finish")}

    @property
    def words(self) -> str:
        """What the keys do."""
        return "   g: go   r: reset the object   d: done" if self.keys else ""

    def begin(self) -> None:
        """The simulation is open: say the task; without a terminal the first trial starts."""
        if self._options.task is None:
            return
        from smooth_operator.sinks.simulation import Simulation
        from smooth_operator.study.tasks import TaskSession

        for sink in self._sinks:
            if isinstance(sink, Simulation) and sink.task == self._options.task:
                for side in self._sides:
                    self._sessions[side] = TaskSession(
                        sink, side, self._options.trials, self._told(side)
                    )
        for session in list(self._sessions.values())[:1]:
            task = session.task.task
            self._progress.note(f"{task.title}: {task.instruction}", matters=True)
        if not (sys.stdin and sys.stdin.isatty()):
            self._go()

    def end(self) -> None:
        """No trial any more."""
        for session in self._sessions.values():
            session.close()
            if session.failed:
                self._progress.note(session.failed, matters=True)

    def summary(self) -> dict[str, Any]:
        """Outcomes of each hand, for ``--json``."""
        if self._options.task is None:
            return {}
        return {
            "task": self._options.task,
            "trials": {
                side: [asdict(outcome) for outcome in session.outcomes]
                for side, session in self._sessions.items()
            },
        }

    def _go(self) -> None:
        options = self._options
        for session in self._sessions.values():
            self._tried(lambda one=session: one.go(  # type: ignore[misc]
                method=options.method, preset=options.preset, source=options.source))  # fmt: skip

    def _each(self, word: str) -> None:
        for session in self._sessions.values():
            self._tried(getattr(session, word))

    def _tried(self, action: Callable[[], None]) -> None:
        try:
            action()
        except SmoothOperatorError as error:
            self._progress.note(str(error), matters=True)

    def _told(self, side: Side) -> Callable[[Outcome], None]:
        def tell(outcome: Outcome) -> None:
            reset = ", after a reset" if outcome.resets else ""
            self._progress.note(
                f"{side}: {outcome.score:g} after {outcome.seconds:.1f} s "
                f"({outcome.ended}: {outcome.reason}{reset})",
                matters=True,
            )

        return tell


def with_task(sinks: Sequence[str], task: str | None) -> tuple[str, ...]:
    """The sinks of a run, the simulation with its task among them.

    Raises:
        ConfigError: a simulation of something else is asked for, too.
    """
    if task is None:
        return tuple(sinks)
    if any(text.partition(":")[0] == "mujoco" for text in sinks):
        raise ConfigError(
            f"--task {task} brings a simulation of its own; leave out --sink mujoco, or --task and "
            f"write --sink mujoco:task={task}"
        )
    return (*sinks, f"mujoco:task={task}")

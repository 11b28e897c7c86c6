"""``smooth-operator teleop --task``: trials of a study's task, told by keys."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from smooth_operator.cli.console import Progressing
from smooth_operator.cli.teleop_options import Teleop
from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.teleop.sinks.sink import Sink, simulated_hands
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.simulation.tasks import Outcome
    from smooth_operator.simulation.tasks.desk import TaskDesk
    from smooth_operator.teleop.control.workshop import Choice


class TaskTrials:
    """Trials on each hand that is driven, where there is a simulation.

    Args:
        options: of the command.
        sinks: among them the simulation, or not.
        sides: that are driven.
        progress: where outcomes are said.
        used: what the hands are driven by now, for the records; as the options say if left out.
        note: takes what happens to trials, for the record of the run.

    Attributes:
        desk: where trials are begun, once everything is open; None without a simulation.
    """

    def __init__(
        self,
        options: Teleop,
        sinks: Sequence[Sink],
        sides: Sequence[Side],
        progress: Progressing,
        used: Callable[[], Choice] | None = None,
        note: Callable[[Side, str], None] = lambda side, text: None,
    ) -> None:
        self._options, self._sinks, self._sides = options, sinks, sides
        self._progress, self._used, self._note = progress, used, note
        self.desk: TaskDesk | None = None

    @property
    def keys(self) -> dict[str, Callable[[], None]]:
        """Key -> what it does."""
        if self._options.task is None:
            return {}
        return {
            "g": lambda: self._tried("go"),
            "r": lambda: self._tried("reset"),
            "d": lambda: self._tried("finish"),
        }

    @property
    def words(self) -> str:
        """What the keys do."""
        return "   g: go   r: reset the object   d: done" if self.keys else ""

    def begin(self) -> None:
        """The simulation is open: say the task; the first trial starts where nobody can say so."""
        simulation = simulated_hands(self._sinks)
        if simulation is None or (self._options.task is None and self._options.control is None):
            return
        from smooth_operator.simulation.tasks.desk import TaskDesk

        self.desk = TaskDesk(
            simulation, self._sides, self._options.trials, self._about, self._tell, self._note
        )
        if self._options.task is None or self.desk.task is None:
            return
        task = self.desk.task.task
        self._progress.note(f"{task.title}: {task.instruction}", matters=True)
        if self._options.control is None and not (sys.stdin and sys.stdin.isatty()):
            self._tried("go")

    def end(self) -> None:
        """No trial any more."""
        if self.desk is not None:
            self.desk.end()
            for failed in self.desk.failures:
                self._progress.note(failed, matters=True)

    def summary(self) -> dict[str, Any]:
        """Outcomes of each hand, for ``--json``; nothing without a task and its trials."""
        if self.desk is None:
            return {}
        outcomes = self.desk.outcomes
        if self._options.task is None and not any(outcomes.values()):
            return {}
        return {
            "task": self._options.task,
            "trials": {side: [asdict(o) for o in found] for side, found in outcomes.items()},
        }

    def _about(self) -> dict[str, Any]:
        options, used = self._options, None if self._used is None else self._used()
        return {
            "method": options.method if used is None else used.method,
            "preset": options.preset if used is None else used.preset,
            "source": options.source,
        }

    def _tried(self, word: str) -> None:
        if self.desk is None:
            return
        try:
            getattr(self.desk, word)()
        except SmoothOperatorError as error:
            self._progress.note(str(error), matters=True)

    def _tell(self, side: Side, outcome: Outcome) -> None:
        reset = ", after a reset" if outcome.resets else ""
        self._progress.note(
            f"{side}: {outcome.score:g} after {outcome.seconds:.1f} s "
            f"({outcome.ended}: {outcome.reason}{reset})",
            matters=True,
        )


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

"""Runs trials of a task while a loop runs; inputs of the operator start them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.reporter import Reporter
from smooth_operator.teleop.sinks.sink import Sink, simulated_hands
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.simulation.tasks import Outcome
    from smooth_operator.simulation.tasks.task_session import TrialRunner


class TaskTrials:
    """Runs trials on each driven hand of a simulation.

    Args:
        sinks: sinks of the run, perhaps with a simulation.
        sides: sides of the driven hands.
        reporter: shows the outcomes.
        task: name of the task; None for the hand alone.
        folder: folder for a record of every trial; None for no records.
        controlled: True if another program may begin trials.
        attended: True if a person may begin trials. If neither is True, the first
            trial begins with the run.
        about: returns the current method and settings, for the records.
        record: called with the events of trials, for the record of the run.

    Attributes:
        runner: runner of the trials, once everything is open; None without a simulation.
    """

    def __init__(
        self,
        sinks: Sequence[Sink],
        sides: Sequence[Side],
        reporter: Reporter,
        *,
        task: str | None = None,
        folder: Path | None = None,
        controlled: bool = False,
        attended: bool = False,
        about: Callable[[], Mapping[str, Any]] = dict,
        record: Callable[[Side, str], None] = lambda side, text: None,
    ) -> None:
        self._sinks, self._sides, self._reporter = sinks, sides, reporter
        self._task, self._folder = task, folder
        self._controlled, self._attended = controlled, attended
        self._about, self._record = about, record
        self.runner: TrialRunner | None = None

    @property
    def actions(self) -> dict[str, Callable[[], None]]:
        """Operator actions for trials, by their names in ``ACTIONS``."""
        if self._task is None:
            return {}
        return {
            "go": lambda: self._act("go"),
            "reset": lambda: self._act("reset"),
            "done": lambda: self._act("finish"),
        }

    def begin(self) -> None:
        """Shows the task in the open simulation; starts a trial if no key or message can."""
        simulation = simulated_hands(self._sinks)
        if simulation is None or (self._task is None and not self._controlled):
            return
        from smooth_operator.simulation.tasks.task_session import TrialRunner

        self.runner = TrialRunner(
            simulation, self._sides, self._folder, self._about, self._tell, self._record
        )
        if self._task is None or self.runner.task is None:
            return
        task = self.runner.task.task
        self._reporter.note(f"{task.title}: {task.instruction}", matters=True)
        if not self._controlled and not self._attended:
            self._act("go")

    def end(self) -> None:
        """Ends the trials."""
        if self.runner is not None:
            self.runner.end()
            for failed in self.runner.failures:
                self._reporter.note(failed, matters=True)

    def shown(self) -> dict[str, Any] | None:
        """The trial as the operator sees it, without its score; None without a task.

        Returns:
            ``title`` and ``instruction`` of the task; ``number`` of the trial as counted by the
            program that began it, and the total ``count`` if known; ``phase``, ``elapsed_s``,
            ``limit_s`` and ``paused`` as in ``TaskSession``; ``object``, True if there is one.
        """
        runner = self.runner
        if runner is None or (task := runner.task) is None:
            return None
        try:
            report = runner.report()
        except SmoothOperatorError:  # the scene is just being changed
            return None
        about = report["about"]
        return {
            "title": task.task.title,
            "instruction": task.task.instruction,
            "number": about.get("trial", report["number"]),
            "count": about.get("trials"),
            **{name: report[name] for name in ("phase", "elapsed_s", "limit_s", "paused")},
            "object": runner.object_there,
        }

    def summary(self) -> dict[str, Any]:
        """Results of each hand's trials, for ``--json``; empty without trials."""
        if self.runner is None:
            return {}
        outcomes = self.runner.outcomes
        if self._task is None and not any(outcomes.values()):
            return {}
        return {
            "task": self._task,
            "trials": {side: [asdict(o) for o in results] for side, results in outcomes.items()},
        }

    def _act(self, method: str) -> None:
        if self.runner is None:
            return
        try:
            getattr(self.runner, method)()
        except SmoothOperatorError as error:
            self._reporter.note(str(error), matters=True)

    def _tell(self, side: Side, outcome: Outcome) -> None:
        reset = ", after a reset" if outcome.resets else ""
        self._reporter.note(
            f"{side}: {outcome.score:g} after {outcome.seconds:.1f} s "
            f"({outcome.ended}: {outcome.reason}{reset})",
            matters=True,
        )


def with_task(sinks: Sequence[str], task: str | None) -> tuple[str, ...]:
    """Returns the sinks of a run, and the simulation of its task among them; ConfigError if there
    already is a simulation among the sinks."""
    if task is None:
        return tuple(sinks)
    if any(sink.partition(":")[0] == "mujoco" for sink in sinks):
        raise ConfigError(
            f"--task {task} includes its own simulation; remove --sink mujoco, or replace "
            f"--task by --sink mujoco:task={task}"
        )
    return (*sinks, f"mujoco:task={task}")

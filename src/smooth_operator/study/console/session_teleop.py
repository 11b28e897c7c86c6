"""The running teleoperation of a study: its method, and the trials of its simulation.

A block starts when the running teleoperation has gone over to its condition, and not before. Where
that drives a simulation with a task, its trials begin, reset and end with those of the protocol,
and what it makes of them is proposed to the experimenter, who has the last word.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.study.console.commands import Command
from smooth_operator.study.console.switching import Standing, Switch, standing
from smooth_operator.study.design.plan import Block
from smooth_operator.study.store.events import Calibrated, Undone
from smooth_operator.study.store.progress import Progress

HIDDEN: Final = "the teleoperation could not be switched; the terminal of the console says why"
"""What a blind experimenter reads, since the reason may name the method."""


class SessionTeleop:
    """What is done at each step of the protocol.

    Args:
        switch: of the running teleoperation.
        blind: whether methods are not to be named.
        report: where reasons go that a blind experimenter may not see.
    """

    def __init__(self, switch: Switch, *, blind: bool, report: Callable[[str], None]) -> None:
        self.switch = switch
        self._blind = blind
        self._report = report
        self._reported = ""
        self._loaded: tuple[str, tuple[tuple[str, str], ...]] | None = None
        self._begun = False  # a trial of the simulation, for the next one of the log
        self._follows: datetime | None = None  # start of the logged trial that it belongs to

    def before(self, command: Command, progress: Progress) -> None:
        """What must be so before a calibration counts, or a block or a trial starts.

        Raises:
            StudyError: it can't be made so; nothing may start.
        """
        block = progress.step.block
        if command.do == "calibrated":
            try:
                self._calibrate(_file(str(command.fields.get("detail", ""))))
            except StudyError as error:
                raise StudyError(
                    f"the calibration was not loaded into the hand: {error}"
                ) from error
        if block is None or command.do not in ("start_block", "start_trial"):
            return
        what = "block" if command.do == "start_block" else "trial"
        try:
            if command.do == "start_block":
                self.switch.to(block.condition)
            else:
                self.switch.keep(block.condition)
            self._pace(progress)
            self._calibrate(calibration(progress, block))
        except StudyError as error:
            self._complain(error)
            why = HIDDEN if self._blind else f"the teleoperation could not be switched: {error}"
            raise StudyError(f"the {what} does not start: {why}") from error
        try:
            self._ready_scene(command, progress, block)
        except StudyError as error:
            raise StudyError(f"the {what} does not start: the simulation: {error}") from error

    def _calibrate(self, file: str | None) -> None:
        """Has the hand use a calibration; not again where it still does."""
        if file is None or self._loaded == (file, self.switch.heard.calibrations):
            return
        self.switch.ask("calibration", path=file)
        self.switch.look()
        self._loaded = (file, self.switch.heard.calibrations)

    def _pace(self, progress: Progress) -> None:
        """Has the hand be sent as many commands a second as the plan says; not where it is."""
        rate = progress.plan.protocol.rate_hz
        if rate is None or self.switch.heard.rate_hz == rate:
            return
        self.switch.ask("rate", rate=rate)
        self.switch.look()

    def _ready_scene(self, command: Command, progress: Progress, block: Block) -> None:
        if command.do == "start_block":
            self.switch.look()
            if self.switch.heard.task is not None and _scene(block) is not None:
                self.switch.ask("task", task=_scene(block))
                self.switch.look()
        elif self._in_scene(block):
            trial = self.switch.heard.trial
            if trial is not None and trial.phase == "running":  # of one that was undone
                self.switch.ask("trial", cancel=True)
            about = {
                "study": progress.plan.protocol.name,
                "operator": progress.operator,
                "condition": block.condition.name,
                "block": block.number,
                "trial": progress.step.trial,
            }
            self.switch.ask("trial", begin=True, about=about)
            self._begun = True
            self.switch.look()

    def along(self, do: str, progress: Progress) -> None:
        """What the simulation does with a trial that was reset, void or scored. Never raises."""
        block = progress.step.block
        if block is None or not self._in_scene(block) or self.switch.heard.state == "gone":
            return
        with contextlib.suppress(StudyError):
            if do == "reset":
                self.switch.ask("reset")
            elif do == "void":
                self.switch.ask("trial", cancel=True)
            elif do == "score":
                trial = standing(self.switch.ask("trial"))
                if trial is not None and trial.phase == "running":
                    self.switch.ask("trial", finish=True)

    def measured(self, progress: Progress) -> float | None:
        """How long the trial that runs took in the simulation [s]; None where that is not over."""
        trial = self._standing(progress, fresh=True)
        return None if trial is None or trial.phase != "done" else trial.time_s

    def watch(self, progress: Progress | None) -> bool:
        """Looks at the teleoperation, and puts it back on the condition of the block that is on.

        Returns:
            Whether it had to be put back.
        """
        block = None if progress is None else progress.begun
        if progress is None or block is None:
            self.switch.look()
            return False
        switched = False
        try:
            if not self.switch.runs(block.condition) and self.switch.heard.state != "refused":
                self.switch.to(block.condition)  # refused is tried again on request
                switched = True
            self._pace(progress)
            if switched or self._loaded is not None:
                self._calibrate(calibration(progress, block))
        except StudyError as error:
            self._complain(error)
        return switched

    def again(self, progress: Progress) -> None:
        """Switches once more, on request.

        Raises:
            StudyError: it can't be.
        """
        block = progress.begun
        if block is None:
            self.switch.look()
            return
        try:
            self.switch.to(block.condition)
        except StudyError as error:
            self._complain(error)
            raise StudyError(HIDDEN if self._blind else str(error)) from error

    def view(self, progress: Progress | None) -> dict[str, Any]:
        """What the experimenter's page shows of it."""
        heard = self.switch.heard
        running = None if heard.running is None else " ".join(filter(None, heard.running))
        hidden = self._blind and heard.state == "refused"
        trial = None if progress is None else self._standing(progress)
        return {
            "state": heard.state,
            "detail": HIDDEN if hidden else heard.detail,
            "running": None if self._blind else running,
            "scene": heard.task,
            "limit_s": self._limit_s(progress),
            "trial": None if trial is None else asdict(trial),
        }

    def _standing(self, progress: Progress, *, fresh: bool = False) -> Standing | None:
        """Of the trial that runs, if the simulation knows of it all that the log does."""
        running = progress.running
        if running is None or not self._in_scene(running.block):
            return None
        trial = self.switch.heard.trial
        if fresh and self.switch.heard.state != "gone":
            report: Mapping[str, Any] | None = None
            with contextlib.suppress(StudyError):
                report = self.switch.ask("trial")
            trial = standing(report)
        if trial is None or trial.phase == "ready" or trial.resets != running.resets:
            return None
        if self._begun or trial.phase == "running":
            self._begun, self._follows = False, running.started
        return trial if self._follows == running.started else None  # or it is that of an earlier

    def _limit_s(self, progress: Progress | None) -> float | None:
        """Time limit of the simulated task that is on; the study's own may say another."""
        from smooth_operator.simulation.tasks.task_registry import task_named

        block = None if progress is None else progress.step.block
        if block is None or not self._in_scene(block):
            return None
        return task_named(block.task.name).task.time_limit_s

    def _in_scene(self, block: Block) -> bool:
        return self.switch.heard.task is not None and self.switch.heard.task == _scene(block)

    def _complain(self, error: Exception) -> None:
        if str(error) != self._reported:
            self._reported = str(error)
            self._report(f"the teleoperation: {error}")


def calibration(progress: Progress, block: Block) -> str | None:
    """The file that an operator was calibrated with for a block's task; None if there is none."""
    undone = {r.event.number for r in progress.records if isinstance(r.event, Undone)}
    for record in reversed(progress.records):
        event, counts = record.event, record.number not in undone
        if counts and isinstance(event, Calibrated) and event.task == block.task.name:
            return _file(event.detail)
    return None


def _file(detail: str) -> str | None:
    """A file of this machine with its folder, since the teleoperation may run in another one."""
    if not detail.lower().endswith(".json"):
        return None
    path = Path(detail).expanduser()
    return str(path.absolute()) if path.is_file() else detail


def _scene(block: Block) -> str | None:
    """Name of the simulated task, where the block's is one."""
    from smooth_operator.simulation.tasks.task_registry import task_named

    try:
        return task_named(block.task.name).name
    except UnknownNameError:
        return None

"""Running teleoperation of a study: its method, and the trials of its simulation.

A block starts only when the running teleoperation has switched to its condition. In a simulation
with a task, trials begin, reset and end with those of the protocol; the simulation proposes line
and time, and the experimenter decides.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import StudyError
from smooth_operator.study.console.commands import Command
from smooth_operator.study.console.switching import SceneTrials, Switch
from smooth_operator.study.store.progress import Progress

HIDDEN: Final = "the teleoperation could not be switched; the terminal of the console says why"
"""Message for a blind experimenter, since the reason may name the method."""


class SessionTeleop:
    """Prepares the teleoperation for each step of the protocol, and follows the trials with it.

    Args:
        switch: switch of the running teleoperation.
        blind: whether methods are not to be named.
        report: called with reasons that a blind experimenter may not see.
    """

    def __init__(self, switch: Switch, *, blind: bool, report: Callable[[str], None]) -> None:
        self.switch = switch
        self._blind = blind
        self._report = report
        self._reported = ""
        self._loaded: tuple[str, tuple[tuple[str, str], ...]] | None = None
        self.scenes = SceneTrials(switch)

    def before(self, command: Command, progress: Progress) -> None:
        """Prepares the hand before a calibration counts, or a block or a trial starts.

        Raises:
            StudyError: the hand can't be prepared; nothing may start.
        """
        block = progress.step.block
        if command.do in ("calibrated", "recalibrate"):
            try:
                self._calibrate(_file(str(command.fields.get("detail", ""))))
            except StudyError as error:
                raise StudyError(
                    f"the calibration was not loaded into the hand: {error}"
                ) from error
        if block is not None and command.do == "start_familiarisation":
            with contextlib.suppress(StudyError):  # watching tries again
                self.scenes.load(block, with_object=False)
        if block is None or command.do not in ("start_block", "start_trial"):
            return
        what = "block" if command.do == "start_block" else "trial"
        try:
            if command.do == "start_block":
                self.switch.to(block.condition)
            else:
                self.switch.remember(block.condition, progress.begun_with)
                if not self.switch.runs(block.condition):
                    self.switch.to(block.condition)
            self._set_rate(progress)
            self._calibrate(_file(progress.calibrations.get(block.task.name, "")))
        except StudyError as error:
            self._report_once(error)
            why = HIDDEN if self._blind else f"the teleoperation could not be switched: {error}"
            raise StudyError(f"the {what} does not start: {why}") from error
        try:
            if command.do == "start_block":
                self.switch.look()
                self.scenes.load(block, with_object=False)
            else:
                self.scenes.load(block)
                self.scenes.begin(progress, block)
        except StudyError as error:
            raise StudyError(f"the {what} does not start: the simulation: {error}") from error

    def _calibrate(self, file: str | None) -> None:
        """Loads a calibration into the hand, unless the hand still uses it."""
        if file is None or self._loaded == (file, self.switch.status.calibrations):
            return
        self.switch.request("calibration", path=file)
        self.switch.look()
        self._loaded = (file, self.switch.status.calibrations)

    def _set_rate(self, progress: Progress) -> None:
        """Sets the plan's rate of commands, unless the hand has it."""
        rate = progress.plan.protocol.rate_hz
        if rate is None or self.switch.status.rate_hz == rate:
            return
        self.switch.request("rate", rate=rate)
        self.switch.look()

    def facts(self, command: Command, progress: Progress) -> dict[str, str | float]:
        """Returns fields of an event that only the teleoperation knows.

        They are the method that runs at the start of a block, and the simulation's proposal of a
        score.
        """
        if command.do == "start_block" and self.switch.status.running is not None:
            method, preset = self.switch.status.running
            return {"method": method, "preset": preset or ""}
        if command.do == "score":
            trial = self.scenes.current(progress)
            if trial is not None and trial.phase == "done":
                return {"proposed_line": trial.line, "proposed_score": trial.score}
        return {}

    def along(self, do: str, progress: Progress) -> None:
        """Lets the simulation follow a trial that was reset, paused, void, scored or undone.

        Never raises.
        """
        self.scenes.along(do, progress)

    def measured(self, progress: Progress) -> float | None:
        """Time of the running trial by the simulation [s]; None where the trial is not over."""
        trial = self.scenes.current(progress, fresh=True)
        return trial.time_s if trial is not None and trial.phase == "done" else None

    def watch(self, progress: Progress | None) -> str:
        """Looks at the teleoperation; restores condition and scene of the current block.

        Returns:
            Text to note in the log; empty for none.
        """
        block = None if progress is None else progress.begun
        if progress is None or block is None:
            self.switch.look()
            return ""
        switched = False
        try:
            self.switch.remember(block.condition, progress.begun_with)
            if not self.switch.runs(block.condition) and self.switch.status.state != "refused":
                self.switch.to(block.condition)  # a refused switch is repeated on request only
                switched = True
            self._set_rate(progress)
            if switched or self._loaded is not None:
                self._calibrate(_file(progress.calibrations.get(block.task.name, "")))
            if progress.running is None:
                # Before the first trial of a block the operator moves without the object.
                tried = any(trial.block == block for trial in progress.trials)
                self.scenes.load(block, with_object=None if tried else False)
        except StudyError as error:
            self._report_once(error)
        if switched and progress.running is not None:
            return "the teleoperation ran something else during a trial; switched back"
        return ""

    def again(self, progress: Progress) -> None:
        """Switches once more, on request.

        Raises:
            StudyError: the hand can't be switched.
        """
        block = progress.begun
        if block is None:
            self.switch.look()
            return
        try:
            self.switch.to(block.condition)
        except StudyError as error:
            self._report_once(error)
            raise StudyError(HIDDEN if self._blind else str(error)) from error

    def view(self, progress: Progress | None) -> dict[str, Any]:
        """Returns the state of the hand for the experimenter's page."""
        status = self.switch.status
        running = None if status.running is None else " ".join(filter(None, status.running))
        hidden = self._blind and status.state == "refused"
        trial = None if progress is None else self.scenes.current(progress)
        block = None if progress is None else progress.step.block
        return {
            "state": status.state,
            "detail": HIDDEN if hidden else status.detail,
            "running": None if self._blind else running,
            "scene": status.task,
            "limit_s": None if block is None else self.scenes.limit_s(block),
            "trial": None if trial is None else {**asdict(trial), "about": None},
        }

    def _report_once(self, error: Exception) -> None:
        if str(error) != self._reported:
            self._reported = str(error)
            self._report(f"the teleoperation: {error}")


def _file(detail: str) -> str | None:
    """A calibration file with its folder, since the teleoperation may run in another one."""
    if not detail.lower().endswith(".json"):
        return None
    path = Path(detail).expanduser()
    return str(path.absolute()) if path.is_file() else detail

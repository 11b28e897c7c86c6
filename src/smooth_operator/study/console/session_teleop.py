"""Running teleoperation of a study: its method, and the trials of its simulation.

A block starts when the running teleoperation has gone over to its condition, and not before. Where
that drives a simulation with a task, its trials begin, reset and end with those of the protocol,
and what it makes of them is proposed to the experimenter, who has the last word.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import (
    StudyError,
)
from smooth_operator.study.console.commands import Command
from smooth_operator.study.console.switching import SceneTrials, Switch
from smooth_operator.study.design.plan import Block
from smooth_operator.study.store.events import Calibrated, Recalibrated, TrialStarted, Undone
from smooth_operator.study.store.progress import Progress

HIDDEN: Final = "the teleoperation could not be switched; the terminal of the console says why"
"""Message for a blind experimenter, since the reason may name the method."""


class SessionTeleop:
    """The part of a running teleoperation in each step of the protocol.

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
        self.scenes = SceneTrials(switch)

    def before(self, command: Command, progress: Progress) -> str:
        """Prepares the hand before a calibration counts, or a block or a trial starts.

        Returns:
            What to note in the log; empty for nothing.

        Raises:
            StudyError: it can't be made so; nothing may start.
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
                return self.scenes.load(block, with_object=False)
        if block is None or command.do not in ("start_block", "start_trial"):
            return ""
        what = "block" if command.do == "start_block" else "trial"
        try:
            if command.do == "start_block":
                self.switch.to(block.condition)
            else:
                self.switch.remember(block.condition, progress.begun_with)
                self.switch.keep(block.condition)
            self._pace(progress)
            self._calibrate(calibration(progress, block))
        except StudyError as error:
            self._complain(error)
            why = HIDDEN if self._blind else f"the teleoperation could not be switched: {error}"
            raise StudyError(f"the {what} does not start: {why}") from error
        try:
            if command.do == "start_block":
                self.switch.look()
                self.scenes.load(block, with_object=False)
                return ""
            note = self.scenes.load(block)
            self.scenes.begin(progress, block)
            return note
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

    def facts(self, command: Command, progress: Progress) -> dict[str, str | float]:
        """Facts on the hand that the log keeps along with an event.

        Of a block, what the teleoperation said it runs; of a score, what the simulation proposed.
        """
        if command.do == "start_block" and self.switch.heard.running is not None:
            method, preset = self.switch.heard.running
            return {"method": method, "preset": preset or ""}
        if command.do == "score":
            trial = self.scenes.standing(progress)
            if trial is not None and trial.phase == "done":
                return {"proposed_line": trial.line, "proposed_score": trial.score}
        return {}

    def along(self, do: str, progress: Progress) -> None:
        """Has the simulation follow a trial that was reset, paused, void, scored or undone.

        Never raises. An event before the trial's start can't be undone while it runs.
        """
        if do == "undo" and not _starts_trial(progress):
            return
        self.scenes.along(do, progress)

    def measured(self, progress: Progress) -> float | None:
        """Time of the trial that runs by the simulation [s]; None where that is not over."""
        trial = self.scenes.standing(progress, fresh=True)
        if trial is None or trial.phase != "done" or trial.time_s is None:
            return None
        running = progress.running
        if running is None or trial.pauses >= len(running.pauses):
            return trial.time_s  # its own clock stood, too
        return max(0.0, trial.time_s - running.paused_within(trial.time_s))

    def watch(self, progress: Progress | None) -> list[str]:
        """Looks at the teleoperation; puts it back on condition and scene of the block that is on.

        Returns:
            What to note in the log.
        """
        block = None if progress is None else progress.begun
        if progress is None or block is None:
            self.switch.look()
            return []
        switched, notes = False, []
        try:
            self.switch.remember(block.condition, progress.begun_with)
            if not self.switch.runs(block.condition) and self.switch.heard.state != "refused":
                self.switch.to(block.condition)  # refused is tried again on request
                switched = True
            self._pace(progress)
            if switched or self._loaded is not None:
                self._calibrate(calibration(progress, block))
            if switched and progress.running is not None:
                notes.append("the teleoperation ran something else during a trial; switched back")
            notes.append(self._watch_scene(progress, block))
        except StudyError as error:
            self._complain(error)
        return [note for note in notes if note]

    def _watch_scene(self, progress: Progress, block: Block) -> str:
        if progress.running is None:
            self.scenes.abandon_stray(progress.operator)
            return self.scenes.load(block, with_object=False if _free(progress, block) else None)
        self.scenes.match_pause(progress)
        self.scenes.standing(progress)
        return self.scenes.lost(progress)

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
        """The hand as the experimenter's page shows it."""
        heard = self.switch.heard
        running = None if heard.running is None else " ".join(filter(None, heard.running))
        hidden = self._blind and heard.state == "refused"
        trial = None if progress is None else self.scenes.standing(progress)
        block = None if progress is None else progress.step.block
        return {
            "state": heard.state,
            "detail": HIDDEN if hidden else heard.detail,
            "running": None if self._blind else running,
            "scene": heard.task,
            "limit_s": None if block is None else self.scenes.limit_s(block),
            "waiting": self.scenes.waiting,
            "trial": None if trial is None else {**asdict(trial), "about": None},
        }

    def _complain(self, error: Exception) -> None:
        if str(error) != self._reported:
            self._reported = str(error)
            self._report(f"the teleoperation: {error}")


def calibration(progress: Progress, block: Block) -> str | None:
    """The file that an operator was calibrated with for a block's task; None if there is none."""
    undone = {r.event.number for r in progress.records if isinstance(r.event, Undone)}
    for record in reversed(progress.records):
        event, counts = record.event, record.number not in undone
        if (
            counts
            and isinstance(event, Calibrated | Recalibrated)
            and event.task == block.task.name
        ):
            return _file(event.detail)
    return None


def _file(detail: str) -> str | None:
    """A file of this machine with its folder, since the teleoperation may run in another one."""
    if not detail.lower().endswith(".json"):
        return None
    path = Path(detail).expanduser()
    return str(path.absolute()) if path.is_file() else detail


def _starts_trial(progress: Progress) -> bool:
    """True if the event that would be undone now is the start of a trial."""
    due = progress.undoable
    return due is not None and isinstance(due.event, TrialStarted)


def _free(progress: Progress, block: Block) -> bool:
    """True if a block has had no trial yet: the operator moves without the object."""
    return not any(trial.block == block for trial in progress.trials)

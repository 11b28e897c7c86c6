"""Remote control of a study's teleoperation: methods, and scenes and trials of its simulation.

A block starts only when the running teleoperation has switched to its condition. The simulation
proposes line and time of a trial, and the experimenter decides.

The simulation has the scene of the current block, without the object before the first trial of the
block. Each trial of the protocol has one trial in the simulation, whose record names study,
operator, block and trial.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal, Protocol, TypeAlias

import msgspec

from smooth_operator.errors import (
    RemoteRefusedError,
    SmoothOperatorError,
    StudyError,
    UnknownNameError,
)
from smooth_operator.simulation.tasks.catalogue import task_named
from smooth_operator.simulation.tasks.task import SimulatedTask
from smooth_operator_study.design.plan import Block
from smooth_operator_study.design.protocol import Condition
from smooth_operator_study.store.progress import Progress

State: TypeAlias = Literal["unknown", "ready", "switching", "refused", "gone"]
_KEYS: Final = ("operator", "task", "block", "trial")
"""Entries that match a simulated trial with one of the log."""
_OPPOSITES: Final = {
    "trial_started": "undone",
    "trial_paused": "resume",
    "trial_resumed": "pause",
}
"""Kind of an event -> what the simulation does when it is undone."""


class Teleop(Protocol):
    """Remote control of a running teleoperation, such as ``RemoteTeleop``."""

    def request(self, do: str, **fields: Any) -> Mapping[str, Any]:
        """Sends a request and returns the answer."""


@dataclass(frozen=True)
class TrialStatus:
    """Status of a simulated trial.

    Attributes:
        phase: ``ready``, ``waiting`` (for the hand to be clear), ``running`` or ``done``.
        line: line of the rubric that fits so far; final when the trial is done.
        score: score of that line.
        resets: number of times that the object was put back.
        reason: reason for the line, in a few words.
        time_s: time of the trial [s]; None before it is done.
        about: entries that the trial was started with; they name the condition.
    """

    phase: str
    line: str
    score: float
    resets: int
    reason: str = ""
    time_s: float | None = None
    about: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TeleopStatus:
    """Status of the teleoperation as of its last answer.

    Attributes:
        state: ``ready`` answers and runs the right method; ``refused`` could not be switched;
            ``gone`` does not answer.
        detail: reason of ``refused`` and ``gone``; may name a method.
        running: method and preset.
        task: name of the scene; None without a simulated task.
        trial: simulated trial; None without one.
        calibrations: calibrations of the hands: side and name.
        rate_hz: commands a second; None if unknown.
        simulated: whether the hand is simulated, with a task or without.
        has_object: whether the scene has its object; None if unknown.
    """

    state: State = "unknown"
    detail: str = ""
    running: tuple[str, str | None] | None = None
    task: str | None = None
    trial: TrialStatus | None = None
    calibrations: tuple[tuple[str, str], ...] = ()
    rate_hz: float | None = None
    simulated: bool = False
    has_object: bool | None = None


HIDDEN: Final = "teleop could not be switched; the terminal of the console shows the reason"
"""Message for a blind experimenter, since the reason may name the method."""


class SessionTeleop:
    """Prepares the teleoperation for each step of the protocol, and follows the trials with it.

    Args:
        teleop: remote control of the teleoperation.
        blind: whether methods are not to be named.
        report: called with reasons that a blind experimenter may not see.
        changed: called when ``status`` has changed, from the thread that changed it.
    """

    def __init__(
        self,
        teleop: Teleop,
        *,
        blind: bool,
        report: Callable[[str], None],
        changed: Callable[[], None],
    ) -> None:
        self.status = TeleopStatus()
        self._teleop = teleop
        self._blind = blind
        self._report = report
        self._changed = changed
        self._lock = threading.RLock()
        self._reported = ""
        self._loaded: tuple[str, tuple[tuple[str, str], ...]] | None = None
        self._answers: dict[str, tuple[str, str | None]] = {}

    # Steps of the protocol.

    def before(self, do: str, fields: Mapping[str, Any], progress: Progress) -> None:
        """Prepares the hand before a calibration counts, or a block or a trial starts."""
        block = progress.step.block
        if do in ("calibrated", "recalibrate"):
            try:
                self._calibrate(_file(str(fields.get("detail", ""))))
            except StudyError as error:
                raise StudyError(
                    f"the calibration was not loaded into the hand: {error}"
                ) from error
        if block is not None and do == "start_familiarisation":
            with contextlib.suppress(StudyError):  # watching tries again
                self._load_scene(block, with_object=False)
        if block is None or do not in ("start_block", "start_trial"):
            return
        what = "block" if do == "start_block" else "trial"
        try:
            if do == "start_block" or not self._runs(block.condition, progress):
                self._switch(block.condition)
            self._set_rate(progress)
            self._calibrate(_file(progress.calibrations.get(block.task.name, "")))
        except StudyError as error:
            self._report_once(error)
            why = HIDDEN if self._blind else f"teleop could not be switched: {error}"
            raise StudyError(f"the {what} does not start: {why}") from error
        try:
            if do == "start_block":
                self._look()
                self._load_scene(block, with_object=False)
            else:
                self._load_scene(block)
                self._begin_trial(progress, block)
        except StudyError as error:
            raise StudyError(f"the {what} does not start: the simulation: {error}") from error

    def facts(self, do: str, progress: Progress) -> dict[str, str | float]:
        """Returns fields of an event that only the teleoperation knows.

        They are the method that runs at the start of a block, and the simulation's proposal of a
        score.
        """
        if do == "start_block" and self.status.running is not None:
            method, preset = self.status.running
            return {"method": method, "preset": preset or ""}
        if do == "score":
            trial = self._current_trial(progress)
            if trial is not None and trial.phase == "done":
                return {"proposed_line": trial.line, "proposed_score": trial.score}
        return {}

    def measured(self, progress: Progress) -> float | None:
        """Time of the running trial by the simulation [s]; None where the trial is not over."""
        trial = self._current_trial(progress, fresh=True)
        return trial.time_s if trial is not None and trial.phase == "done" else None

    def along(self, do: str, progress: Progress) -> None:
        """Lets the simulation follow a trial that was reset, paused, void, scored or undone.

        Never raises.
        """
        running, undone = progress.running, progress.undoable
        if running is None or not self._in_scene(running.block):
            return
        if do == "undo" and undone is not None:
            do = _OPPOSITES.get(undone.event.kind, "")
        with contextlib.suppress(StudyError):
            trial = self._look_at_trial()
            if trial is None or not same_trial(trial.about, progress):
                return
            if do == "reset":
                self._request("reset")
            elif do in ("pause", "resume"):
                self._request("trial", **{do: True})
            elif do == "score" and trial.phase == "running":
                self._request("trial", finish=True)
            elif do in ("void", "undone", "withdraw"):
                mark = "undone" if do == "undone" else "void"
                about = {key: trial.about[key] for key in _KEYS}
                self._request("trial", cancel=True, mark=mark, about=about)

    def abandon(self) -> None:
        """Cancels the simulated trial of a trial that the log does not have."""
        with contextlib.suppress(StudyError):
            self._request("trial", cancel=True)
            self._look_at_trial()

    def watch(self, progress: Progress | None) -> str:
        """Checks the teleoperation; restores condition and scene of the current block.

        Returns:
            Text to note in the log; empty for none.
        """
        block = None if progress is None else progress.begun
        if progress is None or block is None:
            self._look()
            return ""
        switched = False
        try:
            if not self._runs(block.condition, progress) and self.status.state != "refused":
                self._switch(block.condition)  # a refused switch is repeated on request only
                switched = True
            self._set_rate(progress)
            if switched or self._loaded is not None:
                self._calibrate(_file(progress.calibrations.get(block.task.name, "")))
            if progress.running is None:
                # Before the first trial of a block the operator moves without the object.
                tried = any(trial.block == block for trial in progress.trials)
                self._load_scene(block, with_object=None if tried else False)
        except StudyError as error:
            self._report_once(error)
        if switched and progress.running is not None:
            return "teleop ran another method during a trial; it was switched back"
        return ""

    def again(self, progress: Progress) -> None:
        """Switches once more, on request."""
        block = progress.begun
        if block is None:
            self._look()
            return
        try:
            self._switch(block.condition)
        except StudyError as error:
            self._report_once(error)
            raise StudyError(HIDDEN if self._blind else str(error)) from error

    def view(self, progress: Progress | None) -> dict[str, Any]:
        """Returns the state of the hand for the experimenter's page."""
        status = self.status
        hidden = self._blind and status.state == "refused"
        block = None if progress is None else progress.step.block
        scene = None if block is None or not self._in_scene(block) else simulated_task(block)
        trial = None if progress is None else self._current_trial(progress)
        return {
            "state": status.state,
            "detail": HIDDEN if hidden else status.detail,
            "running": None
            if self._blind or status.running is None
            else " ".join(filter(None, status.running)),
            "scene": status.task,
            "limit_s": None if scene is None else scene.seconds,
            "trial": None if trial is None else {**asdict(trial), "about": None},
        }

    # Requests; each failure changes the status.

    def _request(self, do: str, **fields: Any) -> Mapping[str, Any]:
        """Sends a request."""
        try:
            answer = self._teleop.request(do, **fields)
            if answer.get("ok") is not True:
                raise RemoteRefusedError(
                    str(answer.get("error") or f"{do}: refused without a reason")
                )
        except SmoothOperatorError as error:
            if not isinstance(error, RemoteRefusedError):
                self._set(TeleopStatus("gone", str(error)))
            elif do == "method":
                self._set(replace(self.status, state="refused", detail=str(error)))
            raise StudyError(str(error)) from error
        return answer

    def _set(self, status: TeleopStatus) -> None:
        if status != self.status:
            self.status = status
            self._changed()

    def _look(self) -> None:
        """Asks for the status where no particular method has to run. Never raises."""
        with self._lock, contextlib.suppress(StudyError):
            self._set(_status(self._request("status"), "ready"))

    def _look_at_trial(self) -> TrialStatus | None:
        trial = trial_status(self._request("trial"))
        self._set(replace(self.status, trial=trial))
        return trial

    def _switch(self, condition: Condition) -> None:
        """Switches to a condition; returns when its method runs."""
        with self._lock:
            self._set(replace(self.status, state="switching", detail=""))
            preset = {} if condition.preset is None else {"preset": condition.preset}
            running = _running(self._request("method", method=condition.method, **preset))
            if running[0] != condition.method:
                why = (
                    f"the requested method was {condition.method!r}, but teleop runs {running[0]!r}"
                )
                self._set(replace(self.status, state="refused", detail=why, running=running))
                raise StudyError(why)
            self._answers[condition.name] = running
            self._set(replace(self.status, state="ready", detail="", running=running))

    def _runs(self, condition: Condition, progress: Progress) -> bool:
        """Asks the teleoperation whether it runs the condition of the current block."""
        with self._lock:
            answer = self._request("status")
            running = _running(answer)
            # After a restart of the console, the log has the answer from the start of the block.
            target = self._answers.get(condition.name) or progress.begun_with
            if target is None:
                target = (condition.method, condition.preset or _default_preset(running))
            right = running == target
            if not right and self.status.state == "refused":
                self._set(_status(answer, "refused", self.status.detail))
            else:
                self._set(_status(answer, "ready" if right else "unknown"))
            return right

    def _calibrate(self, file: str | None) -> None:
        """Loads a calibration into the hand, unless the hand still uses it."""
        if file is None or self._loaded == (file, self.status.calibrations):
            return
        self._request("calibration", path=file)
        self._look()
        self._loaded = (file, self.status.calibrations)

    def _set_rate(self, progress: Progress) -> None:
        """Sets the plan's rate of commands, unless the hand has it."""
        rate = progress.plan.protocol.rate_hz
        if rate is not None and self.status.rate_hz != rate:
            self._request("rate", rate=rate)
            self._look()

    def _report_once(self, error: Exception) -> None:
        if str(error) != self._reported:
            self._reported = str(error)
            self._report(f"teleop: {error}")

    # The simulation.

    def _load_scene(self, block: Block, *, with_object: bool | None = None) -> None:
        """Loads the scene of a block, unless the simulation has it.

        Args:
            with_object: whether the scene is to have its object; None leaves it unchanged.
        """
        status, task = self.status, simulated_task(block)
        if task is None or not status.simulated:
            return
        check_rubric(block, task)
        if status.task != task.name or with_object not in (None, status.has_object):
            fields = {} if with_object is None else {"object": with_object}
            self._request("task", task=task.name, **fields)
            self._look()

    def _begin_trial(self, progress: Progress, block: Block) -> None:
        """Starts the simulated trial."""
        if not self._in_scene(block):
            return
        trial, limit = self.status.trial, block.task.time_limit_s
        if trial is not None and trial.phase in ("running", "waiting"):  # of one that was undone
            self._request("trial", cancel=True)
        about = {
            "study": progress.plan.protocol.name,
            "operator": progress.operator,
            "condition": block.condition.name,
            "task": block.task.name,
            "block": block.number,
            "trial": progress.step.trial,
            "trials": block.task.trials,
        }
        fields = {} if limit is None else {"limit_s": limit}
        self._request("trial", begin=True, about=about, **fields)
        self._look_at_trial()

    def _current_trial(self, progress: Progress, *, fresh: bool = False) -> TrialStatus | None:
        """Status of the running trial, if the simulation knows all of its resets.

        Args:
            fresh: whether to ask the simulation again.
        """
        running = progress.running
        if running is None or not self._in_scene(running.block):
            return None
        trial = self.status.trial
        if fresh:
            trial = None
            with contextlib.suppress(StudyError):
                trial = self._look_at_trial()
        if trial is None or not same_trial(trial.about, progress):
            return None
        right = trial.phase in ("running", "done") and trial.resets == running.resets
        return trial if right else None

    def _in_scene(self, block: Block) -> bool:
        """True if the simulation has the scene of a block."""
        task = simulated_task(block)
        return task is not None and task.name == self.status.task


def same_trial(about: Mapping[str, Any], progress: Progress) -> bool:
    """True if a simulated trial was started for the running trial of an operator."""
    running = progress.running
    if running is None:
        return False
    place = (progress.operator, *running.block.place, running.number)
    return tuple(about.get(key) for key in _KEYS) == place


def simulated_task(block: Block) -> SimulatedTask | None:
    """Simulated task of a block; None if its task is not simulated."""
    try:
        return task_named(block.task.name)
    except UnknownNameError:
        return None


def check_rubric(block: Block, task: SimulatedTask) -> None:
    """Raises StudyError if the plan's rubric and the scene give the same line different scores."""
    planned = {line.name: line.score for line in block.task.rubric}
    for line in task.task.rubric:
        if planned.get(line.name, line.score) != line.score:
            raise StudyError(
                f"line {line.name!r} of the rubric of task {block.task.name} scores "
                f"{planned[line.name]:g} in the plan and {line.score:g} in the scene; give it "
                "another name in study.toml, or the same score"
            )


def trial_status(answer: object) -> TrialStatus | None:
    """Status of a simulated trial from the answer to ``trial``; None if it has none."""
    try:
        return msgspec.convert(answer, TrialStatus)
    except msgspec.ValidationError:
        return None


def _status(answer: Mapping[str, Any], state: State, detail: str = "") -> TeleopStatus:
    task, operators = answer.get("task"), answer.get("operators")
    sources = operators.items() if isinstance(operators, Mapping) else ()
    rate, has_object = answer.get("rate"), answer.get("object")
    return TeleopStatus(
        state,
        detail,
        _running(answer),
        None if task is None else str(task),
        trial_status(answer.get("trial")),
        tuple(sorted((str(side), str(source)) for side, source in sources)),
        float(rate) if isinstance(rate, int | float) else None,
        task is not None or answer.get("simulation") is True,
        has_object if isinstance(has_object, bool) else None,
    )


def _running(answer: Mapping[str, Any]) -> tuple[str, str | None]:
    preset = answer.get("preset")
    return str(answer.get("method", "")), None if preset is None else str(preset)


def _default_preset(running: tuple[str, str | None]) -> str | None:
    """Default preset of the running method; the running preset if the method is not known here."""
    from smooth_operator.retargeting.presets import default_preset

    try:
        return default_preset(running[0])
    except (SmoothOperatorError, KeyError):
        return running[1]


def _file(detail: str) -> str | None:
    """A calibration file with its folder, since the teleoperation may run in another one."""
    if not detail.lower().endswith(".json"):
        return None
    path = Path(detail).expanduser()
    return str(path.absolute()) if path.is_file() else detail

"""Remote control of a study's teleoperation: methods, and scenes and trials of its simulation.

The scene is that of the block that is on, and there is no object in it before the block's first
trial. A trial of the protocol has one in the simulation; they know each other by the entries that
the record of the simulated one has, so that a console that was started again knows it, too.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, Protocol, TypeAlias

from smooth_operator.errors import (
    RemoteRefusedError,
    SmoothOperatorError,
    StudyError,
    UnknownNameError,
)
from smooth_operator.study.design.plan import Block
from smooth_operator.study.design.protocol import Condition
from smooth_operator.study.store.events import ASIDE, TrialStarted
from smooth_operator.study.store.progress import Progress

State: TypeAlias = Literal["unknown", "ready", "switching", "refused", "gone"]


class Teleop(Protocol):
    """A remote control of a running teleoperation, such as ``RemoteTeleop``."""

    def request(self, do: str, **fields: Any) -> Mapping[str, Any]:
        """Has something done.

        Raises:
            SmoothOperatorError: it can't be, or nobody answers.
        """


@dataclass(frozen=True)
class Standing:
    """State of a simulated trial.

    Attributes:
        phase: ``ready``, ``waiting`` (for the hand to be clear), ``running`` or ``done``; final
            only when it is done.
        line: of the rubric, by which it would be scored.
        score: of that line.
        reason: in a few words.
        resets: how often the object was put back.
        time_s: how long it took [s]; None before it is done.
        about: what it was begun with; names the condition.
        paused: whether its scene stands still.
        pauses: how often it did.
    """

    phase: str
    line: str
    score: float
    reason: str
    resets: int
    time_s: float | None
    about: Mapping[str, Any] = field(default_factory=dict)
    paused: bool = False
    pauses: int = 0


@dataclass(frozen=True)
class Heard:
    """State of the teleoperation as it answered last.

    Attributes:
        state: ``ready`` answers, and runs what it should; ``refused`` could not be switched;
            ``gone`` does not answer.
        detail: why not, in its own words; may name a method.
        running: method and preset.
        task: name of the scene, where it drives a simulation with one.
        trial: in that scene.
        calibrations: of its hands, as it names them.
        rate_hz: commands a second that it sends; None if it does not say.
        simulated: whether it drives a simulation, with a task or without.
        object_there: whether the scene has its object now; None if it does not say.
    """

    state: State = "unknown"
    detail: str = ""
    running: tuple[str, str | None] | None = None
    task: str | None = None
    trial: Standing | None = None
    calibrations: tuple[tuple[str, str], ...] = ()
    rate_hz: float | None = None
    simulated: bool = False
    object_there: bool | None = None


class Switch:
    """Selects what the teleoperation runs, and sees whether it still runs it.

    Args:
        teleop: what is switched.
        changed: called when ``heard`` is new, from the thread that found out.
    """

    def __init__(self, teleop: Teleop, changed: Callable[[], None] = lambda: None) -> None:
        self.heard = Heard()
        self._teleop = teleop
        self._changed = changed
        self._turn = threading.RLock()
        self._answered: dict[str, tuple[str, str | None]] = {}

    def to(self, condition: Condition) -> None:
        """Has it run a condition; returns when it does.

        Raises:
            StudyError: it does not.
        """
        with self._turn:
            self._hear(replace(self.heard, state="switching", detail=""))
            fields: dict[str, Any] = {"method": condition.method}
            if condition.preset is not None:
                fields["preset"] = condition.preset
            running = _running(self.ask("method", **fields))
            if running[0] != condition.method:
                why = (
                    f"it was asked for {condition.method!r} and answers that it runs {running[0]!r}"
                )
                self._hear(replace(self.heard, state="refused", detail=why, running=running))
                raise StudyError(why)
            self._answered[condition.name] = running
            self._hear(replace(self.heard, state="ready", detail="", running=running))

    def keep(self, condition: Condition) -> bool:
        """Has it run a condition, if it does not already.

        Returns:
            Whether it had to be switched.

        Raises:
            StudyError: it does not, and can't be made to.
        """
        with self._turn:
            if self.runs(condition):
                return False
            self.to(condition)
            return True

    def runs(self, condition: Condition) -> bool:
        """Asks if it runs a condition.

        Raises:
            StudyError: it does not answer.
        """
        with self._turn:
            status = self.ask("status")
            running = _running(status)
            target = self._answered.get(condition.name)
            if target is None:  # a console that was started again
                target = (condition.method, condition.preset or _default_preset(running))
            right = running == target
            state: State = "ready" if right else "unknown"
            if not right and self.heard.state == "refused":
                self._hear(_state_of(status, "refused", self.heard.detail))
            else:
                self._hear(_state_of(status, state))
            return right

    def remember(self, condition: Condition, answered: tuple[str, str | None] | None) -> None:
        """Takes over its answer to a condition from before this program was started, if known."""
        if answered is not None:
            self._answered.setdefault(condition.name, answered)

    def look(self) -> None:
        """Sees whether it answers, where nothing particular has to run. Never raises."""
        with self._turn:
            try:
                self._hear(_state_of(self.ask("status"), "ready"))
            except StudyError:
                return

    def follow(self) -> Standing | None:
        """Asks for the state of the simulated trial.

        Raises:
            StudyError: there is none, or nobody answers.
        """
        trial = standing(self.ask("trial"))
        self._hear(replace(self.heard, trial=trial))
        return trial

    def ask(self, do: str, **fields: Any) -> Mapping[str, Any]:
        """Anything else; what is heard of it is kept.

        Raises:
            StudyError: it can't be done, or nobody answers.
        """
        try:
            answer = self._teleop.request(do, **fields)
        except SmoothOperatorError as error:
            if not isinstance(error, RemoteRefusedError):
                self._hear(Heard("gone", str(error)))
            elif do == "method":
                self._hear(replace(self.heard, state="refused", detail=str(error)))
            raise StudyError(str(error)) from error
        if answer.get("ok") is not True:
            why = str(answer.get("error") or f"{do}: refused without a reason")
            if do == "method":
                self._hear(replace(self.heard, state="refused", detail=why))
            raise StudyError(why)
        return answer

    def _hear(self, heard: Heard) -> None:
        if heard != self.heard:
            self.heard = heard
            self._changed()


def standing(report: object) -> Standing | None:
    """State of a simulated trial from the answer to ``trial``; None if that is no state."""
    if not isinstance(report, Mapping):
        return None
    time_s, about = report.get("time_s"), report.get("about")
    try:
        return Standing(
            str(report["phase"]),
            str(report["line"]),
            float(report["score"]),
            str(report.get("reason", "")),
            int(report["resets"]),
            None if time_s is None else float(time_s),
            dict(about) if isinstance(about, Mapping) else {},
            report.get("paused") is True,
            int(report.get("pauses", 0)),
        )
    except (KeyError, TypeError, ValueError):
        return None


def _running(answer: Mapping[str, Any]) -> tuple[str, str | None]:
    preset = answer.get("preset")
    return str(answer.get("method", "")), None if preset is None else str(preset)


def _default_preset(running: tuple[str, str | None]) -> str | None:
    """The preset that a method has where none was asked for; what runs, if it is not known here."""
    from smooth_operator.methods.presets import default_preset

    try:
        return default_preset(running[0])
    except (SmoothOperatorError, KeyError):
        return running[1]


def _state_of(status: Mapping[str, Any], state: State, detail: str = "") -> Heard:
    task, operators = status.get("task"), status.get("operators")
    sources = operators.items() if isinstance(operators, Mapping) else ()
    rate, there = status.get("rate"), status.get("object")
    return Heard(
        state,
        detail,
        _running(status),
        None if task is None else str(task),
        standing(status.get("trial")),
        tuple(sorted((str(side), str(source)) for side, source in sources)),
        float(rate) if isinstance(rate, int | float) else None,
        task is not None or status.get("simulation") is True,
        there if isinstance(there, bool) else None,
    )


CLEAR_WAIT_S: Final = 120.0
"""Longest that a trial waits for the hand to be clear of the object [s]."""
_POLL_S: Final = 0.05
_KEYS: Final = ("operator", "task", "block", "trial", "after")
"""Entries by which a simulated trial is known as one of the log."""


class SceneTrials:
    """The part of the simulation in each step of the protocol.

    Args:
        switch: to the running teleoperation.
    """

    def __init__(self, switch: Switch) -> None:
        self._switch = switch
        self._simulated = False  # whether there was ever a scene
        self._given_up = threading.Event()
        self._state_of: object = None  # start of the logged trial that the simulation ran

    @property
    def waiting(self) -> bool:
        """True while a trial waits for the hand to be clear of the object."""
        trial = self._switch.heard.trial
        return trial is not None and trial.phase == "waiting"

    def load(self, block: Block, *, with_object: bool | None = None) -> str:
        """Has the scene of a block loaded, where it is not there.

        Args:
            block: that is on.
            with_object: whether an object is to be there; None leaves that as it is.

        Returns:
            What was found and changed, for the log; empty if all was right.

        Raises:
            StudyError: it can't be loaded, or plan and scene contradict each other.
        """
        heard, scene = self._switch.heard, scene_of(block)
        self._simulated = self._simulated or heard.task is not None
        if scene is None or not self._simulated or heard.state == "gone":
            return ""
        check_rubric(block)
        there = heard.object_there
        wrong = with_object is not None and there is not None and there is not with_object
        if heard.task == scene and not wrong:
            return ""
        if heard.task is None and not heard.simulated:
            raise StudyError(
                f"task {block.task.name} ran in a simulation, and the teleoperation has none now; "
                f"start it with --task {scene}, or this console again if the hand is real"
            )
        before = heard.task
        fields = {} if with_object is None else {"object": with_object}
        self._switch.ask("task", task=scene, **fields)
        self._switch.look()
        if self._switch.heard.task != scene:
            raise StudyError(
                f"task {block.task.name} needs the scene {scene}, but the teleoperation answers "
                f"that it has {self._switch.heard.task or 'none'}"
            )
        if before == scene:
            return ""
        return f"the simulation had {_named(before)}; the scene {scene} was loaded"

    def begin(self, progress: Progress, block: Block) -> None:
        """Begins the simulated trial; returns when its clock runs, the hand clear of the object.

        Raises:
            StudyError: it can't begin, the hand stays at the object, or it was given up.
        """
        if not self.in_scene(block):
            return
        trial, limit = self._switch.heard.trial, block.task.time_limit_s
        if trial is not None and trial.phase in ("running", "waiting"):  # of one that was undone
            self._switch.ask("trial", cancel=True)
        about = {
            "study": progress.plan.protocol.name,
            "operator": progress.operator,
            "condition": block.condition.name,
            "task": block.task.name,
            "block": block.number,
            "trial": progress.step.trial,
            "trials": block.task.trials,
            "after": progress.number,
        }
        fields = {} if limit is None else {"limit_s": limit}
        self._given_up.clear()
        answer = self._switch.ask("trial", begin=True, when_clear=True, about=about, **fields)
        try:
            _check_limit(block, answer)
            self._wait_until_clear()
        except StudyError:
            self.abandon()
            raise

    def _wait_until_clear(self) -> None:
        end = time.monotonic() + CLEAR_WAIT_S
        while (trial := self._switch.follow()) is not None and trial.phase == "waiting":
            if self._given_up.wait(_POLL_S):
                raise StudyError("its start was cancelled while the hand was in the way")
            if time.monotonic() > end:
                raise StudyError(f"the hand was not clear of the object within {CLEAR_WAIT_S:g} s")
        if trial is None or trial.phase == "ready":
            raise StudyError("it ended before its clock ran")

    def give_up(self) -> None:
        """Waits no longer for the hand to be clear."""
        self._given_up.set()

    def abandon(self) -> None:
        """Forgets the simulated trial that was begun for one that the log does not have."""
        with contextlib.suppress(StudyError):
            self._switch.ask("trial", cancel=True)
            self._switch.follow()

    def abandon_stray(self, operator: str) -> None:
        """The same for one that a console began which was killed before it was logged."""
        trial = self._switch.heard.trial
        if trial is None or trial.phase not in ("waiting", "running"):
            return
        if "after" in trial.about and trial.about.get("operator") == operator:
            self.abandon()

    def along(self, do: str, progress: Progress) -> None:
        """Has the simulation follow a trial: reset, paused, scored, undone or made void.

        Args:
            do: the command.
            progress: before it.
        """
        running = progress.running
        if running is None or not self.in_scene(running.block):
            return
        if self._switch.heard.state == "gone":
            return
        with contextlib.suppress(StudyError):
            trial = self._switch.follow()
            if trial is None or not same_trial(trial.about, progress):
                return
            if do == "reset":
                self._switch.ask("reset")
            elif do in ("pause", "resume") and trial.phase == "running":
                self._switch.ask("trial", **{do: True})
            elif do == "score" and trial.phase == "running":
                self._switch.ask("trial", finish=True)
            elif do in ("void", "undo", "withdraw"):
                mark = "undone" if do == "undo" else "void"
                about = {key: trial.about[key] for key in _KEYS}
                self._switch.ask("trial", cancel=True, mark=mark, about=about)

    def match_pause(self, progress: Progress) -> None:
        """Has the scene stand still while the trial in the log is paused, and go on after that."""
        running, trial = progress.running, self._switch.heard.trial
        if running is None or trial is None or trial.phase != "running":
            return
        if running.paused != trial.paused and same_trial(trial.about, progress):
            with contextlib.suppress(StudyError):
                self._switch.ask("trial", **{"pause" if running.paused else "resume": True})
                self._switch.follow()

    def standing(self, progress: Progress, *, fresh: bool = False) -> Standing | None:
        """State of the trial that runs, if the simulation knows of it all that the log does."""
        running = progress.running
        if running is None or not self.in_scene(running.block):
            return None
        trial = self._switch.heard.trial
        if fresh and self._switch.heard.state != "gone":
            trial = None
            with contextlib.suppress(StudyError):
                trial = self._switch.follow()
        if trial is None or not same_trial(trial.about, progress):
            return None
        self._state_of = running.started
        right = trial.phase in ("running", "done") and trial.resets == running.resets
        return trial if right else None

    def lost(self, progress: Progress) -> str:
        """A note, once, where the simulation no longer runs the trial that it ran."""
        running, heard = progress.running, self._switch.heard
        if running is None or heard.state == "gone" or self._state_of != running.started:
            return ""
        trial = heard.trial
        if self.in_scene(running.block) and trial and same_trial(trial.about, progress):
            return ""
        self._state_of = None
        return (
            f"the simulation no longer runs trial {running.number}, but has {_named(heard.task)}: "
            "void it, or score what was seen"
        )

    def limit_s(self, block: Block) -> float | None:
        """Time limit of the simulated task that is on [s]; the plan's own may say another."""
        from smooth_operator.simulation.tasks.task_registry import task_named

        return task_named(block.task.name).seconds if self.in_scene(block) else None

    def in_scene(self, block: Block) -> bool:
        """True if the simulation has the scene of a block."""
        task = self._switch.heard.task
        return task is not None and task == scene_of(block)


def same_trial(about: Mapping[str, Any], progress: Progress) -> bool:
    """True if a simulated trial was begun for the one that runs in the log.

    Args:
        about: entries of its record.
        progress: of an operator; nothing but notes came between these entries and the start.
    """
    running, after = progress.running, about.get("after")
    if running is None or not isinstance(after, int):
        return False
    place = (progress.operator, running.block.task.name, running.block.number, running.number)
    if tuple(about.get(key) for key in _KEYS[:-1]) != place:
        return False
    started = max(r.number for r in progress.records if isinstance(r.event, TrialStarted))
    between = progress.records[after : started - 1]
    return after < started and all(isinstance(r.event, ASIDE) for r in between)


def scene_of(block: Block) -> str | None:
    """Name of the simulated task, where the block's is one."""
    from smooth_operator.simulation.tasks.task_registry import task_named

    try:
        return task_named(block.task.name).name
    except UnknownNameError:
        return None


def check_rubric(block: Block) -> None:
    """Refuses a plan whose rubric gives another score than the scene for the same line.

    Raises:
        StudyError: names both.
    """
    from smooth_operator.simulation.tasks.task_registry import task_named

    planned = {line.name: line.score for line in block.task.rubric}
    for line in task_named(block.task.name).task.rubric:
        if planned.get(line.name, line.score) != line.score:
            raise StudyError(
                f"line {line.name!r} of the rubric of task {block.task.name} scores "
                f"{planned[line.name]:g} in the plan and {line.score:g} in the scene; give it "
                "another name in study.toml, or the same score"
            )


def _check_limit(block: Block, answer: Mapping[str, Any]) -> None:
    """Refuses a scene that ends a trial at another time than the plan says."""
    from smooth_operator.simulation.tasks.task_registry import task_named

    planned, told = block.task.time_limit_s, answer.get("limit_s")
    used = float(told) if isinstance(told, int | float) else task_named(block.task.name).seconds
    if planned is not None and abs(planned - used) > 1e-6:
        raise StudyError(
            f"the time limit of task {block.task.name} is {planned:g} s in the plan and {used:g} s "
            "in the scene; run console and teleoperation in the same version of smooth-operator"
        )


def _named(scene: str | None) -> str:
    return "no scene" if scene is None else f"the scene {scene}"

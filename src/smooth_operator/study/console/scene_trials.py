"""Scenes and trials of the simulation that a console's teleoperation drives.

The scene is that of the block that is on, and there is no object in it before the block's first
trial. A trial of the protocol has one in the simulation; they know each other by the entries that
the record of the simulated one has, so that a console that was started again knows it, too.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from typing import Any, Final

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.study.console.switching import Standing, Switch
from smooth_operator.study.design.plan import Block
from smooth_operator.study.store.events import ASIDE, TrialStarted
from smooth_operator.study.store.progress import Progress

CLEAR_WAIT_S: Final = 120.0
"""Longest that a trial waits for the hand to be clear of the object [s]."""

_POLL_S: Final = 0.05
_KEYS: Final = ("operator", "task", "block", "trial", "after")
"""Entries by which a simulated trial is known as one of the log."""


class SceneTrials:
    """What is done with the simulation at each step of the protocol.

    Args:
        switch: to the running teleoperation.
    """

    def __init__(self, switch: Switch) -> None:
        self._switch = switch
        self._simulated = False  # whether there was ever a scene
        self._given_up = threading.Event()
        self._seen: object = None  # start of the logged trial that the simulation ran

    @property
    def waiting(self) -> bool:
        """Whether a trial waits for the hand to be clear of the object."""
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
        """What the simulation does with a trial: reset, paused, scored, undone or made void.

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
        """Of the trial that runs, if the simulation knows of it all that the log does."""
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
        self._seen = running.started
        right = trial.phase in ("running", "done") and trial.resets == running.resets
        return trial if right else None

    def lost(self, progress: Progress) -> str:
        """What to note, once, where the simulation no longer runs the trial that it ran."""
        running, heard = progress.running, self._switch.heard
        if running is None or heard.state == "gone" or self._seen != running.started:
            return ""
        trial = heard.trial
        if self.in_scene(running.block) and trial and same_trial(trial.about, progress):
            return ""
        self._seen = None
        return (
            f"the simulation no longer runs trial {running.number}, but has {_named(heard.task)}: "
            "void it, or score what was seen"
        )

    def limit_s(self, block: Block) -> float | None:
        """Time limit of the simulated task that is on [s]; the plan's own may say another."""
        from smooth_operator.simulation.tasks.task_registry import task_named

        return task_named(block.task.name).seconds if self.in_scene(block) else None

    def in_scene(self, block: Block) -> bool:
        """Whether the simulation has the scene of a block."""
        task = self._switch.heard.task
        return task is not None and task == scene_of(block)


def same_trial(about: Mapping[str, Any], progress: Progress) -> bool:
    """Whether a simulated trial was begun for the one that runs in the log.

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

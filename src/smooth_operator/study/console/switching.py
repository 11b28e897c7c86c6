"""Keeps the running teleoperation on the method of the current block."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol, TypeAlias

from smooth_operator.errors import RemoteRefusedError, SmoothOperatorError, StudyError
from smooth_operator.study.design.protocol import Condition

State: TypeAlias = Literal["unknown", "ready", "switching", "refused", "gone"]


class Teleop(Protocol):
    """What takes words for a running teleoperation, as ``RemoteTeleop`` does."""

    def request(self, do: str, **fields: Any) -> Mapping[str, Any]:
        """Has something done.

        Raises:
            SmoothOperatorError: it can't be, or nobody answers.
        """


@dataclass(frozen=True)
class Standing:
    """How a simulated trial stands.

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
    """What is known of the teleoperation.

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
        """Whether it runs a condition, as it says now.

        Raises:
            StudyError: it does not answer.
        """
        with self._turn:
            status = self.ask("status")
            running = _running(status)
            wanted = self._answered.get(condition.name)
            if wanted is None:  # a console that was started again
                wanted = (condition.method, condition.preset or _default_preset(running))
            right = running == wanted
            state: State = "ready" if right else "unknown"
            if not right and self.heard.state == "refused":
                self._hear(_seen(status, "refused", self.heard.detail))
            else:
                self._hear(_seen(status, state))
            return right

    def remember(self, condition: Condition, answered: tuple[str, str | None] | None) -> None:
        """What it answered to a condition before this program was started, if that is known."""
        if answered is not None:
            self._answered.setdefault(condition.name, answered)

    def look(self) -> None:
        """Sees whether it answers, where nothing particular has to run. Never raises."""
        with self._turn:
            try:
                self._hear(_seen(self.ask("status"), "ready"))
            except StudyError:
                return

    def follow(self) -> Standing | None:
        """How the simulated trial stands now.

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
    """How a simulated trial stands, from what ``trial`` answers; None if that is nothing such."""
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


def _seen(status: Mapping[str, Any], state: State, detail: str = "") -> Heard:
    task, operators = status.get("task"), status.get("operators")
    known = operators.items() if isinstance(operators, Mapping) else ()
    rate, there = status.get("rate"), status.get("object")
    return Heard(
        state,
        detail,
        _running(status),
        None if task is None else str(task),
        standing(status.get("trial")),
        tuple(sorted((str(side), str(source)) for side, source in known)),
        float(rate) if isinstance(rate, int | float) else None,
        task is not None or status.get("simulation") is True,
        there if isinstance(there, bool) else None,
    )

"""A running teleoperation for tests of the console: answers as ``teleop --control`` does."""

from collections.abc import Mapping
from typing import Any

from smooth_operator.errors import RemoteError, RemoteRefusedError, UnknownNameError
from smooth_operator.simulation.tasks import task_named


class FakeTeleop:
    """Answers as ``teleop --control`` does."""

    def __init__(self) -> None:
        self.method, self.preset = "sbr", "paper"
        self.asked: list[tuple[str, Mapping[str, Any]]] = []
        self.gone = self.refusing = False

    def request(self, do: str, **fields: Any) -> dict[str, Any]:
        self.asked.append((do, fields))
        if self.gone:
            raise RemoteError("nobody answers")
        if do == "method":
            if self.refusing:
                raise RemoteRefusedError("dexpilot needs four fingers")
            self.method, self.preset = fields["method"], fields.get("preset", "default")
        return {"ok": True, "method": self.method, "preset": self.preset, "modes": {}}

    @property
    def switched(self) -> list[Mapping[str, Any]]:
        return [fields for do, fields in self.asked if do == "method"]


class FakeSimulation(FakeTeleop):
    """With a simulated hand: scenes and trials, without physics.

    Args:
        task: name of the scene; None for a simulation of the hand alone.

    Attributes:
        simulated: whether there is a simulation.
        there: whether the scene has its object.
        marked: entries of the records that were marked, with the words.
    """

    def __init__(self, task: str | None = "cube") -> None:
        super().__init__()
        self.task, self.there = task, True
        self.simulated = True
        self.marked: list[tuple[str, Mapping[str, Any]]] = []
        self.trial = _ready(task)

    def request(self, do: str, **fields: Any) -> dict[str, Any]:
        answer = super().request(do, **fields)
        if do == "task":
            if not self.simulated:
                raise RemoteRefusedError("this run has no simulation")
            try:
                self.task = task_named(fields["task"]).name
            except UnknownNameError as error:
                raise RemoteRefusedError(str(error)) from error
            self.there, self.trial = fields.get("object", True), _ready(self.task)
        if do in ("trial", "reset") and self.task is None:
            raise RemoteRefusedError("there is no task; load one first")
        if do == "trial":
            self._trial(fields)
        if do == "reset":
            self.trial["resets"] += self.trial["phase"] == "running"
        return {
            **answer,
            **(self.trial if do in ("trial", "reset") else {}),
            "simulation": self.simulated,
            "task": self.task,
            "object": self.there,
            "trial": None if self.task is None else dict(self.trial),
        }

    def done(self, line: str, score: float, seconds: float) -> None:
        """The trial ends."""
        self.trial |= {
            "phase": "done",
            "line": line,
            "score": score,
            "time_s": seconds,
            "paused": False,
        }

    def _trial(self, fields: Mapping[str, Any]) -> None:
        phase = self.trial["phase"]
        if fields.get("begin"):
            if phase == "running":
                raise RemoteRefusedError("a trial is running; finish or cancel it first")
            self.there, self.trial = True, _ready(self.task)
            self.trial |= {"phase": "running", "about": dict(fields.get("about", {}))}
            self.trial["limit_s"] = fields.get("limit_s", self.trial["limit_s"])
        elif fields.get("cancel"):
            if phase == "running":
                self.trial["phase"] = "ready"
            elif phase == "done" and (word := fields.get("mark")) is not None:
                self.marked.append((word, self.trial["about"]))
        elif fields.get("pause") or fields.get("resume"):
            self.trial["pauses"] += bool(fields.get("pause")) and not self.trial["paused"]
            self.trial["paused"] = bool(fields.get("pause"))
        elif fields.get("finish"):
            self.done("not-done", 0.0, 30.0)


def _ready(task: str | None) -> dict[str, Any]:
    limit = None if task is None else task_named(task).seconds
    return {
        "phase": "ready",
        "line": "not-done",
        "score": 0.0,
        "reason": "",
        "resets": 0,
        "time_s": None,
        "limit_s": limit,
        "about": {},
        "paused": False,
        "pauses": 0,
    }

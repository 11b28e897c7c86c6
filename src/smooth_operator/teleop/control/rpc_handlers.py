"""RPC handlers of ``teleop --control``: commands that change method, operator, rate and task.

In addition to those of ``smooth_operator.teleop.runtime.rpc_server``:

    {"do": "method", "method": "dexpilot", "preset": "default"}
        another method; compiled while the old one goes on, and answered when the hands go over to
        it: {"ok": true, "method": "dexpilot", "preset": "default"}. Without a preset its default.
    {"do": "calibration", "path": "operator.json"}
        an operator's calibration, of the hand of its side; without a path none for all hands:
        {"ok": true, "method": ..., "preset": ..., "side": "right", "hand": "mimic_p050"}.
    {"do": "rate", "rate": 30}
        commands a second from now on, until the run ends: {"ok": true, "rate": 30.0}.
    {"do": "wrist", "engage": false}
        releases the clutch of the wrist while the fingers go on; true takes it: {"ok": true,
        "engage": false}.
    {"do": "task", "task": "card"}
        the scene of a task, by its name or the paper's (A, B, C); without a task the hand alone:
        {"ok": true, "task": "card", "title": ..., "instruction": ..., "time_limit_s": 60.0}. With
        "object": false there is no object until a trial begins, as for free movement.
    {"do": "trial"}
        how the trial stands. With "begin": true a trial begins, with the object at its start, and
        "about": {...} is put into its record; "when_clear": true has its clock begin when the hand
        has left the object alone for half a second ("phase" is waiting until then), and
        "limit_s": 45 is its time limit in place of the task's. With "finish": true it ends, the
        operator can do no more; with "cancel": true it is forgotten, and with "mark": "undone" or
        "void" the record of one that has ended, with these entries "about" it, is marked so.
        With "pause": true the hand, its scene and the clock of the trial stand still, and go on
        with "resume": true. "side" says which one, if there are two:
        {"ok": true, "task": "card", "phase": "running", "elapsed_s": 3.2, "score": 0.0,
         "line": "not-done", "text": ..., "reason": "on the table", "time_s": null, "ended": null,
         "resets": 0, "number": 1, "placed": true, "paused": false, "pauses": 0, "side": "right"};
        "phase" is ready, running or
        done, and only of a trial that is done are score, line and time_s final.
    {"do": "reset"}
        the one reset of a trial that runs; where none does the object is just put back. The answer
        is that of "trial".

"status" answers "method", "preset", "rate" (as it was asked for), "sides", "hand", "blind",
"building" (what is being compiled), "compiling" (sides whose robot holds until their method is
compiled), "source" {"label", "state", "detail"}, "sinks", "operators" {side: where the
calibration is from}, "simulation" (whether there is one that can have a task),
"task" and "trial" (None without one), "object" (whether it is there) and the loop's own "modes" and
"rate_hz".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.calibration.operator_file import read_operator
from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.human.operator import OperatorProfile
from smooth_operator.teleop.control.method_switcher import DriverSpec, MethodSwitcher
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.rpc_server import RpcHandler
from smooth_operator.types import Side

if TYPE_CHECKING:  # physics, which a run without a task need not have
    from smooth_operator.simulation.tasks.task_session import TrialRunner

_LOOK_S: Final = 0.5
"""Interval of the checks that a run still goes on [s]."""


class RpcHandlers:
    """Commands of other programs to a running loop.

    Args:
        loop: the loop.
        switcher: switcher of its methods.
        runner: returns the trial runner of the simulation, or None; called for every command.
        blind: True if the operator must not know the method; for the status.
    """

    def __init__(
        self,
        loop: TeleopLoop,
        switcher: MethodSwitcher,
        runner: Callable[[], TrialRunner | None] = lambda: None,
        *,
        blind: bool = False,
    ) -> None:
        self._loop, self._switcher, self._runner, self._blind = loop, switcher, runner, blind

    @property
    def by_command(self) -> dict[str, RpcHandler]:
        """Command -> its handler."""
        return {
            "method": self._method,
            "calibration": self._calibration,
            "rate": self._rate,
            "wrist": self._wrist,
            "task": self._task,
            "trial": self._trial,
            "reset": self._reset,
        }

    def status(self) -> dict[str, Any]:
        """Status of the run, without a request to the loop."""
        loop, switcher, runner = self._loop, self._switcher, self._runner()
        used = switcher.used
        task = None if runner is None else runner.task
        trial = None
        if runner is not None and task is not None:
            try:
                trial = runner.report()
            except SmoothOperatorError:  # the scene is just being changed
                task = None
        return {
            "method": used.method,
            "preset": used.preset,
            "rate": loop.config.rate,
            "building": switcher.building,
            "compiling": [s for s, hand in loop.pipelines.items() if hand.supervisor.compiling],
            "blind": self._blind,
            "sides": list(loop.pipelines),
            "hand": next(iter(loop.pipelines.values())).retargeter.hand.name,
            "source": {"label": loop.source.label, **asdict(loop.source.health())},
            "sinks": [asdict(health) for health in loop.sinks.health()],
            "operators": {
                side: None if operator is None else operator.source
                for side, operator in switcher.operators.items()
            },
            "simulation": runner is not None,
            "task": None if task is None else task.name,
            "object": runner is not None and task is not None and runner.object_there,
            "trial": trial,
        }

    def _method(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        method, preset = _text(fields, "method"), _text(fields, "preset")
        if method is None:
            raise ConfigError('which method? {"do": "method", "method": "dexpilot"}')
        return _driven(self._await(self._switcher.choose(method, preset)))

    def _calibration(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        path = _text(fields, "path")
        if path is None:
            none: dict[Side, OperatorProfile | None] = dict.fromkeys(self._loop.pipelines)
            return _driven(self._await(self._switcher.operate(none)))
        operator = read_operator(Path(path))
        spec = self._await(self._switcher.operate({operator.side: operator}))
        return {**_driven(spec), "side": operator.side, "hand": operator.hand}

    def _rate(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        rate = fields.get("rate")
        if isinstance(rate, bool) or not isinstance(rate, int | float):
            raise ConfigError(f"rate: expected commands a second, not {rate!r}")
        self._loop.pace(float(rate))
        return {"rate": self._loop.config.rate}

    def _wrist(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        engage = fields.get("engage")
        if not isinstance(engage, bool):
            raise ConfigError(f"engage: expected true or false, not {engage!r}")
        self._loop.controls.follow(engage)
        return {"engage": engage}

    def _task(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        there = fields.get("object", True)
        if not isinstance(there, bool):
            raise ConfigError(f"object: expected true or false, not {there!r}")
        loaded = self._open_runner().change(_text(fields, "task"), there)
        if loaded is None:
            return {"task": None}
        task = loaded.task
        return {
            "task": loaded.name,
            "title": task.title,
            "instruction": task.instruction,
            "time_limit_s": task.time_limit_s,
            "rubric": [asdict(line) for line in task.rubric],
        }

    def _trial(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        runner = self._open_runner()
        actions = [
            word for word in ("begin", "finish", "cancel", "pause", "resume") if fields.get(word)
        ]
        if len(actions) > 1:
            raise ConfigError(f"a trial can't {' and '.join(actions)} together")
        about = fields.get("about") or {}
        if not isinstance(about, dict) or {"when_clear", "limit_s", "mark"} & about.keys():
            raise ConfigError(f"about: expected an object with other entries, not {about!r}")
        if "begin" in actions:
            clear = bool(fields.get("when_clear"))
            runner.go(when_clear=clear, limit_s=_limit(fields), **about)
        elif "cancel" in actions:
            mark = _text(fields, "mark")
            if mark not in (None, "undone", "void"):
                raise ConfigError(f"mark: expected undone or void, not {mark!r}")
            runner.cancel(mark, **about)
        elif "finish" in actions:
            runner.finish()
        elif actions:
            runner.pause("pause" in actions)
        return runner.report(_side(fields))

    def _reset(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        runner = self._open_runner()
        runner.reset()
        return runner.report(_side(fields))

    def _open_runner(self) -> TrialRunner:
        runner = self._runner()
        if runner is None:
            raise ConfigError(
                "this run has no simulation: start teleop with --task card or with --sink mujoco"
            )
        return runner

    def _await(self, request: Future[DriverSpec]) -> DriverSpec:
        """Wait until the requested method drives the hands, and return it."""
        while True:
            try:
                return request.result(_LOOK_S)
            except TimeoutError:
                if self._loop.controls.quitting:
                    raise ConfigError("the run has ended") from None


def _driven(spec: DriverSpec) -> dict[str, Any]:
    return {"method": spec.method, "preset": spec.preset}


def _text(fields: Mapping[str, Any], name: str) -> str | None:
    value = fields.get(name)
    if value is not None and not (isinstance(value, str) and value):
        raise ConfigError(f"{name}: expected a text, not {value!r}")
    return value


def _limit(fields: Mapping[str, Any]) -> float | None:
    value = fields.get("limit_s")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e5:
        raise ConfigError(f"limit_s: expected seconds above 0, not {value!r}")
    return float(value)


def _side(fields: Mapping[str, Any]) -> Side | None:
    side = _text(fields, "side")
    if side not in (None, "right", "left"):
        raise ConfigError(f"side: expected right or left, not {side!r}")
    return side  # type: ignore[return-value]  # just looked at

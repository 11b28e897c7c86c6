"""Connects a running loop to its page: state as JSON, and actions of the page's controls."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.methods.presets import live_presets
from smooth_operator.planning import RetargetRequest, live_configuration
from smooth_operator.poses import is_valid
from smooth_operator.teleop.control.method_switcher import MethodSwitcher, checked
from smooth_operator.teleop.pages.live.calibration_wizard import CalibrationWizard
from smooth_operator.teleop.pages.live.camera import CameraFeed
from smooth_operator.teleop.pages.live.fields import changed, config_fields
from smooth_operator.teleop.pages.live.rates import RateMeter
from smooth_operator.teleop.pages.live.recordings import Recordings
from smooth_operator.teleop.pages.live.scenery import Scenery
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.sink import Sink, simulated_hands
from smooth_operator.teleop.sinks.tick import ArmCommand, Tick, WristCommand
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import Side

_SEEN_S: Final = 1.0
"""A hand that was not tracked for so long is no longer drawn [s]."""
_EVENTS: Final = 6
_RATE_S: Final = 0.9
_FRAME_RATE_S: Final = 2.0
"""Over how long commands, and the tracker's frames, are counted [s]; a tracker may be slow."""
_TELLING: Final = ("solve", "total")
"""Stages that take so long that one knows the method by them."""


class LiveSession:
    """What a page knows and may do of a loop. Its methods are for the page's thread, but for
    ``watch``, which is for the loop's.

    Args:
        loop: the running loop.
        asked: what the run was begun with.
        sinks: those that it was begun with; of a simulated hand among them the state is shown, and
            what it works on.
        folder: where recordings and calibrations go.
        switcher: builds methods; a new one if left out.
        trial: what is to be shown of the trial of a task; None for nothing.
        blind: nothing on the page shows which method drives the hands, and none can be chosen.
    """

    def __init__(
        self,
        loop: TeleopLoop,
        asked: RetargetRequest,
        sinks: Sequence[Sink] = (),
        folder: Path = Path(),
        *,
        switcher: MethodSwitcher | None = None,
        blind: bool = False,
        trial: Callable[[], Mapping[str, Any] | None] = lambda: None,
    ) -> None:
        self.loop = loop
        self._trial = trial
        self.wizard = CalibrationWizard()
        self.switcher = MethodSwitcher(loop, asked) if switcher is None else switcher
        self.blind = blind
        self.recordings = Recordings(loop.sinks, folder / "takes", self._configuration)
        self._asked, self._folder = asked, folder
        self._simulation = simulated_hands(sinks)
        self._scenery = None if self._simulation is None else Scenery(self._simulation)
        self._camera = CameraFeed(loop.source)
        self._default = LoopConfig(loop.config.rate)
        self._ticks: dict[Side, Tick] = {}
        self._arrivals: dict[Side, Arrival] = {}
        self._events: deque[tuple[float, str]] = deque(maxlen=_EVENTS)
        self._commands = {side: RateMeter(_RATE_S) for side in loop.pipelines}
        self._frames = {side: RateMeter(_FRAME_RATE_S) for side in loop.pipelines}
        self._message = ""
        self._fields_changed = 0
        self._actions: dict[str, Callable[..., None]] = {
            "stop": loop.controls.stop,
            "release": loop.controls.release,
            "pause": loop.controls.pause,
            "resume": loop.controls.resume,
            "follow": loop.controls.follow,
            "record": self.recordings.toggle,
            "method": self._choose,
            "set": self._set,
            "set_loop": self._set_loop,
            "calibrate": self._calibrate,
            "cancel_calibration": self.wizard.cancel,
            "use_operator": self._use_operator,
            "drop_operator": self._drop_operator,
            "save_operator": self._save_operator,
        }
        if blind:
            for name in ("method", "set"):
                del self._actions[name]

    def watch(self, tick: Tick) -> None:
        """Take note of a tick; called by the loop after its sinks."""
        self._ticks[tick.side] = tick
        seen = self.loop.pipelines[tick.side].seen
        if seen is not None and seen is not self._arrivals.get(tick.side):
            self._arrivals[tick.side] = seen
            self.wizard.see(seen)
        if tick.events:
            self._note(tick)

    def do(self, name: str, *values: Any) -> None:
        """Do what a control asks for; what can't be done becomes a message on the page."""
        try:
            if name not in self._actions:
                raise ConfigError(f"the page asks for {name!r}, which is nothing here")
            self._message = ""
            self._actions[name](*values)
        except SmoothOperatorError as error:
            self._message = str(error)
        except TypeError:
            self._message = f"the page asks for {name!r} with the wrong values"

    def look(
        self, *, text: bool, fields: int, scenery: int = 0, picture: int | None = None
    ) -> dict[str, Any]:
        """What to show now, as JSON has it.

        Args:
            text: with figures and controls, not the hands alone.
            fields: for which ``fields_number`` the fields are known already.
            scenery: for which number the shapes of the task's scene are.
            picture: which of the camera's pictures is known; None if none is wanted.
        """
        now = self.loop.mailbox.clock()
        shown: dict[str, Any] = {
            "hands": {side: self._hand(side, tick, now) for side, tick in self._ticks.items()},
            "calibration": self.wizard.look(now),
        }
        if (trial := self._trial()) is not None:
            shown["trial"] = dict(trial)
        if self._scenery is not None:
            shown["scenery"] = self._scenery.look(tuple(self.loop.pipelines), scenery)
        if picture is not None and (camera := self._camera.look(picture, now)) is not None:
            shown["camera"] = camera
        if text:
            shown["status"] = self._status(now)
            shown["controls"] = self._controls(fields)
        return shown

    @property
    def fields_number(self) -> int:
        """Changes when the page has to update the fields: another method, a value refused."""
        shown = self.switcher.wanted
        return hash((shown.method, shown.preset, self.switcher.refused, self._fields_changed))

    def configuration(self) -> str:
        """The configuration as it is now, as JSON text; empty where it is not to be known."""
        if self.blind:
            return ""
        used = self.switcher.used
        content = live_configuration("teleop", self._asked, used.configs, loop=self.loop.config,
                                     source=self.loop.source)  # fmt: skip
        return to_json({**content, **self._configuration()}, indent=2) + "\n"

    def close(self) -> None:
        """End what runs in the background."""
        self.switcher.close()

    def _configuration(self) -> Mapping[str, Any]:
        used = self.switcher.used
        return {
            "method": used.method,
            "preset": used.preset,
            "config": dict(used.configs),
            "loop": self.loop.config,
        }

    def _hand(self, side: Side, tick: Tick, now: float) -> dict[str, Any]:
        arrival = self._arrivals.get(side)
        age = None if arrival is None else now - arrival.received
        state = self._measured(side)
        pipeline = self.loop.pipelines[side]
        return {
            "mode": tick.mode.value,
            "positions": _numbers(tick.command.positions),
            "arm": None if tick.arm is None else _arm(tick.arm, tick.wrist),
            "simulated": None
            if state is None
            else _numbers(np.where(np.isfinite(state), state, tick.command.positions)),
            "human": None
            if arrival is None or age is None or age > _SEEN_S
            else _numbers(_trusted(arrival).ravel()),
            "age_s": age,
            # a method without latches has None, and so has one that is not to be known
            "latched": None if self.blind else pipeline.latched,
            "compiling": pipeline.supervisor.compiling,
            "scale": pipeline.retargeter.config.alignment.scale,
            "wrist": None if arrival is None else _wrist(arrival, tick, pipeline.clutch.released),
        }

    def _measured(self, side: Side) -> np.ndarray | None:
        """(n,) where a hand is, real or simulated [rad]; the one at a task before the other."""
        simulation = self._simulation
        if simulation is not None and simulation.task_now != "none":
            simulated = simulation.state(side)
            return None if simulated is None else simulated.positions
        state = self.loop.sinks.state(side)
        return None if state is None else state.positions

    def _status(self, now: float) -> dict[str, Any]:
        statistics, loop = self.loop.statistics, self.loop
        for side, tick in self._ticks.items():
            self._commands[side].count(tick.number, tick.time)
        for side, meter in self._frames.items():
            meter.count(loop.mailbox.received_of[side], now)
        stages = {
            name: {key: round(found[key], 3) for key in ("p50", "p99")}
            for name, found in statistics.recent(500).items()
            if found and not (self.blind and name in _TELLING)
        }
        return {
            "rates": {side: meter.rate for side, meter in self._commands.items()},
            "frame_rates": {side: meter.rate for side, meter in self._frames.items()},
            "blind": self.blind,
            "stages": stages,
            "missed_share": statistics.missed_share,
            "motion_delay": {
                side: None if (found := delay.now()) is None else found.seconds
                for side, delay in list(statistics.motion.items())
            },
            "unusable": statistics.unusable,
            "refused": {side: dict(p.supervisor.refused) for side, p in loop.pipelines.items()},
            "source": {"label": loop.source.label, **asdict(loop.source.health())},
            "sinks": [asdict(health) for health in loop.sinks.health()],
            "events": [(round(now - at, 1), words) for at, words in list(self._events)],
        }

    def _controls(self, known: int) -> dict[str, Any]:
        switcher = self.switcher
        supervisors = [pipeline.supervisor for pipeline in self.loop.pipelines.values()]
        shown, number = switcher.wanted, self.fields_number
        controls: dict[str, Any] = {
            "building": self._told(switcher.building, "getting ready"),
            "message": self._message
            or self._told(switcher.error, "that could not be done; the experimenter knows why")
            or self.recordings.error,
            "stopped": any(supervisor.stopped for supervisor in supervisors),
            "paused": any(supervisor.paused for supervisor in supervisors),
            "recording": self.recordings.recording,
            "operators": {
                side: None if operator is None else asdict(operator)
                for side, operator in switcher.operators.items()
            },
            "fields_number": number,
        }
        if not self.blind:
            controls["method"], controls["preset"] = shown.method, shown.preset
            controls["presets"] = live_presets()
        if number != known:
            if not self.blind:
                controls["fields"] = [asdict(f) for f in config_fields(shown.shown, shown.base)]
            loop = config_fields(self.loop.config, self._default)
            controls["loop_fields"] = [asdict(field) for field in loop if field.path != "rate"]
        return controls

    def _told(self, words: str, blind: str) -> str:
        """What may name a method, or what is said in its place."""
        return blind if words and self.blind else words

    def _choose(self, method: str, preset: str | None = None) -> None:
        self.switcher.choose(method, preset)

    def _set(self, path: str, value: Any) -> None:
        self.switcher.adjust(lambda config: changed(config, path, value))

    def _set_loop(self, path: str, value: Any) -> None:
        try:
            self.loop.configure(changed(self.loop.config, path, value))
        except SmoothOperatorError:
            self._fields_changed += 1
            raise

    def _calibrate(self, side: Side) -> None:
        if side not in self.loop.pipelines:
            raise ConfigError(f"there is no {side} hand in this run")
        self.wizard.begin(self.loop.pipelines[side].retargeter.hand)

    def _use_operator(self) -> None:
        operator = checked(self.wizard.operator)
        self.switcher.operate({operator.side: operator})
        self._fields_changed += 1

    def _drop_operator(self, side: Side) -> None:
        self.switcher.operate({side: None})
        self._fields_changed += 1

    def _save_operator(self) -> None:
        path = self.wizard.save(self._folder)
        self._message = f"wrote {path.resolve()}; next time: --operator {path}"

    def _note(self, tick: Tick) -> None:
        for words in tick.events:
            line = f"{tick.side}: {words}" if len(self.loop.pipelines) > 1 else words
            if self._events and self._events[-1][1] == line:
                self._events.pop()  # the same again: the newest time counts
            self._events.append((tick.time, line))


def _arm(arm: ArmCommand, wrist: WristCommand | None) -> dict[str, Any]:
    """Joints of an arm, commanded and measured, and where the wrist is to be, in its base."""
    return {
        "positions": _numbers(arm.positions),
        "measured": None if arm.measured is None else _numbers(arm.measured),
        "target": None if wrist is None else _numbers(wrist.pose),
        "state": arm.state,
        "position_error": arm.position_error,
        "clearance": arm.clearance,
    }


def _wrist(arrival: Arrival, tick: Tick, released: bool) -> dict[str, Any] | None:
    """The wrists of a hand; None with a tracker that has none."""
    found, command = arrival.frame.T_world_wrist, tick.wrist
    if found is None or command is None:
        return None
    return {
        "operator": _numbers(found) if command.valid and is_valid(found) else None,
        "world": arrival.frame.world or "its world",
        "target": _numbers(command.pose),
        "base": command.world,
        "engaged": command.engaged,
        "released": released,
    }


def _trusted(arrival: Arrival) -> np.ndarray:
    """(21, 3) landmarks in the tracker's frame [m]; NaN where the tracker has nothing to trust."""
    frame = arrival.frame
    assert frame.valid is not None  # filled in on construction
    return np.where(frame.valid[:, None], frame.landmarks, np.nan)


def _numbers(values: np.ndarray) -> list[float]:
    return [round(value, 5) for value in np.asarray(values, float).tolist()]

"""Provides the state of a running loop to its page as JSON, and carries out the actions of the
page's controls."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, Final

import numpy as np

from smooth_operator.errors import ConfigError, SinkError, SmoothOperatorError
from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.poses import is_valid
from smooth_operator.retargeting.presets import live_presets
from smooth_operator.simulation.arms.arm import inverse, pose_of, rigid
from smooth_operator.simulation.live import LiveSimulation
from smooth_operator.simulation.scenes import Scene, ScenePart
from smooth_operator.simulation.scenes.scene import Mount
from smooth_operator.teleop.cameras import Cameras
from smooth_operator.teleop.control.method_switcher import MethodSwitcher
from smooth_operator.teleop.recording.takes import Takes
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.sinks.feedback import VALID_S
from smooth_operator.teleop.sinks.sink import Sink, simulated_hands
from smooth_operator.teleop.sinks.tick import ArmCommand, Mode, Tick, WristCommand
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.terminal import print_note
from smooth_operator.types import Side

_SEEN_S: Final = 1.0  # time without tracking after which the human hand disappears [s]
_EVENTS: Final = 6
_RATE_S, _FRAME_RATE_S = 0.9, 2.0  # windows of the rates of commands and of the tracker [s]
_TELLING: Final = ("solve", "total")
"""Stages whose duration would reveal the method."""


class LiveSession:
    """Provides a loop's state and actions to a page. The page's threads call its methods, except
    ``watch``, which the loop's thread calls.

    Args:
        loop: the running loop.
        sinks: sinks at the start of the run; a simulated hand among them is shown with its task.
        switcher: switcher of methods.
        takes: recordings of the operator.
        actions: actions of the operator's inputs.
        trial: returns the state of a task's trial, or None.
        blind: hide the method from the operator, who then can't change it.
        change_hand: restarts the run with another hand, given its name.
        other_hands: names for ``change_hand``.
        cameras: cameras whose pictures the pages show; None without cameras.
    """

    def __init__(
        self,
        loop: TeleopLoop,
        sinks: Sequence[Sink],
        switcher: MethodSwitcher,
        takes: Takes,
        actions: Mapping[str, Callable[[], None]],
        *,
        trial: Callable[[], Mapping[str, Any] | None] = lambda: None,
        blind: bool = False,
        change_hand: Callable[[str], None] = lambda name: None,
        other_hands: Sequence[str] = (),
        cameras: Cameras | None = None,
    ) -> None:
        self.loop = loop
        self.cameras = cameras
        self._other_hands = list(other_hands)
        self._trial = trial
        self.switcher = switcher
        self.blind = blind
        self.takes = takes
        self._simulation = simulated_hands(sinks)
        self._ticks: dict[Side, Tick] = {}
        self._arrivals: dict[Side, Arrival] = {}
        self._events: deque[tuple[float, str]] = deque(maxlen=_EVENTS)
        self._commands = {side: RateMeter(_RATE_S) for side in loop.pipelines}
        self._frames = {side: RateMeter(_FRAME_RATE_S) for side in loop.pipelines}
        self._message = ""
        self._actions: dict[str, Callable[..., object]] = {
            **actions,
            "stop": self._stop,
            "release": self._release,
            "record": takes.toggle,
            "keep": takes.keep,
            "discard": takes.discard,
            "hand": self._go_on_with,
        }
        self._change_hand = change_hand
        if not blind:
            self._actions["method"] = switcher.choose
        self._begun: dict[str, float] = {}
        self._stopping = False  # True until the loop carries out the last stop
        self._next_hand = ""

    def watch(self, tick: Tick) -> None:
        """Stores the state at a tick; the loop calls this after its sinks."""
        self._ticks[tick.side] = tick
        if tick.mode is Mode.STOPPED:
            self._stopping = False
        arrival = self.loop.pipelines[tick.side].latest
        if arrival is not None:
            self._arrivals[tick.side] = arrival
        for words in tick.events:
            line = f"{tick.side}: {words}" if len(self.loop.pipelines) > 1 else words
            if self._events and self._events[-1][1] == line:
                self._events.pop()  # a repeated event has its newest time
            self._events.append((tick.time, line))

    def do(self, name: str, *values: Any) -> None:
        """Carries out the action of a control. An error becomes a message on the page."""
        try:
            if name not in self._actions:
                raise ConfigError(f"the page requests the unknown action {name!r}")
            self._message = ""
            self._actions[name](*values)
        except SmoothOperatorError as error:
            self._message = str(error)
        except TypeError:
            self._message = f"the page requests the action {name!r} with wrong values"
        except Exception as error:  # the page must go on because of its stop
            words = f"{name}: {type(error).__name__}: {error}"
            self._message = self._masked(
                words, f"{name} failed; the experimenter's page shows the reason"
            )
            print_note(f"note: a click on the page failed: {words}")

    @property
    def stopped(self) -> bool:
        """True if an emergency stop holds a hand now, or will as of the loop's next command."""
        return self._stopping or any(p.supervisor.stopped for p in self.loop.pipelines.values())

    def look(
        self, *, text: bool, scenery: int = 0, pictures: Sequence[int] | None = None
    ) -> dict[str, Any]:
        """Returns the state for the page, as JSON values.

        Args:
            text: include statistics and controls.
            scenery: number of the task scene whose shapes the page already has.
            pictures: numbers of the cameras' pictures that the page already has; None for no
                pictures.
        """
        if self._next_hand:  # source and sinks end now, which is not a failure
            return {
                "hands": {},
                "notice": f"changing to {self._next_hand}",
                "stopped": self.stopped,
            }
        now = self.loop.mailbox.clock()
        shown: dict[str, Any] = {
            "hands": {side: self._hand(side, tick, now) for side, tick in self._ticks.items()},
        }
        if (trial := self._trial()) is not None:
            shown["trial"] = dict(trial)
        if self._simulation is not None:
            sides = tuple(self.loop.pipelines)
            shown["scenery"] = task_scenes(self._simulation, sides, scenery)
        if self.cameras is not None and pictures is not None:
            shown["cameras"] = self.cameras.states(now, pictures)
        if not self._ticks:  # nor have source and sinks started
            shown["notice"] = "starting"
        elif text:
            shown["status"] = self._status(now)
        if text:
            shown["controls"] = self._controls()
        return shown

    def arrival(self, side: Side) -> Arrival | None:
        """The frame that ``look`` reports as the operator's hand."""
        return self._arrivals.get(side)

    def close(self) -> None:
        """Ends the work in the background."""
        self.switcher.close()

    def _hand(self, side: Side, tick: Tick, now: float) -> dict[str, Any]:
        arrival = self._arrivals.get(side)
        age = None if arrival is None else now - arrival.received
        state = self._measured(side)
        pipeline = self.loop.pipelines[side]
        return {
            "mode": tick.mode.value,
            "positions": _numbers(tick.command.joint_positions),
            "arm": None if tick.arm is None else _arm(tick.arm, tick.wrist),
            "simulated": None
            if state is None
            else _numbers(np.where(np.isfinite(state), state, tick.command.joint_positions)),
            "human": None
            if arrival is None or age is None or age > _SEEN_S
            else _numbers(_trusted(arrival).ravel()),
            "contact": None
            if tick.state is None or tick.state.contact is None or now - tick.state.stamp > VALID_S
            else _numbers(np.nan_to_num(tick.state.contact.levels)),
            "age_s": age,
            "latched": None if self.blind else pipeline.latched,
            "targets": None
            if self.blind or (targets := pipeline.fingertip_targets) is None
            else _numbers(targets.ravel()),
            "closes_at_mm": None if self.blind or arrival is None else _gaps_mm(pipeline, arrival),
            "compiling": self._elapsed(side, pipeline.supervisor.compiling, now),
            "scale": pipeline.retargeter.config.alignment.scale,
            "wrist": None if arrival is None else _wrist(arrival, tick, pipeline.clutch.released),
        }

    def _measured(self, side: Side) -> np.ndarray | None:
        """(n,) measured positions of a real or simulated hand [rad], preferably that of a task."""
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
            name: {key: round(percentiles[key], 3) for key in ("p50", "p99")}
            for name, percentiles in statistics.recent(500).items()
            if percentiles and not (self.blind and name in _TELLING)
        }
        return {
            "rates": {side: meter.rate for side, meter in self._commands.items()},
            "frame_rates": {side: meter.rate for side, meter in self._frames.items()},
            "blind": self.blind,
            "stages": stages,
            "missed_share": statistics.missed_share,
            "motion_delay": {s: delay.now() for s, delay in list(statistics.motion.items())},
            "unusable": statistics.unusable,
            "refused": {side: dict(p.supervisor.refused) for side, p in loop.pipelines.items()},
            "source": {"label": loop.source.label, **asdict(loop.source.health())},
            "sinks": [asdict(health) for health in loop.sinks.health()],
            "events": [(round(now - at, 1), words) for at, words in list(self._events)],
        }

    def _controls(self) -> dict[str, Any]:
        switcher = self.switcher
        supervisors = [pipeline.supervisor for pipeline in self.loop.pipelines.values()]
        building = self._masked(switcher.building, "preparing")
        since = self._elapsed("building", bool(building), self.loop.mailbox.clock())
        controls: dict[str, Any] = {
            "building": building and f"{building}, {since:.0f} s",
            "message": self._message
            or self._masked(
                switcher.error, "the change failed; the experimenter's page shows the reason"
            )
            or self.takes.error,
            "stopped": self.stopped,
            "paused": any(supervisor.paused for supervisor in supervisors),
            "take": self.takes.state(),
        }
        if not self.blind:
            target = switcher.target
            controls["method"], controls["preset"] = target.method, target.preset
            controls["presets"] = live_presets()
            controls["hands"] = self._other_hands
        return controls

    def _elapsed(self, what: str, going_on: bool, now: float) -> float | None:
        """Time since the first look at a running activity [s]; None if it has ended."""
        if not going_on:
            self._begun.pop(what, None)
            return None
        return now - self._begun.setdefault(what, now)

    def _masked(self, words: str, blind: str) -> str:
        """Replaces a text that may name a method by ``blind`` on a page that hides the method."""
        return blind if words and self.blind else words

    def _go_on_with(self, hand: str) -> None:
        self._change_hand(hand)
        self._next_hand = hand

    def _stop(self) -> None:
        self._stopping = True
        self.loop.controls.stop()

    def _release(self) -> None:
        self._stopping = False
        self.loop.controls.release()


def _arm(arm: ArmCommand, wrist: WristCommand | None) -> dict[str, Any]:
    """Commanded and measured joints of an arm, and the target of the wrist in its base."""
    return {
        "positions": _numbers(arm.positions),
        "measured": None if arm.measured is None else _numbers(arm.measured),
        "target": None if wrist is None else _numbers(wrist.pose),
        "state": arm.state,
        "position_error": arm.position_error,
        "clearance": arm.clearance,
    }


def _wrist(arrival: Arrival, tick: Tick, released: bool) -> dict[str, Any] | None:
    """State of a wrist for the page; None if the tracker does not measure it."""
    pose, command = arrival.frame.T_world_wrist, tick.wrist
    if pose is None or command is None:
        return None
    return {
        "tracked": bool(command.valid and is_valid(pose)),
        "engaged": command.engaged,
        "released": released,
    }


def _gaps_mm(pipeline: HandPipeline, arrival: Arrival) -> dict[str, float] | None:
    """Finger -> distance from the thumb that the tracker reports at a touch [mm]; None if
    unknown."""
    landmarks = arrival.frame.landmarks
    palm = 1e3 * float(np.linalg.norm(landmarks[BASES[2]] - landmarks[WRIST]))
    gaps = {name: round(gap * palm, 1) for name, gap in pipeline.pinch_gaps.items()}
    return gaps if gaps and np.isfinite(palm) else None


def _trusted(arrival: Arrival) -> np.ndarray:
    """(21, 3) landmarks in the tracker's frame [m]; NaN where not valid."""
    frame = arrival.frame
    assert frame.valid is not None  # filled in on construction
    return np.where(frame.valid[:, None], frame.landmarks, np.nan)


def _numbers(*arrays: np.ndarray) -> list[float]:
    return [round(value, 5) for array in arrays for value in np.asarray(array, float).tolist()]


class RateMeter:
    """Measures the rate of a counter over windows of at least ``window`` seconds.

    Attributes:
        rate: rate over the last complete window [Hz]; None before the end of the first.
    """

    def __init__(self, window: float) -> None:
        self.rate: float | None = None
        self._window = window
        self._start: tuple[int, float] | None = None

    def count(self, number: int, time: float) -> None:
        """Updates the rate with the counter's value at a time on a monotonic clock [s]."""
        if self._start is None:
            self._start = number, time
        elif time - self._start[1] >= self._window:
            self.rate = round((number - self._start[0]) / (time - self._start[1]), 1)
            self._start = number, time


def task_scenes(
    simulation: LiveSimulation, sides: Sequence[Side], shown_number: int
) -> dict[str, Any]:
    """State of a simulation's task scenes as JSON values, in the palm frame.

    Args:
        shown_number: number of the scenes whose shapes the page already has.

    Returns:
        ``number`` of the scenes; ``poses``: side -> position [m] and quaternion (wxyz) of the
        object; ``away``: sides whose object is currently removed; ``fixtures``: side -> pose of
        the palm frame in the base of an arm that carries the hand; for a new number also
        ``parts``: side -> shapes, and ``views``: side -> rows right, up and toward the viewer.
    """
    number = simulation.world_number
    shown: dict[str, Any] = {"number": number, "poses": {}, "away": [], "fixtures": {}}
    try:
        mounts = {side: simulation.scene_of(side).mount for side in sides}
        for side, mount in mounts.items():
            state = simulation.scene_state(side)
            if state is not None:
                pose = mount.in_palm(state.position, state.quaternion)
                shown["poses"][side] = _numbers(*pose)
                if state.away:
                    shown["away"].append(side)
            if (base := simulation.arm_base(side)) is not None:
                position, turn = mount.palm
                fixture = pose_of(inverse(base) @ rigid(turn, position))
                shown["fixtures"][side] = _numbers(fixture)
        if number != shown_number:
            shown["parts"] = {
                side: [_part(mount, part) for part in simulation.parts_of(side)]
                for side, mount in mounts.items()
            }
            shown["views"] = {side: _view(simulation.scene_of(side), side) for side in sides}
    except SinkError:  # no task, or the scene is changing
        shown["poses"] = {}
        if number != shown_number:
            shown["parts"], shown["views"] = {}, {}
    return shown


def _part(mount: Mount, part: ScenePart) -> dict[str, Any]:
    if not part.moves:
        at, turn = mount.in_palm(part.position, part.quaternion)
        part = replace(part, position=at, quaternion=turn)
    plain = asdict(part)
    return {**plain, "position": _numbers(part.position), "quaternion": _numbers(part.quaternion)}


def _view(scene: Scene, side: Side) -> list[list[float]]:
    """(3, 3) rows right, up and toward the viewer, in the palm frame."""
    azimuth, elevation = np.radians(scene.view)
    azimuth = azimuth if side == "right" else -azimuth
    ahead = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead), -ahead])  # in the world
    _, turn = scene.mount.palm
    return [_numbers(row) for row in axes @ turn]

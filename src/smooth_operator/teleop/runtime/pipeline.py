"""Pipeline of one hand: turns the newest frame, or its absence, into the next command."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.teleop.runtime.clutch import Clutch
from smooth_operator.teleop.runtime.limiter import Limiter
from smooth_operator.teleop.runtime.motion_delay import TrackerDelay
from smooth_operator.teleop.runtime.plausible import SessionCheck, implausible
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.runtime.supervisor import Supervisor
from smooth_operator.teleop.sinks.tick import Driver, Mode, Tick
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import JointCommand, Result, Side, Status

if TYPE_CHECKING:  # which needs the extra arm
    from smooth_operator.teleop.arm.controller import ArmController

SWITCHED: Final = "another method, or other settings"
"""Event of the first tick after a switch; the tick's driver has the details."""
COMPILING: Final = "the method is compiled first; the robot holds"
COMPILED: Final = "the method is compiled"
"""Event of the first tick after a hold for the compiler."""


class HandPipeline:
    """Frames of one hand to commands of one robot hand.

    Not thread-safe: it belongs to the loop; other threads use ``Controls``.

    Args:
        retargeter: method and hand.
        config: policies and limits.
        clock: clock for the times of the stages; the time of a step is an argument.
        driver: names and settings of the method, for the record.
        arm: controller of the arm that carries the hand; None without an arm.
        compiling: True if the method is not compiled yet: the robot holds until ``go_on``.

    Attributes:
        supervisor: mode and policies.
        limiter: limiter with the last command.
        clutch: clutch of the wrist.
        latest: the last frame that was not refused, also in a pause or an emergency stop.
    """

    def __init__(
        self,
        retargeter: Retargeter,
        config: LoopConfig,
        clock: Callable[[], float] = time.perf_counter,
        driver: Driver | None = None,
        arm: ArmController | None = None,
        compiling: bool = False,
    ) -> None:
        self.retargeter = retargeter
        self.arm = arm
        self.driver = driver
        self.config = config
        self.supervisor = Supervisor(config.safety)
        self.limiter = Limiter(retargeter.hand, config.limits)
        self.clutch = Clutch(config)
        self.side: Side = retargeter.hand.spec.side
        self._clock = clock
        self._state = retargeter.init()
        self._target = self.limiter.q  # what the operator asked for last
        self._from = self.limiter.q  # where a blend began
        self._delay = TrackerDelay()
        self._session = SessionCheck(self.side)
        self._last: float | None = None
        self._number = 0
        self.latest: Arrival | None = None
        self._next_events: list[str] = []  # events of the next step
        if compiling:
            self.hold()

    @property
    def mode_now(self) -> Mode:
        """Mode of the next tick, if no frame comes."""
        return self.supervisor.preview(self._clock())

    def switch(self, retargeter: Retargeter, driver: Driver | None = None) -> None:
        """Switch to another method, or other settings, which must be compiled.

        The robot moves on from its last command within the limits.
        """
        self.retargeter, self.driver = retargeter, driver
        self.note(SWITCHED)
        self._state = retargeter.init()
        self.supervisor.restart_blend(self._last)
        self._from = self.limiter.q
        self.go_on()

    def hold(self) -> None:
        """Hold the robot while a method is compiled; frames are shown and not answered."""
        if not self.supervisor.compiling:
            self.supervisor.hold()
            self.note(COMPILING)

    def go_on(self) -> None:
        """End a hold; the robot moves to the operator's hand."""
        if self.supervisor.compiling:
            self.supervisor.compiling = False
            self.note(COMPILED)

    def note(self, text: str) -> None:
        """Add an event to the next step, and so to the record."""
        self._next_events.append(text)

    def pace(self, rate: float) -> None:
        """Change the rate [Hz]."""
        self.config = replace(self.config, rate=rate)

    @property
    def latched(self) -> tuple[str, ...] | None:
        """Fingers that the method has latched to the thumb; None for a method without latches.

        Safe from any thread without a lock, since a state is replaced and never changed."""
        latched = self.retargeter.method.latched(self._state.method)
        if latched is None:
            return None
        fingers = self.retargeter.hand.fingers[1:]
        return tuple(f for f, on in zip(fingers, np.asarray(latched), strict=True) if on)

    @property
    def fingertip_targets(self) -> np.ndarray | None:
        """(F, 3) places of the fingertips that the last frame asks for, in the palm frame [m]; None
        where there are none. Safe from any thread."""
        return self.retargeter.fingertip_targets(self._state)

    def step(self, now: float, arrival: Arrival | None = None) -> Tick:
        """The next command.

        Args:
            now: time of the step, by the clock of the arrivals [s].
            arrival: the newest frame, if one has come since the last step.
        """
        before = self.supervisor.mode
        events, self._next_events = self._next_events, []
        stages: dict[str, float] = {}
        result: Result | None = None
        self.supervisor.update(now)  # what the operator switched since the last step
        if arrival is not None:
            why = implausible(arrival.frame)
            if why is None:
                self._delay.see(arrival)
                why = self.supervisor.admits(arrival, now)
            else:
                self.supervisor.refuse(why)
            if why is None and (doubt := self._session.doubt(arrival)) is not None:
                why = self.supervisor.refuse(doubt.live)
            if why is not None:
                events.append(f"frame refused: {why}")
                arrival = None
            elif not self.supervisor.listens:
                self.latest, arrival = arrival, None
            else:
                self.latest = arrival
                result, stages = self._answer(arrival, now)
                if result.status != Status.OK:
                    events.append(f"frame not used: {result.status.reason}")
        mode = self.supervisor.update(now)
        guarded = self._clock()
        dt = self.config.period if self._last is None else guarded - self._last
        q = self._follow(mode, now, dt)
        velocity = self.limiter.velocity
        wrist = self.clutch.step(mode, guarded, dt, arrival)
        events += self.clutch.events()
        if mode is not before:
            events.append(f"{before.value} -> {mode.value}")
        hand = self.retargeter.hand
        command = JointCommand(
            hand.full_configuration(q),
            hand.joint_names,
            now if arrival is None else arrival.stamp,
        )
        ready = self._clock()
        if result is not None:
            stages["limit"] = (ready - guarded) * 1e3
        arm = None
        if self.arm is not None:
            arm = self.arm.step(
                None if wrist is None else wrist.pose,
                dt,
                command.positions,
                stop=mode is Mode.STOPPED,
            )
            if result is not None:
                stages["arm"] = (self._clock() - ready) * 1e3
        tick = Tick(
            self.side,
            hand.name,
            command,
            hand.coupling_matrix @ velocity,
            mode,
            guarded,
            self._number,
            None if result is None else result.status,
            arrival,
            stages,
            float("nan") if result is None else result.tracking_loss,
            float("nan") if result is None else result.scale,
            tuple(events),
            self.driver,
            wrist,
            arm=arm,
        )
        # Times of commands, not of the frames that they answer: solving occasionally takes longer.
        self._last, self._number = guarded, self._number + 1
        return tick

    def _answer(self, arrival: Arrival, now: float) -> tuple[Result, dict[str, float]]:
        """Result of the method for a frame, and the times of its stages [ms]."""
        start = self._clock()
        if self.supervisor.starts_again:
            self._state = self.retargeter.init()
        state, result = self.retargeter.step(self._state, arrival.frame)
        solved = self._clock()
        if result.status == Status.OK:
            if not self.supervisor.mode.moves:
                self._from = self.limiter.q
            self.supervisor.usable(now)
            self._state = state
            self._target = result.command.positions[list(self.retargeter.hand.actuated)]
        return result, {
            "tracker": self._delay.above_fastest(arrival) * 1e3,
            "receive": (start - arrival.received) * 1e3,
            "solve": (solved - start) * 1e3,
        }

    def _follow(self, mode: Mode, now: float, dt: float) -> np.ndarray:
        """Joint positions that the limits allow in this mode since the last command."""
        if mode is Mode.TRACKING:
            return self.limiter.step(self._target, dt)
        if mode is Mode.BLENDING:
            share = self.supervisor.blend(now)
            return self.limiter.step(self._from + share * (self._target - self._from), dt)
        if mode is Mode.EASING:
            return self.limiter.step(
                self.retargeter.hand.neutral, dt, self.config.safety.ease_velocity
            )
        return self.limiter.rest(dt)

"""Pipeline of one hand: turns the newest frame, or the lack of one, into the next command.

The pipeline checks whether a frame is plausible (size of the hand, side, time in seconds). Its
supervisor is a state machine that decides, from the frames and the time without frames, what the
robot does. Times are arguments.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.io.anatomy import PALM_RANGE_M, Doubt, HandCheck
from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.retargeting.program import RetargetState
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.teleop.runtime.limiter import Clutch, Limiter
from smooth_operator.teleop.runtime.missing_tips import MissingTips
from smooth_operator.teleop.runtime.settings import LoopConfig, SafetyConfig
from smooth_operator.teleop.runtime.statistics import TrackerDelay
from smooth_operator.teleop.sinks.tick import Driver, Mode, Tick
from smooth_operator.teleop.sources.live import LATEST_STAMP_S, Arrival
from smooth_operator.types import HandFrame, JointCommand, Result, Side, Status
from smooth_operator.wrist_following import WristFollower

if TYPE_CHECKING:
    from smooth_operator.teleop.arm.controller import ArmController


REACH_M = 0.5
"""Largest plausible distance of a landmark from the wrist, along any axis [m]."""
_FAR = (
    f"a landmark more than {REACH_M:g} m from the wrist can't belong to a human hand; "
    "landmarks must be in metres"
)

_PALM: Final = (
    "a palm outside {} to {} m can't belong to a human hand; landmarks must be in metres".format(
        *PALM_RANGE_M
    )
)
_MIDDLE: Final = BASES[2]


@np.errstate(all="ignore")  # numbers of any size may come
def implausible(frame: HandFrame) -> str | None:
    """Reason why a frame can't show a human hand, judging by its size and time; None if it can.

    Ignores missing landmarks, since not every method needs them. The reasons are few and contain no
    numbers, so that frames can be counted by reason.
    """
    if frame.stamp is not None and not abs(frame.stamp) < LATEST_STAMP_S:
        return "the timestamp is not a time in seconds"
    p = frame.landmarks
    if (np.abs(p[frame.valid] - p[WRIST]) > REACH_M).any():
        return _FAR
    palm = float(np.linalg.norm(p[_MIDDLE] - p[WRIST]))
    if not np.isfinite(palm):
        return None
    if not PALM_RANGE_M[0] <= palm <= PALM_RANGE_M[1]:
        return _PALM
    return None


@dataclass
class Supervisor:
    """State machine for the mode of one hand, driven by its usable frames and the operator's
    switches.

    Attributes:
        config: the policies.
        mode: mode of the loop for the hand.
        refused: reason -> number of refused frames.
        paused: True while the clutch is released, also in an emergency stop.
        stopped: True while an emergency stop holds the robot.
        compiling: True while the method is compiled: the robot holds, and frames are only shown.
    """

    config: SafetyConfig
    mode: Mode = Mode.WAITING
    refused: dict[str, int] = field(default_factory=dict)
    paused: bool = False
    stopped: bool = False
    compiling: bool = False
    _held: bool = False
    _last_good: float | None = None
    _newest: tuple[int, float] | None = None
    _blend_start: float = 0.0
    _blend_length: float = 0.0

    def admits(self, arrival: Arrival, now: float) -> str | None:
        """Reason to refuse a frame that is not newer than the last one; None if it is newer."""
        stamp, session = arrival.stamp, arrival.session
        if now - arrival.received > self.config.stale_s:
            return self.refuse("too late")
        if self._newest is not None and session == self._newest[0]:
            behind = self._newest[1] - stamp
            if behind == 0:
                return self.refuse("a repeated timestamp")
            if 0 < behind <= self.config.restart_s:
                return self.refuse("out of order")
        self._newest = session, stamp
        return None

    def refuse(self, why: str) -> str:
        """Counts a refused frame under its reason, and returns the reason."""
        self.refused[why] = self.refused.get(why, 0) + 1
        return why

    @property
    def starts_again(self) -> bool:
        """True if the operator takes over again, so that the method's state must be reset."""
        return not self.mode.moves and self.mode is not Mode.HOLDING

    def usable(self, now: float) -> None:
        """Registers a frame that led to a command. After a gap in the frames, begins a blend."""
        if not self.mode.moves:
            gap = self.config.blend_s
            if self.mode is Mode.HOLDING and self._last_good is not None and not self._held:
                gap = min(gap, now - self._last_good)
            self._blend_start, self._blend_length = now, gap
        self._last_good, self._held = now, False

    def hold(self) -> None:
        """Holds the robot while a method is compiled, and then until the next frame arrives."""
        self.compiling = self._held = True

    def restart_blend(self, now: float | None) -> None:
        """Begins to blend smoothly into new commands."""
        if now is not None and self.mode.moves:
            self._blend_start, self._blend_length = now, self.config.blend_s

    def update(self, now: float) -> Mode:
        """Updates the mode to a time, and returns it."""
        self.mode = self._mode(now)
        return self.mode

    def preview(self, now: float) -> Mode:
        """Returns the mode at a time without changing any state."""
        return replace(self)._mode(now)

    def blend(self, now: float) -> float:
        """Weight of the operator's motion in the command, 0 to 1, which starts and ends
        smoothly."""
        if self._blend_length <= 0:
            return 1.0
        x = min(max((now - self._blend_start) / self._blend_length, 0.0), 1.0)
        return x * x * (3 - 2 * x)

    def pause(self) -> None:
        """Releases the clutch."""
        self.paused = True

    def resume(self) -> None:
        """Engages the clutch: the robot moves to the pose of the operator's hand."""
        self.paused = False

    def stop(self) -> None:
        """Starts an emergency stop, which lasts until ``release`` is called."""
        self.stopped = True

    def release(self) -> None:
        """Ends an emergency stop; the operator takes over as after a pause."""
        self.stopped = False

    @property
    def listens(self) -> bool:
        """True if new frames move the robot."""
        return not (self.paused or self.stopped or self.compiling)

    def _mode(self, now: float) -> Mode:
        if self.stopped:
            return Mode.STOPPED
        if self.paused:
            return Mode.PAUSED
        if self.mode in (Mode.STOPPED, Mode.PAUSED):
            # The hand holds until a frame comes, and then blends to it.
            self._last_good = None
            return Mode.WAITING
        if self._last_good is None:
            return Mode.WAITING
        if self._held:
            return Mode.HOLDING
        silence = now - self._last_good
        if silence > self.config.lost_s and self.config.on_loss == "ease":
            return Mode.EASING
        if silence > self.config.stale_s:
            return Mode.HOLDING
        if now - self._blend_start < self._blend_length:
            return Mode.BLENDING
        return Mode.TRACKING


SWITCHED: Final = "changed to another method or to other settings"
"""Event of the first tick after a switch. ``Tick.driver`` has the details."""
COMPILING: Final = "compiling the method; the robot holds its pose"
COMPILED: Final = "the method is compiled"
"""Event of the first tick after the robot was held while its method was compiled."""
NOT_FINITE: Final = "the command was not finite; the last one is repeated"


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method computed for a frame.

    Attributes:
        arrival: the frame.
        state: state of the method after it.
        result: result of the method.
        stages: name of a stage -> its duration [ms].
    """

    arrival: Arrival
    state: RetargetState
    result: Result
    stages: dict[str, float]


class HandPipeline:
    """Turns frames of one human hand into commands for one robot hand.

    Not thread-safe: it belongs to the loop; other threads use ``Controls``.

    Args:
        retargeter: method and hand.
        config: policies and limits.
        clock: clock for the durations of the stages; the time of a step is an argument.
        driver: names and settings of the method, for recordings.
        arm: controller of the arm that carries the hand; None without an arm.
        compiling: True if the method is not compiled yet: the robot holds until ``go_on``.
        wrist_joints: True to command the wrist joints of the hand, if it has any.

    Attributes:
        hand: the robot hand with the joints that are commanded.
        supervisor: mode and policies.
        limiter: limiter with the last command.
        clutch: clutch of the wrist.
        latest: the last frame that was not refused, even during a pause or an emergency stop.
        filled: finger -> number of frames in which its missing fingertip was filled in.
    """

    def __init__(
        self,
        retargeter: Retargeter,
        config: LoopConfig,
        clock: Callable[[], float] = time.perf_counter,
        driver: Driver | None = None,
        arm: ArmController | None = None,
        compiling: bool = False,
        wrist_joints: bool = False,
    ) -> None:
        # Method and state are replaced together: a page reads them while the loop switches.
        self._driven: tuple[Retargeter, RetargetState] = retargeter, retargeter.init()
        self.arm = arm
        self.driver = driver
        self.config = config
        self.supervisor = Supervisor(config.safety)
        self.hand = with_wrist_joints(retargeter.hand) if wrist_joints else retargeter.hand
        self._wrist = None if self.hand is retargeter.hand else WristFollower(retargeter.hand)
        self.limiter = Limiter(self.hand, config.limits)
        self.clutch = Clutch(config)
        self.side: Side = retargeter.hand.spec.side
        self._clock = clock
        self._target = self.limiter.q  # last target from the operator
        self._from = self.limiter.q  # start of a blend
        self._delay = TrackerDelay()
        self._check = HandCheck(self.side)
        self._session: int | None = None  # the one that it checks
        self._tips = MissingTips()
        self._filled: tuple[str, ...] = ()  # fingers of the last frame
        self.filled: Counter[str] = Counter()
        self._answered: int | None = None  # session of the last frame that became a target
        self._last: float | None = None
        self._number = 0
        self._mode = self.supervisor.mode  # of the last tick
        self.latest: Arrival | None = None
        self._frame: HandFrame | None = None  # the latest, with its missing fingertips
        self._next_events: list[str] = []  # events of the next step
        if compiling:
            self.hold()

    @property
    def retargeter(self) -> Retargeter:
        """The retargeter, with its method and hand. Safe from any thread."""
        return self._driven[0]

    @property
    def mode_now(self) -> Mode:
        """Mode of the next tick if no frame arrives."""
        return self.supervisor.preview(self._clock())

    def switch(self, retargeter: Retargeter, driver: Driver | None = None) -> None:
        """Switches to another method or to other settings, which must be compiled already.

        The robot moves on from its last command within the limits.
        """
        self._driven, self.driver = (retargeter, retargeter.init()), driver
        self.note(SWITCHED)
        self.supervisor.restart_blend(self._last)
        self._from = self.limiter.q
        self.go_on()

    def hold(self) -> None:
        """Holds the robot while a method is compiled; frames are shown but do not move the
        robot."""
        if not self.supervisor.compiling:
            self.supervisor.hold()
            self.note(COMPILING)

    def go_on(self) -> None:
        """Ends a hold; the robot moves to the pose of the operator's hand."""
        if self.supervisor.compiling:
            self.supervisor.compiling = False
            self.note(COMPILED)

    def note(self, text: str) -> None:
        """Adds an event to the next tick, so that it is recorded."""
        self._next_events.append(text)

    def pace(self, rate: float) -> None:
        """Changes the command rate [Hz]."""
        self.config = replace(self.config, rate=rate)

    @property
    def latched(self) -> tuple[str, ...] | None:
        """Fingers that the method has latched to the thumb; None for a method without latches.

        Safe from any thread.
        """
        retargeter, state = self._driven
        latched = retargeter.method.latched(state.method)
        if latched is None:
            return None
        fingers = retargeter.hand.fingers[1:]
        return tuple(f for f, on in zip(fingers, np.asarray(latched), strict=True) if on)

    @property
    def pinch_gaps(self) -> dict[str, float]:
        """Maps each finger to the gap that the tracker reports while it touches the thumb [palm
        lengths].

        Safe from any thread.
        """
        retargeter, state = self._driven
        return retargeter.pinch_gaps(state)

    @property
    def fingertip_targets(self) -> np.ndarray | None:
        """(F, 3) targets of the fingertips of the last frame in the palm frame [m], or None.

        Safe from any thread.
        """
        retargeter, state = self._driven
        return retargeter.fingertip_targets(state)

    def step(self, now: float, arrival: Arrival | None = None) -> Tick:
        """Computes the next command: calls ``admit``, ``solve`` and ``command`` in turn.

        Args:
            now: time of the step, by the clock of the arrivals [s].
            arrival: the newest frame, if one has come since the last step.
        """
        arrival = None if arrival is None else self.admit(now, arrival)
        return self.command(now, None if arrival is None else self.solve(arrival))

    def admit(self, now: float, arrival: Arrival) -> Arrival | None:
        """Returns the frame if the method must solve it; None if it is refused or does not move the
        robot."""
        self.supervisor.update(now)  # for switches since the last step
        why = implausible(arrival.frame)
        if why is None:
            self._delay.see(arrival)
            why = self.supervisor.admits(arrival, now)
        else:
            self.supervisor.refuse(why)
        if why is None and (doubt := self._doubt(arrival)) is not None:
            why = self.supervisor.refuse(advice(doubt))
        if why is not None:
            self.note(f"frame refused: {why}")
            return None
        self.latest = arrival
        self._frame, filled = self._tips.fill(arrival.frame)
        for finger in filled:
            self.filled[finger] += 1
        if filled != self._filled:
            self._filled = filled
            lost = (
                f"{' and '.join(filled)} not seen, so estimated from the other joints"
                if filled
                else "all seen again"
            )
            self.note(f"fingertips: {lost}")
        return arrival if self.supervisor.listens else None

    def solve(self, arrival: Arrival) -> Answer:
        """Runs the method on the frame from the last ``admit``.

        This may take long and changes nothing, so another thread may call ``command`` meanwhile.
        """
        start = self._clock()
        (retargeter, state), frame = self._driven, self._frame or arrival.frame
        if self.supervisor.starts_again:
            state = retargeter.init(before=state)
        state, result = retargeter.step(state, frame)
        stages = {
            "tracker": self._delay.above_fastest(arrival) * 1e3,
            "receive": (start - arrival.received) * 1e3,
            "solve": (self._clock() - start) * 1e3,
        }
        return Answer(arrival, state, result, stages)

    def command(self, now: float, answer: Answer | None = None) -> Tick:
        """Computes the next command, from the method's result for a frame or without a new
        frame."""
        result, arrival = (None, None) if answer is None else (answer.result, answer.arrival)
        stages = {} if answer is None else dict(answer.stages)
        if answer is not None:
            self._take(answer, now)
        mode = self.supervisor.update(now)
        guarded = self._clock()
        dt = self.config.period if self._last is None else guarded - self._last
        before = self.limiter.q, self.clutch.limiter.pose
        q = self._follow(mode, now, dt)
        wrist = self.clutch.step(mode, guarded, dt, arrival)
        if not all(
            np.isfinite(x).all() for x in (q, self.limiter.velocity, self.clutch.limiter.pose)
        ):
            # No known fault leads here: it is the last check before a robot.
            self.limiter.put(before[0])
            self.clutch.limiter.put(before[1])
            q = self.limiter.q
            wrist = None if wrist is None else replace(wrist, pose=before[1])
            self.note(NOT_FINITE)
        velocity = self.limiter.velocity
        events, self._next_events = [*self._next_events, *self.clutch.events()], []
        if mode is not self._mode:
            events.append(f"{self._mode.value} -> {mode.value}")
        self._mode = mode
        hand = self.hand
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
                command.joint_positions,
                stop=mode is Mode.STOPPED,
            )
            if result is not None:
                stages["arm"] = (self._clock() - ready) * 1e3
        tick = Tick(
            self.side,
            hand.name,
            command,
            hand.transmission.slopes(q) @ velocity,
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
        # Time of the command, not of the answered frame: solving may take long.
        self._last, self._number = guarded, self._number + 1
        return tick

    def _doubt(self, arrival: Arrival) -> Doubt | None:
        """Reason to distrust the side or landmark order of the session's frames so far, or None."""
        if arrival.session != self._session:
            self._session, self._check = arrival.session, HandCheck(self.side)
        frame = arrival.frame
        assert frame.valid is not None  # filled in by HandFrame
        return self._check.see(frame.landmarks, frame.valid, arrival.received)

    def _take(self, answer: Answer, now: float) -> None:
        """Make a method's result the target, if it is usable."""
        result = answer.result
        if result.status != Status.OK:
            self.note(f"frame not used: {result.status.reason}")
            return
        session, before = answer.arrival.session, self._answered
        if before not in (None, session):
            self.supervisor.restart_blend(now)  # a hand in place of a controller, or a restart
        if not self.supervisor.mode.moves or before != session:
            self._from = self.limiter.q
        self._answered = session
        fingers = list(self.retargeter.hand.actuated)
        self._target = result.command.joint_positions[fingers]
        if self._wrist is not None:
            if self.supervisor.starts_again or self.clutch.released:
                self._wrist.release(self.limiter.q[len(fingers) :])
            if not self.clutch.released:
                frame = answer.arrival.frame
                world = answer.arrival.session, frame.world
                self._wrist.follow(frame.T_world_wrist, frame.forearm, world)
            self._target = np.concatenate([self._target, self._wrist.target])
        self.supervisor.usable(now)
        self._driven = self.retargeter, answer.state

    def _follow(self, mode: Mode, now: float, dt: float) -> np.ndarray:
        """Joint positions of the next command in this mode, within the limits."""
        if mode is Mode.TRACKING:
            return self.limiter.step(self._target, dt)
        if mode is Mode.BLENDING:
            share = self.supervisor.blend(now)
            return self.limiter.step(self._from + share * (self._target - self._from), dt)
        if mode is Mode.EASING:
            return self.limiter.step(self.hand.neutral, dt, self.config.safety.ease_velocity)
        return self.limiter.rest(dt)


def advice(doubt: Doubt) -> str:
    """Describes a problem with the landmarks in the frames, and its remedy, in a few words."""
    if doubt.side is not None:
        return (
            f"judging by its shape, it is a {doubt.side} hand; use side={doubt.side}, or "
            "do not mirror it"
        )
    if doubt.layout is not None:
        return f"landmarks in the order {doubt.layout!r}; for a source, set layout={doubt.layout}"
    if doubt.mend:
        return f"{doubt.what}; {doubt.mend}"
    return f"the landmarks are in another order; reorder them: points[{list(doubt.order or ())}]"

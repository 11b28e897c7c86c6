"""The teleoperation loop: turns the newest frame of each hand into a command for the sinks."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from queue import SimpleQueue
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.teleop.runtime.limiter import RateLimiter
from smooth_operator.teleop.runtime.pipeline import Answer, HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.runtime.statistics import LoopStatistics
from smooth_operator.teleop.sinks.sink import SinkRunner
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.teleop.sources.live import LiveSource, Mailbox
from smooth_operator.types import Side


class TeleopLoop:
    """Drives robot hands from a source until it is stopped.

    The loop processes a frame as soon as it arrives, so waiting adds no latency. When no frames
    arrive, commands are sent at the loop's rate; they hold the robot or move it slowly to its safe
    pose (``SafetyConfig``). The commands of a hand never exceed the rate (``RateLimiter``), except
    for the first one of an emergency stop.

    An emergency stop does not wait for a method: while a method compiles or takes long, another
    thread commands the stop.

    Args:
        pipelines: side -> pipeline of the hand.
        source: source of the frames.
        sinks: sinks of the commands.
        config: pace and policies.
        mailbox: mailbox between source and loop, with the clock.
        watch: called with every tick after the sinks, for example by a page; must be quick.

    Attributes:
        controls: switches, for any thread.
        statistics: statistics of the run.
        watch: the argument; may be set before ``run``.
    """

    def __init__(
        self,
        pipelines: Mapping[Side, HandPipeline],
        source: LiveSource,
        sinks: SinkRunner,
        config: LoopConfig,
        *,
        mailbox: Mailbox | None = None,
        watch: Callable[[Tick], None] | None = None,
    ) -> None:
        self.pipelines = dict(pipelines)
        self.source = source
        self.sinks = sinks
        self.config = config
        self.mailbox = Mailbox() if mailbox is None else mailbox
        self.controls = Controls(self.mailbox)
        self.mailbox.stop, self.mailbox.mode = self.controls.stop, self._mode
        self.statistics = LoopStatistics(config.period)
        self.watch = watch
        for side, pipeline in self.pipelines.items():
            pipeline.clutch.measured = functools.partial(self._measured_wrist, side)
        self._beat = self.mailbox.clock()
        self._rate_limiters = {side: RateLimiter(config.period) for side in self.pipelines}
        self._changed_sides: set[Side] = set()  # hands with a change since their last command
        self._stopped: set[Side] = set()  # hands whose emergency stop the sinks don't know yet
        self._turn = threading.Lock()  # held by the stop's thread while it commands
        self._held_up = False  # True while the loop's thread makes no commands
        self._stand_ins = 0  # number of commands of the stop's thread

    def run(
        self,
        duration: float | None = None,
        configuration: Mapping[str, Any] = {},
        started: Callable[[], None] = lambda: None,
    ) -> None:
        """Opens the sinks, starts the source, and runs the loop.

        Args:
            duration: length of the run [s]; None until ``Controls.quit`` or the source's end.
            configuration: resolved configuration, for sinks that store it.
            started: called once, when everything is open and before anything moves.

        Raises:
            SourceError, SinkError, OutputError, MissingExtraError: a part can't be opened; the open
                ones are closed.
        """
        hands = {side: pipeline.hand for side, pipeline in self.pipelines.items()}
        self.sinks.open(hands, configuration)
        try:
            self.source.start(self.mailbox)
            try:
                # Before `started`, which gives real-time priority to existing threads.
                with self._stops_at_once():
                    started()
                    with self._watchdog():
                        self._loop(duration)
            finally:
                self.source.stop()
        finally:
            self.sinks.close()

    def pace(self, rate: float) -> None:
        """Changes the command rate, starting with the next command.

        Args:
            rate: commands per second and hand [Hz].

        Raises:
            ConfigError: the rate is out of its range.
        """
        self.config = replace(self.config, rate=rate)
        period = self.config.period
        self.controls.change(lambda hand: hand.pace(rate))
        self.statistics.period = period
        for pace in self._rate_limiters.values():
            pace.period = period

    @property
    def silent_s(self) -> float:
        """Time since the last command or, before the first one, since the loop's start [s]."""
        return self.mailbox.clock() - self._beat

    def _mode(self) -> str:
        """One mode for all hands, to show to the operator: that of the hand that moves least."""
        hands = [pipeline.supervisor for pipeline in self.pipelines.values()]
        for mode, is_so in (
            (Mode.STOPPED.value, [hand.stopped for hand in hands]),
            (Mode.PAUSED.value, [hand.paused for hand in hands]),
            ("compiling", [hand.compiling for hand in hands]),
        ):
            if any(is_so):
                return mode
        return min((hand.mode for hand in hands), key=lambda mode: mode.moves).value

    def _loop(self, duration: float | None) -> None:
        clock, sides = self.mailbox.clock, tuple(self.pipelines)
        start = clock()
        for pace in self._rate_limiters.values():
            pace.begin(start)
        ended: float | None = None
        while not self.controls.quitting:
            now = clock()
            if duration is not None and now - start >= duration:
                return
            if self.source.health().state == "ended":
                # Only a recording ends so, after the policies for silence.
                ended = now if ended is None else ended
                if now - ended > self.config.safety.lost_s:
                    return
            self._wait(sides)
            self._change()
            for side in sides:
                self._serve(side)

    def _wait(self, sides: Sequence[Side]) -> None:
        """Sleep until the next command, frame or change is due."""
        if self.controls.waiting:
            return
        count, now = self.mailbox.received, self.mailbox.clock()
        opens = [self._rate_limiters[side].opens for side in sides]
        until = min(
            at if at > now else self._due(side, now) for side, at in zip(sides, opens, strict=True)
        )
        # A frame need not wake the loop before a command may leave.
        self.mailbox.sleep(until - now, count if min(opens) <= now else None)

    def _change(self) -> None:
        """Carry out the pending changes of the switches."""
        free = {side for side, hand in self.pipelines.items() if not hand.supervisor.stopped}
        for change in self.controls.drain():
            for side, pipeline in self.pipelines.items():
                with self._away():
                    change(pipeline)
                self._changed_sides.add(side)  # informs the sinks as soon as the pace allows
        self._stopped |= {side for side in free if self.pipelines[side].supervisor.stopped}

    def _due(self, side: Side, now: float) -> float:
        """Time at which the next command of a hand is due [s]."""
        pace, following = self._rate_limiters[side], self.mailbox.following(side)
        if side in self._stopped:
            return now
        if side in self._changed_sides:
            return min(pace.opens, now)
        arrival = self.mailbox.newest(side)
        if arrival is None:
            return pace.keeps(following)
        return pace.answers(arrival.received, following)

    def _serve(self, side: Side) -> None:
        """Send a command for the newest frame of a hand, or to keep the pace."""
        now, pace = self.mailbox.clock(), self._rate_limiters[side]
        if now < pace.opens and side not in self._stopped:
            return
        due = self._due(side, now)
        if now < due:
            return
        pipeline, arrival = self.pipelines[side], self.mailbox.take(side)
        answer, stand_ins = None, self._stand_ins
        if arrival is not None and (frame := pipeline.admit(now, arrival)) is not None:
            with self._away():
                answer = pipeline.solve(frame)
            if self._stand_ins != stand_ins:
                return  # the robot was stopped meanwhile
        self._command(side, now, due, answer)

    def _command(self, side: Side, now: float, due: float, answer: Answer | None = None) -> None:
        """Send the next command of a hand to the sinks."""
        self._changed_sides.discard(side)
        self._stopped.discard(side)
        self._rate_limiters[side].take(now)
        tick = self.pipelines[side].command(now, answer)
        state = self.sinks.state(side)
        if state is not None:
            stages = dict(tick.stages)
            if state.contact is not None and tick.status is not None:
                stages["contact"] = (tick.time - state.stamp) * 1e3
            tick = replace(tick, state=state, stages=stages)
        if tick.arm is not None and (measured := self.sinks.measured_arm(side)) is not None:
            tick = replace(tick, arm=replace(tick.arm, measured=measured))
        before = self.mailbox.clock()
        self.sinks.send(tick)
        sent = self._beat = self.mailbox.clock()
        if tick.status is not None:
            tick = replace(tick, stages={**tick.stages, "send": (sent - before) * 1e3})
        self.sinks.observe(tick)
        self.statistics.add(tick, due, sent)
        if self.watch is not None:
            self.watch(tick)

    def _measured_wrist(self, side: Side) -> Float[np.ndarray, "7"] | None:
        """Pose of a hand's wrist on its arm: as a sink measured it, or else as last commanded."""
        measured, arm = self.sinks.measured_wrist(side), self.pipelines[side].arm
        return arm.pose if measured is None and arm is not None else measured

    @contextlib.contextmanager
    def _away(self) -> Iterator[None]:
        """Marks a block in which the loop's thread may take long and sends no commands."""
        self._held_up = True
        try:
            yield
        finally:
            with self._turn:
                self._held_up = False

    @contextlib.contextmanager
    def _stops_at_once(self) -> Iterator[None]:
        """Runs a thread that commands an emergency stop while the loop's thread is held up."""
        done = threading.Event()

        def stand_in() -> None:
            while (stop := self.controls.stops.get()) is not None:
                while not (stop.taken or done.is_set()):
                    with self._turn:
                        if self._held_up:
                            self._command_stop()
                    done.wait(self.config.period)

        def end() -> None:
            done.set()
            self.controls.stops.put(None)

        with _thread(stand_in, "stop", end):
            yield

    def _command_stop(self) -> None:
        """Send the next command of an emergency stop to each hand."""
        now = self.mailbox.clock()
        for side, pipeline in self.pipelines.items():
            pipeline.supervisor.stop()
            self._stand_ins += 1
            self._command(side, now, now)

    @contextlib.contextmanager
    def _watchdog(self) -> Iterator[None]:
        """Runs a thread that tells the sinks when the loop sends no commands."""
        done = threading.Event()
        self._beat = self.mailbox.clock()

        def watch() -> None:
            while not done.wait(self.config.safety.watchdog_s / 2):
                silence = self.silent_s
                if silence > self.config.safety.watchdog_s:
                    self.sinks.stalled(silence)

        with _thread(watch, "watchdog", done.set):
            yield


@contextlib.contextmanager
def _thread(work: Callable[[], None], name: str, end: Callable[[], None]) -> Iterator[None]:
    """Runs a thread during the block; ``end`` makes it return."""
    thread = threading.Thread(target=work, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        end()
        thread.join()


Change: TypeAlias = Callable[[HandPipeline], None]
"""Function that changes a hand's pipeline between two of its steps."""


class Stop:
    """A change that stops a hand in an emergency.

    Attributes:
        taken: True once the loop has carried it out.
    """

    taken = False

    def __call__(self, hand: HandPipeline) -> None:
        """Stop a hand; called on the loop's thread."""
        hand.supervisor.stop()
        self.taken = True


class Controls:
    """Controls of a loop; safe to use from any thread and from a signal handler.

    Each takes effect before the loop's next command, and wakes the loop.

    Args:
        mailbox: mailbox on which the loop waits.

    Attributes:
        stops: emergency stops, for the thread that carries them out while the loop can't.
    """

    def __init__(self, mailbox: Mailbox) -> None:
        self.stops: SimpleQueue[Stop | None] = SimpleQueue()
        self._mailbox = mailbox
        self._pending: deque[Change] = deque()
        self._stops = 0  # number of stops: a release ends only the earlier ones
        self._quit = threading.Event()

    def pause(self) -> None:
        """Releases the clutch: the robot holds its position."""
        self.change(lambda hand: hand.supervisor.pause())

    def resume(self) -> None:
        """Engages the clutch: the robot moves to the pose of the operator's hand."""
        self.change(lambda hand: hand.supervisor.resume())

    def follow(self, on: bool) -> None:
        """Engages or releases the wrist clutch; the fingers continue to follow."""
        self.change(lambda hand: hand.clutch.follow(on))

    def stop(self) -> None:
        """Emergency stop: the robot brakes and stays stopped until ``release`` is called."""
        self._stops += 1
        stop = Stop()
        self._pending.appendleft(stop)  # before all pending changes
        self.stops.put(stop)
        self._mailbox.wake()

    def release(self) -> None:
        """Ends an emergency stop, unless another one comes before the release takes effect."""
        stops = self._stops

        def release(hand: HandPipeline) -> None:
            if self._stops == stops:
                hand.supervisor.release()

        self.change(release)

    def change(self, change: Change) -> None:
        """Applies a change to every hand, on the loop's thread; the change must be quick."""
        self._pending.append(change)
        self._mailbox.wake()

    def quit(self) -> None:
        """Ends the loop."""
        self._quit.set()
        # A signal handler may run inside the mailbox, on the thread that holds its lock.
        threading.Thread(target=self._mailbox.wake, daemon=True).start()

    @property
    def quitting(self) -> bool:
        """True if the loop was asked to end."""
        return self._quit.is_set()

    @property
    def waiting(self) -> bool:
        """True if a change is pending."""
        return bool(self._pending) or self.quitting

    def drain(self) -> list[Change]:
        """Returns the pending changes in order and clears them; only the loop may call this."""
        changes = []
        while self._pending:
            changes.append(self._pending.popleft())
        return changes

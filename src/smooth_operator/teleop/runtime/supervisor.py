"""Supervisor of a hand: a state machine over frames and silence, without a clock."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from smooth_operator.teleop.runtime.settings import SafetyConfig
from smooth_operator.teleop.sinks.tick import Mode
from smooth_operator.teleop.sources.live import Arrival


@dataclass
class Supervisor:
    """Mode of one hand, from the times of its usable frames and the operator's switches.

    Attributes:
        config: the policies.
        mode: what the loop is doing with the hand.
        refused: why -> number of frames that were refused.
        compiling: the method is being compiled: the robot holds, and frames are only shown.
    """

    config: SafetyConfig
    mode: Mode = Mode.WAITING
    refused: dict[str, int] = field(default_factory=dict)
    compiling: bool = False
    _held: bool = False
    _last_good: float | None = None
    _newest: tuple[int, float] | None = None
    _blend_start: float = 0.0
    _blend_length: float = 0.0
    _paused: bool = False
    _stopped: bool = False

    def admits(self, arrival: Arrival, now: float) -> str | None:
        """True if a frame is newer than all before it; if not, why it is refused."""
        stamp, session = arrival.stamp, arrival.session
        if now - arrival.received > self.config.stale_s:
            return self.refuse("too late")
        if self._newest is not None and session == self._newest[0]:
            behind = self._newest[1] - stamp
            if behind == 0:
                return self.refuse("a stamp that came before")
            if 0 < behind <= self.config.restart_s:
                return self.refuse("out of order")
        self._newest = session, stamp
        return None

    def refuse(self, why: str) -> str:
        """Count a frame that is not used, by its reason; returns the reason."""
        self.refused[why] = self.refused.get(why, 0) + 1
        return why

    @property
    def starts_again(self) -> bool:
        """True if the operator is new to the robot: what a method remembers means nothing then."""
        return not self.mode.moves and self.mode is not Mode.HOLDING

    def usable(self, now: float) -> None:
        """A frame was answered; one that ends a silence begins a blend."""
        if not self.mode.moves:
            gap = self.config.blend_s
            if self.mode is Mode.HOLDING and self._last_good is not None and not self._held:
                gap = min(gap, now - self._last_good)
            self._blend_start, self._blend_length = now, gap
        self._last_good, self._held = now, False

    def hold(self) -> None:
        """Begin a hold while a method is compiled; it lasts until a frame after ``compiling``."""
        self.compiling = self._held = True

    def restart_blend(self, now: float | None) -> None:
        """Something else asks for commands from now on: go over to it smoothly."""
        if now is not None and self.mode.moves:
            self._blend_start, self._blend_length = now, self.config.blend_s

    def update(self, now: float) -> Mode:
        """The mode at a time."""
        self.mode = self._mode(now)
        return self.mode

    def preview(self, now: float) -> Mode:
        """The mode at a time, without going there."""
        return replace(self)._mode(now)

    def blend(self, now: float) -> float:
        """Share of the operator in the command, 0 to 1, with a smooth start and end."""
        if self._blend_length <= 0:
            return 1.0
        x = min(max((now - self._blend_start) / self._blend_length, 0.0), 1.0)
        return x * x * (3 - 2 * x)

    def pause(self) -> None:
        """Release the clutch."""
        self._paused = True

    def resume(self) -> None:
        """Take the clutch: the robot goes over to where the operator's hand is now."""
        self._paused = False

    def stop(self) -> None:
        """Emergency stop; latched."""
        self._stopped = True

    def release(self) -> None:
        """End an emergency stop; the operator takes over as after a pause."""
        self._stopped = False

    @property
    def stopped(self) -> bool:
        """True if an emergency stop holds the robot; safe from any thread."""
        return self._stopped

    @property
    def paused(self) -> bool:
        """True if the clutch is released, in an emergency stop, too; safe from any thread."""
        return self._paused

    @property
    def listens(self) -> bool:
        """Frames move the robot."""
        return not (self._paused or self._stopped or self.compiling)

    def _mode(self, now: float) -> Mode:
        if self._stopped:
            return Mode.STOPPED
        if self._paused:
            return Mode.PAUSED
        if self.mode in (Mode.STOPPED, Mode.PAUSED):
            # The hand stays put until a frame comes, and then goes over to it.
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

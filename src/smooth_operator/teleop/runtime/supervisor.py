"""Supervisor of a hand: a state machine over frames and silence; times are arguments."""

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
        mode: mode of the loop for the hand.
        refused: reason -> number of refused frames.
        compiling: True while the method is compiled: the robot holds, and frames are only shown.
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
        """Reason to refuse a frame that is not newer than the last one; None if it is newer."""
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
        """Count a refused frame by its reason, and return the reason."""
        self.refused[why] = self.refused.get(why, 0) + 1
        return why

    @property
    def starts_again(self) -> bool:
        """True if the operator takes over again, so that the state of the method must be reset."""
        return not self.mode.moves and self.mode is not Mode.HOLDING

    def usable(self, now: float) -> None:
        """Register an answered frame; after a silence it begins a blend."""
        if not self.mode.moves:
            gap = self.config.blend_s
            if self.mode is Mode.HOLDING and self._last_good is not None and not self._held:
                gap = min(gap, now - self._last_good)
            self._blend_start, self._blend_length = now, gap
        self._last_good, self._held = now, False

    def hold(self) -> None:
        """Begin a hold for the compiler; it lasts until a frame after ``compiling``."""
        self.compiling = self._held = True

    def restart_blend(self, now: float | None) -> None:
        """Begin a blend, since the origin of the commands changes."""
        if now is not None and self.mode.moves:
            self._blend_start, self._blend_length = now, self.config.blend_s

    def update(self, now: float) -> Mode:
        """The mode at a time."""
        self.mode = self._mode(now)
        return self.mode

    def preview(self, now: float) -> Mode:
        """The mode at a time, without a change of state."""
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
        """Engage the clutch: the robot moves to the operator's current hand."""
        self._paused = False

    def stop(self) -> None:
        """Emergency stop; latched."""
        self._stopped = True

    def release(self) -> None:
        """End an emergency stop; the operator takes over as after a pause."""
        self._stopped = False

    @property
    def stopped(self) -> bool:
        """True while an emergency stop holds the robot; safe from any thread."""
        return self._stopped

    @property
    def paused(self) -> bool:
        """True while the clutch is released, also in an emergency stop; safe from any thread."""
        return self._paused

    @property
    def listens(self) -> bool:
        """True if frames move the robot."""
        return not (self._paused or self._stopped or self.compiling)

    def _mode(self, now: float) -> Mode:
        if self._stopped:
            return Mode.STOPPED
        if self._paused:
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

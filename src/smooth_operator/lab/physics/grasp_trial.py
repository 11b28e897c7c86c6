"""A pinch of a robot hand tried on an object in physics: held, pushed, let go."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.grasp_physics import GraspPhysics

HOLD_S: Final = 1.0
"""How long the object must be held [s]."""
GRACE_S: Final = 0.2
"""The hand must have the object so long after the human's tightest moment [s]."""
REST_S: Final = HOLD_S + GRACE_S + 0.05
"""How long the human rests at the tightest moment [s]."""
PUSH_N: Final = 0.3
"""[N]"""
OPEN_S: Final = 0.15
"""The object must be free so long after the human has opened [s]."""
HYSTERESIS: Final = 0.003
"""The human has opened where the skins are farther apart than the object's width by this [m]."""

_GRIP_N: Final = 0.2  # thumb and finger press so hard [N]...
_GRIP_S: Final = 0.05  # ... for so long before the object is let go [s]
_LOST_S: Final = 0.03  # not pressed from both sides for so long is lost [s]
_ALONE_S: Final = 0.25  # of the hold, without a push [s]
_LIMIT: Final = 0.99  # of a motor's torque


@dataclass(frozen=True, eq=False)
class RobotPinch:
    """What the robot is commanded in a pinch, and when the human does what.

    Attributes:
        finger: which finger pinches, as an index of ``Hand.fingers``.
        stamps: (T,) of the commands [s].
        commands: (T, n) positions of all joints [rad].
        tight: when the human's fingers are nearest, and rest [s].
        shut: until when the human holds the object [s]; None: until the end of the recording.
        opened: when the human has opened, by ``HYSTERESIS`` more [s]; None: never.
    """

    finger: int
    stamps: Float[np.ndarray, " T"]
    commands: Float[np.ndarray, "T n"]
    tight: float
    shut: float | None
    opened: float | None


@dataclass(frozen=True)
class GraspResult:
    """How a pinch fared with an object.

    Attributes:
        touched: the pads came as near as the object is wide.
        held: thumb and finger pressed on it for a second under gravity and pushes, gaps of up to
            30 ms aside.
        dropped: thumb and finger had it, and lost it while the human still held.
        let_go: it was free in time after the human opened; None where it was not held until then,
            or the recording ends before.
        delay: from the human's opening until it was free [s]; None likewise, or if it never was.
        gap: how much wider than the object the pads stayed [m]; 0 where they touched.
        force: with which thumb and finger pressed while it was held, mean of the weaker of both
            [N]; None where there was no hold.
        at_limit: share of the hold in which a motor was at its torque limit; None likewise.
    """

    touched: bool
    held: bool = False
    dropped: bool = False
    let_go: bool | None = None
    delay: float | None = None
    gap: float = 0.0
    force: float | None = None
    at_limit: float | None = None


def try_pinch(physics: GraspPhysics, pinch: RobotPinch) -> GraspResult:
    """Do a pinch with an object.

    The object appears between the pads when they are as far apart as it is wide, on the way to
    closing. Somebody holds it loosely until both pads press on it, or until ``GRACE_S`` after the
    human's tightest moment. Then it must stay for ``HOLD_S``, in which it is pushed in six
    directions one after the other, and be free ``OPEN_S`` after the human has opened.
    """
    run = _Run(physics, pinch)
    gap = run.close()
    if gap > 0.0:
        return GraspResult(False, gap=gap)
    if not run.hand_over():
        return GraspResult(True, dropped=run.gripped)
    held = run.hold()
    force, limit = run.force, run.at_limit
    if not held:
        return GraspResult(True, dropped=run.gripped, force=force, at_limit=limit)
    end = float(pinch.stamps[-1])
    opened = pinch.opened if pinch.opened is not None and pinch.opened + OPEN_S <= end else None
    free = run.release(end if opened is None else opened + OPEN_S)
    if free is not None and free < (end if pinch.shut is None else pinch.shut):
        return GraspResult(True, True, True, force=force, at_limit=limit)
    if opened is None:
        return GraspResult(True, True, force=force, at_limit=limit)
    delay = None if free is None else free - opened
    return GraspResult(True, True, False, free is not None, delay, 0.0, force, limit)


class _Run:
    """One trial, stage after stage."""

    def __init__(self, physics: GraspPhysics, pinch: RobotPinch) -> None:
        self._physics, self._pinch = physics, pinch
        self._start = float(pinch.stamps[0])
        self._frame = 0
        self._grips: list[float] = []
        self._efforts: list[float] = []
        self.gripped = False
        physics.begin(pinch.finger, pinch.commands[0])
        self._zero = physics.time

    @property
    def time(self) -> float:
        """By the pinch's clock [s]."""
        return self._start + self._physics.time - self._zero

    @property
    def force(self) -> float | None:
        """Mean force while it was held [N]."""
        return float(np.mean(self._grips)) if self._grips else None

    @property
    def at_limit(self) -> float | None:
        """Share of the hold in which a motor was at its limit."""
        return float(np.mean(np.array(self._efforts) > _LIMIT)) if self._efforts else None

    def close(self) -> float:
        """Until the pads are as near as the object is wide; how much wider they stay [m]."""
        width = self._physics.thing.width
        before, least = -1.0, np.inf
        for _ in self._until(self._pinch.tight + GRACE_S):
            gap = self._physics.gap().distance
            least = min(least, gap - width)
            if before > width >= gap:
                self._physics.appear()
                return 0.0
            before = gap
        # Pads that never were as far apart as the object could not take it.
        return max(float(least), 1e-6)

    def hand_over(self) -> bool:
        """Until both pads press on the object; False if it is lost before the hold begins."""
        pressed = 0.0
        for step in self._until(self._pinch.tight + GRACE_S):
            pressed = pressed + step if min(self._physics.pinch) > _GRIP_N else 0.0
            if pressed >= _GRIP_S:
                self.gripped = True
                break
        self._physics.let_go()
        return all(self._has(step) for step in self._until(self._pinch.tight))

    def hold(self) -> bool:
        """Gravity, then pushes; whether the object stays."""
        physics = self._physics
        axes, begin = physics.axes, self.time
        pushes = [sign * PUSH_N * axes[:, k] for k in range(3) for sign in (1.0, -1.0)]
        each = (HOLD_S - _ALONE_S) / len(pushes)
        stays, lost = True, 0.0
        for step in self._until(begin + HOLD_S):
            number = int((self.time - begin - _ALONE_S) / each)
            if self.time - begin > _ALONE_S:
                physics.push(pushes[min(number, len(pushes) - 1)])
            pinch = physics.pinch
            self._grips.append(min(pinch))
            self._efforts.append(physics.effort)
            lost = 0.0 if min(pinch) > 0.0 else lost + step
            stays = lost < _LOST_S
            if not stays:
                break
        physics.push(np.zeros(3))
        return stays

    def release(self, deadline: float) -> float | None:
        """Until the object is free; when that was [s]; None if not by the deadline."""
        lost = 0.0
        for step in self._until(deadline + _LOST_S):
            lost = 0.0 if min(self._physics.pinch) > 0.0 else lost + step
            if lost >= _LOST_S:
                return self.time - lost
        return None

    def _has(self, step: float) -> bool:
        """Whether both fingers press, brief gaps aside."""
        self._lost = 0.0 if min(self._physics.pinch) > 0.0 else self._lost + step
        return self._lost < _LOST_S

    _lost = 0.0

    def _until(self, end: float) -> Iterator[float]:
        """Let time pass in steps of the physics, with the commands that are due."""
        physics, pinch = self._physics, self._pinch
        while self.time < end - 1e-9:
            while self._frame < len(pinch.stamps) and pinch.stamps[self._frame] <= self.time + 1e-9:
                physics.command(pinch.commands[self._frame])
                self._frame += 1
            physics.advance(physics.timestep)
            yield physics.timestep

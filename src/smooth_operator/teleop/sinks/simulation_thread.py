"""The thread of a simulation: steps the physics of its hands, hears commands, shows scenes."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Mapping
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError
from smooth_operator.simulation.arms.carried import CarriedHand, WristKinematics
from smooth_operator.simulation.live import Watcher
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.simulation.scenes import ScenePhysics, SceneState
from smooth_operator.teleop.sinks.hand_state import HandState
from smooth_operator.types import Side

_WAKE_S: Final = 0.004
"""How often the thread wakes for several steps; waking costs more than a step."""

_SLICE_S: Final = 0.01
"""Longest that the physics goes on without a look at commands, and at what happened [s]."""

_BEHIND_S: Final = 0.1
"""Time that is given up, rather than made up for, when the machine is too slow [s]."""

_Target = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " a"] | None]
"""Joint positions of a hand and of its arm [rad]."""

_NUMBERS: Final = itertools.count(1)


class World:
    """The thread that steps the physics of all hands in real time.

    Args:
        physics: of each hand.
        events: where it is said what went wrong.
        carried: arms that carry hands.
    """

    def __init__(
        self,
        physics: Mapping[Side, HandPhysics],
        events: list[str],
        carried: Mapping[Side, CarriedHand],
    ) -> None:
        now = time.perf_counter()
        self.kinematics = {
            side: WristKinematics(carried[side]) for side in physics if side in carried
        }
        self.arms = {
            side: arm for side, p in physics.items() if (arm := p.arm_positions) is not None
        }
        self.number = next(_NUMBERS)
        self.seen = {side: _measured(side, p, now) for side, p in physics.items()}
        self.physics, self._events = physics, events
        self.scenes: dict[Side, SceneState] = {
            side: p.observe() for side, p in physics.items() if isinstance(p, ScenePhysics)
        }
        self._watchers: dict[Side, Watcher] = {}
        self._there: dict[Side, bool] = {}  # whether the object is to be put back or away
        self._targets: dict[Side, _Target | None] = {}
        self._frozen: set[Side] = set()
        self._changed = threading.Lock()
        self._error: Exception | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mujoco", daemon=True)
        self._thread.start()

    def command(
        self,
        side: Side,
        positions: Float[np.ndarray, " n"],
        arm: Float[np.ndarray, " a"] | None,
    ) -> None:
        """New targets of the servos of a hand, and of its arm.

        Raises:
            SinkError: the simulation has ended.
        """
        if self._error is not None:
            raise SinkError(f"mujoco: the simulation ended: {self._error}") from self._error
        with self._changed:
            self._targets[side] = positions, arm

    def hold(self) -> None:
        """Have the hands stay where they are."""
        with self._changed:
            for side in self.physics:
                self._targets[side] = None  # stands for: where it is

    def watch(self, side: Side, watcher: Watcher | None) -> None:
        """Have each new state of a scene given to a watcher; None takes it away."""
        with self._changed:
            if watcher is None:
                self._watchers.pop(side, None)
            else:
                self._watchers[side] = watcher

    def reset_object(self, side: Side, physics: ScenePhysics) -> int:
        """Have the object put back; ``starts`` of the states after it."""
        with self._changed:
            self._there[side] = True
            return physics.starts + 1

    def put_away(self, side: Side) -> None:
        """Have no object."""
        with self._changed:
            self._there[side] = False

    def freeze(self, side: Side, frozen: bool) -> None:
        """Have a hand and its scene stand still, or go on."""
        with self._changed:
            (self._frozen.add if frozen else self._frozen.discard)(side)

    def end(self) -> None:
        """Stop."""
        self._ending.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        try:
            last = time.perf_counter()
            held: set[Side] = set()
            while not self._ending.wait(_WAKE_S):
                now = time.perf_counter()
                due, last = min(now - last, _BEHIND_S), now
                while due > 0.0:
                    self._take(held)
                    self._step(min(due, _SLICE_S), now)
                    due -= _SLICE_S
        except Exception as error:  # reaches the loop with its next command
            self._error = error

    def _take(self, held: set[Side]) -> None:
        """The newest commands; ``held`` are the hands that stay where they are."""
        with self._changed:
            targets, self._targets = self._targets, {}
        for side, target in targets.items():
            if target is not None:
                positions, arm = target
                self.physics[side].command(positions)
                if arm is not None:
                    self.physics[side].command_arm(arm)
                held.discard(side)
            elif side not in held:  # once: a hand that is held again and again would creep
                self.physics[side].hold()
                held.add(side)

    def _step(self, seconds: float, now: float) -> None:
        for side, physics in self.physics.items():
            with self._changed:
                frozen, asked = side in self._frozen, side in self._there
            if frozen:
                self.seen[side] = _measured(side, physics, now)
                if asked and isinstance(physics, ScenePhysics):
                    self._show(side, physics)  # the object may be put back meanwhile
                continue
            if not physics.advance(seconds):
                text = f"the physics of the {side} hand came apart and was set back"
                resets = f"{text} ({physics.resets} times)" if physics.resets > 1 else text
                self._events[:] = [e for e in self._events if not e.startswith(text)] + [resets]
            self.seen[side] = _measured(side, physics, now)
            if (arm := physics.arm_positions) is not None:
                self.arms[side] = arm
            if isinstance(physics, ScenePhysics):
                self._show(side, physics)

    def _show(self, side: Side, physics: ScenePhysics) -> None:
        """The scene's new state, to whom it concerns; resets that were asked for."""
        with self._changed:
            watcher = self._watchers.get(side)
            there = self._there.pop(side, None)
        if there is not None:
            (physics.reset_object if there else physics.put_away)()
        state = self.scenes[side] = physics.observe()
        if watcher is not None:
            watcher(state, physics.positions)


def _measured(side: Side, physics: HandPhysics, now: float) -> HandState:
    """What encoders in the joints would say."""
    hand = physics.hand
    return HandState(side, hand.name, now, hand.joint_names, physics.positions)

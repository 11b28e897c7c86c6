"""One hand of the robot: its keys, its limiter, and the sink that moves and measures it."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_smooth_hand.config_smooth_hand import SmoothHandConfig
from lerobot_robot_smooth_hand.wrist_port import WristPort
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.runtime.limiter import Limiter
from smooth_operator.teleop.runtime.settings import LimitsConfig
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import HandState, Mode, Tick
from smooth_operator.types import JointCommand
from smooth_operator_devices.hands.hardware_sink import HardwareSink

if TYPE_CHECKING:  # which needs the extra arm
    from smooth_operator.teleop.arm.controller import ArmController

FACTORS = {"degrees": 180.0 / math.pi, "radians": 1.0}
"""Unit of the keys -> number of these units per radian."""

TACTILE = {"none": "", "newtons": "newtons", "levels": "level"}
"""Setting of the contact that is observed -> end of its keys."""

_PAUSE_S = 0.5
"""Length of a pause after which the hand approaches the next action slowly [s]."""

_APPROACH = 0.5
"""Speed at which an approach begins [rad/s]; it increases by 2 rad/s each second."""

_ARRIVED = 0.02
"""Distance from the action at which an approach ends [rad]."""

_PATIENCE_S = 5.0
"""Longest time that ``connect`` waits for the first measurement [s]."""


class HandPort:
    """One hand of the robot: its keys, its limiter, and the sink that moves it.

    Args:
        hand: the robot hand.
        config: settings of the robot.
        joints: model's joint -> name in the keys; empty for all actuated ones.
        prefix: prefix of the keys.
        arm: controller of the arm that carries the hand; None without an arm.

    Raises:
        ValueError: a joint can't be commanded on this hand, or two joints have the same name.
    """

    def __init__(
        self,
        hand: Hand,
        config: SmoothHandConfig,
        joints: Mapping[str, str],
        prefix: str,
        arm: ArmController | None = None,
    ) -> None:
        self.hand, self.side = hand, hand.spec.side
        self._config, self._factor = config, FACTORS[config.unit]
        own = hand.joint_names if config.keys == "all" else hand.actuated_names
        names = dict(joints) or {name: name for name in own}
        unknown = [name for name in joints if name not in hand.actuated_names]
        if unknown:
            raise ValueError(
                f"joints: {', '.join(unknown)} can't be commanded on {hand.name} "
                f"{self.side}, which has {', '.join(hand.actuated_names)}"
            )
        self.keys = tuple(f"{prefix}{name}.pos" for name in names.values())
        if len(set(self.keys)) < len(self.keys):
            raise ValueError(f"joints: two joints have the same key: {', '.join(self.keys)}")
        self._prefix, quantity = prefix, TACTILE[config.tactile]
        self.tactile = tuple(
            f"{prefix}tactile.{finger}.{quantity}" for finger in hand.fingers if quantity
        )
        self.wrist = WristPort(config.wrist, prefix, self.side, arm, self._factor)
        commanded = [name for name in names if name in hand.actuated_names]
        self._given = [f"{prefix}{names[name]}.pos" for name in commanded]
        self._places = [hand.actuated_names.index(name) for name in commanded]
        self._measured = [hand.joint_names.index(name) for name in names]
        limits = LimitsConfig(config.velocity, config.acceleration)
        self._limiter = Limiter(hand, limits)
        self._target = self._limiter.q.copy()
        self._last, self._approach_since, self._number = -math.inf, math.inf, 0
        self._sink: Sink | None = None
        self._seen: HandState | None = None

    def attach(self, sinks: Sequence[Sink]) -> None:
        """Find the sink that measures the hand, and start from the measured pose.

        Raises:
            DeviceNotConnectedError: no sink measures the hand, or some joints or the contact of
                fingers that the settings ask for are not measured.
        """
        state, deadline = None, time.perf_counter() + _PATIENCE_S
        while time.perf_counter() < deadline:
            state = self._look(sinks)
            if state is not None and (not self.tactile or state.contact is not None):
                break
            time.sleep(0.02)
        if state is None:
            raise DeviceNotConnectedError(
                f"none of the sinks {', '.join(sink.label for sink in sinks)} measures the "
                f"{self.side} hand; name mujoco or a driver in --robot.sinks"
            )
        actuated = np.asarray(state.positions)[list(self.hand.actuated)]
        unknown = [self.hand.actuated_names[i] for i in np.flatnonzero(~np.isfinite(actuated))]
        if unknown and self._config.unmeasured == "refuse":
            raise DeviceNotConnectedError(
                f"the {self.side} hand does not measure {', '.join(unknown)}; to observe their "
                "commands instead, set --robot.unmeasured=command"
            )
        self._contact(state)
        self._limiter.put(np.where(np.isfinite(actuated), actuated, self.hand.neutral))
        self._target = self._limiter.q.copy()
        self._last = -math.inf  # the first action is approached slowly, however soon it comes
        self.wrist.attach(sinks)

    def currents(self, sinks: Sequence[Sink]) -> tuple[str, ...]:
        """Keys of the currents, from the driver's table; known before the sinks are open.

        Raises:
            ValueError: no sink has a table of this hand's actuators.
        """
        if not self._config.currents:
            return ()
        for sink in sinks:
            if isinstance(sink, HardwareSink) and sink.side in (None, self.side):
                names = [actuator.name for actuator in sink.actuators(self.side).actuators]
                return tuple(f"{self._prefix}{name}.current" for name in names)
        raise ValueError(f"currents: no driver in --robot.sinks measures the {self.side} hand")

    def send(self, action: Mapping[str, float], sinks: Sequence[Sink]) -> dict[str, float]:
        """Move towards an action within the limits; returns the values that were sent.

        Raises:
            ValueError: a key is missing, or a value is not a number.
        """
        needed = (*self._given, *self.wrist.keys)
        missing = [key for key in needed if key not in action]
        if missing:
            raise ValueError(f"the action lacks {', '.join(missing)}")
        if not all(math.isfinite(action[key]) for key in needed):
            raise ValueError(f"the action has values that are not numbers: {dict(action)}")
        wanted = np.array([float(action[key]) for key in self._given]) / self._factor
        now = time.perf_counter()
        pause = now - self._last
        if pause > _PAUSE_S:
            self._approach_since, pause = now, 1.0 / 30.0
            self._limiter.put(self._limiter.q)  # the hand has come to rest meanwhile
            self.wrist.approach(now)
        self._last = now
        low, high = self.hand.limits.T
        self._target[self._places] = wanted
        self._target = np.clip(self._target, low, high)
        slow = None
        if math.isfinite(self._approach_since):
            slow = _APPROACH + 2.0 * (now - self._approach_since)
        q = self._limiter.step(self._target, pause, slow)
        if np.abs(self._target - q).max() < _ARRIVED:
            self._approach_since = math.inf
        positions = self.hand.full_configuration(q)
        wrist, arm = self.wrist.step(action, now, pause, positions)
        tick = Tick(
            self.side,
            self.hand.name,
            JointCommand(positions, self.hand.joint_names, now),
            self.hand.transmission.slopes(self._limiter.q) @ self._limiter.velocity,
            Mode.TRACKING,
            now,
            self._number,
            wrist=wrist,
            arm=arm,
        )
        self._number += 1
        for sink in sinks:
            sink.send(tick)
        sent = self._factor * positions[self._measured]
        return {**dict(zip(self.keys, sent.tolist(), strict=True)), **self.wrist.values(wrist)}

    def observation(self, sinks: Sequence[Sink]) -> dict[str, float]:
        """Measurements of the hand and its arm, in the unit of the keys.

        Raises:
            DeviceNotConnectedError: the newest measurement is too old.
        """
        state = self._state()
        age = time.perf_counter() - state.time
        if age > self._config.stale_s:
            note = "" if self._sink is None else self._sink.note
            raise DeviceNotConnectedError(
                f"the {self.side} hand has not been measured for {age:.1f} s: "
                f"{note or 'the device does not answer'}"
            )
        angles = np.asarray(state.positions)
        commanded = self.hand.full_configuration(self._limiter.q)
        angles = self._factor * np.where(np.isfinite(angles), angles, commanded)
        values = dict(zip(self.keys, angles[self._measured].tolist(), strict=True))
        if self._config.currents:
            values |= self._currents(state)
        return values | self._contact(state) | self.wrist.observation(sinks)

    def _currents(self, state: HandState) -> dict[str, float]:
        keys = [f"{self._prefix}{name}.current" for name in state.actuators]
        if state.currents is None or not np.isfinite(state.currents).all():
            raise DeviceNotConnectedError(
                f"the {self.side} hand does not measure the currents of all actuators; remove "
                "--robot.currents"
            )
        return dict(zip(keys, state.currents.tolist(), strict=True))

    def _contact(self, state: HandState) -> dict[str, float]:
        """Contact of each finger by its key; empty if the settings do not ask for it."""
        if not self.tactile:
            return {}
        found = state.contact
        values = None if found is None else getattr(found, self._config.tactile)
        if values is None or not np.isfinite(values).all():
            other = "" if found is None else "; set --robot.tactile=levels"
            raise DeviceNotConnectedError(
                f"the {self.side} hand does not measure the contact of all fingers in "
                f"{self._config.tactile}{other or '; remove --robot.tactile'}"
            )
        return dict(zip(self.tactile, values.tolist(), strict=True))

    def _look(self, sinks: Sequence[Sink]) -> HandState | None:
        for sink in sinks:
            state = sink.state(self.side)
            if state is not None:
                self._sink, self._seen = sink, state
                return state
        return None

    def _state(self) -> HandState:
        """The newest measurement; while the device is disconnected, the last one before."""
        state = None if self._sink is None else self._sink.state(self.side)
        if state is not None:
            self._seen = state
        if self._seen is None:
            raise DeviceNotConnectedError(f"the {self.side} hand is not measured")
        return self._seen

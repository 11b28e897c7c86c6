"""The robot: LeRobot's interface to a sink that moves a hand and measures it."""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from lerobot.robots.robot import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_smooth_hand.config_smooth_hand import SmoothHandConfig
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.teleop.runtime.limiter import Limiter
from smooth_operator.teleop.runtime.settings import LimitsConfig
from smooth_operator.teleop.sinks.registry import build_sink
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.types import JointCommand

logger = logging.getLogger(__name__)

_FACTORS = {"degrees": 180.0 / math.pi, "radians": 1.0}

_PAUSE_S = 0.5
"""After a pause as long as this the hand approaches the action slowly [s]."""

_APPROACH = 0.5
"""Speed at which an approach begins [rad/s]; 2 rad/s faster with each second."""

_ARRIVED = 0.02
"""An approach has ended this near to the action [rad]."""

_PATIENCE_S = 5.0
"""How long ``connect`` waits for the first measurement [s]."""


class _HandPort:
    """One hand: its keys, its limiter, and the sink that moves it.

    Args:
        hand: the robot hand.
        config: settings of the robot.
        joints: model's joint -> name in the keys; empty for all actuated ones.
        prefix: of the keys.

    Raises:
        ValueError: the hand has no such joint to command, or two have one name.
    """

    def __init__(
        self, hand: Hand, config: SmoothHandConfig, joints: Mapping[str, str], prefix: str
    ) -> None:
        self.hand, self.side = hand, hand.spec.side
        self._config, self._factor = config, _FACTORS[config.unit]
        names = dict(joints) or {name: name for name in hand.actuated_names}
        unknown = [name for name in names if name not in hand.actuated_names]
        if unknown:
            raise ValueError(
                f"joints: {', '.join(unknown)} can't be commanded on {hand.name} "
                f"{self.side}, which has {', '.join(hand.actuated_names)}"
            )
        self.keys = tuple(f"{prefix}{name}.pos" for name in names.values())
        if len(set(self.keys)) < len(self.keys):
            raise ValueError(f"joints: two joints have one key: {', '.join(self.keys)}")
        self._prefix = prefix
        self._places = [hand.actuated_names.index(name) for name in names]
        self._measured = [hand.joint_names.index(name) for name in names]
        limits = LimitsConfig(config.velocity, config.acceleration)
        self._limiter = Limiter(hand, limits)
        self._target = self._limiter.q.copy()
        self._last, self._approach_since, self._number = -math.inf, math.inf, 0
        self._sink: Sink | None = None

    def attach(self, sinks: list[Sink]) -> None:
        """Find the sink that measures the hand, and begin where the hand is.

        Raises:
            DeviceNotConnectedError: no sink measures it, or not all of its joints.
        """
        deadline = time.perf_counter() + _PATIENCE_S
        while (state := self._look(sinks)) is None and time.perf_counter() < deadline:
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
                "command in place of it, set --robot.unmeasured=command"
            )
        low, high = self.hand.limits.T
        start = np.where(np.isfinite(actuated), actuated, self.hand.neutral)
        self._limiter.q = np.clip(start, low, high)
        self._target = self._limiter.q.copy()

    @property
    def currents(self) -> tuple[str, ...]:
        """Keys of the currents; known once the sink is open."""
        if not self._config.currents:
            return ()
        return tuple(f"{self._prefix}{name}.current" for name in self._state().actuators)

    def send(self, action: Mapping[str, float], sinks: list[Sink]) -> dict[str, float]:
        """Move towards an action within the limits; returns what was sent.

        Raises:
            ValueError: a key is missing, or a value is no number.
        """
        missing = [key for key in self.keys if key not in action]
        if missing:
            raise ValueError(f"the action lacks {', '.join(missing)}")
        wanted = np.array([float(action[key]) for key in self.keys]) / self._factor
        if not np.isfinite(wanted).all():
            raise ValueError(f"the action has values that are no numbers: {dict(action)}")
        now = time.perf_counter()
        pause = now - self._last
        if pause > _PAUSE_S:
            self._approach_since, pause = now, 1.0 / 30.0
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
        self._command(q, now, sinks)
        return dict(zip(self.keys, (self._factor * q[self._places]).tolist(), strict=True))

    def observation(self) -> dict[str, float]:
        """What the hand measures, in the unit of the keys.

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
        angles = np.asarray(state.positions)[self._measured]
        commanded = self._limiter.q[self._places]
        angles = self._factor * np.where(np.isfinite(angles), angles, commanded)
        values = dict(zip(self.keys, angles.tolist(), strict=True))
        if self._config.currents:
            currents = np.nan_to_num(np.asarray(state.currents, np.float64)).tolist()
            values.update(zip(self.currents, currents, strict=True))
        return values

    def _command(self, q: np.ndarray, now: float, sinks: list[Sink]) -> None:
        names, positions = self.hand.joint_names, self.hand.full_configuration(q)
        tick = Tick(
            self.side,
            self.hand.name,
            JointCommand(positions, names, now),
            self.hand.full_configuration(self._limiter.velocity)
            - self.hand.full_configuration(np.zeros_like(q)),
            Mode.TRACKING,
            now,
            self._number,
        )
        self._number += 1
        for sink in sinks:
            sink.send(tick)

    def _look(self, sinks: list[Sink]) -> Any:
        for sink in sinks:
            state = sink.state(self.side)
            if state is not None:
                self._sink = sink
                return state
        return None

    def _state(self) -> Any:
        state = None if self._sink is None else self._sink.state(self.side)
        if state is None:
            raise DeviceNotConnectedError(f"the {self.side} hand is not measured")
        return state


class SmoothHand(Robot):
    """A robot hand that smooth-operator's sinks move and measure.

    Actions and observations have the same keys, ``JOINT.pos``, one for each joint that is
    commanded. An action is followed within the limits of position, velocity and acceleration;
    the first one, and one after half a second of silence, is approached slowly. Real hands rest
    when no action comes for 0.2 s (``docs/robots`` says how).

    Args:
        config: settings.

    Raises:
        ValueError: a setting is wrong.
        SmoothOperatorError: there is no such hand or sink.
    """

    config_class = SmoothHandConfig
    name = "smooth_hand"

    def __init__(self, config: SmoothHandConfig) -> None:
        super().__init__(config)
        self.config = config
        self._hands = _hand_ports(config)
        self._sinks: list[Sink] = [build_sink(text) for text in config.sinks]
        self._connected = False
        self.cameras: dict[str, Any] = _cameras(config)

    @property
    def action_features(self) -> dict[str, type]:
        """Key -> ``float``."""
        return {key: float for hand in self._hands for key in hand.keys}

    @property
    def observation_features(self) -> dict[str, Any]:
        """Key -> ``float``, and the shape of each camera's picture."""
        features: dict[str, Any] = dict(self.action_features)
        for hand in self._hands:
            features |= dict.fromkeys(hand.currents, float)
        for name, camera in self.config.cameras.items():
            features[name] = (camera.height, camera.width, 3)
        return features

    @property
    def is_connected(self) -> bool:
        """Whether the hand can be moved."""
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        """Always: a driver has its table, see ``smooth-operator hardware check``."""
        return True

    def calibrate(self) -> None:
        """Nothing to do; see ``smooth-operator hardware check``."""

    def configure(self) -> None:
        """Nothing to do."""

    def connect(self, calibrate: bool = True) -> None:
        """Open the sinks and the cameras, and find out where the hand is. Nothing moves.

        Raises:
            DeviceAlreadyConnectedError: it is connected.
            DeviceNotConnectedError: the hand is not measured.
            SmoothOperatorError: a sink can't be opened.
        """
        if self._connected:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        hands = {hand.side: hand.hand for hand in self._hands}
        about = {"program": "lerobot", "hand": self.config.hand, "sinks": list(self.config.sinks)}
        with contextlib.ExitStack() as opened:
            for sink in self._sinks:
                sink.open(hands, about)
                opened.callback(sink.close)
            for hand in self._hands:
                hand.attach(self._sinks)
            for camera in self.cameras.values():
                camera.connect()
                opened.callback(camera.disconnect)
            opened.pop_all()
        self._connected = True

    def get_observation(self) -> dict[str, Any]:
        """Measured joints, currents and pictures.

        Raises:
            DeviceNotConnectedError: not connected, or the newest measurement is too old.
        """
        self._check()
        seen: dict[str, Any] = {}
        for hand in self._hands:
            seen |= hand.observation()
        for name, camera in self.cameras.items():
            seen[name] = camera.async_read()
        return seen

    def send_action(self, action: Mapping[str, float]) -> dict[str, float]:
        """Move towards an action; keys that the hand does not have are left out.

        Returns:
            What was sent, within the limits.

        Raises:
            DeviceNotConnectedError: not connected.
            ValueError: a key is missing, or a value is no number.
            SinkError: the hand can't be reached.
        """
        self._check()
        sent: dict[str, float] = {}
        for hand in self._hands:
            sent |= hand.send(action, self._sinks)
        return sent

    def disconnect(self) -> None:
        """Bring the hand to rest and close everything.

        Raises:
            DeviceNotConnectedError: it is not connected.
        """
        self._check()
        self._connected = False
        with contextlib.ExitStack() as closing:  # all of them, whatever one raises
            for thing in (*self._sinks, *self.cameras.values()):
                closing.callback(thing.close if isinstance(thing, Sink) else thing.disconnect)

    def _check(self) -> None:
        if not self._connected:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first")


def _hand_ports(config: SmoothHandConfig) -> list[_HandPort]:
    """The hands that the settings ask for.

    Raises:
        ValueError: a setting is wrong.
    """
    for name, known in (
        ("side", ("right", "left", "both")),
        ("unit", tuple(_FACTORS)),
        ("unmeasured", ("refuse", "command")),
    ):
        value = getattr(config, name)
        if value not in known:
            raise ValueError(f"{name} must be one of {', '.join(known)}, not {value!r}")
    if not config.sinks:
        raise ValueError("sinks: name at least one, such as mujoco")
    sides = ("right", "left") if config.side == "both" else (config.side,)
    if config.left_joints and config.side != "both":
        raise ValueError("left_joints is for --robot.side=both; use joints for one hand")
    ports = []
    for side in sides:
        hand = load_hand(config.hand, side)
        joints = config.left_joints if side == "left" and config.left_joints else config.joints
        prefix = f"{side}_" if config.side == "both" else ""
        ports.append(_HandPort(hand, config, joints, prefix))
    return ports


def _cameras(config: SmoothHandConfig) -> dict[str, Any]:
    if not config.cameras:
        return {}
    from lerobot.cameras.utils import make_cameras_from_configs

    return cast("dict[str, Any]", make_cameras_from_configs(config.cameras))

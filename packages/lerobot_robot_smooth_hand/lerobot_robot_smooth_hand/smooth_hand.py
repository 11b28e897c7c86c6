"""LeRobot robot that moves and measures a hand through smooth-operator's sinks."""

from __future__ import annotations

import contextlib
import logging
import signal
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

from lerobot.robots.robot import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_camera_smooth_hand import SmoothHandCamera

from lerobot_robot_smooth_hand.config_smooth_hand import SmoothHandConfig
from lerobot_robot_smooth_hand.hand_port import FACTORS, TACTILE, HandPort
from smooth_operator.episode_files.lerobot.schema import WRIST_NAMES
from smooth_operator.errors import require
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.settings import check_numbers
from smooth_operator.signals import ended_by_signals
from smooth_operator.teleop.arm.settings import read_arm
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.types import Side, as_side

if TYPE_CHECKING:  # which needs the extra arm
    from smooth_operator.teleop.arm.controller import ArmOfHand

logger = logging.getLogger(__name__)


class SmoothHand(Robot):
    """A robot hand that smooth-operator's sinks move and measure.

    Actions and observations have the same keys, ``JOINT.pos``, one for each joint. If ``wrist`` is
    set, actions also have ``tcp.x`` and so on. The hand follows an action within the limits of
    position, velocity and acceleration; the first action, and one after a pause of half a second,
    is approached slowly. Real hands stop when no action comes for 0.2 s (``docs/robots`` describes
    how). While the robot is connected, SIGTERM and a closed terminal (SIGHUP) act like Ctrl-C,
    unless the program handles signals itself: LeRobot's commands then disconnect, and the hand
    comes to rest.

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
        self._arms: dict[Side, ArmOfHand] = {}
        self._hands = _hand_ports(config, self._arms)
        self._sinks: list[Sink] = [build_sink(text) for text in config.sinks]
        self._connected = False
        self._opened = contextlib.ExitStack()
        for hand in self._hands:
            hand.currents(self._sinks)  # a driver without them is found out now
        self.cameras: dict[str, Any] = _cameras(config)

    @property
    def action_features(self) -> dict[str, type]:
        """Key -> ``float``."""
        return {key: float for hand in self._hands for key in (*hand.keys, *hand.wrist.keys)}

    @property
    def observation_features(self) -> dict[str, Any]:
        """Key -> ``float``, and the shape of each camera's picture."""
        features: dict[str, Any] = {key: float for hand in self._hands for key in hand.keys}
        for hand in self._hands:
            keys = (*hand.currents(self._sinks), *hand.tactile, *hand.wrist.observed)
            features |= dict.fromkeys(keys, float)
        for name, camera in self.config.cameras.items():
            features[name] = (camera.height, camera.width, 3)
        return features

    @property
    def is_connected(self) -> bool:
        """True if the hand can be moved."""
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        """Always True: the table of a driver is its calibration (``smooth-operator hardware
        check``)."""
        return True

    def calibrate(self) -> None:
        """Print how a hand is calibrated; does nothing else."""
        logger.info(
            "smooth_hand needs no calibration by LeRobot. A real hand is calibrated by the table "
            "of its driver: smooth-operator hardware check --help"
        )

    def configure(self) -> None:
        """Does nothing."""

    def connect(self, calibrate: bool = True) -> None:
        """Open the sinks and the cameras, and measure the hand's pose. Nothing moves.

        Raises:
            DeviceAlreadyConnectedError: it is already connected.
            DeviceNotConnectedError: the hand is not measured, or a camera can't draw.
            ValueError: a simulated camera has no simulated hand to show.
            SmoothOperatorError: a sink can't be opened.
        """
        if self._connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        hands = {hand.side: hand.hand for hand in self._hands}
        about = {"program": "lerobot", "hand": self.config.hand, "sinks": list(self.config.sinks)}
        with contextlib.ExitStack() as opened:
            if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:  # the program has no handlers
                opened.enter_context(ended_by_signals())
            for sink in self._sinks:
                sink.use_arms({side: arm.carried for side, arm in self._arms.items()})
                sink.open(hands, about)
                opened.callback(sink.close)
            for hand in self._hands:
                hand.attach(self._sinks)
            for camera in self.cameras.values():
                if isinstance(camera, SmoothHandCamera):
                    camera.attach(self._sinks, [hand.side for hand in self._hands])
                camera.connect()
                opened.callback(camera.disconnect)
            self._opened = opened.pop_all()
        self._connected = True

    def get_observation(self) -> dict[str, Any]:
        """Return measured joints, currents, contacts and pictures.

        Raises:
            DeviceNotConnectedError: the robot is not connected, or the newest measurement is too
                old.
        """
        self._check()
        seen: dict[str, Any] = {}
        for hand in self._hands:
            seen |= hand.observation(self._sinks)
        for name, camera in self.cameras.items():
            seen[name] = camera.read_latest()
        return seen

    def send_action(self, action: Mapping[str, float]) -> dict[str, float]:
        """Move towards an action; keys that the hand does not have are ignored.

        Returns:
            The values that were sent, within the limits.

        Raises:
            DeviceNotConnectedError: the robot is not connected.
            ValueError: a key is missing, or a value is not a number.
            SinkError: the hand does not respond.
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
        self._opened.close()

    def _check(self) -> None:
        if not self._connected:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first")


def _hand_ports(config: SmoothHandConfig, arms: dict[Side, ArmOfHand]) -> list[HandPort]:
    """Create the hands that the settings request; their arms are added to ``arms``.

    Raises:
        ValueError: a setting is wrong.
    """
    for name, known in (
        ("side", ("right", "left", "both")),
        ("unit", tuple(FACTORS)),
        ("keys", ("actuated", "all")),
        ("wrist", tuple(WRIST_NAMES)),
        ("unmeasured", ("refuse", "command")),
        ("tactile", tuple(TACTILE)),
    ):
        value = getattr(config, name)
        if value not in known:
            raise ValueError(f"{name} must be one of {', '.join(known)}, not {value!r}")
    check_numbers(config, positive=("velocity", "acceleration"), not_negative=("stale_s",))
    if not config.sinks:
        raise ValueError("sinks: name at least one sink, such as mujoco")
    sides = ("right", "left") if config.side == "both" else (config.side,)
    if config.left_joints and config.side != "both":
        raise ValueError("left_joints is for --robot.side=both; use joints for one hand")
    if config.arm and config.wrist == "none":
        raise ValueError("an arm follows the wrist: add --robot.wrist=quaternion or rotation_6d")
    hands = {as_side(side): load_hand(config.hand, side) for side in sides}
    if config.wrist_joints and config.wrist == "none":
        hands = {side: with_wrist_joints(hand) for side, hand in hands.items()}
    if config.arm:
        require("an arm", "arm", "mink", "daqp")
        from smooth_operator.teleop.arm.controller import build_arms

        arms.update(build_arms(read_arm(config.arm), hands))
    ports = []
    for side, hand in hands.items():
        joints = config.left_joints if side == "left" and config.left_joints else config.joints
        prefix = f"{side}_" if config.side == "both" else ""
        arm = arms[side].controller if arms else None
        ports.append(HandPort(hand, config, joints, prefix, arm))
    return ports


def _cameras(config: SmoothHandConfig) -> dict[str, Any]:
    if not config.cameras:
        return {}
    from lerobot.cameras.utils import make_cameras_from_configs

    return cast("dict[str, Any]", make_cameras_from_configs(config.cameras))

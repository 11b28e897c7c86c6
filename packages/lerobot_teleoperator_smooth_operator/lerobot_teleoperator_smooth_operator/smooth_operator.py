"""LeRobot teleoperator that returns smooth-operator's newest command as an action."""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.teleoperators.utils import TeleopEvents
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_teleoperator_smooth_operator.commands import ARM_PREFIX, Command, Newest
from lerobot_teleoperator_smooth_operator.config_smooth_operator import SmoothOperatorConfig
from lerobot_teleoperator_smooth_operator.end_effector import (
    DELTA_KEYS,
    EE_KEYS,
    Steps,
    gripper_command,
)
from lerobot_teleoperator_smooth_operator.following import Follower, PoseFollower
from lerobot_teleoperator_smooth_operator.gripper import OPEN, Gripper, Jaw
from lerobot_teleoperator_smooth_operator.human_hands import HumanHands
from lerobot_teleoperator_smooth_operator.joint_keys import JointKey, check_names, joint_keys
from lerobot_teleoperator_smooth_operator.landmark_steps import LANDMARK_KEYS
from lerobot_teleoperator_smooth_operator.subscription import Feed, InProcess, Subscription
from smooth_operator import poses
from smooth_operator.episode_files.lerobot.schema import WRIST_NAMES, pose_keys, wrist_pose
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.settings import check_numbers
from smooth_operator.teleop.arm.settings import read_arm

logger = logging.getLogger(__name__)

_EPISODE = ("success", "end", "again")
"""What the keys of ``teleop`` say about an episode."""

_MOVING = ("tracking", "blending")
"""Modes of the loop in which the operator moves the robot."""

_OWN_HAND, _OWN_GRIPPER = "mimic_p050", "so101"
"""Robot hand of a loop in this process, if the settings name none."""

_WRIST_KEYS = {
    **{name: pose_keys(names) for name, names in WRIST_NAMES.items()},
    "ee": EE_KEYS,
    "delta": DELTA_KEYS,
}
"""Notation of the wrist -> its keys."""

_GRIPPER_KEYS = {"ee": "ee.gripper_pos", "delta": "gripper"}
"""Notation of the wrist -> key of the gripper, if it has one of its own."""


class _HandActions:
    """Actions of one hand, and the last values sent.

    Args:
        side: side of the hand.
        config: settings of the teleoperator.
        joints: model's joint -> robot's joint; empty for all.
        prefix: prefix of the keys.
    """

    def __init__(
        self, side: str, config: SmoothOperatorConfig, joints: Mapping[str, str], prefix: str
    ) -> None:
        self.side, self._config, self._prefix = side, config, prefix
        by = config.gripper or ("pinch" if config.arm or config.wrist in _GRIPPER_KEYS else "")
        self._gripper = Gripper(by) if by else None
        self._jaw: Jaw | None = None  # with a pinch, if the hand that is driven is a gripper
        self._by_jaw = by == "pinch"
        self._given: Mapping[str, str] | None = joints or None
        if not joints and config.arm:
            names = read_arm(config.arm).spec.joint_names
            self._given = {f"{ARM_PREFIX}{name}": name for name in names}
        elif not joints and by:
            self._given = {}
        self._expected = () if self._given is not None else _model_joints(side, config)
        self.known = self._given is not None or bool(self._expected)
        self.keys = self._made(self._expected)
        self._order: tuple[int, ...] = ()
        self._names: tuple[str, ...] = ()
        self._joints, self._pose = Follower(), PoseFollower()
        self._steps = Steps(config.delta_step_m)
        self.pose_keys = tuple(f"{prefix}{key}" for key in _WRIST_KEYS[config.wrist])
        self.landmark_keys = tuple(f"{prefix}{key}" for key in LANDMARK_KEYS if config.landmarks)
        self._landmarks = np.zeros(len(LANDMARK_KEYS))

    def ready(self, command: Command | None) -> bool:
        """True if a command contains everything that an action needs."""
        return command is not None and (command.wrist is not None or not self.pose_keys)

    def arrange(self, command: Command) -> None:
        """Find the configured joints in a command.

        Raises:
            ValueError: a joint is missing.
        """
        if self._expected not in ((), command.names):
            raise ValueError(
                f"--teleop.hand={_own_hand(self._config)} has the joints "
                f"{', '.join(self._expected)}, but smooth-operator sends "
                f"{', '.join(command.names)} for the {self.side} hand; name the hand that teleop "
                "drives, or the joints in --teleop.joints"
            )
        missing = [name for name in self._given or () if name not in command.names]
        if missing:
            arm = f"; start teleop with --arm {self._config.arm}" if self._config.arm else ""
            raise ValueError(
                f"joints: {', '.join(missing)} are not joints of the {self.side} hand that "
                f"smooth-operator drives: {', '.join(command.names)}{arm}"
            )
        self.keys, self.known = self._made(command.names), True
        self._order = tuple(command.names.index(key.joint) for key in self.keys if key.joint)
        if self._by_jaw:
            with contextlib.suppress(SmoothOperatorError):  # a hand that only teleop knows
                self._jaw = Jaw.of(load_hand(command.hand, self.side))
        self._names = command.names

    def hold(self) -> None:
        """Repeat the last action."""
        self._joints.hold()
        self._pose.hold()
        self._landmarks[-1] = 0.0

    def put(self, action: Mapping[str, float]) -> None:
        """Hold an action of the robot, such as that of a policy; other keys are ignored."""
        if self._config.wrist == "delta":
            return  # an action of it is no place
        angles = self._joints.values
        if angles is not None:
            pairs = zip(self.keys, angles, strict=True)
            self._joints.put(
                [key.angle(action[key.key]) if key.key in action else angle for key, angle in pairs]
            )
        if self.pose_keys and all(key in action for key in self.pose_keys):
            # LeRobot interpolates each number: halfway a rotation may be none, the end is one.
            with contextlib.suppress(ValueError):
                self._pose.put(wrist_pose([action[key] for key in self.pose_keys]))

    def follow(self, command: Command, now: float) -> None:
        """Let the next action follow a command."""
        if command.names != self._names:  # teleop was started again, with another hand
            keys = self.keys
            self.arrange(command)
            if self.keys != keys:
                raise ValueError(
                    f"smooth-operator now drives another {self.side} hand; connect again, or name "
                    "the joints in --teleop.joints"
                )
        points = command.landmarks
        if points is not None and np.isfinite(points).all() and command.mode in _MOVING:
            self._landmarks = np.append(points, 1.0)
        else:
            self._landmarks[-1] = 0.0
        targets = [command.positions[i] for i in self._order]
        if self._gripper is not None:
            if self._jaw is not None and command.mode in _MOVING:
                position = command.positions[command.names.index(self._jaw.joint)]
                self._gripper.move(self._jaw.opening(position))
            elif self._jaw is None and self._landmarks[-1]:
                self._gripper.follow(self._landmarks[:-1].reshape(21, 3))
            targets.append(self._gripper.opening / OPEN)
        self._joints.follow(targets, now)
        if self.pose_keys and command.wrist is not None:
            self._pose.follow(command.wrist, now)
        elif self.pose_keys:
            self._pose.hold()

    def action(self) -> dict[str, float] | None:
        """The action's values by key; None before the first command."""
        angles, pose = self._joints.values, self._pose.values
        if angles is None:
            return None
        values = {
            key.key: key.value(float(angle)) for key, angle in zip(self.keys, angles, strict=True)
        }
        if self.pose_keys and pose is not None:
            values.update(zip(self.pose_keys, map(float, self._wrist_values(pose)), strict=True))
        if self._config.wrist == "delta":
            gripper = self.keys[-1].key
            values[gripper] = gripper_command(values[gripper])
        values.update(zip(self.landmark_keys, map(float, self._landmarks), strict=False))
        return values

    def _wrist_values(self, pose: np.ndarray) -> np.ndarray:
        """Values of ``pose_keys`` for a pose (7,) of the wrist."""
        wrist = self._config.wrist
        if wrist == "delta":
            return self._steps.next(pose[:3])
        if wrist == "ee":
            return np.append(pose[:3], poses.rotation_vectors(pose[3:]))
        if wrist == "rotation_6d":
            return np.append(pose[:3], poses.rotation_matrices(pose[3:])[:, :2].T)
        return pose

    def _made(self, names: Sequence[str]) -> tuple[JointKey, ...]:
        """Keys of the joints that the settings name, or of all ``names``; the gripper's is last."""
        config = self._config
        joints = joint_keys(
            {name: name for name in names} if self._given is None else self._given,
            config.unit or ("degrees" if config.arm else "radians"),
            ends=config.ends,
            signs=config.signs,
            offsets=config.offsets,
            prefix=self._prefix,
        )
        if self._gripper is None:
            return joints
        key = f"{self._prefix}{_GRIPPER_KEYS.get(config.wrist, 'gripper.pos')}"
        if any(joint.key == key for joint in joints):
            raise ValueError(f"joints: {key} is the gripper's key; rename the joint")
        return (*joints, JointKey("", key, OPEN, 0.0, 0.0, OPEN))


class SmoothOperator(Teleoperator):
    """Teleoperator by a tracked human hand, with the keys and units of a robot.

    ``get_action`` returns the newest command and never waits. A command that is no longer valid
    (``valid_for_s`` in each message, 0.2 s) is not followed: the last action is repeated for up to
    ``hold_s``, and then ``get_action`` raises. If commands resume within that time, the action
    blends into them over at least 0.5 s, without a jump.

    Args:
        config: settings.
        clock: returns the time [s]; for tests.

    Attributes:
        human: the human hands that the newest action follows, for the program that records them.

    Raises:
        ValueError: a setting is wrong.
    """

    config_class = SmoothOperatorConfig
    name = "smooth_operator"

    def __init__(
        self, config: SmoothOperatorConfig, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(config)
        self.config, self._clock = config, clock
        self._hands = _hands(config)
        self._newest = Newest(clock)
        self._feed: Feed | None = None
        self._fresh_at: dict[str, float] = {}
        self._torque = self._warned = False
        self._pressed = dict.fromkeys(_EPISODE, 0)
        self.human = HumanHands([hand.side for hand in self._hands])

    @property
    def action_features(self) -> dict[str, Any]:
        """Key -> ``float``; before ``connect`` if the settings name the joints.

        ``hand``, ``source``, ``arm`` and a gripper name them, too. With ``wrist=delta``, it
        describes a column, as LeRobot's own teleoperators with such keys do.
        """
        if not all(hand.known for hand in self._hands):
            raise DeviceNotConnectedError(
                "the joints are unknown until commands arrive: connect first, or name the hand "
                "that teleop drives (--teleop.hand) or its joints (--teleop.joints)"
            )
        if self.config.wrist == "delta":
            names = (*self._hands[0].pose_keys, *(key.key for key in self._hands[0].keys))
            numbers = {name: number for number, name in enumerate(names)}
            return {"dtype": "float32", "shape": (len(names),), "names": numbers}
        features: dict[str, Any] = {}
        for hand in self._hands:
            features |= {key.key: float for key in hand.keys}
            features |= dict.fromkeys((*hand.pose_keys, *hand.landmark_keys), float)
        return features

    @property
    def feedback_features(self) -> dict[str, Any]:
        """Features of an action, so that LeRobot's DAgger hands over by ``send_feedback``."""
        return self.action_features

    @property
    def is_connected(self) -> bool:
        """True while commands are received."""
        return self._feed is not None

    @property
    def operator_file(self) -> Path | None:
        """File of the operator's calibration; None if the settings name no operator."""
        name = self.config.operator or self.id
        if not name:
            return None
        return (
            Path(name) if name.endswith(".json") else self.calibration_dir / f"{name}.operator.json"
        )

    @property
    def is_calibrated(self) -> bool:
        """True if the operator's file exists. Most trackers need no calibration."""
        return self.operator_file is not None and self.operator_file.exists()

    def calibrate(self) -> None:
        """Ask for pinches in the terminal, and store the gaps that the tracker reports.

        It takes half a minute. Afterwards no more commands are received: disconnect, and connect
        again. The loop in this process then uses the gaps; for a separate ``teleop``, give the file
        to ``--operator``.

        Raises:
            DeviceNotConnectedError: it is not connected.
            ValueError: the settings name no operator, or two hands.
            SmoothOperatorError: no hand was tracked, or the file can't be read or written.
        """
        from lerobot_teleoperator_smooth_operator.operator_calibration import calibrate_operator

        feed, file, side = self._feed, self.operator_file, self.config.side
        if feed is None:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first")
        if file is None or side == "both":
            raise ValueError(
                "lerobot-calibrate calibrates one hand of one operator: name both, as in "
                "--teleop.operator=anna --teleop.side=right"
            )
        gaps = calibrate_operator(file, self._newest, feed, side).pinch_gaps
        logger.info(
            "wrote %s (pinch gaps: %s). To use it in a separate teleop, add --operator %s",
            file,
            ", ".join(f"{finger} {gap:.3f} palm lengths" for finger, gap in gaps.items()) or "none",
            file,
        )

    def configure(self) -> None:
        """Nothing to do."""

    def connect(self, calibrate: bool = True) -> None:
        """Connect, and wait for the first command of each hand.

        Raises:
            DeviceAlreadyConnectedError: it is already connected.
            DeviceNotConnectedError: no command arrived in time.
            ValueError: a joint is unknown, or the address is not valid.
        """
        if self._feed is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        config = self.config
        self._newest = Newest(self._clock)
        self._hands = _hands(config)
        self._fresh_at, self._torque = {}, False
        feed: Feed
        if config.source:
            feed = InProcess(config, self._newest, _own_hand(config), self.operator_file)
        else:
            feed = Subscription(config.address, self._newest)
        try:
            # The loop in this process compiles first, and says itself what goes wrong.
            self._await(feed, 600.0 if config.source else config.timeout_s)
            for hand in self._hands:
                command = self._newest.command(hand.side)
                assert command is not None  # it was awaited
                hand.arrange(command)
        except BaseException:
            feed.close()
            raise
        self._feed = feed
        self.get_teleop_events()  # discards the keys that were pressed before

    def get_action(self) -> dict[str, float]:
        """Return the newest command in the robot's keys and units, without waiting.

        Raises:
            DeviceNotConnectedError: it is not connected, or no command has arrived for ``hold_s``.
        """
        if self._feed is None:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first")
        now = self._clock()
        action: dict[str, float] = {}
        held = []
        for hand in self._hands:
            command = self._newest.command(hand.side)
            assert command is not None  # `connect` waited for it
            why = self._stale(hand, command)
            if self._torque and hand.action() is not None:
                self._fresh_at[hand.side] = now
                hand.hold()
            elif why:
                held.append(hand.side)
                hand.hold()
            else:
                self._fresh_at[hand.side] = now
                hand.follow(command, now)
            self.human.update(hand.side, None if why else command, now)
            silent = now - self._fresh_at.get(hand.side, -math.inf)
            values = hand.action()
            if values is None or silent > self.config.hold_s:
                raise DeviceNotConnectedError(self._lost(hand.side, why, silent))
            action |= values
        self._report(held)
        return action

    @property
    def modes(self) -> dict[str, str]:
        """Side -> mode of the loop for that hand: ``tracking``, ``holding``, ..."""
        found = {side: self._newest.command(side) for side in self._newest.sides}
        return {side: command.mode for side, command in found.items() if command is not None}

    def get_teleop_events(self) -> dict[TeleopEvents, bool]:
        """Events since the last call, for LeRobot's loops with a human in them.

        The operator intervenes while a hand follows them (``p`` in ``teleop`` pauses it). The keys
        ``s``, ``e`` and ``a`` in the terminal of ``teleop`` (or other inputs of the actions
        ``success``, ``end`` and ``again``) mean success, end of the episode, and
        end with a new recording.
        """
        found = [self._newest.command(hand.side) for hand in self._hands]
        commands = [
            command
            for hand, command in zip(self._hands, found, strict=True)
            if command is not None and self._feed is not None and not self._stale(hand, command)
        ]
        pressed = dict.fromkeys(_EPISODE, 0)
        for command in commands:
            pressed |= {name: max(pressed.get(name, 0), n) for name, n in command.episode.items()}
        before, self._pressed = self._pressed, pressed if commands else self._pressed
        new = {name: self._pressed[name] > before[name] for name in _EPISODE}
        return {
            TeleopEvents.IS_INTERVENTION: not self._torque
            and any(each.mode in _MOVING for each in commands),
            TeleopEvents.TERMINATE_EPISODE: new["end"] or new["again"],
            TeleopEvents.SUCCESS: new["success"],
            TeleopEvents.RERECORD_EPISODE: new["again"],
        }

    def enable_torque(self) -> None:
        """Hold the action: it follows ``send_feedback`` instead of the human."""
        self._torque = True

    def disable_torque(self) -> None:
        """Follow the human again: the action moves slowly from the held one to the human's."""
        self._torque = False

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Set the action that is held, such as the last one of a policy (``feedback_features``).

        LeRobot's DAgger calls this while the policy pauses, so that the human takes over where the
        robot is. There is no force on the human's hand. Without ``enable_torque`` it does nothing.
        """
        for hand in self._hands if self._torque else ():
            hand.put(feedback)

    def disconnect(self) -> None:
        """Stop receiving.

        Raises:
            DeviceNotConnectedError: it is not connected.
        """
        if self._feed is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        feed, self._feed = self._feed, None
        feed.close()

    def _await(self, feed: Feed, patience: float) -> None:
        def there() -> bool:
            return feed.error is not None or all(
                hand.ready(self._newest.command(hand.side))
                and not self._stale(hand, self._newest.command(hand.side))
                for hand in self._hands
            )

        done = self._newest.wait(there, patience)
        if feed.error is not None:
            raise DeviceNotConnectedError(f"smooth-operator: {feed.error}") from feed.error
        if not done:
            raise DeviceNotConnectedError(self._nothing())

    def _stale(self, hand: _HandActions, command: Command | None) -> str:
        """Reason why a command must not be followed; empty if it may be followed."""
        if command is None:
            return "no command has arrived"
        silence = self._newest.silence(hand.side)
        if silence:
            return silence
        age = self._clock() - command.sent
        if age > command.valid_for_s:
            return f"the newest command is {age:.2f} s old"
        return ""

    def _nothing(self) -> str:
        config = self.config
        come = self._newest.sides
        missing = [hand.side for hand in self._hands if hand.side not in come]
        if missing and come:
            return (
                f"{config.address} sends commands for the {' and '.join(come)} hand, but not for "
                f"the {' and '.join(missing)} hand; set --teleop.side={come[0]}, or start teleop "
                "with --side both"
            )
        if not missing and config.wrist != "none":
            return (
                f"commands arrive from {config.address}, but without the pose of a wrist; "
                "use a source that tracks the wrist, or --teleop.wrist=none"
            )
        text = (
            f"no command at {config.address} within {config.timeout_s:g} s; start smooth-operator "
            f"teleop --source SOURCE --side {config.side} --sink zmq:{config.address}"
        )
        return f"{text} ({self._newest.refused})" if self._newest.refused else text

    def _lost(self, side: str, why: str, silent: float) -> str:
        feed = self._feed
        why = str(feed.error) if feed is not None and feed.error is not None else why
        for_s = f" for {silent:.1f} s" if math.isfinite(silent) else ""
        return (
            f"no valid command for the {side} hand{for_s}: {why}; start teleop again, or repeat "
            "the last action for longer with --teleop.hold_s"
        )

    def _report(self, held: list[str]) -> None:
        if held and not self._warned:
            logger.warning(
                "no valid command for the %s hand: the last action is repeated",
                " and ".join(held),
            )
        elif self._warned and not held:
            logger.warning("commands have resumed")
        self._warned = bool(held)


def _own_hand(config: SmoothOperatorConfig) -> str:
    """Robot hand of a loop in this process."""
    gripper = config.arm or config.gripper or config.wrist in _GRIPPER_KEYS
    return config.hand or (_OWN_GRIPPER if gripper else _OWN_HAND)


def _model_joints(side: str, config: SmoothOperatorConfig) -> tuple[str, ...]:
    """Joints of the hand that the settings name, as commands name them; empty without a hand."""
    if not config.hand and not config.source:
        return ()
    hand = load_hand(_own_hand(config), side)
    return (with_wrist_joints(hand) if config.wrist == "none" else hand).joint_names


def _hands(config: SmoothOperatorConfig) -> list[_HandActions]:
    """Create the hands that the settings request.

    Raises:
        ValueError: a setting is wrong.
    """
    if config.side not in ("right", "left", "both"):
        raise ValueError(f"side must be right, left or both, not {config.side!r}")
    if config.wrist not in _WRIST_KEYS:
        raise ValueError(f"wrist must be one of {', '.join(_WRIST_KEYS)}, not {config.wrist!r}")
    if config.wrist == "delta" and (config.side == "both" or config.joints or config.arm):
        raise ValueError("wrist=delta works for one hand, without joints and arm: remove them")
    positive = ("delta_step_m", "wrist_scale")
    check_numbers(
        config, positive=positive, not_negative=("timeout_s", "hold_s"), finite=("wrist_yaw",)
    )
    if not config.source and (config.wrist_scale, config.wrist_yaw) != (1.0, 0.0):
        raise ValueError(
            "wrist_scale and wrist_yaw are for a loop in this process (source); give "
            "--wrist.scale and --wrist.yaw to teleop"
        )
    left = config.left_joints or config.joints
    named = {**config.joints, **{f"{name} (left)": key for name, key in left.items()}}
    about: dict[str, Mapping[str, object]] = {
        "ends": config.ends,
        "signs": config.signs,
        "offsets": config.offsets,
    }
    check_names(named, about, all_joints=not config.joints)
    if config.side != "both":
        if config.left_joints:
            raise ValueError("left_joints is for --teleop.side=both; use joints for one hand")
        return [_HandActions(config.side, config, config.joints, "")]
    return [
        _HandActions("right", config, config.joints, "right_"),
        _HandActions("left", config, left, "left_"),
    ]

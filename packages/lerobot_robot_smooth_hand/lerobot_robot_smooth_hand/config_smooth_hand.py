"""Settings of the robot, as LeRobot's command line shows them."""

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots.config import RobotConfig


# LeRobot makes an option of each field and finds the class by the name without "Config".
@RobotConfig.register_subclass("smooth_hand")
@dataclass(kw_only=True)
class SmoothHandConfig(RobotConfig):
    """Settings of the robot; they are checked when it is made.

    Attributes:
        hand: name of the robot hand, or the path of its spec file.
        side: ``right``, ``left`` or ``both``; with ``both`` each key begins with ``right_`` or
            ``left_``.
        sinks: what moves the hand, as after ``smooth-operator teleop --sink``: ``mujoco``, or a
            driver such as ``leap:/dev/ttyUSB0``. Two drivers for two hands.
        joints: model's joint -> name in the keys; empty for all, by the model's names. Joints that
            are left out stay in the neutral pose.
        left_joints: the same for the left hand with ``both``; empty for ``joints``.
        keys: where ``joints`` is empty: the ``actuated`` joints, or ``all``, those that follow
            others too, as in the datasets of ``smooth-operator convert``; they are observed, and
            their actions have no effect.
        unit: unit of the keys: ``radians`` or ``degrees``.
        wrist: ``none``, or take targets of the hand's wrist as ``rotation_6d`` or ``quaternion``
            (``tcp.x``, ...) and hand them to the sinks, for an arm.
        arm: that carries the hand in the sink ``mujoco`` and follows the wrist: ``panda``,
            ``ur5e``, ``xarm7`` or ``iiwa14``, as after ``teleop --arm``; wrist and arm's joints
            are then observed, too. Empty for none.
        currents: observe the current of each actuator too, ``index.current`` in the driver's unit.
        unmeasured: what the observation of a joint is that the hand does not measure: ``refuse``
            to connect, or the ``command``.
        velocity: largest velocity of any joint [rad/s].
        acceleration: largest acceleration of any joint [rad/s^2].
        stale_s: a measurement older than this is an error, not an observation [s].
        cameras: LeRobot's cameras, and of type ``smooth_hand`` a simulated one.
    """

    hand: str = "mimic_p050"
    side: str = "right"
    sinks: list[str] = field(default_factory=lambda: ["mujoco"])
    joints: dict[str, str] = field(default_factory=dict)
    left_joints: dict[str, str] = field(default_factory=dict)
    keys: str = "actuated"
    unit: str = "radians"
    wrist: str = "none"
    arm: str = ""
    currents: bool = False
    unmeasured: str = "refuse"
    velocity: float = 8.0
    acceleration: float = 1500.0
    stale_s: float = 1.0
    cameras: dict[str, CameraConfig] = field(default_factory=dict)

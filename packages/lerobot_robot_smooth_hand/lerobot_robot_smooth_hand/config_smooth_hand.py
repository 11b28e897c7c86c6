"""Settings of the robot, as LeRobot's command line shows them."""

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots.config import RobotConfig


# LeRobot makes an option of each field and finds the class by the name without "Config".
@RobotConfig.register_subclass("smooth_hand")
@dataclass(kw_only=True)
class SmoothHandConfig(RobotConfig):
    """Settings of the robot; they are checked when the robot is created.

    Attributes:
        hand: name of the robot hand, or the path of its spec file.
        side: ``right``, ``left`` or ``both``; with ``both`` each key begins with ``right_`` or
            ``left_``.
        sinks: sinks that move the hand, written as for ``smooth-operator teleop --sink``:
            ``mujoco``, or a driver such as ``leap:/dev/ttyUSB0``; two drivers for two hands.
        joints: model's joint -> name in the keys; empty for all joints under the model's names.
            Joints that are left out stay in the neutral pose.
        left_joints: ``joints`` for the left hand if ``side`` is ``both``; empty to use ``joints``.
        keys: joints to use if ``joints`` is empty: ``actuated``, or ``all``, which adds the coupled
            joints, as in the datasets of ``smooth-operator convert``. Coupled joints are observed,
            but actions for them have no effect.
        unit: unit of the keys: ``radians`` or ``degrees``.
        wrist: ``none``, or the form of the targets for the hand's wrist, ``rotation_6d`` or
            ``quaternion`` (``tcp.x``, ...); the sinks get them, for an arm.
        wrist_joints: also command the joints between forearm and palm of a hand that has any. They
            are left out if ``wrist`` is not ``none``, since the arm then moves the palm.
        arm: arm that carries the hand in the sink ``mujoco`` and follows the wrist: ``panda``,
            ``ur5e``, ``xarm7`` or ``iiwa14``, written as for ``teleop --arm``. The wrist and the
            arm's joints are then also observed. Empty for no arm.
        currents: also observe the current of each actuator, ``index.current`` in the driver's unit.
        tactile: ``none``, or also observe the contact of each finger: ``newtons``, the force
            ``tactile.FINGER.newtons`` [N], or ``levels``, ``tactile.FINGER.level`` from 0 (none) to
            1 (full contact by the scale of the driver's table). Pads of which only levels are known
            need ``levels``.
        unmeasured: what to do about a joint that the hand does not measure: ``refuse`` to connect,
            or observe its ``command``.
        velocity: largest velocity of any joint [rad/s].
        acceleration: largest acceleration of any joint [rad/s^2].
        stale_s: age above which a measurement raises an error instead of being observed [s].
        cameras: LeRobot's cameras; the type ``smooth_hand`` is a simulated camera.
    """

    hand: str = "mimic_p050"
    side: str = "right"
    sinks: list[str] = field(default_factory=lambda: ["mujoco"])
    joints: dict[str, str] = field(default_factory=dict)
    left_joints: dict[str, str] = field(default_factory=dict)
    keys: str = "actuated"
    unit: str = "radians"
    wrist: str = "none"
    wrist_joints: bool = True
    arm: str = ""
    currents: bool = False
    tactile: str = "none"
    unmeasured: str = "refuse"
    velocity: float = 8.0
    acceleration: float = 1500.0
    stale_s: float = 1.0
    cameras: dict[str, CameraConfig] = field(default_factory=dict)

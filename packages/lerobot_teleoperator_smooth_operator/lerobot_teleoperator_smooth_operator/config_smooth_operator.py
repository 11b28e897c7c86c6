"""Settings of the teleoperator, as LeRobot's command line shows them."""

from dataclasses import dataclass, field

from lerobot.teleoperators.config import TeleoperatorConfig


# LeRobot makes an option of each field and finds the class by the name without "Config".
@TeleoperatorConfig.register_subclass("smooth_operator")
@dataclass(kw_only=True)
class SmoothOperatorConfig(TeleoperatorConfig):
    """Settings of the teleoperator; they are checked when it is created.

    Attributes:
        address: address at which ``smooth-operator teleop --sink zmq`` publishes.
        side: ``right``, ``left`` or ``both``; with ``both`` each key begins with ``right_`` or
            ``left_``.
        joints: model's joint -> robot's joint, such as ``{right_i-mcp: index_mcp}``, whose key is
            ``index_mcp.pos``. With ``teleop --arm`` also ``{arm_joint1: joint1}``. Empty for all
            joints under the model's names; with ``arm``, for those of the arm; with a gripper and
            no arm, for none.
        left_joints: ``joints`` for the left hand if ``side`` is ``both``; empty to use ``joints``.
        arm: arm that follows the wrist, as for ``teleop --arm`` (``so101``); its joints are keys
            under their own names. Empty without an arm.
        unit: unit of the robot's keys: ``radians``, ``degrees``, ``range_m100_100`` (-100 to 100)
            or ``range_0_100``; empty for degrees with ``arm``, otherwise radians.
        ends: robot's joint -> model's angles [rad] at the two ends of a range,
            ``{index_mcp: [0.0, 1.6]}``; the first may be the larger. Only for range units.
        signs: robot's joint -> 1 or -1, only for degrees and radians; 1 by default.
        offsets: robot's joint -> its angle when the model's angle is zero [unit].
        wrist: ``none``, ``rotation_6d`` (``tcp.x``, ``tcp.y``, ``tcp.z`` [m] and ``tcp.r1`` to
            ``tcp.r6``: first and second column of the rotation matrix), ``quaternion``
            (``tcp.qw``, ``tcp.qx``, ``tcp.qy``, ``tcp.qz``), ``ee`` (``ee.x``, ``ee.y``, ``ee.z``
            [m], ``ee.wx``, ``ee.wy``, ``ee.wz`` (rotation vector [rad]) and ``ee.gripper_pos``,
            0 to 100) or ``delta`` (``delta_x``, ``delta_y``, ``delta_z``, -1 to 1, and
            ``gripper``: 0 close, 1 stay, 2 open), as LeRobot's HIL-SERL takes them.
        gripper: what closes a parallel gripper: ``pinch`` (thumb and index finger) or ``hand`` (a
            fist). Its key is ``gripper.pos`` (0 closed, 100 open), or that of ``wrist``. Empty for
            ``pinch`` with ``arm`` and with a ``wrist`` that has a gripper, otherwise for no
            gripper.
        wrist_scale: ratio of the robot's translation to the operator's, if the loop runs in this
            process; in other runs, ``teleop --wrist.scale`` sets it.
        wrist_yaw: direction of the tracker's x axis in the robot's base, counterclockwise
            [degrees], if the loop runs in this process (``teleop --wrist.yaw``): 180 with a camera
            that faces the operator.
        delta_step_m: with ``wrist=delta``, translation for the value 1 [m]; LeRobot's
            ``end_effector_step_sizes``.
        timeout_s: longest time that ``connect`` waits for the first command [s].
        hold_s: time for which the last action is repeated when commands stop or are too old [s];
            after that, ``get_action`` raises.
        source: source (``webxr``, ``manus``, ``synthetic``) with which to run the loop in this
            process; empty to subscribe to ``address``.
        hand: robot hand: the one to drive if the loop runs in this process (by default
            ``mimic_p050``, or ``so101`` with a gripper); otherwise the one that ``teleop`` drives,
            with which ``action_features`` is known before ``connect``, also without ``joints``.
        method: retargeting method, if the loop runs in this process; empty for the default.
        operator: name of the operator, whose calibration is in LeRobot's folder of calibrations, or
            path of an operator file (``*.json``); by default ``id``. ``lerobot-calibrate`` writes
            the file; the loop in this process reads it, and adds the pinch gaps that it estimates.
        bind: inputs of the operator's actions if the loop runs in this process, such as
            ``[success=pinch:index, again=button:b]``, written as for ``teleop --bind``.
        landmarks: True to add the landmarks of the human hand to the action, for the processor
            steps of ``landmark_steps``, which replace them.
    """

    address: str = "tcp://127.0.0.1:5556"
    side: str = "right"
    joints: dict[str, str] = field(default_factory=dict)
    left_joints: dict[str, str] = field(default_factory=dict)
    arm: str = ""
    unit: str = ""
    ends: dict[str, list[float]] = field(default_factory=dict)
    signs: dict[str, float] = field(default_factory=dict)
    offsets: dict[str, float] = field(default_factory=dict)
    wrist: str = "none"
    gripper: str = ""
    wrist_scale: float = 1.0
    wrist_yaw: float = 0.0
    delta_step_m: float = 0.025
    timeout_s: float = 5.0
    hold_s: float = 2.0
    source: str = ""
    hand: str = ""
    method: str = ""
    operator: str = ""
    bind: list[str] = field(default_factory=list)
    landmarks: bool = False

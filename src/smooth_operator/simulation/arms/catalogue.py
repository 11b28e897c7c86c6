"""Built-in robot arms: numbers from the makers' data sheets, and capsules around the links.

Frames and angles are those of the makers' controllers, so the real arm can use a command unchanged.
The capsules are our own, from the makers' dimensioned drawings; those of the Panda follow the
figures that Franka publishes for its self-collision model.
"""

from __future__ import annotations

from math import pi, radians, sqrt
from typing import Final

from smooth_operator.errors import UnknownNameError
from smooth_operator.simulation.arms.arm import ArmSpec, Capsule, Link
from smooth_operator.simulation.arms.arm import denavit_hartenberg as _dh

_HALF: Final = pi / 2
_ROOT: Final = sqrt(0.5)
_DOWN: Final = pi / 3  # tilt of the fingers at home, far from the wrists' singular poses


def _degrees(low: float, high: float) -> tuple[float, float]:
    return radians(low), radians(high)


_PANDA: Final = ArmSpec(
    name="panda",
    title="Franka Emika Panda",
    links=(
        Link("joint1", _dh(0.0, 0.0, 0.333), (-2.8973, 2.8973), 2.175, 15.0, 87.0, 4.97,
             (Capsule((0, 0, -0.25), (0, 0, -0.05), 0.06),)),
        Link("joint2", _dh(-_HALF, 0.0, 0.0), (-1.7628, 1.7628), 2.175, 7.5, 87.0, 0.65,
             (Capsule((0, 0, -0.06), (0, 0, 0.06), 0.06),)),
        Link("joint3", _dh(_HALF, 0.0, 0.316), (-2.8973, 2.8973), 2.175, 10.0, 87.0, 3.23,
             (Capsule((0, 0, -0.22), (0, 0, -0.07), 0.06),)),
        Link("joint4", _dh(_HALF, 0.0825, 0.0), (-3.0718, -0.0698), 2.175, 12.5, 87.0, 3.59,
             (Capsule((0, 0, -0.06), (0, 0, 0.06), 0.06),)),
        Link("joint5", _dh(-_HALF, -0.0825, 0.384), (-2.8973, 2.8973), 2.61, 15.0, 12.0, 1.23,
             (Capsule((0, 0, -0.31), (0, 0, -0.21), 0.06),
              Capsule((0, 0.06, -0.2), (0, 0.08, -0.06), 0.03))),
        Link("joint6", _dh(_HALF, 0.0, 0.0), (-0.0175, 3.7525), 2.61, 20.0, 12.0, 1.67,
             (Capsule((0, 0, -0.07), (0, 0, 0.01), 0.05),
              Capsule((0.03, 0, 0), (0.088, 0, 0), 0.045))),
        Link("joint7", _dh(_HALF, 0.088, 0.0), (-2.8973, 2.8973), 2.61, 20.0, 12.0, 0.74,
             (Capsule((0, 0, -0.03), (0, 0, 0.067), 0.04),)),
    ),
    flange=_dh(0.0, 0.0, 0.107),
    base=(Capsule((-0.075, 0, 0.06), (0, 0, 0.06), 0.08), Capsule((0, 0, 0.06), (0, 0, 0.1), 0.08)),
    nominal=(0.0, -0.3, 0.0, -2.3, 0.0, 2.5, 0.785),
    home=(0.6, 0.0, 0.4),
    pitch=_DOWN,
    roll=-pi / 4,
    reach=0.855,
    sources=("Franka Control Interface documentation: Denavit-Hartenberg parameters and limits",
             "masses: Gaz et al. 2019"),
)  # fmt: skip

_UR5E: Final = ArmSpec(
    name="ur5e",
    title="Universal Robots UR5e",
    links=(
        Link("shoulder_pan_joint", _dh(0.0, 0.0, 0.1625), (-2 * pi, 2 * pi), pi, 10.0, 150.0, 3.76,
             (Capsule((0, 0, -0.06), (0, 0, 0), 0.065),)),
        Link("shoulder_lift_joint", _dh(_HALF, 0.0, 0.0), (-2 * pi, 2 * pi), pi, 10.0, 150.0, 8.06,
             (Capsule((0, 0, 0.05), (0, 0, 0.15), 0.06),
              Capsule((0, 0, 0.138), (-0.4, 0, 0.138), 0.055))),
        Link("elbow_joint", _dh(0.0, -0.425, 0.0), (-pi, pi), pi, 10.0, 150.0, 2.85,
             (Capsule((0, 0, 0.03), (0, 0, 0.14), 0.055),
              Capsule((0, 0, 0.007), (-0.39, 0, 0.007), 0.045))),
        Link("wrist_1_joint", _dh(0.0, -0.3922, 0.1333), (-2 * pi, 2 * pi), pi, 15.0, 28.0, 1.37,
             (Capsule((0, 0, -0.11), (0, 0, 0), 0.042),)),
        Link("wrist_2_joint", _dh(_HALF, 0.0, 0.0997), (-2 * pi, 2 * pi), pi, 15.0, 28.0, 1.3,
             (Capsule((0, 0, -0.08), (0, 0, 0), 0.042),)),
        Link("wrist_3_joint", _dh(-_HALF, 0.0, 0.0996), (-2 * pi, 2 * pi), pi, 15.0, 28.0, 0.365,
             (Capsule((0, 0, -0.06), (0, 0, -0.035), 0.035),)),
    ),
    flange=_dh(0.0, 0.0, 0.0),
    base=(Capsule((0, 0, 0.03), (0, 0, 0.07), 0.075),),
    nominal=(2.45, -1.4, 1.4, 1.2, 1.25, 0.9),
    home=(0.5, -0.13, 0.35),
    pitch=_DOWN,
    roll=0.0,
    reach=0.85,
    sources=("Universal Robots: DH parameters for calculations of kinematics and dynamics",
             "Universal Robots e-Series data sheet: ranges, 180 degrees/s",
             "Universal Robots: max. joint torques"),
    notes=("accelerations are our choice: the vendor states none",
           "the elbow is limited to 180 degrees, as in the vendor's ROS description"),
)  # fmt: skip

_XARM7: Final = ArmSpec(
    name="xarm7",
    title="UFACTORY xArm 7",
    links=(
        Link("joint1", _dh(0.0, 0.0, 0.267), _degrees(-360, 360), pi, 20.0, 50.0, 2.38,
             (Capsule((0, 0, -0.13), (0, 0, 0), 0.06),)),
        Link("joint2", _dh(-_HALF, 0.0, 0.0), _degrees(-118, 120), pi, 20.0, 50.0, 1.87,
             (Capsule((0, 0, 0), (0, -0.2, 0.0), 0.06),)),
        Link("joint3", _dh(_HALF, 0.0, 0.293), _degrees(-360, 360), pi, 20.0, 30.0, 1.64,
             (Capsule((0, 0, -0.07), (0.03, 0, 0), 0.055),)),
        Link("joint4", _dh(_HALF, 0.0525, 0.0), _degrees(-11, 225), pi, 20.0, 30.0, 1.73,
             (Capsule((0.02, 0, 0), (0.0775, -0.13, 0), 0.055),)),
        Link("joint5", _dh(_HALF, 0.0775, 0.3425), _degrees(-360, 360), pi, 20.0, 30.0, 1.32,
             (Capsule((0, 0, -0.19), (0, 0, -0.03), 0.05),)),
        Link("joint6", _dh(_HALF, 0.0, 0.0), _degrees(-97, 180), pi, 20.0, 20.0, 1.33,
             (Capsule((0, 0, 0), (0.076, 0.03, 0), 0.05),)),
        Link("joint7", _dh(-_HALF, 0.076, 0.097), _degrees(-360, 360), pi, 20.0, 20.0, 0.17,
             (Capsule((0, 0, -0.04), (0, 0, -0.03), 0.03),)),
    ),
    flange=_dh(0.0, 0.0, 0.0),
    base=(Capsule((0, 0, 0.04), (0, 0, 0.09), 0.07),),
    nominal=(0.0, -0.25, 0.0, 1.1, 0.0, 0.9, 0.0),
    home=(0.5, 0.0, 0.4),
    pitch=_DOWN,
    roll=0.0,
    reach=0.7,
    sources=("UFACTORY xArm user manual: modified DH parameters, ranges, 180 degrees/s, "
             "1145 degrees/s^2",),
    notes=("torques are those of MuJoCo Menagerie",),
)  # fmt: skip

_IIWA14: Final = ArmSpec(
    name="iiwa14",
    title="KUKA LBR iiwa 14 R820",
    links=(
        Link("joint1", _dh(0.0, 0.0, 0.36), _degrees(-170, 170), radians(85), 10.0, 320.0, 5.76,
             (Capsule((0, 0, -0.17), (0, 0, -0.02), 0.085),)),
        Link("joint2", _dh(-_HALF, 0.0, 0.0), _degrees(-120, 120), radians(85), 10.0, 320.0, 6.35,
             (Capsule((0, 0, 0), (0, -0.2, 0), 0.085),)),
        Link("joint3", _dh(_HALF, 0.0, 0.42), _degrees(-170, 170), radians(100), 10.0, 176.0, 3.5,
             (Capsule((0, 0, -0.19), (0, 0, -0.03), 0.075),)),
        Link("joint4", _dh(_HALF, 0.0, 0.0), _degrees(-120, 120), radians(75), 10.0, 176.0, 3.5,
             (Capsule((0, 0, 0), (0, 0.19, 0), 0.08),)),
        Link("joint5", _dh(-_HALF, 0.0, 0.4), _degrees(-170, 170), radians(130), 15.0, 110.0, 3.5,
             (Capsule((0, 0, -0.19), (0, 0, -0.06), 0.065),)),
        Link("joint6", _dh(-_HALF, 0.0, 0.0), _degrees(-120, 120), radians(135), 15.0, 40.0, 1.8,
             (Capsule((0, 0, -0.05), (0, 0, 0.03), 0.065),)),
        Link("joint7", _dh(_HALF, 0.0, 0.0), _degrees(-175, 175), radians(135), 15.0, 40.0, 1.2,
             (Capsule((0, 0, 0.05), (0, 0, 0.08), 0.05),)),
    ),
    flange=_dh(0.0, 0.0, 0.126),
    base=(Capsule((-0.05, 0, 0.07), (0, 0, 0.07), 0.09), Capsule((0, 0, 0.07), (0, 0, 0.12), 0.1)),
    nominal=(0.0, 0.15, 0.0, -1.75, 0.0, 0.75, 0.0),
    home=(0.65, 0.0, 0.4),
    pitch=_DOWN,
    roll=pi,
    reach=0.82,
    back=0.1,
    sources=("KUKA LBR iiwa 14 R820 data sheet: axis data, dimensions, ranges, speeds",),
    notes=("accelerations are our choice: the vendor states none",),
)  # fmt: skip

_SO101: Final = ArmSpec(
    name="so101",
    title="TheRobotStudio SO-101",
    links=(
        Link("shoulder_pan", (0.0388353, 0, 0.0624, 0, 0, 1, 0),
             (-1.91986, 1.91986), 4.7, 10.0, 2.94, 0.1,
             (Capsule((-0.03, 0, -0.04), (-0.02, 0, 0.02), 0.03),)),
        Link("shoulder_lift", (-0.0303992, -0.0182778, -0.0542, 0.5, -0.5, -0.5, -0.5),
             (-1.74533, 1.74533), 4.7, 10.0, 2.94, 0.103,
             (Capsule((0, 0, 0.018), (-0.11, -0.01, 0.018), 0.03),)),
        Link("elbow_flex", (-0.11257, -0.028, 0, _ROOT, 0, 0, _ROOT),
             (-1.69, 1.69), 4.7, 10.0, 2.94, 0.104,
             (Capsule((0, 0, 0.018), (-0.12, 0.003, 0.018), 0.028),)),
        Link("wrist_flex", (-0.1349, 0.0052, 0, _ROOT, 0, 0, -_ROOT),
             (-1.65806, 1.65806), 4.7, 10.0, 2.94, 0.079,
             (Capsule((0, 0, 0.02), (0, -0.04, 0.025), 0.025),)),
        Link("wrist_roll",
             (0, -0.0611, 0.0181, 0.017210072, -0.017208133, 0.706898659, 0.706896017),
             (-2.74385, 2.84121), 4.7, 10.0, 2.94, 0.087,
             (Capsule((0, 0, -0.03), (0, 0, -0.01), 0.018),)),
    ),
    flange=(0, 0, 0, 0, 0, 1, 0),
    base=(Capsule((0.02, -0.02, 0.04), (0.02, 0.02, 0.04), 0.04),),
    nominal=(0.0, -0.6, 0.7, 1.0, 0.0),
    reach=0.39,
    sources=("github.com/TheRobotStudio/SO-ARM100 at fda892cba810 (Apache-2.0), "
             "Simulation/SO101/so101_new_calib.urdf: frames, ranges, masses; the zeros are those "
             "of LeRobot's calibration",
             "Feetech ST-3215-C018 data sheet: 45 rpm without load, 30 kg cm at 12 V"),
    notes=("accelerations are our choice: the vendor states none",),
    gripper=("so101", (0, 0, 0, 0, 0, -1, 0)),
)  # fmt: skip

ARMS: Final[dict[str, ArmSpec]] = {
    arm.name: arm for arm in (_PANDA, _UR5E, _XARM7, _IIWA14, _SO101)
}
"""Name -> arm."""


def arm_named(name: str) -> ArmSpec:
    """Returns the arm with this name; UnknownNameError if there is none."""
    if name not in ARMS:
        raise UnknownNameError("arm", name, ARMS)
    return ARMS[name]

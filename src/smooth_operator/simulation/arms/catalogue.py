"""Catalogue of arms: figures of the makers' data sheets, with capsules around the links.

Frames and angles are those of the makers' controllers, so the real arm can use a command unchanged.
The capsules are our own, from the makers' dimensioned drawings; those of the Panda follow the
figures that Franka publishes for its self-collision model.
"""

from __future__ import annotations

from math import pi, radians
from typing import Final

from smooth_operator.errors import UnknownNameError
from smooth_operator.simulation.arms.arm import ArmSpec, Capsule, Link

_HALF: Final = pi / 2
_DOWN: Final = pi / 3  # tilt of the fingers at home, far from the wrists' singular poses


def _degrees(low: float, high: float) -> tuple[float, float]:
    return radians(low), radians(high)


_PANDA: Final = ArmSpec(
    name="panda",
    title="Franka Emika Panda",
    links=(
        Link("joint1", 0.0, 0.0, 0.333, (-2.8973, 2.8973), 2.175, 15.0, 87.0, 4.97,
             (Capsule((0, 0, -0.25), (0, 0, -0.05), 0.06),)),
        Link("joint2", -_HALF, 0.0, 0.0, (-1.7628, 1.7628), 2.175, 7.5, 87.0, 0.65,
             (Capsule((0, 0, -0.06), (0, 0, 0.06), 0.06),)),
        Link("joint3", _HALF, 0.0, 0.316, (-2.8973, 2.8973), 2.175, 10.0, 87.0, 3.23,
             (Capsule((0, 0, -0.22), (0, 0, -0.07), 0.06),)),
        Link("joint4", _HALF, 0.0825, 0.0, (-3.0718, -0.0698), 2.175, 12.5, 87.0, 3.59,
             (Capsule((0, 0, -0.06), (0, 0, 0.06), 0.06),)),
        Link("joint5", -_HALF, -0.0825, 0.384, (-2.8973, 2.8973), 2.61, 15.0, 12.0, 1.23,
             (Capsule((0, 0, -0.31), (0, 0, -0.21), 0.06),
              Capsule((0, 0.06, -0.2), (0, 0.08, -0.06), 0.03))),
        Link("joint6", _HALF, 0.0, 0.0, (-0.0175, 3.7525), 2.61, 20.0, 12.0, 1.67,
             (Capsule((0, 0, -0.07), (0, 0, 0.01), 0.05),
              Capsule((0.03, 0, 0), (0.088, 0, 0), 0.045))),
        Link("joint7", _HALF, 0.088, 0.0, (-2.8973, 2.8973), 2.61, 20.0, 12.0, 0.74,
             (Capsule((0, 0, -0.03), (0, 0, 0.067), 0.04),)),
    ),
    flange=0.107,
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
        Link("shoulder_pan_joint", 0.0, 0.0, 0.1625, (-2 * pi, 2 * pi), pi, 10.0, 150.0, 3.76,
             (Capsule((0, 0, -0.06), (0, 0, 0), 0.065),)),
        Link("shoulder_lift_joint", _HALF, 0.0, 0.0, (-2 * pi, 2 * pi), pi, 10.0, 150.0, 8.06,
             (Capsule((0, 0, 0.05), (0, 0, 0.15), 0.06),
              Capsule((0, 0, 0.138), (-0.4, 0, 0.138), 0.055))),
        Link("elbow_joint", 0.0, -0.425, 0.0, (-pi, pi), pi, 10.0, 150.0, 2.85,
             (Capsule((0, 0, 0.03), (0, 0, 0.14), 0.055),
              Capsule((0, 0, 0.007), (-0.39, 0, 0.007), 0.045))),
        Link("wrist_1_joint", 0.0, -0.3922, 0.1333, (-2 * pi, 2 * pi), pi, 15.0, 28.0, 1.37,
             (Capsule((0, 0, -0.11), (0, 0, 0), 0.042),)),
        Link("wrist_2_joint", _HALF, 0.0, 0.0997, (-2 * pi, 2 * pi), pi, 15.0, 28.0, 1.3,
             (Capsule((0, 0, -0.08), (0, 0, 0), 0.042),)),
        Link("wrist_3_joint", -_HALF, 0.0, 0.0996, (-2 * pi, 2 * pi), pi, 15.0, 28.0, 0.365,
             (Capsule((0, 0, -0.06), (0, 0, -0.035), 0.035),)),
    ),
    flange=0.0,
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
        Link("joint1", 0.0, 0.0, 0.267, _degrees(-360, 360), pi, 20.0, 50.0, 2.38,
             (Capsule((0, 0, -0.13), (0, 0, 0), 0.06),)),
        Link("joint2", -_HALF, 0.0, 0.0, _degrees(-118, 120), pi, 20.0, 50.0, 1.87,
             (Capsule((0, 0, 0), (0, -0.2, 0.0), 0.06),)),
        Link("joint3", _HALF, 0.0, 0.293, _degrees(-360, 360), pi, 20.0, 30.0, 1.64,
             (Capsule((0, 0, -0.07), (0.03, 0, 0), 0.055),)),
        Link("joint4", _HALF, 0.0525, 0.0, _degrees(-11, 225), pi, 20.0, 30.0, 1.73,
             (Capsule((0.02, 0, 0), (0.0775, -0.13, 0), 0.055),)),
        Link("joint5", _HALF, 0.0775, 0.3425, _degrees(-360, 360), pi, 20.0, 30.0, 1.32,
             (Capsule((0, 0, -0.19), (0, 0, -0.03), 0.05),)),
        Link("joint6", _HALF, 0.0, 0.0, _degrees(-97, 180), pi, 20.0, 20.0, 1.33,
             (Capsule((0, 0, 0), (0.076, 0.03, 0), 0.05),)),
        Link("joint7", -_HALF, 0.076, 0.097, _degrees(-360, 360), pi, 20.0, 20.0, 0.17,
             (Capsule((0, 0, -0.04), (0, 0, -0.03), 0.03),)),
    ),
    flange=0.0,
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
        Link("joint1", 0.0, 0.0, 0.36, _degrees(-170, 170), radians(85), 10.0, 320.0, 5.76,
             (Capsule((0, 0, -0.17), (0, 0, -0.02), 0.085),)),
        Link("joint2", -_HALF, 0.0, 0.0, _degrees(-120, 120), radians(85), 10.0, 320.0, 6.35,
             (Capsule((0, 0, 0), (0, -0.2, 0), 0.085),)),
        Link("joint3", _HALF, 0.0, 0.42, _degrees(-170, 170), radians(100), 10.0, 176.0, 3.5,
             (Capsule((0, 0, -0.19), (0, 0, -0.03), 0.075),)),
        Link("joint4", _HALF, 0.0, 0.0, _degrees(-120, 120), radians(75), 10.0, 176.0, 3.5,
             (Capsule((0, 0, 0), (0, 0.19, 0), 0.08),)),
        Link("joint5", -_HALF, 0.0, 0.4, _degrees(-170, 170), radians(130), 15.0, 110.0, 3.5,
             (Capsule((0, 0, -0.19), (0, 0, -0.06), 0.065),)),
        Link("joint6", -_HALF, 0.0, 0.0, _degrees(-120, 120), radians(135), 15.0, 40.0, 1.8,
             (Capsule((0, 0, -0.05), (0, 0, 0.03), 0.065),)),
        Link("joint7", _HALF, 0.0, 0.0, _degrees(-175, 175), radians(135), 15.0, 40.0, 1.2,
             (Capsule((0, 0, 0.05), (0, 0, 0.08), 0.05),)),
    ),
    flange=0.126,
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

ARMS: Final[dict[str, ArmSpec]] = {arm.name: arm for arm in (_PANDA, _UR5E, _XARM7, _IIWA14)}
"""Name -> arm."""


def arm_named(name: str) -> ArmSpec:
    """An arm by its name; UnknownNameError if there is no arm of that name."""
    if name not in ARMS:
        raise UnknownNameError("arm", name, ARMS)
    return ARMS[name]

"""Model files of arms, for tests."""

import warnings

from scipy.spatial.transform import Rotation

from smooth_operator.simulation.arms.catalogue import ARMS


def so101_urdf() -> str:
    """An SO-101 of our catalogue as a URDF without shapes, with the maker's frame between jaws."""
    spec = ARMS["so101"]
    joints = (*spec.joint_names, "gripper")
    jaw = (0.0202, 0.0188, -0.0234, 0.5**0.5, 0.5**0.5, 0.0, 0.0)
    places = [*(link.place for link in spec.links), jaw]
    mass = (
        '<inertial><mass value="0.1"/>'
        '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    text, parent = '<robot name="so101"><link name="base"/>', "base"
    for name, (x, y, z, w, *axis) in zip(joints, places, strict=True):
        with warnings.catch_warnings(action="ignore"):  # at the pole, roll and yaw count as one
            roll, pitch, yaw = Rotation.from_quat([*axis, w]).as_euler("xyz")
        text += (
            f'<link name="{name}_link">{mass}</link><joint name="{name}" type="revolute">'
            f'<origin xyz="{x} {y} {z}" rpy="{roll} {pitch} {yaw}"/>'
            f'<parent link="{parent}"/><child link="{name}_link"/><axis xyz="0 0 1"/>'
            '<limit lower="-3" upper="3" effort="10" velocity="10"/></joint>'
        )
        parent = parent if name == "gripper" else f"{name}_link"
    return text + (
        '<link name="gripper_frame_link"/><joint name="frame" type="fixed">'
        f'<origin xyz="-0.0079 -0.0002 -0.0981" rpy="0 3.14159265 0"/><parent link="{parent}"/>'
        '<child link="gripper_frame_link"/></joint></robot>'
    )

"""The mirror image of a robot model: a left hand from a right one."""

from __future__ import annotations

import mujoco

from smooth_operator.errors import HandModelError


def mirror_spec(spec: mujoco.MjSpec) -> None:
    """Reflect a model across the x = 0 plane of every local frame, in place.

    A reflection turns positions (x, y, z) into (-x, y, z) and rotations (w, x, y, z) into
    (w, x, -y, -z). A hinge axis is a pseudo-vector: (x, y, z) becomes (x, -y, -z), so that the same
    joint angle gives the mirrored pose and limits keep their sign; a slide's axis is an ordinary
    vector.

    Raises:
        HandModelError: if the model has meshes, whose points are not mirrored here.
    """
    if list(spec.meshes):
        raise HandModelError(
            "a model with meshes can't be mirrored; name the side that it is of (--side left or "
            "right, or a recording of that side), or add a model of the other side"
        )
    for element in [*spec.bodies, *spec.geoms, *spec.sites, *spec.cameras]:
        element.pos = element.pos * (-1, 1, 1)
        element.quat = element.quat * (1, 1, -1, -1)
    for element in [*spec.geoms, *spec.sites]:
        element.fromto = element.fromto * (-1, 1, 1, -1, 1, 1)  # NaN where unused, and stays so
    for joint in spec.joints:
        slide = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
        joint.pos = joint.pos * (-1, 1, 1)
        joint.axis = joint.axis * ((-1, 1, 1) if slide else (1, -1, -1))

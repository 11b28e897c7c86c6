"""Converts a hand of 26 joints, as OpenXR's extension XR_EXT_hand_tracking provides it.

The joints are the palm, the wrist, and those of the fingers from thumb to little finger, in metres,
in a world with y up. A joint's flags say which of its values are valid.

Source: ``XrHandJointEXT`` and ``XrSpaceLocationFlagBits`` of the OpenXR specification,
https://registry.khronos.org/OpenXR/specs/1.1/html/xrspec.html
"""

from __future__ import annotations

from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.formats.checks import check_palm
from smooth_operator.landmarks import FROM_OPENXR_26, METACARPALS_OPENXR_26
from smooth_operator.poses import WORLD_AXES, WRIST_AXES, points_to_ours, to_ours
from smooth_operator.types import HandFrame, Side

Axes: TypeAlias = Literal["openxr", "unity"]
"""Axes of the joints."""

JOINTS: Final = 26
ORIENTATION_VALID: Final = 1
POSITION_VALID: Final = 2

_WRIST: Final = 1
_LANDMARKS: Final = np.array(FROM_OPENXR_26)
_METACARPALS: Final = np.array(METACARPALS_OPENXR_26)
_WXYZ: Final = [0, 1, 2, 6, 3, 4, 5]


def openxr_frame(
    poses: Float[np.ndarray, "26 7"],
    flags: np.ndarray[Any, np.dtype[Any]],
    side: Side,
    stamp: float | None,
    *,
    world: str,
    where: str,
    axes: Axes = "openxr",
) -> HandFrame:
    """Converts an OpenXR hand to this project's conventions. Joints whose position OpenXR does not
    flag as valid are marked invalid.

    Args:
        poses: x y z [m] and quaternion x y z w of each joint.
        flags: (26,) bits of XrSpaceLocationFlags.
        stamp: stamp of the frame [s], or None.
        world: name of the world frame.
        where: what has the joints, for messages.
        axes: axes of the joints.

    Raises:
        RecordingError: another unit than metres.
    """
    poses = np.array(poses, np.float64)
    poses[(flags & POSITION_VALID) == 0, :3] = np.nan
    turned = poses[:, _WXYZ]
    turned[(flags & ORIENTATION_VALID) == 0, 3:] = np.nan
    points = points_to_ours(poses[:, :3], WORLD_AXES[axes])
    landmarks = points[_LANDMARKS]
    valid: Bool[np.ndarray, "21"] = np.isfinite(landmarks).all(axis=1)
    check_palm(landmarks, valid, where)
    ours = to_ours(turned, WORLD_AXES[axes], WRIST_AXES[axes])
    return HandFrame(
        landmarks,
        stamp,
        side,
        valid=valid,
        metacarpals=points[_METACARPALS],
        orientations=ours[_LANDMARKS, 3:],
        T_world_wrist=ours[_WRIST],
        world=world,
    )

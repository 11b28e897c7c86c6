"""Hands of the Vision Pro app Tracking Streamer (``avp_stream``), from its matrices.

A hand is 25 joints, or 27 with two of the forearm, in WebXR's order: 4 x 4 transforms from the
joint to the hand's anchor, which is the wrist; and the anchor's transform to the world, in ARKit's
axes (right-handed, y up). The app sends the identity for what it has never seen, and the last
transform for what it has lost.

Source: ``AppModel.swift`` and ``RecordingManager.swift`` of Improbable-AI/VisionProTeleop; the axes
of the wrist from its issue 12.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.formats.checks import check_palm
from smooth_operator.landmarks import NODE_LAYOUTS
from smooth_operator.poses import WORLD_AXES, WRIST_AXES, from_matrices, is_rigid, to_ours
from smooth_operator.types import HandFrame, Side

WORLD: Final = "avp"
"""Name of the world frame: where the app was started, on the floor."""
JOINTS: Final = 25
"""Joints that are used, the first of what is sent."""

_LANDMARKS: Final = np.array(NODE_LAYOUTS[27][0])
_METACARPALS: Final = np.array(NODE_LAYOUTS[27][1])
_WRISTS: Final = {side: WRIST_AXES[f"arkit_{side}"] for side in ("right", "left")}


def avp_frame(
    joints: Float[np.ndarray, "n 4 4"],
    wrist: Float[np.ndarray, "4 4"],
    side: Side,
    stamp: float | None,
) -> HandFrame | None:
    """A hand in the project's conventions.

    Args:
        joints: transforms from joint to wrist [m]; NaN where missing.
        wrist: transform from wrist to world.
        side: which hand.
        stamp: [s], or None.

    Returns:
        the hand, its landmarks in the wrist's axes; None if the headset has never seen it.

    Raises:
        RecordingError: fewer than 25 joints, or another unit than metres.
    """
    if len(joints) < JOINTS:
        raise RecordingError(f"a hand must have 25 or 27 joints, not {len(joints)}")
    axes = _WRISTS[side]
    poses = to_ours(_poses(joints[:JOINTS]), axes, axes)
    tracked: np.ndarray = np.any(
        poses[:, :3], axis=1
    )  # NaN counts as something, and is invalid anyway
    tracked[0] = True
    if not tracked[1:].any():
        return None
    poses[~tracked] = np.nan
    landmarks = poses[_LANDMARKS, :3]
    valid = np.isfinite(landmarks).all(axis=1)
    check_palm(landmarks, valid, "the joints")
    anchor = _poses(wrist[None])[0]
    if not anchor[:3].any():
        anchor[:] = np.nan
    return HandFrame(
        landmarks,
        stamp,
        side,
        valid=valid,
        metacarpals=poses[_METACARPALS, :3],
        orientations=poses[_LANDMARKS, 3:],
        T_world_wrist=to_ours(anchor, WORLD_AXES["openxr"], axes),
        world=WORLD,
    )


def _poses(matrices: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 7"]:
    """NaN where a matrix is no rigid transform."""
    good = is_rigid(matrices)
    poses = np.full((len(matrices), 7), np.nan)
    poses[good] = from_matrices(matrices[good])
    return poses

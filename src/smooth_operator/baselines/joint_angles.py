"""Anatomical joint angles, measured on the 21 landmarks of a hand.

The same function measures a human hand and a robot's counterparts of its landmarks: that is what a
map from human to robot joints is derived with. Angles are signed, in radians, and the same for a
left hand as for its mirror image. Of a palm three directions are known: *distal* (to the fingers),
*radial* (to the side of the thumb) and *palmar*.

Long fingers, from the three bones MCP-PIP, PIP-DIP, DIP-tip:

- ``*_mcp_abduction``: direction of the plane that the finger bends in, seen along *palmar*, from
  *distal* towards *radial*. The bones, projected along *palmar*, lie close to one line; it is that
  line's direction, from their second moments. A finger whose bones nearly all point along *palmar*
  shows no line; then zero takes over, smoothly.
- ``*_mcp``: first bone out of *distal*, in that plane, towards *palmar* (flexion).
- ``*_pip``, ``*_dip``: a bone against the one before, in that plane (flexion).

Thumb, from the three bones CMC-MCP, MCP-IP, IP-tip:

- ``thumb_flexion``, ``thumb_abduction``: where the thumb points, from its CMC joint to its tip, as
  the rotation vector out of *distal*: flexion towards the little finger's side about *palmar*,
  abduction away from the palm about *radial*. The ray to the tip, and not the metacarpal alone:
  human and robot thumbs differ most in how their bones share one direction. With the metacarpal's,
  the mimic hand's thumb keyvectors had a mean cosine of 0.58 instead of 0.82 where a glove's wearer
  pinches, and 0.47 instead of 0.86 on the set that GeoRT trains on.
- ``thumb_mcp``, ``thumb_ip``: a bone against the one before, in the plane that holds the metacarpal
  and the direction to the base of the little finger, taken as 27 degrees distal of ulnar: towards
  there a thumb flexes (Kapandji 1986).

Every angle is an arc tangent of two components, so a straight finger is no special case.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.geometry import AnyArray, AnyKind, array_namespace
from smooth_operator.human.anatomical_axes import PalmAxes, unit_vectors
from smooth_operator.landmarks import FINGERS

JOINT_ANGLES: Final = (
    "thumb_flexion",
    "thumb_abduction",
    "thumb_mcp",
    "thumb_ip",
    *(
        f"{finger}_{angle}"
        for finger in FINGERS[1:]
        for angle in ("mcp_abduction", "mcp", "pip", "dip")
    ),
)
"""Names of the 20 angles, four to a finger, thumb first. Flexion is positive, and so are finger
abduction towards the thumb and thumb abduction away from the palm."""

NUM_JOINT_ANGLES: Final = len(JOINT_ANGLES)

_THUMB_FLEXES_TOWARDS = np.array([0.5, -1.0, 0.0])  # distal, radial, palmar
_PRIOR = 1.5  # squared lengths of projected bones, of at most 3, under which zero abduction gains


def joint_angles(landmarks: AnyKind, axes: PalmAxes[Any]) -> Float[AnyKind, "*batch 20"]:
    """The angles ``JOINT_ANGLES`` of a hand.

    Args:
        landmarks: (..., 21, 3) [m]. Landmarks that are NaN make the angles of their finger NaN and
            leave the others alone; the wrist is not used.
        axes: of the palm: its own (``palm_axes``), or constant ones of the frame that the
            landmarks have been aligned to.

    Returns:
        (..., 20) angles [rad], in (-pi, pi], finite wherever the landmarks are, coincident ones
        included.
    """
    xp = array_namespace(landmarks)
    batch = landmarks.shape[:-2]
    fingers = landmarks[..., 1:, :].reshape(*batch, 5, 4, 3)
    basis = xp.stack([xp.asarray(axis, landmarks.dtype) for axis in axes], axis=-1)
    rays = xp.concatenate(
        [fingers[..., 1:, :] - fingers[..., :-1, :], fingers[..., 3:, :] - fingers[..., :1, :]],
        axis=-2,
    )  # (..., 5, 3 bones and base to tip, 3)
    components = unit_vectors(xp.einsum("...fbi,...ic->...fbc", rays, basis), xp)
    thumb = _thumb(components[..., 0, :, :], xp)
    angles = xp.concatenate([thumb[..., None, :], _long(components[..., 1:, :3, :], xp)], axis=-2)
    return angles.reshape(*batch, NUM_JOINT_ANGLES)  # type: ignore[no-any-return]


def _long(bones: AnyArray, xp: ModuleType) -> AnyArray:
    """(..., 4, 3 bones, distal radial palmar) unit vectors to (..., 4, 4)."""
    distal, radial, palmar = (bones[..., i] for i in range(3))
    along, across = distal * distal, radial * radial
    prior = xp.maximum(_PRIOR - (along + across).sum(axis=-1), 0)
    # Principal axis of the projected bones; half of a double angle has no preferred end, so a bone
    # that points back, as in a fist, counts as one that points ahead.
    abduction = 0.5 * xp.arctan2(
        2 * (distal * radial).sum(axis=-1), (along - across).sum(axis=-1) + prior
    )
    ahead = distal * xp.cos(abduction)[..., None] + radial * xp.sin(abduction)[..., None]
    slope = xp.arctan2(palmar, ahead)
    bends = _wrapped(slope[..., 1:] - slope[..., :-1], xp)
    out: AnyArray = xp.concatenate([abduction[..., None], slope[..., :1], bends], axis=-1)
    return out


def _thumb(rays: AnyArray, xp: ModuleType) -> AnyArray:
    """(..., 3 bones and base to tip, distal radial palmar) unit vectors to (..., 4)."""
    distal, radial, palmar = (rays[..., 3, i] for i in range(3))
    sine = xp.sqrt(radial * radial + palmar * palmar)
    small = sine < 1e-6  # angle / sine is 1 there, and must not be 0 / 0
    stretch = xp.where(small, 1.0, xp.arctan2(sine, distal) / xp.where(small, 1.0, sine))
    towards = xp.asarray(_THUMB_FLEXES_TOWARDS, rays.dtype)
    axis = unit_vectors(
        xp.cross(rays[..., 0, :], xp.broadcast_to(towards, rays[..., 0, :].shape)), xp
    )
    before, after = rays[..., :2, :], rays[..., 1:3, :]
    bends = xp.arctan2(
        (axis[..., None, :] * xp.cross(before, after)).sum(axis=-1), (before * after).sum(axis=-1)
    )
    ray = xp.stack([-radial * stretch, palmar * stretch], axis=-1)
    out: AnyArray = xp.concatenate([ray, bends], axis=-1)
    return out


def _wrapped(angle: AnyArray, xp: ModuleType) -> AnyArray:
    turns: AnyArray = xp.round(angle / (2 * np.pi))
    return angle - 2 * np.pi * turns

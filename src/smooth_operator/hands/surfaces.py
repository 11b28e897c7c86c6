"""Measures the distance between the surfaces of a hand's thumb and fingers at their tips."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from smooth_operator.errors import HandModelError
from smooth_operator.hands.capsules import hand_capsules, segments_apart
from smooth_operator.hands.collision import Capsule, owners, solid_shapes
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS

_FAR: Final = 0.2
"""Distance at which the search for nearest points ends [m]; two tips of a pinch are nearer."""


class _Pad(NamedTuple):
    """Shapes of a finger's last link: the model's geoms, and capsules that fill or replace them."""

    geoms: tuple[int, ...]
    capsules: tuple[Capsule, ...]


def tip_surface_distances(
    hand: Hand, joint_positions: ArrayLike, wanted: Bool[np.ndarray, "T f"]
) -> Float[np.ndarray, "T f"]:
    """Distances from the surface of the thumb's last link to those of the other fingers' last
    links.

    MuJoCo measures it between the colliding shapes of the model (``mj_geomDistance``; a mesh is
    its convex hull), so it does not depend on a method's model of the hand. Where a last link
    lost its shapes, the capsules that stand in for it are measured instead.

    Args:
        joint_positions: (T, n) positions of all joints [rad].
        wanted: (T, F - 1) for each finger but the thumb, the frames to measure.

    Returns:
        (T, F - 1) [m], negative inside. NaN where it is not wanted, the pose is not finite, or one
        of the two fingers has no shape.

    Raises:
        HandModelError: if the arrays do not fit the hand.
    """
    q = np.asarray(joint_positions, np.float64)
    shapes = (len(q), len(hand.joint_names)), (len(q), len(hand.fingers) - 1)
    if (q.shape, np.shape(wanted)) != shapes:
        raise HandModelError(
            f"joint positions and selected frames of hand {hand.name!r} must have the shapes "
            f"{shapes[0]} and {shapes[1]}, not {q.shape} and {np.shape(wanted)}"
        )
    thumb, *others = _pads(hand)
    data, out = mujoco.MjData(hand.model), np.full(np.shape(wanted), np.nan)
    for t in np.flatnonzero(np.any(wanted, axis=1) & np.isfinite(q).all(axis=1)):
        data.qpos[:] = hand.qpos(q[t])
        mujoco.mj_kinematics(hand.model, data)
        for i in np.flatnonzero(wanted[t]):
            out[t, i] = _distance(hand.model, data, thumb, others[i])
    return out


def _pads(hand: Hand) -> list[_Pad]:
    """The outermost link with shapes of each finger, thumb first."""
    model, capsules = hand.model, hand_capsules(hand)
    part, owner = model.body_weldid, owners(hand)
    solid = np.flatnonzero(solid_shapes(hand))
    stand_ins = {int(part[c.body]) for c in capsules if c.geom < 0}
    pads = []
    for finger in hand.spec.fingers:
        body = int(part[model.body(finger.tip.body).id])
        while owner[body] == FINGERS.index(finger.name):
            own = [c for c in capsules if part[c.body] == body]
            if own:
                break
            body = int(part[model.body_parentid[body]])
        else:
            own = []
        geoms = [int(g) for g in solid if own and part[model.geom_bodyid[g]] == body]
        pads.append(_Pad(() if body in stand_ins else tuple(geoms), tuple(own)))
    return pads


def _distance(model: mujoco.MjModel, data: mujoco.MjData, first: _Pad, second: _Pad) -> float:
    """Least distance of two pads [m]; NaN where one has no shape."""
    if first.geoms and second.geoms:
        return min(
            float(mujoco.mj_geomDistance(model, data, a, b, _FAR, None))
            for a in first.geoms
            for b in second.geoms
        )
    if not first.capsules or not second.capsules:
        return float("nan")
    one, other = (_ends(data, pad.capsules) for pad in (first, second))
    between, _, _ = segments_apart(
        (one[:, None, 0], one[:, None, 1]), (other[None, :, 0], other[None, :, 1])
    )
    radii = np.add.outer(*([c.radius for c in pad.capsules] for pad in (first, second)))
    return float((np.linalg.norm(between, axis=-1) - radii).min())


def _ends(data: mujoco.MjData, capsules: Sequence[Capsule]) -> Float[np.ndarray, "C 2 3"]:
    """Ends of capsules in the world [m]."""
    return np.stack(
        [c.ends @ data.xmat[c.body].reshape(3, 3).T + data.xpos[c.body] for c in capsules]
    )

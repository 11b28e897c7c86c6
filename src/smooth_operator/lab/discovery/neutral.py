"""A relaxed pose: fingers slightly bent and apart, the thumb turned as for a pinch."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.lab.discovery.branches import Chain
from smooth_operator.lab.discovery.motion import Bending, Reach
from smooth_operator.lab.discovery.skeleton import Skeleton

_BENT: Final = 0.22  # share of its closing range by which a joint is bent at rest
_TURNED: Final = 0.7  # how far the thumb is turned to where it pinches
_BEST: Final = 40  # pairs of poses that show where it pinches
_DEEP: Final = 3e-3  # fingers farther inside each other than this are opened [m]
_OPENED: Final = (0.2, 0.4, 0.6)  # shares of the way to an open knuckle that are tried


def find_neutral(
    skeleton: Skeleton,
    chains: tuple[Chain, ...],
    bends: tuple[Bending, ...],
    reach: Reach,
    order: tuple[int, ...],
) -> tuple[dict[str, float], tuple[str, ...]]:
    """The pose, within limits.

    Fingers that would be inside each other, as those that stand in a ring may be, are opened at
    their knuckles.

    Args:
        order: chains, thumb first, then from its side.

    Returns:
        joint name -> position [rad] of the hand's joints that follow no other; and the pose in
        words.
    """
    q = skeleton.reference.copy()
    named: list[int] = []
    for chain, bend in zip(chains, bends, strict=True):
        for j in chain.joints:
            if j in skeleton.leaders or not skeleton.bounded[j] or j in named:
                continue
            named.append(j)
            low, high = skeleton.limits[j]
            if j in bend.joints:
                closed = high if bend.senses[bend.joints.index(j)] > 0 else low
                q[j] += _BENT * (closed - q[j])
            elif not low < q[j] < high:  # away from its limit, where it could move one way only
                q[j] += 0.2 * ((high if q[j] <= low else low) - q[j])
    thumb = order[0]
    turning = [j for j in chains[thumb].own if j in named and j not in bends[thumb].joints]
    turned = _pinching(chains, reach, order)
    if turned is not None:
        for j in turning:
            start = skeleton.reference[j]
            q[j] = start + _TURNED * (turned[j] - start)
    notes = ["fingers bent by a fifth of their range, the thumb turned towards them"]
    depth = finger_overlap(skeleton, chains, skeleton.coupled(q))
    if depth > _DEEP:
        knuckles = {bend.joints[0]: bend.senses[0] for bend in bends if bend.joints}
        q, less = _opened(skeleton, chains, {j: s for j, s in knuckles.items() if j in named}, q)
        notes.append(
            f"fingers would be {1e3 * depth:.0f} mm inside each other so; with their knuckles "
            f"opened it is {1e3 * less:.0f} mm"
        )
    return {skeleton.joint_names[j]: round(float(q[j]), 4) for j in sorted(named)}, tuple(notes)


def _opened(
    skeleton: Skeleton, chains: tuple[Chain, ...], knuckles: dict[int, int], q: np.ndarray
) -> tuple[np.ndarray, float]:
    """The pose with its knuckles opened no farther than needed, and the overlap that is left [m].

    Args:
        knuckles: joint -> sign of the motion that closes its finger.
    """
    best, least = q, finger_overlap(skeleton, chains, skeleton.coupled(q))
    for share in _OPENED:
        trial = q.copy()
        for j, sense in knuckles.items():
            low, high = skeleton.limits[j]
            trial[j] += share * ((low if sense > 0 else high) - q[j])
        depth = finger_overlap(skeleton, chains, skeleton.coupled(trial))
        if depth < least:
            best, least = trial, depth
        if least < _DEEP:
            break
    return best, least


def _pinching(chains: tuple[Chain, ...], reach: Reach, order: tuple[int, ...]) -> np.ndarray | None:
    """Mean pose of the thumb where it pinches best with the fingers next to it; None if nowhere."""
    length = float(np.median([chain.length for chain in chains]))
    poses = []
    for finger in order[1:3]:
        facing = reach.facing(order[0], finger, length)
        best = np.argpartition(facing, -_BEST, axis=None)[-_BEST:]
        thumb_poses = np.unravel_index(best, facing.shape)[0]
        poses += [reach.poses[a] for a, i in zip(thumb_poses, best, strict=True)
                  if facing.flat[i] > 0]  # fmt: skip
    return np.mean(poses, axis=0) if poses else None


def finger_overlap(
    skeleton: Skeleton, chains: tuple[Chain, ...], q: Float[np.ndarray, " n"]
) -> float:
    """Deepest overlap of shapes of two fingers in a pose [m]; 0 if none touch.

    Meshes count as their convex hulls, and what the model takes out of collision stays out.

    Args:
        q: positions of all joints [rad].
    """
    model = skeleton.model
    owner = np.full(model.nbody, -1)
    for i, chain in enumerate(chains):
        moved = [int(model.jnt_bodyid[j]) for j in chain.own]
        for body in (b for first in moved for b in skeleton.rigid(first)):
            owner[body] = i
    finger = owner[model.geom_bodyid]
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    single = np.flatnonzero(skeleton.moves)
    data.qpos[model.jnt_qposadr[single]] = q[single]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    pairs = finger[np.array(data.contact.geom).reshape(-1, 2)]
    between = (pairs >= 0).all(axis=1) & (pairs[:, 0] != pairs[:, 1])
    return max(float(np.max(-data.contact.dist[between], initial=0.0)), 0.0)

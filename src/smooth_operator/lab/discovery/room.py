"""Penetration depth of fingers into each other."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.lab.discovery.branches import Chain
from smooth_operator.lab.discovery.skeleton import Skeleton


def finger_overlap(
    skeleton: Skeleton, chains: tuple[Chain, ...], q: Float[np.ndarray, " n"]
) -> float:
    """Deepest overlap of shapes of two fingers in a pose [m]; 0 if none touch.

    Meshes count as their convex hulls, and what the model takes out of collision stays out.

    Args:
        skeleton: the model.
        chains: the fingers.
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

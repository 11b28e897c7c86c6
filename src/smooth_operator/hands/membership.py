"""Selects the bodies and joints of a model that belong to the hand."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Bool


def own_joints(model: mujoco.MjModel, palm: int) -> tuple[int, ...]:
    """Hinges and slides below the palm, in the model's own order.

    Args:
        model: the compiled model.
        palm: body; its own joints, as a wrist's, move the hand as a whole and are not the hand's.
    """
    own = _below(model, palm)
    own[palm] = False
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    fit = own[model.jnt_bodyid] & np.isin(model.jnt_type, kinds)
    return tuple(int(j) for j in np.flatnonzero(fit))


def own_bodies(model: mujoco.MjModel, palm: int) -> Bool[np.ndarray, " nbody"]:
    """Bodies to draw and to look at for collisions: the palm, what hangs from it, its base.

    The base is what the palm is fixed to without a joint, and what is fixed to that and carries
    nothing that moves; fingers of a second hand on the same base are left out.
    """
    below = _below(model, palm)
    rigid = np.asarray(model.body_weldid == model.body_weldid[palm])
    carries = np.zeros(model.nbody, bool)  # a joint, on it or further out
    above = np.zeros(model.nbody, bool)
    for body in range(model.nbody - 1, 0, -1):  # children come last
        carries[body] |= bool(model.body_jntnum[body])
        carries[model.body_parentid[body]] |= carries[body]
    body = palm
    while body:
        body = int(model.body_parentid[body])
        above[body] = True
    own: np.ndarray = below | (rigid & (above | ~carries))
    return own


def _below(model: mujoco.MjModel, top: int) -> Bool[np.ndarray, " nbody"]:
    """A body and all that hangs from it."""
    below = np.zeros(model.nbody, bool)
    below[top] = True
    for body in range(top + 1, model.nbody):  # parents come first
        below[body] |= below[model.body_parentid[body]]
    return below

"""Which joints follow another, and whether what the file says of it can be."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from smooth_operator.hands.discovery.findings import Finding, FoundCoupling
from smooth_operator.hands.discovery.skeleton import Skeleton

_DECLARED: Final = 0.95
_TENDON: Final = 0.7  # how the joints of a tendon share its travel is not in the file
_CONTRADICTED: Final = 0.3
_OVERLAP: Final = 0.05  # least share of a follower's range that its leader must be able to use


def find_couplings(
    skeleton: Skeleton, joints: frozenset[int]
) -> tuple[tuple[FoundCoupling, ...], Finding]:
    """The couplings among a hand's joints, and what to say of them all.

    A coupling is doubted that would leave its follower no room: in such a file a sign is wrong.

    Args:
        skeleton: the model.
        joints: those of the hand.
    """
    names = {skeleton.joint_names[j] for j in joints}
    tendons = _on_tendons(skeleton)
    found, said = [], []
    for c in skeleton.couplings:
        if c.joint not in names:
            continue
        text = f"{c.joint} follows {c.follows}"
        confidence = _DECLARED
        if c.joint in tendons:
            confidence = _TENDON
            text += " on a tendon (how they share its travel is taken from its coefficients)"
        if _contradicted(skeleton, c.joint):
            confidence = _CONTRADICTED
            text += (
                f" with the factor {c.multiplier:g}, as declared, which its own limits do not "
                "allow: is the sign wrong in the file?"
            )
        found.append(FoundCoupling(c, confidence))
        said.append(text)
    overrule = "edit the model file"
    if not found:
        return (), Finding("coupled", "none", 0.9, ("the file declares none",), overrule)
    least = min(f.confidence for f in found)
    return tuple(found), Finding(
        "coupled", f"{len(found)} joints", least, (*said, "as the file declares"), overrule
    )


def _contradicted(skeleton: Skeleton, name: str) -> bool:
    follower = skeleton.joint_names.index(name)
    leader, gain, offset = skeleton.leaders[follower]
    ranges = skeleton.limits[[follower, leader]]
    if not np.isfinite(ranges).all():
        return False
    led = np.sort(gain * ranges[1] + offset)
    overlap = min(ranges[0, 1], led[1]) - max(ranges[0, 0], led[0])
    return bool(overlap < _OVERLAP * min(np.ptp(ranges[0]), np.ptp(led)))


def _on_tendons(skeleton: Skeleton) -> set[str]:
    """Joints that a tendon moves, and no equality holds to another."""
    model = skeleton.model
    kind, held = mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtEq.mjEQ_JOINT
    wrapped = {int(model.wrap_objid[w]) for w in np.flatnonzero(model.wrap_type == int(kind))}
    equal = {int(model.eq_obj1id[e]) for e in np.flatnonzero(model.eq_type == int(held))}
    return {skeleton.joint_names[j] for j in wrapped - equal}

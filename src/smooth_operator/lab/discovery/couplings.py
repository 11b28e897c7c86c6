"""Couplings of joints, and a check of those that the file declares."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from smooth_operator.hands.loading import NO_ROOM, Coupling, shared_range
from smooth_operator.lab.discovery.findings import Finding, FoundCoupling
from smooth_operator.lab.discovery.skeleton import Skeleton

_DECLARED: Final = 0.95
_TENDON: Final = 0.7  # how the joints of a tendon share its travel is not in the file
_CONTRADICTED: Final = 0.3


def find_couplings(
    skeleton: Skeleton, joints: frozenset[int]
) -> tuple[tuple[FoundCoupling, ...], Finding]:
    """The couplings among a hand's joints, and what to say of them all.

    A coupling is doubted that would leave its follower no room: in such a file a sign is wrong, and
    has been turned where that mends it.

    Args:
        skeleton: the model.
        joints: those of the hand.
    """
    names = {skeleton.joint_names[j] for j in joints}
    tendons = _on_tendons(skeleton)
    couplings, notes = [], []
    for c in skeleton.couplings:
        if c.joint not in names:
            continue
        text = f"{c.joint} follows {c.follows}"
        confidence = _DECLARED
        if c.joint in tendons:
            confidence = _TENDON
            text += " on a tendon (how they share its travel is taken from its coefficients)"
        if c.turned:
            confidence = _CONTRADICTED
            text += f" with the factor {c.multiplier:g}: {_turned(c)}"
        elif _contradicted(skeleton, c.joint):
            confidence = _CONTRADICTED
            text += (
                f" with the factor {c.multiplier:g}, as declared, which its own limits do not "
                "allow: mend the factor or the limits in the file"
            )
        couplings.append(FoundCoupling(c, confidence))
        notes.append(text)
    overrule = "edit the model file"
    if not couplings:
        return (), Finding("coupled", "none", 0.9, ("the file declares none",), overrule)
    least = min(f.confidence for f in couplings)
    return tuple(couplings), Finding(
        "coupled", f"{len(couplings)} joints", least, (*notes, "as the file declares"), overrule
    )


def coupling_notes(couplings: tuple[FoundCoupling, ...]) -> tuple[str, ...]:
    """Warnings: couplings that are not as the file has them."""
    return tuple(
        f"joint {c.joint!r} follows {c.follows!r} with the factor {c.multiplier:g}: {_turned(c)}. "
        "Check it on the hand; if it is the limits that are wrong, mend them in the file"
        for c in (f.coupling for f in couplings)
        if c.turned
    )


def _turned(coupling: Coupling) -> str:
    return (
        f"the file says {-coupling.multiplier:g}, for which its own limits leave no room, so the "
        "sign is taken to be wrong there"
    )


def _contradicted(skeleton: Skeleton, name: str) -> bool:
    follower = skeleton.joint_names.index(name)
    leader, gain, offset = skeleton.leaders[follower]
    ranges = skeleton.limits[[follower, leader]]
    if not np.isfinite(ranges).all():
        return False
    resolved = Coupling(name, skeleton.joint_names[leader], gain, offset)
    return shared_range(resolved, *ranges) < NO_ROOM


def _on_tendons(skeleton: Skeleton) -> set[str]:
    """Joints that a tendon moves, and no equality holds to another."""
    model = skeleton.model
    kind, held = mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtEq.mjEQ_JOINT
    wrapped = {int(model.wrap_objid[w]) for w in np.flatnonzero(model.wrap_type == int(kind))}
    equal = {int(model.eq_obj1id[e]) for e in np.flatnonzero(model.eq_type == int(held))}
    return {skeleton.joint_names[j] for j in wrapped - equal}

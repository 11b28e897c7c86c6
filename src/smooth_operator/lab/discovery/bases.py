"""Finger bases that joints move, fixed to the palm."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from smooth_operator.hands.spec import FingerSpec, Point
from smooth_operator.lab.discovery.findings import Finding
from smooth_operator.lab.discovery.motion import Reach
from smooth_operator.lab.discovery.skeleton import Placement, Skeleton

_STILL: Final = 1e-4  # [m]: a base that travels less lies on its joints' axes, but for rounding


def fix_bases(
    skeleton: Skeleton,
    palm: int,
    fingers: tuple[FingerSpec, ...],
    reach: Reach,
    neutral: Placement,
) -> tuple[tuple[FingerSpec, ...], dict[str, float]]:
    """Puts bases that joints move where they lie in the neutral pose, fixed to the palm.

    A human's knuckles don't move in the palm, and the alignment goes by them: with a base that
    swings with its finger, spreading the fingers would turn the whole hand.

    Args:
        skeleton: the model.
        palm: the palm's body.
        fingers: as found.
        reach: poses to see in which a base moves.
        neutral: the neutral pose.

    Returns:
        the fingers; and of those whose base was moved, by how much joints move it [m].
    """
    bodies = [int(skeleton.model.body(finger.base.body).id) for finger in fingers]
    offsets = [np.array(finger.base.offset) for finger in fingers]

    def places(at: Placement) -> np.ndarray:
        points = [at.world(b, offset) for b, offset in zip(bodies, offsets, strict=True)]
        return at.local(palm, np.array(points))

    placed = np.array([places(skeleton.place(q)) for q in reach.poses])  # (s, f, 3)
    travel = np.linalg.norm(placed[:, None] - placed[None], axis=-1).max(axis=(0, 1))
    out, moved = [], {}
    for finger, place, path in zip(fingers, places(neutral), travel, strict=True):
        if path > _STILL:
            x, y, z = (round(float(c), 6) + 0.0 for c in place)
            base = Point(skeleton.body_name(palm), (x, y, z))
            finger = replace(finger, points=(base, *finger.points[1:]))
            moved[finger.name] = float(path)
        out.append(finger)
    return tuple(out), moved


def bases_finding(moved: dict[str, float]) -> Finding:
    """Reports what was done about the bases, for the checklist.

    Args:
        moved: human finger -> how far joints would move its base [m].
    """
    why = "no joint moves them"
    if moved:
        why = (
            f"joints move {'that' if len(moved) == 1 else 'those'} of {', '.join(moved)}, by up "
            f"to {max(moved.values()) * 1e3:.0f} mm; put where they lie in the neutral pose, as a "
            "human's knuckles don't move in the palm"
        )
    return Finding(
        "bases",
        "fixed to the palm",
        0.85 if moved else 0.9,
        (why,),
        "edit the first point of the finger in the spec file",
    )

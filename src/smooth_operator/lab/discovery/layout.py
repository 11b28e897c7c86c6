"""Palm directions, side, and the order of the fingers across the palm."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.lab.discovery.branches import Chain
from smooth_operator.lab.discovery.motion import Bending, Reach
from smooth_operator.landmarks import FINGERS
from smooth_operator.types import Side

_CLEAR: Final = 0.12  # of a finger's length: thumb off the middle of the palm, for a clear side
_BASE: Final = 0.04  # the same of its base, to the side of its reach; hands have 0.1 to 0.5
_UNCLEAR: Final = 0.3  # confidence of a side that is not clear


@dataclass(frozen=True, eq=False)
class Layout:
    """The hand's own directions, world frame, and what follows from them.

    Attributes:
        forward: from wrist to fingers.
        lateral: axis about which the fingers close, right-handed; to the thumb of a right hand.
        palmar: out of the palm, forward and lateral at right angles to it.
        side: right or left.
        side_confidence: confidence of the side.
        side_evidence: in words.
        order: chain indices, thumb first, then from the thumb's side.
        order_confidence: confidence of the order.
        order_evidence: in words.
        names: human fingers, in that order.
        names_confidence: confidence of the names.
    """

    forward: Float[np.ndarray, "3"]
    lateral: Float[np.ndarray, "3"]
    palmar: Float[np.ndarray, "3"]
    side: Side
    side_confidence: float
    side_evidence: tuple[str, ...]
    order: tuple[int, ...]
    order_confidence: float
    order_evidence: tuple[str, ...]
    names: tuple[str, ...]
    names_confidence: float


def find_layout(
    chains: tuple[Chain, ...],
    bends: tuple[Bending, ...],
    reach: Reach,
    thumb: int,
    labels: list[str | None],
    side_said: Side | None,
    side_given: Side | None,
) -> Layout:
    """Side and order from the directions in which the fingers point and close.

    With fingers pointing along f and closing about w, the palm faces w x f, and a right hand has
    its thumb on the side of w.

    Args:
        reach: places that the fingers can reach.
        labels: the human finger that each one's names speak of.
        side_said: the side that names speak of.
        side_given: the side that a person gave.
    """
    others = [i for i in range(len(chains)) if i != thumb]
    length = float(np.median([chain.length for chain in chains]))
    lateral = _unit(np.mean([bends[i].axis for i in others], axis=0), bends[others[0]].axis)
    forward = np.mean([bends[i].along for i in others], axis=0)
    forward = _unit(forward - (forward @ lateral) * lateral, bends[others[0]].along)
    palmar = np.cross(lateral, forward)

    bases = np.array([chain.base for chain in chains])
    middle = reach.tips.mean(axis=0)  # of all that each finger reaches
    by_base = float((bases[thumb] - bases[others].mean(axis=0)) @ lateral) / length
    by_reach = float((middle[thumb] - middle[others].mean(axis=0)) @ lateral) / length
    sideways = 0.5 * by_base + 0.5 * by_reach
    side: Side = "right" if sideways >= 0 else "left"
    clear = min(abs(sideways) / _CLEAR, 1.0)
    evidence = [
        "seen with the fingers up and the palm towards you, the thumb is "
        f"{abs(sideways) * length * 1e3:.0f} mm to the {side}: its base "
        f"{by_base * length * 1e3:+.0f} mm, its reach {by_reach * length * 1e3:+.0f} mm"
    ]
    sure = min(bends[i].clear for i in others)
    confidence = 0.4 + 0.45 * clear + 0.13 * min(sure / 0.2, 1.0)
    if by_base * np.sign(by_reach) < _BASE:
        confidence = _UNCLEAR
        evidence.append(
            "the two disagree: the fingers stand around the middle, it may be a gripper without a "
            "side"
        )
    if clear < 0.3:
        confidence = _UNCLEAR
        evidence = ["the thumb is opposite the middle of the palm: the hand may serve as either"]
        if side_said is not None:
            side = side_said
        elif side_given is None:
            side = "right"
            evidence.append("right is assumed")
    if side_said == side:
        confidence = min(confidence + (0.3 if clear < 0.3 else 0.05), 0.98)
        evidence.append(f"names say {side} (weak evidence)")
    elif side_said is not None:
        confidence = max(confidence - 0.25, 0.1)
        evidence.append(f"though names say {side_said}")
    if side_given is not None:
        if side_given != side and clear >= 0.3:
            evidence.append(f"given as {side_given}, though the shape says {side}")
            confidence = 0.4
        else:
            evidence.append("given with --side")
            confidence = max(confidence, 0.95)
        side = side_given

    # An unclear thumb has no clear side: the side of the hand then says where the index is.
    towards = 1.0 if (sideways >= 0 if clear >= 0.3 else side == "right") else -1.0
    place = {i: towards * float((0.7 * bases[i] + 0.3 * middle[i]) @ lateral) for i in others}
    ranked = sorted(others, key=lambda i: place[i], reverse=True)
    gaps = [place[a] - place[b] for a, b in pairwise(ranked)]
    gap = min(gaps, default=length)
    ordered = 0.5 + 0.47 * min(gap / (0.1 * length), 1.0)
    reasons = [
        "from the thumb's side across the palm, "
        + (f"at least {gap * 1e3:.0f} mm apart" if gaps else "one finger besides the thumb")
    ]
    if clear < 0.3 and len(others) > 1:
        ordered = min(ordered, 0.4)
        reasons.append("which end is the thumb's follows from the side, which is not clear")
    if clear < 0.3 and _spoken([labels[i] for i in others]):
        # what the shape leaves open, names may decide
        ranked = sorted(others, key=lambda i: FINGERS.index(labels[i] or ""))
        ordered = 0.6
        reasons[1:] = ["its ends are distinguished by names only (weak evidence)"]
        if side_said is None and side_given is None and len(ranked) > 1:
            across = bases @ lateral
            side = "right" if across[ranked[0]] > across[ranked[-1]] else "left"
            evidence[-1] = f"{side}, if the names of its fingers are right"
    names, how_sure, why = _names([labels[i] for i in ranked])
    return Layout(
        forward=forward,
        lateral=lateral,
        palmar=palmar,
        side=side,
        side_confidence=round(confidence, 2),
        side_evidence=tuple(evidence),
        order=(thumb, *ranked),
        order_confidence=round(min(ordered, how_sure), 2),
        order_evidence=(*reasons, *why),
        names=("thumb", *names),
        names_confidence=round(how_sure, 2),
    )


def _names(labels: list[str | None]) -> tuple[tuple[str, ...], float, list[str]]:
    """Human fingers for the robot's, in their order; names of the model only if they fit."""
    count = len(labels)
    named = _spoken(labels)
    if named and list(named) == sorted(named, key=FINGERS.index):
        return named, 0.95, ["named as the model's own names say"]
    names = FINGERS[1 : 1 + count]
    if count == 4:
        return names, 0.95, []
    drives = f"driven by {', '.join(names)}; any other may drive them"
    return names, 0.85 if count == 3 else 0.75, [drives]


def _spoken(labels: list[str | None]) -> tuple[str, ...]:
    """Finger names of the chains other than the thumb; empty unless each has one."""
    named = tuple(name for name in labels if name is not None and name != "thumb")
    return named if len(set(named)) == len(labels) else ()


def _unit(vector: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    norm = float(np.linalg.norm(vector))
    return vector / norm if norm > 1e-6 else otherwise

"""Search for the thumb: the finger that closes against the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smooth_operator.lab.discovery.branches import Chain
from smooth_operator.lab.discovery.motion import Bending, Reach


@dataclass(frozen=True)
class Thumb:
    """The thumb's index among the chains, how sure, why."""

    index: int
    confidence: float
    evidence: tuple[str, ...]


def find_thumb(
    chains: tuple[Chain, ...],
    bends: tuple[Bending, ...],
    reach: Reach,
    labels: list[str | None],
) -> Thumb:
    """Finds the thumb by opposition, by the direction in which it closes, by where its base is.

    Args:
        chains: the fingers.
        bends: bending of each finger.
        reach: places that they can reach together.
        labels: the human finger that each one's names speak of; weak evidence.
    """
    count = len(chains)
    length = float(np.median([chain.length for chain in chains]))
    opposed = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            opposed[i, j] = opposed[j, i] = reach.opposition(i, j, length)
    closing = reach.axes.mean(axis=0)
    straight = np.array([bend.axis for bend in bends])
    bases = np.array([chain.base for chain in chains])
    along = np.array([bend.along for bend in bends])

    scores, parts = np.zeros(count), []
    for t in range(count):
        others = [i for i in range(count) if i != t]
        rest = opposed[np.ix_(others, others)]
        pairs = len(others) * (len(others) - 1)
        opposition = opposed[t, others].mean() - (rest.sum() / pairs if pairs else 0.0)
        moving, cosine = _apart(closing, t)
        resting, _ = _apart(straight, t)
        across = (moving + resting) / 2 if count > 2 else 0.0
        forward = along[others].mean(axis=0)
        behind = float((bases[others].mean(axis=0) - bases[t]) @ forward) / length
        # a name counts against the others' silence only
        named = float(labels[t] == "thumb" and labels.count("thumb") == 1)
        scores[t] = (
            1.2 * opposition + across + 0.5 * float(np.clip(behind, -0.5, 0.6)) + 0.35 * named
        )
        parts.append((opposed[t, others].max(), cosine, behind, named))

    best = int(np.argmax(scores))
    margin = float(scores[best] - np.delete(scores, best).max())
    meets, cosine, behind, named = parts[best]
    evidence = []
    if count > 2:
        if meets > 0.05:
            met = sum(opposed[best, i] > 0.05 for i in range(count) if i != best)
            evidence.append(f"it meets {met} of {count - 1} fingertips pad to pad")
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        evidence.append(f"it closes about an axis {angle:.0f}° from the others'")
    if behind > 0.1:
        evidence.append(f"its base is {behind * length * 1e3:.0f} mm behind the others'")
    if named:
        evidence.append("its names say so (weak evidence)")
    if labels.count("thumb") == 1 and not named:
        evidence.append("though names call another finger the thumb")
        margin -= 0.2
    if count == 2:
        evidence.append("of two fingers, which is the thumb is a matter of taste")
        confidence = 0.35 + 0.35 * float(np.clip(margin, 0, 1))
    else:
        confidence = 0.4 + 0.8 * float(np.clip(margin, 0, 0.72))
    return Thumb(best, round(float(np.clip(confidence, 0.05, 0.98)), 2), tuple(evidence))


def _apart(axes: np.ndarray, finger: int) -> tuple[float, float]:
    """Measures how much one finger's closing direction differs from the others'.

    Returns:
        1 where all others close about one axis and it about the opposite one, 0 where it closes
        as they do or they do not agree; and the cosine of its axis and their mean.
    """
    together = np.delete(axes, finger, axis=0).mean(axis=0)
    agree, own = float(np.linalg.norm(together)), float(np.linalg.norm(axes[finger]))
    cosine = float(axes[finger] @ together) / max(agree * own, 1e-9)
    return agree * (1 - cosine) / 2, cosine

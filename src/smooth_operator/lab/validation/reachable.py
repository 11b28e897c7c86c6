"""What a hand can reach: poses, and pinches of the thumb with each other finger."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.lab.validation.checks import Check
from smooth_operator.lab.validation.samples import Samples

_TOUCH: Final = 1e-3  # deepest overlap of a pose that a real hand could take [m]
_PINCH: Final = 0.02  # closer than this, targets with pinches mean a pinch and not the pose [m]
_TRIES: Final = 40  # random poses per wanted one


def reachable_poses(hand: Hand, count: int, seed: int) -> Float[np.ndarray, "T m"]:
    """Random poses within the limits that a real hand could take, and that mean no pinch.

    Uniform in every actuated joint. Left out are poses in which parts of the hand lie more than a
    millimetre inside each other (as far as the model has shapes), and those in which the thumb's
    tip is within 20 mm of another: there, a method that closes pinches is right to go elsewhere. A
    hand that has too few such poses gets those that come nearest to it.

    Args:
        count: number of poses.

    Returns:
        (count, m) positions of the actuated joints [rad].
    """
    rng, low, high = np.random.default_rng(seed), hand.limits[:, 0], hand.limits[:, 1]
    batches: list[np.ndarray] = []
    rest: list[np.ndarray] = []
    faults: list[np.ndarray] = []
    for _ in range(_TRIES):
        if sum(map(len, batches)) >= count:
            break
        poses = rng.uniform(low, high, (count, len(low)))
        fault = _fault(hand, poses)
        batches.append(poses[fault <= 0])
        rest.append(poses[fault > 0])
        faults.append(fault[fault > 0])
    order = np.argsort(np.concatenate(faults), kind="stable")
    chosen: np.ndarray = np.concatenate([*batches, np.concatenate(rest)[order]])[:count]
    return chosen


def _fault(hand: Hand, poses: Float[np.ndarray, "T m"]) -> Float[np.ndarray, " T"]:
    """(T,) by how much a pose breaks the two rules [m]; 0 where it keeps them."""
    every = hand.full_configuration(poses)
    tips = hand.tips(every)
    gaps = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1).min(axis=1)
    depths = penetration_depths(hand, every)
    inside = np.zeros(len(poses)) if depths is None else np.maximum(depths - _TOUCH, 0)
    fault: np.ndarray = inside + np.maximum(_PINCH - gaps, 0)
    return fault


_MEETS: Final = 0.010  # landmarks lie in the pads or inside the tips, so they need not touch [m]
_NEAR: Final = 0.030  # [m]
_MET: Final = 1e-4  # nearer is not worth looking for [m]
_STARTS: Final = 4
_EVALUATIONS: Final = 60


def check_pinches(samples: Samples, sound: tuple[str, ...]) -> Check:
    """Finds the fingers that the thumb can pinch with, by landmarks; shapes may touch before."""
    hand = samples.hand
    others = [name for name in hand.fingers if name != "thumb" and name in sound]
    if "thumb" not in sound or not others:
        return Check("pinches", "skipped", "not checked: fingertips have to be mended first")
    gaps = {name: closest_pinch(samples, name) for name in others}
    figures = {name: round(1e3 * gap, 2) for name, gap in gaps.items()}
    text = "thumb to " + ", ".join(f"{name} {1e3 * gap:.1f}" for name, gap in gaps.items()) + " mm"
    apart = [name for name, gap in gaps.items() if gap > _MEETS]
    check = partial(Check, "pinches", figures=figures)
    if not apart:
        return check("ok", text)
    if all(gap > _NEAR for gap in gaps.values()):
        return check(
            "failed",
            text,
            "the thumb meets no finger: look at its limits and tip, and whether it is the thumb",
        )
    return check(
        "warning",
        text,
        f"no pinch with {', '.join(apart)}: some hands can't; if yours can, look at limits, tips",
    )


def closest_pinch(samples: Samples, finger: str) -> float:
    """Smallest distance of the tips of thumb and finger over all poses within the limits [m].

    Least squares within the limits, from the best of many random poses.
    """
    from scipy.optimize import least_squares

    hand, k = samples.hand, samples.hand.fingers.index(finger)
    apart = np.linalg.norm(samples.tips[:, k] - samples.tips[:, 0], axis=1)
    low, high = hand.limits.T
    inset = 1e-6 * (high - low)  # least_squares begins within the limits

    nudges = 1e-6 * np.eye(len(low))

    def gap(q: Float[np.ndarray, "*batch m"]) -> Float[np.ndarray, "*batch 3"]:
        tips = hand.tips(hand.full_configuration(q))
        return np.asarray(tips[..., k, :] - tips[..., 0, :])

    def jacobian(q: Float[np.ndarray, " m"]) -> Float[np.ndarray, "3 m"]:
        return np.asarray((gap(q + nudges) - gap(q - nudges)).T / 2e-6)

    best = np.inf
    for start in samples.poses[np.argsort(apart)[:_STARTS]]:
        inside = np.clip(start, low + inset, high - inset)
        found = least_squares(
            gap, inside, jacobian, bounds=(low, high), x_scale=high - low, max_nfev=_EVALUATIONS
        )
        best = min(best, float(np.linalg.norm(found.fun)))
        if best < _MET:
            break
    return best

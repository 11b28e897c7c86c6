"""Distance to which the thumb's tip can approach each other fingertip."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.lab.validation.checks import Check
from smooth_operator.lab.validation.samples import Samples

_MEETS: Final = 0.010  # landmarks lie in the pads or inside the tips, so they need not touch [m]
_NEAR: Final = 0.030  # [m]
_MET: Final = 1e-4  # nearer is not worth looking for [m]
_STARTS: Final = 4
_STEPS: Final = 60


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
    if not apart:
        return Check("pinches", "ok", text, "", figures)
    if all(gap > _NEAR for gap in gaps.values()):
        return Check(
            "pinches",
            "failed",
            text,
            "the thumb meets no finger: look at its limits and tip, and whether it is the thumb",
            figures,
        )
    return Check(
        "pinches",
        "warning",
        text,
        f"no pinch with {', '.join(apart)}: some hands can't; if yours can, look at limits, tips",
        figures,
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

    def gap(q: Float[np.ndarray, " m"]) -> Float[np.ndarray, "3"]:
        tips = hand.tips(hand.full_configuration(q))
        return np.asarray(tips[k] - tips[0])

    best = np.inf
    for start in samples.poses[np.argsort(apart)[:_STARTS]]:
        inside = np.clip(start, low + inset, high - inset)
        found = least_squares(gap, inside, bounds=(low, high), x_scale=high - low, max_nfev=_STEPS)
        best = min(best, float(np.linalg.norm(found.fun)))
        if best < _MET:
            break
    return best

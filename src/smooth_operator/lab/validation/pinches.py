"""Distance to which the thumb's tip can approach each other fingertip."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.lab.validation.checks import Check
from smooth_operator.lab.validation.samples import Samples

_MEETS: Final = 0.010  # landmarks lie in the pads or inside the tips, so they need not touch [m]
_NEAR: Final = 0.030  # [m]
_MET: Final = 1e-4  # nearer is not worth looking for [m]
_STARTS: Final = 24
_STEPS: Final = 40
_DAMPING: Final = (1e-6, 1e-4, 1e-2)  # of Levenberg and Marquardt, in half ranges [m^2]
_DIFFERENCE: Final = 1e-5  # of a joint's half range


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

    From the best of many random poses, Levenberg and Marquardt's steps within the limits.
    """
    hand, k = samples.hand, samples.hand.fingers.index(finger)
    apart = np.linalg.norm(samples.tips[:, k] - samples.tips[:, 0], axis=1)
    q = samples.poses[np.argsort(apart)[:_STARTS]]
    low, half = hand.limits[:, 0], np.ptp(hand.limits, axis=1) / 2
    x = (q - low) / half  # 0 to 2
    used = np.flatnonzero(
        [np.abs(_gaps(hand, k, low + half * (x + step)) - _gaps(hand, k, q)).max() > 1e-9
         for step in 1e-3 * np.eye(len(low))]
    )  # fmt: skip
    gap = _gaps(hand, k, q)
    best = (gap**2).sum(axis=1)
    steps = _DIFFERENCE * np.eye(len(low))[used]
    for _ in range(_STEPS):
        if best.min() < _MET**2:
            break
        ahead = _gaps(hand, k, low + half * (x[:, None] + steps))
        jacobian = (ahead - gap[:, None]) / _DIFFERENCE  # (s, u, 3)
        for damping in _DAMPING:
            # (J J' + d I) is 3 x 3: the step in joints is J' of its solution
            free = _free(x[:, used], np.einsum("suc,sc->su", jacobian, gap))
            open_jacobian = jacobian * free[..., None]
            system = np.einsum("suc,sud->scd", open_jacobian, open_jacobian)
            solved = np.linalg.solve(system + damping * np.eye(3), gap[..., None])[..., 0]
            trial = x.copy()
            trial[:, used] -= np.einsum("suc,sc->su", open_jacobian, solved)
            trial = np.clip(trial, 0, 2)
            new = _gaps(hand, k, low + half * trial)
            cost = (new**2).sum(axis=1)
            better = cost < best
            x[better], gap[better], best[better] = trial[better], new[better], cost[better]
    return float(np.sqrt(best.min()))


def _gaps(hand: Hand, k: int, q: Float[np.ndarray, "*b m"]) -> Float[np.ndarray, "*b 3"]:
    tips = hand.tips(hand.full_configuration(q))
    gap: np.ndarray = tips[..., k, :] - tips[..., 0, :]
    return gap


def _free(x: np.ndarray, uphill: np.ndarray) -> np.ndarray:
    """Joints that are not pressed against a limit."""
    pressed = ((x <= 0) & (uphill > 0)) | ((x >= 2) & (uphill < 0))
    out: np.ndarray = (~pressed).astype(float)
    return out

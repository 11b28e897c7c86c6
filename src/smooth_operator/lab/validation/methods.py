"""The round trip through every method, as checks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.lab.validation.checks import Check, Verdict
from smooth_operator.lab.validation.round_trip import RoundTrip, round_trip
from smooth_operator.methods.default import DEFAULT_METHOD
from smooth_operator.methods.presets import method_config
from smooth_operator.methods.retargeter import Retargeter

MEASURE: Final = "sbr"
"""The method that the description is judged by: it gets to a pose that the hand can reach."""
GOOD_MM: Final = 3.0
"""Median error of a reachable round trip that ``MEASURE`` is to keep on any hand [mm]."""
_BAD_MM: Final = 10.0
_FROZEN: Final = 0.02  # share of frames
_FOLLOWS_TIPS: Final = (MEASURE, "keyvector", "hybrid")
"""Methods whose answer to a reachable pose is that pose; the others aim at something else."""


def check_method(
    hand: Hand,
    method: str,
    *,
    poses: int,
    seed: int,
    track: Callable[[Iterable[int]], Iterable[int]] | None = None,
) -> Check:
    """One method's round trip; the pull to the neutral pose is taken away, to judge the hand."""
    name = f"round trip: {method}"
    try:
        retargeter = Retargeter(hand, config=method_config(method).without_pull())
    except SmoothOperatorError as error:
        return Check(name, "skipped", f"not served: {error}")
    trip = round_trip(retargeter, poses=poses, seed=seed, track=track)
    verdict, advice = _judge(method, trip)
    text = f"fingertips off by {trip.median:.2f} mm, median; 95 % within {trip.p95:.1f} mm"
    if trip.limit_violations:
        text += f"; {trip.limit_violations} frames outside the limits"
    if (trip.frozen or 0.0) > _FROZEN:
        text += f"; the hand stood still in {100 * (trip.frozen or 0):.0f} % of the motion"
    if trip.ok < 1:
        text += f"; {100 * (1 - trip.ok):.0f} % of the frames refused"
    figures = {
        "median_mm": round(trip.median, 4),
        "p95_mm": round(trip.p95, 4),
        "ok": trip.ok,
        "frozen": trip.frozen,
        "limit_violations": trip.limit_violations,
        "poses": poses,
    }
    return Check(name, verdict, text, advice, figures)


def _judge(method: str, trip: RoundTrip) -> tuple[Verdict, str]:
    if trip.limit_violations:
        return "failed", "please report this: no command may leave the limits"
    if trip.ok < 1:
        return "failed", "look at the palm frame: frames of the hand itself are refused"
    if (trip.frozen or 0.0) > _FROZEN:
        return "failed", "the method can't move this hand: look at limits and couplings"
    if method == DEFAULT_METHOD and trip.median > _BAD_MM:
        return "warning", (
            "poses of the hand itself are followed loosely: look at the model's shapes, which may "
            "keep its parts apart (hands show), and at palm frame and tips"
        )
    if method not in (*_FOLLOWS_TIPS, DEFAULT_METHOD):
        return "unjudged", "for information: this method does not aim at a pose's fingertips"
    if method == DEFAULT_METHOD or trip.median <= GOOD_MM:
        return "ok", ""
    if method == MEASURE and trip.median > _BAD_MM:
        return "failed", "poses of the hand itself can't be followed: look at palm frame and tips"
    return "warning", (
        "poses of the hand itself are followed loosely: look at the palm frame, and whether other "
        "joints reach the same tips"
    )

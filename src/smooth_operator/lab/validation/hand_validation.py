"""Validation of a hand description: all checks, in an order that reports a fault once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.spec import HandSpec
from smooth_operator.lab.validation.checks import Check, HandValidation, Samples
from smooth_operator.lab.validation.fingers import (
    check_flexion,
    check_side,
    check_tips,
    find_flexion_axes,
)
from smooth_operator.lab.validation.joints import (
    check_motion,
    check_neutral,
    check_palm,
    check_ranges,
    check_shapes,
    check_size,
    check_tilt,
)
from smooth_operator.lab.validation.round_trip import MEASURE, check_method, check_pinches
from smooth_operator.methods.default import DEFAULT_METHOD
from smooth_operator.methods.presets import method_names

_POSES: Final = 20

Track = Callable[[str, Sequence[int]], Iterable[int]]
"""What is being done and its steps, to the same steps: for a progress bar."""


def check_hand(
    hand: str | Path | HandSpec | Hand,
    side: str | None = None,
    *,
    quick: bool = False,
    poses: int = _POSES,
    methods: Sequence[str] | None = None,
    seed: int = 0,
    track: Track | None = None,
) -> HandValidation:
    """Checks the description of a hand.

    What rests on something that failed is skipped, so that one fault is one failure: with limits in
    degrees nothing that moves is looked at, and without sound fingertips there is no round trip.

    Args:
        hand: name of a hand, path of a spec file, a description, or a loaded hand.
        side: side of a hand given by name; a spec file brings its own, and is mirrored if the other
            is asked for.
        quick: the round trip goes through two methods only: the one that measures best, and the one
            that is used where none is named.
        poses: number of poses of each round trip.
        methods: that the round trip goes through; all if left out.
        seed: seed of the round trip's poses.
        track: for a progress bar.

    Returns:
        the checklist.

    Raises:
        UnknownNameError: there is no such hand or method.
        HandModelError: the description or its model can't be loaded.
        ConfigError: poses is less than one.
    """
    loaded = hand if isinstance(hand, Hand) else load_hand(hand, side)
    few = (MEASURE, DEFAULT_METHOD)
    chosen = tuple(methods if methods is not None else few if quick else method_names())
    checks = list(_checks(loaded, chosen, poses, seed, track))
    return HandValidation(loaded.name, loaded.spec.side, tuple(checks))


def _checks(
    hand: Hand, methods: tuple[str, ...], poses: int, seed: int, track: Track | None
) -> Iterator[Check]:
    samples = Samples(hand)
    yield (size := check_size(samples))
    yield (palm := check_palm(samples))
    yield (ranges := check_ranges(hand))
    motion = _after("joints used", ranges) if ranges.verdict == "failed" else check_motion(samples)
    yield motion
    tips, sound = check_tips(hand)
    yield tips
    if ranges.verdict == "failed":
        for name in ("palm tilt", "neutral pose", "shapes", "flexion", "side", "pinches"):
            yield _after(name, ranges)
    else:
        failed = palm.verdict == "failed"
        yield _after("palm tilt", palm) if failed else check_tilt(samples)
        yield check_neutral(hand)
        yield check_shapes(hand)
        axes = find_flexion_axes(samples, sound)
        yield check_flexion(axes)
        yield check_side(samples, axes, sound)
        yield check_pinches(samples, sound)
    broken = [check for check in (size, palm, ranges, motion, tips) if check.verdict == "failed"]
    for method in methods:
        name = f"round trip: {method}"
        if broken:
            yield _after(name, broken[0])
            continue
        bar = None if track is None else _named(track, name)
        yield check_method(hand, method, poses=poses, seed=seed, track=bar)


def _named(track: Track, name: str) -> Callable[[Iterable[int]], Iterable[int]]:
    return lambda steps: track(name, list(steps))


def _after(name: str, cause: Check) -> Check:
    return Check(name, "skipped", f"not checked: mend {cause.name!r} first")

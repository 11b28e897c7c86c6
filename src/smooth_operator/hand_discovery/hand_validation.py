"""Validates a hand description: runs all checks, and retargets known poses with every method.

A fault is reported once: a check that depends on a failed one is skipped. A round trip retargets
the landmarks of a pose of the hand; the result should be the same pose."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.hand_discovery.checks import Check, HandValidation, Samples, Verdict
from smooth_operator.hand_discovery.fingers import (
    check_flexion,
    check_side,
    check_tips,
    find_flexion_axes,
)
from smooth_operator.hand_discovery.joint_map import check_joint_map
from smooth_operator.hand_discovery.joints import (
    check_motion,
    check_neutral,
    check_palm,
    check_ranges,
    check_shapes,
    check_size,
    check_tilt,
    check_wrist,
    check_wrist_joints,
)
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.spec import HandSpec
from smooth_operator.hands.surfaces import tip_surface_distances
from smooth_operator.metrics.consistency import frozen_share
from smooth_operator.retargeting.method import MethodConfig, ObjectiveMethodConfig
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.presets import PRESETS, method_names
from smooth_operator.retargeting.program_store import ProgramStore
from smooth_operator.retargeting.registry import DEFAULT_METHOD
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.types import HandFrame, Status

_TOUCH: Final = 1e-3  # largest overlap of parts in a pose that a real hand could take [m]
_PINCH: Final = 0.02  # distance of two tips below which some methods close a pinch [m]
_TRIES: Final = 40  # largest number of random poses for each requested one


def reachable_poses(hand: Hand, count: int, seed: int) -> Float[np.ndarray, "T m"]:
    """Random poses within the limits that a real hand can take, without pinches.

    The poses are uniform in every actuated joint, under two rules. No two parts of the hand overlap
    by more than a millimetre, as far as the model has shapes. The thumb's tip is at least 20 mm
    from the other tips, because a method that closes pinches correctly changes closer poses. If too
    few poses satisfy the rules, those with the smallest violation are added.

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
    """(T,) violation of the two rules of ``reachable_poses`` [m]; 0 if a pose satisfies them."""
    every = hand.full_configuration(poses)
    tips = hand.tips(every)
    gaps = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1).min(axis=1)
    depths = penetration_depths(hand, every)
    inside = np.zeros(len(poses)) if depths is None else np.maximum(depths - _TOUCH, 0)
    fault: np.ndarray = inside + np.maximum(_PINCH - gaps, 0)
    return fault


TOUCH_GAP: Final = 0.010
"""Largest gap of two fingertips that can touch [m], because landmarks lie inside the pads."""
_NEAR: Final = 0.030  # gap to all fingers above which the thumb has a fault [m]
_MET: Final = 1e-4  # gap at which the search ends [m]
_STARTS: Final = 4
_EVALUATIONS: Final = 60


def check_pinches(samples: Samples, sound: tuple[str, ...]) -> Check:
    """Finds the fingers with which the thumb can pinch, and the smallest gap to each other finger.

    It measures the landmarks of the tips, and the surfaces of the last links, which touch earlier.
    A gap is the smallest within the limits, whatever the pose of the rest of the hand.
    """
    hand = samples.hand
    others = [name for name in hand.fingers if name != "thumb" and name in sound]
    if "thumb" not in sound or not others:
        return Check("pinches", "skipped", "not checked: correct the fingertips first")
    found = {name: _closest(samples, name) for name in others}
    gaps = {name: gap for name, (gap, _) in found.items()}
    surfaces = {name: closest_surfaces(samples, name, q) for name, (_, q) in found.items()}
    figures = {
        "tips_mm": {name: round(1e3 * gap, 2) for name, gap in gaps.items()},
        "surfaces_mm": {
            name: None if np.isnan(gap) else round(1e3 * gap, 2) for name, gap in surfaces.items()
        },
    }
    text = f"smallest gap to the thumb between tip points: {_millimetres(gaps)}"
    if not np.isnan(list(surfaces.values())).any():
        text += f"; between surfaces: {_millimetres(surfaces)}"
    # comparisons with NaN, of a hand without shapes, are false
    apart = [n for n, gap in gaps.items() if gap > TOUCH_GAP and not surfaces[n] <= _TOUCH]
    check = partial(Check, "pinches", figures=figures)
    if not apart:
        return check("ok", text)
    if all(gap > _NEAR for gap in gaps.values()):
        return check(
            "failed",
            text,
            "the thumb can't reach any finger: check the thumb's limits and tip, and check that "
            "the correct finger was detected as the thumb",
        )
    return check(
        "warning",
        text,
        f"the thumb can't pinch with {', '.join(apart)}, which is true of some hands; if yours "
        "can, check limits and tips",
    )


def _millimetres(gaps: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {1e3 * gap:.1f}" for name, gap in gaps.items()) + " mm"


_NEAREST: Final = 120  # random poses from which the surfaces' least gap is searched
_SHARES: Final = (
    0.3,
    0.3,
    0.1,
    0.1,
    0.03,
    0.03,
    0.01,
)  # of the joints' ranges, by which these poses are varied
_VARIED: Final = 60  # variations by each of them


def closest_surfaces(samples: Samples, finger: str, start: Float[np.ndarray, " m"]) -> float:
    """Smallest gap [m] between the last links of thumb and finger over all poses within the limits.

    Random variations, by ever smaller steps, of the best of many random poses and of ``start``.

    Args:
        start: (m,) a pose in which the tips are close [rad].

    Returns:
        The gap; 0 if the surfaces can touch, NaN if one of the links has no shape.
    """
    hand, k = samples.hand, samples.hand.fingers.index(finger)
    low, high = hand.limits.T
    wanted = np.arange(len(hand.fingers) - 1) == k - 1
    rng = np.random.default_rng(0)

    def nearest(poses: Float[np.ndarray, "p m"]) -> tuple[float, Float[np.ndarray, " m"]]:
        every = hand.full_configuration(poses)
        gaps = tip_surface_distances(hand, every, np.tile(wanted, (len(poses), 1)))[:, k - 1]
        best = int(np.argmin(gaps))
        return float(gaps[best]), poses[best]

    apart = np.linalg.norm(samples.tips[:, k] - samples.tips[:, 0], axis=1)
    least, pose = nearest(np.vstack([start, samples.poses[np.argsort(apart)[:_NEAREST]]]))
    for share in _SHARES:
        if not least > 0:  # they touch, or it is NaN
            break
        steps = rng.uniform(-share, share, (_VARIED, len(low))) * (high - low)
        gap, varied = nearest(np.clip(pose + steps, low, high))
        if gap < least:
            least, pose = gap, varied
    return max(least, 0.0) if np.isfinite(least) else least


def closest_pinch(samples: Samples, finger: str) -> float:
    """Smallest distance [m] between the tips of thumb and finger over all poses within the limits.

    Bounded least squares, started from the best of many random poses.
    """
    return _closest(samples, finger)[0]


def _closest(samples: Samples, finger: str) -> tuple[float, Float[np.ndarray, " m"]]:
    """The least distance of two tips [m], and its pose [rad]."""
    from scipy.optimize import least_squares

    hand, k = samples.hand, samples.hand.fingers.index(finger)
    apart = np.linalg.norm(samples.tips[:, k] - samples.tips[:, 0], axis=1)
    low, high = hand.limits.T
    inset = 1e-6 * (high - low)  # least_squares needs a start between the limits
    nudges = 1e-6 * np.eye(len(low))

    def gap(q: Float[np.ndarray, "*batch m"]) -> Float[np.ndarray, "*batch 3"]:
        tips = hand.tips(hand.full_configuration(q))
        return np.asarray(tips[..., k, :] - tips[..., 0, :])

    def jacobian(q: Float[np.ndarray, " m"]) -> Float[np.ndarray, "3 m"]:
        ahead, behind = gap(q + np.stack([nudges, -nudges]))
        return np.asarray((ahead - behind).T / 2e-6)

    best, pose = np.inf, samples.poses[int(np.argmin(apart))]
    for start in samples.poses[np.argsort(apart)[:_STARTS]]:
        inside = np.clip(start, low + inset, high - inset)
        solution = least_squares(
            gap, inside, jacobian, bounds=(low, high), x_scale=high - low, max_nfev=_EVALUATIONS
        )
        if (distance := float(np.linalg.norm(solution.fun))) < best:
            best, pose = distance, np.asarray(solution.x)
        if best < _MET:
            break
    return best, pose


_APPROACH: Final = 20  # frames from the neutral pose to the pose
_HOLD: Final = 15  # frames in which the human then holds the pose
_PERIOD_S: Final = 0.01  # time between two frames [s]
_ROUNDING: Final = 1e-9  # rounding of limits in float64 [rad]


@dataclass(frozen=True, eq=False)
class RoundTrip:
    """Errors of poses that were converted to landmarks and then retargeted back to joint positions.

    Attributes:
        tip_error_mm: (poses, F) distance of each fingertip from its position in the pose [mm],
            thumb first.
        ok: fraction of frames with the status OK.
        limit_violations: number of frames in which a joint was outside its limits.
        frozen: fraction of the frames with a moving human in which no joint moved; None if the
            human never moved.
    """

    tip_error_mm: Float[np.ndarray, "poses F"]
    ok: float
    limit_violations: int
    frozen: float | None

    @cached_property
    def median(self) -> float:
        """Median error over all fingertips of all poses [mm]."""
        return float(np.median(self.tip_error_mm))

    @cached_property
    def p95(self) -> float:
        """95th percentile of the error over all fingertips of all poses [mm]."""
        return float(np.percentile(self.tip_error_mm, 95))


def round_trip(
    retargeter: Retargeter,
    *,
    poses: int,
    seed: int,
    track: Callable[[Iterable[int]], Iterable[int]] | None = None,
) -> RoundTrip:
    """Retargets the landmarks of poses that the hand can reach, and measures how far the results
    are from those poses.

    The input is the robot's own landmarks in random poses (``reachable_poses``). From a fresh
    state, they move from the neutral pose to the pose in 20 frames, because a live hand does not
    jump, and stay there for 15 frames, so that filters settle. The last command counts.

    The method runs with its configuration. Many methods balance a pull to the neutral pose against
    the landmarks, and end millimetres away from a pose that they could reach. To judge a hand
    or a solver, remove that pull with ``without_pull``.

    Args:
        retargeter: the method on its hand; its own state does not change.
        poses: number of poses.
        seed: seed of the poses, apart from that of the retargeter.
        track: wraps the iteration over poses, for a progress bar.

    Raises:
        ConfigError: poses is less than one.
    """
    if poses < 1:
        raise ConfigError(f"a round trip needs at least one pose, not {poses}")
    hand = retargeter.hand
    targets = reachable_poses(hand, poses, seed)
    share = np.append(np.linspace(0, 1, _APPROACH), np.ones(_HOLD))[:, None]
    commands, frozen, good, outside = [], [], 0, 0
    for k in range(poses) if track is None else track(range(poses)):
        way = hand.neutral + share * (targets[k] - hand.neutral)
        landmarks = human_landmarks(hand, way)
        state, positions = retargeter.init(), []
        for i, points in enumerate(landmarks):
            frame = HandFrame(points, i * _PERIOD_S, hand.spec.side)
            state, result = retargeter.step(state, frame)
            positions.append(result.command.joint_positions)
            good += result.status == Status.OK
        run = np.array(positions)
        low, high = hand.joint_limits.T
        outside += int(((run < low - _ROUNDING) | (run > high + _ROUNDING)).any(axis=1).sum())
        reaches = hand.tips(hand.full_configuration(way))
        if (still := frozen_share(reaches - hand.wrist, run)) is not None:
            frozen.append(still)
        commands.append(run[-1])
    missed = hand.tips(np.array(commands)) - hand.tips(hand.full_configuration(targets))
    return RoundTrip(
        tip_error_mm=np.linalg.norm(missed, axis=-1) * 1e3,
        ok=good / (poses * len(share)),
        limit_violations=outside,
        frozen=float(np.mean(frozen)) if frozen else None,
    )


MEASURE: Final = "sbr"
"""Method by which a description is judged, because it reaches any pose that the hand can take."""
GOOD_MM: Final = 3.0
"""Largest median error of ``MEASURE`` in a round trip of a sound hand [mm]."""
_BAD_MM: Final = 10.0
_FROZEN: Final = 0.02  # largest share of frames without motion
_FOLLOWS_TIPS: Final = (MEASURE, "keyvector", "hybrid")
"""Methods whose result for a reachable pose is that pose; the others have another goal."""


_FAINT: Final = 1e-4
"""Weight of a pull to the neutral pose that only decides between equally good poses."""


def without_pull(config: MethodConfig) -> MethodConfig:
    """Settings of a method with almost no pull to the neutral pose, used to judge a hand or a
    solver."""
    if not isinstance(config, ObjectiveMethodConfig):
        return config
    weight = min(config.objective.pose_weight, _FAINT)
    changed: Any = config  # a dataclass, which its base class can't express
    return cast(
        MethodConfig, replace(changed, objective=replace(config.objective, pose_weight=weight))
    )


def check_method(
    hand: Hand,
    method: str,
    *,
    poses: int,
    seed: int,
    track: Callable[[Iterable[int]], Iterable[int]] | None = None,
) -> Check:
    """Runs the round trip of one method without its pull to the neutral pose, to judge the hand
    rather than the method."""
    name = f"round trip: {method}"
    try:
        # A published limit of iterations says nothing about the hand.
        preset = "fast" if "fast" in PRESETS[method] else None
        config = without_pull(method_config(method, preset))
        retargeter = Retargeter(hand, config=config, cache=ProgramStore.of_user())
    except SmoothOperatorError as error:
        return Check(name, "skipped", f"not supported: {error}")
    trip = round_trip(retargeter, poses=poses, seed=seed, track=track)
    verdict, advice = _judge(method, trip)
    within = trip.ok == 1 and not trip.limit_violations
    if hand.spec.gripper and method == DEFAULT_METHOD and within:
        verdict, advice = (
            "unjudged",
            "for information only: this method scales the human's pinch to the gripper's opening",
        )
    text = f"fingertips are off by {trip.median:.2f} mm (median); 95 % by {trip.p95:.1f} mm or less"
    if trip.limit_violations:
        text += f"; {trip.limit_violations} frames are outside the limits"
    if (trip.frozen or 0.0) > _FROZEN:
        text += f"; the hand did not move in {100 * (trip.frozen or 0):.0f} % of the motion"
    if trip.ok < 1:
        text += f"; {100 * (1 - trip.ok):.0f} % of the frames were refused"
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
        return "failed", "please report this: commands must never exceed the limits"
    if trip.ok < 1:
        return "failed", "the method refuses the hand's own landmarks: check the palm frame"
    if (trip.frozen or 0.0) > _FROZEN:
        return "failed", "the method can't move this hand: check limits and couplings"
    if method == DEFAULT_METHOD and trip.median > _BAD_MM:
        return "warning", (
            "the method reproduces the hand's own poses inaccurately: check the model's "
            "shapes, which may keep its parts apart (see hands show), the palm frame and the "
            "tips"
        )
    if method not in (*_FOLLOWS_TIPS, DEFAULT_METHOD):
        return "unjudged", (
            "for information only: this method does not try to match the fingertips of a pose"
        )
    if method == DEFAULT_METHOD or trip.median <= GOOD_MM:
        return "ok", ""
    if method == MEASURE and trip.median > _BAD_MM:
        return (
            "failed",
            "the method can't reproduce the hand's own poses: check the palm frame and the tips",
        )
    return "warning", (
        "the method reproduces the hand's own poses inaccurately: check the palm frame, and "
        "check whether other joint positions give the same fingertip positions"
    )


_TRIP_POSES: Final = 20

Track = Callable[[str, Sequence[int]], Iterable[int]]
"""Function of a progress bar: takes a label and the steps, and yields the steps."""


def check_hand(
    hand: str | Path | HandSpec | Hand,
    side: str | None = None,
    *,
    quick: bool = False,
    poses: int = _TRIP_POSES,
    methods: Sequence[str] | None = None,
    seed: int = 0,
    track: Track | None = None,
) -> HandValidation:
    """Checks the description of a hand.

    A check that depends on a failed one is skipped, so that one fault gives one failure: with
    limits in degrees, no motion is checked, and without sound fingertips there is no round trip.

    Args:
        hand: name of a hand, path of a spec file, a description, or a loaded hand.
        side: side of the hand. A spec file of the other side is mirrored. Default: the side of the
            spec file, or right.
        quick: True for round trips of two methods only: ``MEASURE`` and the default method.
        poses: number of poses of each round trip.
        methods: methods of the round trips. Default: all.
        seed: seed of the round trip's poses.
        track: function of a progress bar.

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
    yield check_wrist(samples)
    if hand.spec.wrist_joints:
        yield check_wrist_joints(hand)
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
        yield check_shapes(samples)
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
    if "joint_angle" in methods:
        yield _after("joint map", broken[0]) if broken else check_joint_map(hand)


def _named(track: Track, name: str) -> Callable[[Iterable[int]], Iterable[int]]:
    return lambda steps: track(name, list(steps))


def _after(name: str, cause: Check) -> Check:
    return Check(name, "skipped", f"not checked: correct {cause.name!r} first")

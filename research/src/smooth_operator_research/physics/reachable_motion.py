"""Measure 1: the human motion is a motion of the robot hand itself, so every target is
reachable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.synthetic.tracker import TrackerStream, tracker_model
from smooth_operator.types import HandRecording, Side, Status
from smooth_operator_research.physics.measure import (
    Case,
    Clip,
    Drawing,
    Measured,
    PhysicsSettings,
    Unit,
)
from smooth_operator_research.physics.page import interval_drawings
from smooth_operator_research.physics.results import Figure, MeasureResults

KNOT_S: Final = 0.4
"""Time between two knots of the spline [s]; half of its inverse, 1.25 Hz, bounds the band."""
PINCH_SHARE: Final = 1 / 3
"""Fraction of key poses in which the thumb touches a finger."""
PINCH_GAP: Final = 0.02
"""Tips closer than this are a pinch [m]."""
TOUCH: Final = 1e-3
"""Largest overlap in a pose that a real hand could take [m]."""

_DRAWS: Final = 30  # key poses that are tried in turn where the way to one collides
_NARROWING: Final = 15  # of them, the last, come nearer and nearer to the pose before
_MOST_FINGERS: Final = 12  # a multiple of 2, 3 and 4: no finger is drawn more often
_STARTS: Final = 12  # random poses from which a pinch is searched
_STEPS: Final = 60
_NEAR: Final = 3e-3  # most that a step of the search closes a pinch [m]
_TURN: Final = 0.15  # most that a joint turns in a step of the search [rad]
_DAMPING: Final = 1e-6  # of the search [m^2]
_PROBE: Final = 1e-5  # of finite differences [rad]
_HALVINGS: Final = 8

# Uniform cubic B-spline: position in a segment -> weights of its four control points.
_BASIS: Final = (
    np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1, 3, -3, 1]])
    / 6.0
)


@dataclass(frozen=True, eq=False)
class JointMotion:
    """A motion of a hand's actuated joints.

    Attributes:
        stamps: (T,) times from 0 [s].
        joints: (T, m) positions of the actuated joints [rad].
        pinches: number of key poses that are pinches.
        deepest: deepest self-penetration [m]; None if the model has no colliding shapes.
    """

    stamps: Float[np.ndarray, " T"]
    joints: Float[np.ndarray, "T m"]
    pinches: int
    deepest: float | None

    @property
    def peak_speed(self) -> float:
        """Highest speed of a joint [rad/s]."""
        return float(np.abs(np.gradient(self.joints, self.stamps, axis=0)).max())


def joint_motion(hand: Hand, seed: int, *, duration: float) -> JointMotion:
    """A random motion from the neutral pose, within the limits and free of self-collision.

    It is a uniform cubic B-spline with a knot every 0.4 s: twice continuously differentiable,
    within the limits because its control points are, and without frequencies above 1.25 Hz. A third
    of the key poses are pinches of the thumb with each finger in turn, which the motion reaches
    exactly and holds for up to 0.4 s; the others are uniform within the limits. A key pose is drawn
    again if, there or on the way to it, parts of the hand are more than a millimetre inside each
    other, provided that the model has colliding shapes.

    Args:
        duration: length [s].
    """
    rng = np.random.default_rng(seed)
    per_knot = round(KNOT_S * RATE_HZ)
    count = round(duration * RATE_HZ)
    segments = -(-count // per_knot)
    poses = _KeyPoses(hand, rng)
    control = [hand.neutral] * 4  # still for one segment
    pinches, deepest = 0, 0.0
    while len(control) < segments + 3:
        pinch = rng.random() < PINCH_SHARE and poses.can_pinch
        turn = int(rng.integers(_MOST_FINGERS))
        for draw in range(_DRAWS):
            key = poses.pinch(turn + draw) if pinch else poses.free()[0]
            # The last draws stay near the pose before, from where the way is free.
            share = min(1.0, (_DRAWS - 1 - draw) / _NARROWING)
            pinch = pinch and share == 1.0
            group = [control[-1] + share * (key - control[-1])]
            group *= int(rng.integers(3, 5) if pinch else rng.integers(1, 3))
            # And two more: that the motion can always rest where it is, so the last draw is free.
            depth = depth_of(hand, spline([*control[-3:], *group, group[-1], group[-1]], per_knot))
            if depth <= TOUCH:
                break
        control += group
        pinches += pinch
        deepest = max(deepest, depth)
    joints = spline(control, per_knot)[:count]
    measurable = penetration_depths(hand, hand.full_configuration(joints[:1])) is not None
    return JointMotion(np.arange(count) / RATE_HZ, joints, pinches, deepest if measurable else None)


def spline(control: list[np.ndarray], per_knot: int) -> Float[np.ndarray, "T m"]:
    """A uniform cubic B-spline.

    Args:
        control: at least four control points; each four neighbours define a segment.
        per_knot: number of frames per segment.

    Returns:
        (segments * per_knot, m) without the end of the last segment.
    """
    points = np.asarray(control)
    u = np.arange(per_knot) / per_knot
    weights = np.stack([np.ones_like(u), u, u**2, u**3], axis=1) @ _BASIS
    return np.concatenate([weights @ points[i : i + 4] for i in range(len(points) - 3)])


def depth_of(hand: Hand, joints: Float[np.ndarray, "T m"]) -> float:
    """Deepest self-penetration of some poses [m]; 0 if the model has no collision shapes."""
    depths = penetration_depths(hand, hand.full_configuration(joints))
    return 0.0 if depths is None else float(depths.max())


class _KeyPoses:
    """Random collision-free poses of a hand, and poses in which the thumb touches a finger."""

    def __init__(self, hand: Hand, rng: np.random.Generator) -> None:
        self.hand, self._rng = hand, rng
        self._low, self._high = hand.limits.T
        pinches = [self._pinches(finger) for finger in range(1, len(hand.fingers))]
        self._found = [poses for poses in pinches if len(poses)]

    @property
    def can_pinch(self) -> bool:
        """True if the thumb reaches a finger."""
        return bool(self._found)

    def free(self, count: int = 1) -> Float[np.ndarray, "k m"]:
        """Collision-free random poses; if there are too few, also those with the least overlap."""
        poses = self._rng.uniform(self._low, self._high, (_DRAWS // 3 * count, len(self._low)))
        depths = penetration_depths(self.hand, self.hand.full_configuration(poses))
        worse = np.zeros(len(poses)) if depths is None else np.maximum(depths, TOUCH)
        chosen: np.ndarray = poses[np.argsort(worse, kind="stable")[:count]]
        return chosen

    def pinch(self, turn: int) -> Float[np.ndarray, " m"]:
        """A pose in which the thumb touches a finger, or comes as near as the hand allows.

        Args:
            turn: number of the pinch; the fingers that the thumb reaches take turns.
        """
        poses = self._found[turn % len(self._found)]
        pose: np.ndarray = poses[self._rng.integers(len(poses))]
        return pose

    def _pinches(self, finger: int) -> Float[np.ndarray, "k m"]:
        """Poses in which the thumb pinches a finger; none where it stays 20 mm away.

        From random poses, damped Gauss-Newton steps bring the two tips together. The pose just
        before the first collision is taken: where it is that of the two pads, they touch. Kept is
        the half with the smallest gaps.

        Args:
            finger: index into ``hand.fingers``.
        """
        pose = self.free(_STARTS)
        path = [pose]
        for _ in range(_STEPS):
            apart, jacobian = self._gap(pose, finger)
            gap = np.linalg.norm(apart, axis=1, keepdims=True)
            target_step = -apart * np.minimum(1.0, _NEAR / np.maximum(gap, 1e-9))
            square = jacobian @ jacobian.transpose(0, 2, 1) + _DAMPING * np.eye(3)
            solved = np.linalg.solve(square, target_step[..., None])
            step = (jacobian.transpose(0, 2, 1) @ solved)[..., 0]
            step *= np.minimum(1.0, _TURN / np.maximum(np.abs(step).max(1, keepdims=True), 1e-9))
            pose = np.clip(pose + step, self._low, self._high)
            path.append(pose)
        touching = self._touching(np.stack(path, axis=1))
        gaps = np.linalg.norm(self._gap(touching, finger)[0], axis=1)
        order = np.argsort(gaps, kind="stable")[: _STARTS // 2]
        chosen: np.ndarray = touching[order[gaps[order] < PINCH_GAP]]
        return chosen

    def _gap(self, pose: np.ndarray, finger: int) -> tuple[np.ndarray, np.ndarray]:
        """Vectors (b, 3) from the thumb's tip to the finger's [m], and their derivatives (b, 3, m)
        by the joints."""
        size = pose.shape[1]
        probes = np.concatenate([np.zeros((1, size)), _PROBE * np.eye(size)])
        tips = self.hand.tips(self.hand.full_configuration(pose[:, None] + probes))
        apart = tips[..., finger, :] - tips[..., 0, :]
        jacobian = (apart[:, 1:] - apart[:, :1]).transpose(0, 2, 1) / _PROBE
        return apart[:, 0], jacobian

    def _touching(self, paths: Float[np.ndarray, "k s m"]) -> Float[np.ndarray, "k m"]:
        """Last collision-free pose of each path; a path begins free of collision."""
        every = self.hand.full_configuration(paths.reshape(-1, paths.shape[-1]))
        depths = penetration_depths(self.hand, every)
        if depths is None:
            last: np.ndarray = paths[:, -1]
            return last
        collides = depths.reshape(paths.shape[:2]) > TOUCH
        first = np.where(collides.any(axis=1), collides.argmax(axis=1), paths.shape[1] - 1)
        row = np.arange(len(paths))
        free, inside = paths[row, np.maximum(first - 1, 0)], paths[row, first]
        for _ in range(_HALVINGS):
            middle = (free + inside) / 2
            depth = penetration_depths(self.hand, self.hand.full_configuration(middle))
            assert depth is not None  # it was not
            good = (depth <= TOUCH)[:, None]
            free, inside = np.where(good, middle, free), np.where(good, inside, middle)
        touching: np.ndarray = free
        return touching


SECONDS: Final = 8.0
QUICK_SECONDS: Final = 3.0
RATE_HZ: Final = 100.0
WARM_UP_S: Final = 0.5
"""Time left out at the beginning [s], because hand and methods start at the neutral pose."""
CLEAN: Final = "clean"
"""Condition in which fingertips do not shake."""
EXACT: Final = 0.5e-3
"""A frame is exact if the error of every fingertip is at most this [m]."""

_UNITS, _QUICK_UNITS = 5, 2
_MOST_LAG = 30  # frames


@dataclass(frozen=True, eq=False)
class AskedMotion:
    """A motion that a robot hand can make exactly, as a recording of a human hand.

    Attributes:
        recording: the robot's own landmarks in the palm frame as a human's, with shaking fingertips
            if requested; the alignment does not move these landmarks.
        joints: (T, n) positions of all joints that produced it [rad].
        tips: (T, F, 3) fingertips at these positions, without shake [m], thumb first.
        motion: motion of the actuated joints.
    """

    recording: HandRecording
    joints: Float[np.ndarray, "T n"]
    tips: Float[np.ndarray, "T F 3"]
    motion: JointMotion


def reachable_motion(
    hand: Hand, seed: int, *, tracker: str | None = None, duration: float = SECONDS
) -> AskedMotion:
    """A random smooth, collision-free motion of a hand, with pinches; see ``joint_motion``.

    Args:
        tracker: kind of tracker whose shake is added to the fingertips, at the rate of the motion
            and without its delay, losses and pinch gaps; None for no shake.
        duration: length [s].
    """
    return _asked(hand, joint_motion(hand, seed, duration=duration), seed, tracker)


def _asked(hand: Hand, motion: JointMotion, seed: int, tracker: str | None) -> AskedMotion:
    landmarks = human_landmarks(hand, motion.joints)
    if tracker is not None:
        model = replace(tracker_model(tracker, seed), pinch_gaps=(0.0, 0.0, 0.0, 0.0))
        rate = 1.0 / float(np.median(np.diff(motion.stamps)))
        landmarks = TrackerStream(model, rate).next(len(landmarks)).shown(landmarks)
    name = f"reachable motion {seed}"
    recording = HandRecording(landmarks, motion.stamps, hand.spec.side, name=name)
    joints = hand.full_configuration(motion.joints)
    return AskedMotion(recording, joints, hand.tips(joints), motion)


@lru_cache(maxsize=8)
def _motion(hand_name: str, side: Side, seed: int, duration: float) -> JointMotion:
    """Motion of a seed, cached for the methods, which run one after another."""
    return joint_motion(load_hand(hand_name, side), seed, duration=duration)


class ReachableMotion:
    """Measure with reachable motions; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "reachable"
    title: Final = "Reachable motion"
    definition: Final = (
        "Error of the fingertips when the human's landmarks are the robot hand's own, in a "
        "random smooth, collision-free motion with pinches that it can make exactly."
    )
    page: Final = "docs/physics-measures.md#reachable-motion"
    unit: Final = "seed"
    figures: Final = (
        Figure(
            "tip_error_mm",
            "mm",
            "down",
            "Fingertip error, mean over fingers and frames.",
            short="tip error",
        ),
        Figure(
            "tip_p95_mm",
            "mm",
            "down",
            "Fingertip error, 95th percentile over fingers and frames.",
            short="tip p95",
        ),
        Figure(
            "pinch_gap_error_mm",
            "mm",
            "down",
            "Difference between the robot's distance of thumb and finger and the target "
            "distance, if that is below 20 mm.",
            short="pinch gap error",
        ),
        Figure(
            "lag_ms",
            "ms",
            "down",
            "Shift in time by which the robot's fingertips fit their targets best.",
            short="lag",
        ),
        Figure(
            "exact",
            "",
            "up",
            "Share of the frames in which no fingertip error exceeds 0.5 mm.",
            short="exact frames",
        ),
        Figure(
            "common_shift_mm",
            "mm",
            "down",
            "Length of the error common to all fingertips: displacement of the whole hand.",
            short="common shift",
            main=False,
        ),
        Figure(
            "input_error_mm",
            "mm",
            "",
            "Error of the aligned tip landmarks in the input: the error of a method that follows "
            "them exactly.",
            short="input error",
            main=False,
        ),
        *(
            Figure(
                f"tip_error_{finger}_mm",
                "mm",
                "down",
                f"Error of the {finger}'s tip, mean.",
                short=finger,
                main=False,
            )
            for finger in FINGERS
        ),
    )

    def conditions(self, settings: PhysicsSettings) -> Sequence[str]:
        """No shake, and the shake of each tracker."""
        return (CLEAN, *settings.trackers)

    def units(self, settings: PhysicsSettings) -> Sequence[Unit]:
        """Seeds of motions."""
        count = settings.count(_UNITS, _QUICK_UNITS)
        seeds = range(settings.seed, settings.seed + count)
        return [Unit(f"seed {seed}", data=seed) for seed in seeds]

    def run(self, case: Case) -> Measured:
        """Retargets one motion."""
        duration = QUICK_SECONDS if case.quick else SECONDS
        motion = _motion(case.hand_name, case.side, case.unit.data, duration)
        tracker = None if case.condition == CLEAN else case.condition
        request = _asked(case.hand, motion, case.unit.data, tracker)
        commands = case.commands(request.recording)
        row = motion_figures(case.hand, request, commands.joint_positions)
        row["held_frames"] = int((commands.status != Status.OK).sum())
        human = align_recording(request.recording, case.hand, case.config.alignment)
        own = [TIPS[FINGERS.index(finger)] for finger in case.hand.fingers]
        off = np.linalg.norm(human[:, own] - request.tips, axis=-1)
        row["input_error_mm"] = 1e3 * float(off[_warm(request) :].mean())
        if not case.clip:
            return Measured(row)
        return Measured(row, Clip(request.recording.stamps, human, commands.joint_positions))

    def draw(self, results: MeasureResults, colors: Mapping[str, str]) -> Sequence[Drawing]:
        """Draws fingertip error, pinch gap error and lag of each method."""
        return interval_drawings(self.name, results, self.figures[:4], colors)


def motion_figures(
    hand: Hand, request: AskedMotion, joints: Float[np.ndarray, "T n"]
) -> dict[str, float | int | str | None]:
    """Measures one motion without its first half second.

    Args:
        joints: (T, n) commanded positions of all joints [rad].
    """
    warm = _warm(request)
    tips = hand.tips(joints)
    off = (tips - request.tips)[warm:]
    error = np.linalg.norm(off, axis=-1)
    gaps, human_gaps = (
        np.linalg.norm(points[warm:, 1:] - points[warm:, :1], axis=-1)
        for points in (tips, request.tips)
    )
    pinched = human_gaps < PINCH_GAP
    apart = np.abs(gaps - human_gaps)[pinched]
    period = float(np.median(np.diff(request.recording.stamps)))
    return {
        "tip_error_mm": 1e3 * float(error.mean()),
        "tip_p95_mm": 1e3 * float(np.percentile(error, 95)),
        "pinch_gap_error_mm": 1e3 * float(apart.mean()) if apart.size else None,
        "lag_ms": 1e3 * period * lag_frames(request.tips[warm:], tips[warm:]),
        "exact": float((error.max(axis=1) <= EXACT).mean()),
        "common_shift_mm": 1e3 * float(np.linalg.norm(off.mean(axis=1), axis=-1).mean()),
        **{
            f"tip_error_{finger}_mm": 1e3 * float(error[:, i].mean())
            for i, finger in enumerate(hand.fingers)
        },
        "pinched_frames": int(pinched.any(axis=1).sum()),
        "frames": len(error),
        "asked_peak_speed_rad_s": request.motion.peak_speed,
        "asked_overlap_mm": None
        if request.motion.deepest is None
        else 1e3 * request.motion.deepest,
    }


def _warm(request: AskedMotion) -> int:
    """Number of frames that are left out."""
    stamps = request.recording.stamps
    return int(np.searchsorted(stamps, stamps[0] + WARM_UP_S))


def lag_frames(human: Float[np.ndarray, "T F 3"], robot: Float[np.ndarray, "T F 3"]) -> float:
    """Delay of one motion behind another in frames.

    It is the whole number of frames with the smallest mean squared distance, plus the fraction that
    explains the remaining distance along the target velocity, by least squares. An exact motion has
    lag 0.

    Args:
        human: (T, F, 3) points [m].
        robot: (T, F, 3) points that follow them [m].

    Returns:
        number of frames, at least -1; 0 if nothing moves or the motion is too short.
    """
    most = min(_MOST_LAG, len(human) // 4)
    if most < 1:
        return 0.0
    own = robot[most:]
    ahead = [human[most - k : len(human) - k] for k in range(most + 1)]
    shift = int(np.argmin([np.mean((own - part) ** 2) for part in ahead]))
    velocity = np.gradient(human, axis=0)[most - shift : len(human) - shift]
    square = float((velocity**2).sum())
    if square == 0.0:
        return 0.0
    rest = -float(((own - ahead[shift]) * velocity).sum()) / square
    return shift + float(np.clip(rest, -1.0, 1.0))

"""Measure 1: motions that the robot hand itself makes play the human, so every target is exact."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.alignment import align_recording
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.types import HandRecording, Side, Status
from smooth_operator_research.physics.joint_motion import PINCH_GAP, JointMotion, joint_motion
from smooth_operator_research.physics.measure import Case, Clip, Drawing, Measured, Unit
from smooth_operator_research.physics.plots import interval_drawings
from smooth_operator_research.physics.results import Figure, MeasureResults
from smooth_operator_research.physics.settings import PhysicsSettings

SECONDS: Final = 8.0
QUICK_SECONDS: Final = 3.0
RATE_HZ: Final = 100.0
WARM_UP_S: Final = 0.5
"""What is left out at the beginning [s]: the hand starts at its neutral pose, and so do methods."""
NOISE: Final = {"clean": 0.0, "noise 0.5 mm": 0.5e-3}
"""Condition -> standard deviation of each coordinate of each landmark [m]."""
EXACT: Final = 0.5e-3
"""A frame is exact where no fingertip is further off than this [m]."""

_UNITS, _QUICK_UNITS = 5, 2
_MOST_LAG = 30  # frames


@dataclass(frozen=True, eq=False)
class AskedMotion:
    """A motion that a robot hand can make exactly, as a recording of a human hand.

    Attributes:
        recording: the robot's own landmarks in the palm frame as a human's, with tracker noise
            where it was asked for; the alignment leaves landmarks without noise where they are.
        joints: (T, n) positions of all joints that made it [rad].
        tips: (T, F, 3) the fingertips of those, without noise [m], thumb first.
        motion: how it was made.
    """

    recording: HandRecording
    joints: Float[np.ndarray, "T n"]
    tips: Float[np.ndarray, "T F 3"]
    motion: JointMotion


def reachable_motion(
    hand: Hand,
    seed: int,
    *,
    noise: float = 0.0,
    duration: float = SECONDS,
    rate_hz: float = RATE_HZ,
) -> AskedMotion:
    """A random smooth, collision-free motion of a hand, with pinches; see ``joint_motion``.

    Args:
        hand: the robot hand.
        seed: of the random numbers.
        noise: of the tracker: standard deviation of each coordinate of each landmark in each
            frame, independent (white) [m]. It moves the landmarks of the palm, too.
        duration: length [s].
        rate_hz: frames a second [Hz].
    """
    return _asked(hand, joint_motion(hand, seed, duration=duration, rate_hz=rate_hz), seed, noise)


def _asked(hand: Hand, motion: JointMotion, seed: int, noise: float) -> AskedMotion:
    landmarks = human_landmarks(hand, motion.joints)
    if noise:
        rng = np.random.default_rng([seed, 1])
        landmarks = landmarks + rng.normal(0.0, noise, landmarks.shape)
    name = f"reachable motion {seed}"
    recording = HandRecording(landmarks, motion.stamps, hand.spec.side, name=name)
    joints = hand.full_configuration(motion.joints)
    return AskedMotion(recording, joints, hand.tips(joints), motion)


@lru_cache(maxsize=8)
def _motion(hand_name: str, side: Side, seed: int, duration: float) -> JointMotion:
    """The same for all methods, which come one after the other."""
    return joint_motion(load_hand(hand_name, side), seed, duration=duration, rate_hz=RATE_HZ)


class ReachableMotion:
    """The measure; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "reachable"
    title: Final = "Reachable motion"
    definition: Final = (
        "A robot hand's own landmarks in a random smooth, collision-free motion with pinches play "
        "the human's: how far off are its fingertips when it is asked for what it can do exactly?"
    )
    page: Final = "docs/physics-measures.md#reachable-motion"
    unit: Final = "seed"
    figures: Final = (
        Figure("tip_error_mm", "mm", "down", "Fingertip error, mean over fingers and frames.",
               short="tip error"),
        Figure("tip_p95_mm", "mm", "down", "Its 95th percentile over fingers and frames.",
               short="tip p95"),
        Figure("pinch_gap_error_mm", "mm", "down", "Difference between the robot's and the asked "
               "distance of thumb and finger, where that is below 20 mm.", short="pinch gap error"),
        Figure("lag_ms", "ms", "down", "Shift in time by which the robot's fingertips fit the "
               "asked ones best.", short="lag"),
        Figure("exact", "", "up", "Share of the frames in which no fingertip is further off than "
               "0.5 mm.", short="exact frames"),
        Figure("common_shift_mm", "mm", "down", "Length of the error that all fingertips have in "
               "common: by how much the hand is moved as a whole.", short="common shift",
               main=False),
        Figure("input_error_mm", "mm", "", "How far off the aligned landmarks of the tips are that "
               "the method is given: what a method that follows them exactly would be off by.",
               short="input error", main=False),
        *(
            Figure(f"tip_error_{finger}_mm", "mm", "down", f"Error of the {finger}'s tip, mean.",
                   short=finger, main=False)
            for finger in FINGERS
        ),
    )  # fmt: skip

    def conditions(self, settings: PhysicsSettings) -> Sequence[str]:
        """Without and with tracker noise."""
        return tuple(NOISE)

    def units(self, settings: PhysicsSettings) -> Sequence[Unit]:
        """Seeds of motions."""
        count = settings.count(_UNITS, _QUICK_UNITS)
        seeds = range(settings.seed, settings.seed + count)
        return [Unit(f"seed {seed}", data=seed) for seed in seeds]

    def run(self, case: Case) -> Measured:
        """Retargets one motion."""
        duration = QUICK_SECONDS if case.quick else SECONDS
        motion = _motion(case.hand_name, case.side, case.unit.data, duration)
        asked = _asked(case.hand, motion, case.unit.data, NOISE[case.condition])
        commands = case.commands(asked.recording)
        row = motion_figures(case.hand, asked, commands.joint_positions)
        row["held_frames"] = int((commands.status != Status.OK).sum())
        human = align_recording(asked.recording, case.hand, case.config.alignment)
        own = [TIPS[FINGERS.index(finger)] for finger in case.hand.fingers]
        off = np.linalg.norm(human[:, own] - asked.tips, axis=-1)
        row["input_error_mm"] = 1e3 * float(off[_warm(asked) :].mean())
        if not case.clip:
            return Measured(row)
        return Measured(row, Clip(asked.recording.stamps, human, commands.joint_positions))

    def draw(self, results: MeasureResults, colors: Mapping[str, str]) -> Sequence[Drawing]:
        """Fingertip error, pinch gap error and lag of each method."""
        return interval_drawings(self.name, results, self.figures[:4], colors)


def motion_figures(
    hand: Hand, asked: AskedMotion, joints: Float[np.ndarray, "T n"]
) -> dict[str, float | int | str | None]:
    """The figures of one motion; the first half second is left out.

    Args:
        hand: the robot hand.
        asked: what it was asked for.
        joints: (T, n) what it was commanded [rad].
    """
    warm = _warm(asked)
    tips = hand.tips(joints)
    off = (tips - asked.tips)[warm:]
    error = np.linalg.norm(off, axis=-1)
    gaps, wanted = (_thumb_gaps(points)[warm:] for points in (tips, asked.tips))
    pinched = wanted < PINCH_GAP
    apart = np.abs(gaps - wanted)[pinched]
    period = float(np.median(np.diff(asked.recording.stamps)))
    return {
        "tip_error_mm": 1e3 * float(error.mean()),
        "tip_p95_mm": 1e3 * float(np.percentile(error, 95)),
        "pinch_gap_error_mm": 1e3 * float(apart.mean()) if apart.size else None,
        "lag_ms": 1e3 * period * lag_frames(asked.tips[warm:], tips[warm:]),
        "exact": float((error.max(axis=1) <= EXACT).mean()),
        "common_shift_mm": 1e3 * float(np.linalg.norm(off.mean(axis=1), axis=-1).mean()),
        **{
            f"tip_error_{finger}_mm": 1e3 * float(error[:, i].mean())
            for i, finger in enumerate(hand.fingers)
        },
        "pinched_frames": int(pinched.any(axis=1).sum()),
        "frames": len(error),
        "asked_peak_speed_rad_s": asked.motion.peak_speed,
        "asked_overlap_mm": None if asked.motion.deepest is None else 1e3 * asked.motion.deepest,
    }


def _warm(asked: AskedMotion) -> int:
    """How many frames are left out."""
    stamps = asked.recording.stamps
    return int(np.searchsorted(stamps, stamps[0] + WARM_UP_S))


def _thumb_gaps(tips: Float[np.ndarray, "T F 3"]) -> Float[np.ndarray, "T f"]:
    """Distance of each finger's tip from the thumb's [m]."""
    gaps: np.ndarray = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1)
    return gaps


def lag_frames(asked: Float[np.ndarray, "T F 3"], given: Float[np.ndarray, "T F 3"]) -> float:
    """By how many frames one motion trails another.

    The whole number of frames with the smallest mean squared distance, and the fraction that the
    remaining distance makes along the asked velocity, by least squares. What is exact has lag 0.

    Args:
        asked: (T, F, 3) points [m].
        given: (T, F, 3) the points that follow.

    Returns:
        frames, down to -1; 0 where nothing moves or the motion is too short to tell.
    """
    most = min(_MOST_LAG, len(asked) // 4)
    if most < 1:
        return 0.0
    own = given[most:]
    ahead = [asked[most - k : len(asked) - k] for k in range(most + 1)]
    shift = int(np.argmin([np.mean((own - part) ** 2) for part in ahead]))
    velocity = np.gradient(asked, axis=0)[most - shift : len(asked) - shift]
    square = float((velocity**2).sum())
    if square == 0.0:
        return 0.0
    rest = -float(((own - ahead[shift]) * velocity).sum()) / square
    return shift + float(np.clip(rest, -1.0, 1.0))

"""What GeoRT trains on: points per finger, pinches, reachable fingertips; synthetic operators."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from smooth_operator.baselines.geort import finger_joints, human_tips
from smooth_operator.errors import RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.human.aligned_recording import align_recording
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.lab.training.settings import VOXEL, GeortTraining
from smooth_operator.synthetic.operator import SyntheticOperator
from smooth_operator.types import HandRecording, Side

REACH_POSES: Final = 65_536
"""Random poses of the robot whose fingertips are its reach."""
FEWEST_POINTS: Final = 50
"""Fewer occupied cells than this is a hand that hardly moved."""


@dataclass(frozen=True, eq=False)
class PointSet:
    """Human fingertips in the palm frame.

    Attributes:
        points: (F, 3, N) points of each finger, one per occupied cell, without pairing [m]; a
            finger's row is filled up with its first point.
        counts: (F,) how many of the N are its own.
        pinches: (F, 3, P) fingertips of frames in which the human pinches, of one moment each [m].
        pinched: (F - 1, P) which fingers pinch with the thumb there.
    """

    points: Float[np.ndarray, "F 3 N"]
    counts: Int[np.ndarray, " F"]
    pinches: Float[np.ndarray, "F 3 P"]
    pinched: Bool[np.ndarray, "f P"]


@dataclass(frozen=True, eq=False)
class TrainingData:
    """All that the training sees.

    Attributes:
        train: frames of training.
        validation: frames of validation; None without any.
        reach: (F, 3, R) robot fingertips that are to be covered, of random poses [m].
        sources: names of the recordings, and of those kept apart whole.
        frames: numbers of usable frames of training and validation.
    """

    train: PointSet
    validation: PointSet | None
    reach: Float[np.ndarray, "F 3 R"]
    sources: dict[str, list[str]]
    frames: dict[str, int]

    @property
    def digest(self) -> str:
        """Identifies this data; a resumed training must have the same."""
        digest = hashlib.sha256()
        for part in (self.train, self.validation):
            if part is not None:
                for array in (part.points, part.counts, part.pinches, part.pinched):
                    digest.update(repr(array.shape).encode())
                    digest.update(np.ascontiguousarray(array).tobytes())
        digest.update(np.ascontiguousarray(self.reach).tobytes())
        return digest.hexdigest()


def training_data(
    recordings: Sequence[HandRecording],
    hand: Hand,
    settings: GeortTraining,
    held_out: Sequence[HandRecording] = (),
) -> TrainingData:
    """Aligns, thins and splits.

    Args:
        recordings: recordings of the model's users, of the hand's side.
        settings: ``alignment``, ``validation``, ``pinch_distance``, ``margin`` and ``seed`` count
            here.
        held_out: recordings for validation alone; without them the end of each recording is kept
            apart.

    Raises:
        RecordingError: there is no recording, one is of the other hand, or a finger hardly moves.
    """
    if not recordings:
        raise RecordingError("training needs one recording at least")
    sets, apart = [], []
    for recording in recordings:
        tips = _tips(recording, hand, settings.alignment)
        at = len(tips) if held_out else round(len(tips) * (1 - settings.validation))
        sets.append(tips[:at])
        apart.append(tips[at:])
    apart += [_tips(recording, hand, settings.alignment) for recording in held_out]
    train, validation = np.concatenate(sets), np.concatenate(apart)
    names = {
        "train": [recording.name for recording in recordings],
        "validation": [recording.name for recording in held_out],
    }
    points = _point_set(train, settings.pinch_distance)
    few = [f for f, n in zip(hand.fingers, points.counts, strict=True) if n < FEWEST_POINTS]
    if few:
        raise RecordingError(
            f"{', '.join(names['train'])}: the tips of {', '.join(few)} hardly move: they visit "
            f"{points.counts.tolist()} cells of {VOXEL * 1e3:g} mm (fingers {hand.fingers}), "
            f"expected {FEWEST_POINTS} at least; record a hand that opens, closes, spreads and "
            "pinches for half a minute"
        )
    held = _point_set(validation, settings.pinch_distance)
    return TrainingData(
        points,
        held if held.counts.min() > 0 else None,
        _reach(hand, settings.seed, points, settings.margin),
        names,
        {"train": _count_finite(train), "validation": _count_finite(validation)},
    )


def _tips(
    recording: HandRecording, hand: Hand, alignment: AlignmentConfig
) -> Float[np.ndarray, "T F 3"]:
    if recording.side != hand.spec.side:
        raise RecordingError(
            f"{recording.name}: it is of a {recording.side} hand, but {hand.name!r} is a "
            f"{hand.spec.side} one; load that side of the robot"
        )
    return align_recording(recording, hand, alignment)[:, list(human_tips(hand))]


def _count_finite(tips: Float[np.ndarray, "T F 3"]) -> int:
    return int(np.isfinite(tips).all(axis=-1).any(axis=-1).sum())


def _point_set(tips: Float[np.ndarray, "T F 3"], distance: float) -> PointSet:
    fingers = []
    for finger in np.moveaxis(tips, 1, 0):
        finite = finger[np.isfinite(finger).all(axis=-1)]
        _, first = np.unique(np.floor(finite / VOXEL).astype(int), axis=0, return_index=True)
        fingers.append(finite[np.sort(first)])
    counts = np.array([len(points) for points in fingers])
    points = np.zeros((len(fingers), 3, max(int(counts.max()), 1)))
    for row, own in zip(points, fingers, strict=True):
        if len(own):
            row[:] = own[:1].T
            row[:, : len(own)] = own.T
    gaps = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1)
    pinched = gaps < distance  # NaN compares as False
    at = np.flatnonzero(pinched.any(axis=-1))
    together = np.moveaxis(tips[at], 0, -1)
    # a tip that was not seen takes part in no pinch, but its network is asked anyway
    together = np.where(np.isfinite(together), together, points[:, :, :1])
    return PointSet(
        points.astype(np.float32), counts, together.astype(np.float32), pinched[at].T.copy()
    )


def _reach(
    hand: Hand, seed: int, human: PointSet, margin: float | None
) -> Float[np.ndarray, "F 3 R"]:
    """Tips of poses uniform in the joints that the networks command; the others stay neutral.

    With a margin, those near to where the human's were, drawn again up to the same number.
    """
    rng = np.random.default_rng([seed, 0x9E])
    low, high = hand.limits.T
    drawn = rng.uniform(low, high, (REACH_POSES, len(low)))
    own = [joint for joints in finger_joints(hand) for joint in joints]
    q = np.broadcast_to(hand.neutral, drawn.shape).copy()
    q[:, own] = drawn[:, own]
    tips = np.moveaxis(hand.tips(hand.full_configuration(q)), 0, -1)
    if margin is not None:
        for finger, reachable in enumerate(tips):
            visited = human.points[finger, :, : human.counts[finger]].T
            away, _ = cKDTree(visited).query(reachable.T)
            near = np.flatnonzero(away <= margin)
            if len(near) < FEWEST_POINTS:  # an operator far from all that the robot reaches
                near = np.argsort(away)[:FEWEST_POINTS]
            tips[finger] = reachable[:, rng.choice(near, REACH_POSES)]
    return np.ascontiguousarray(tips, np.float32)


FIRST_SEED: Final = 9000
"""Operators of this seed and above are for training; judge a model on others."""
TRAINING_OPERATORS: Final = 12
HELD_OUT_OPERATORS: Final = 2
DURATION_S: Final = 40.0
"""About two rounds of all gestures."""
RATE_HZ: Final = 50.0
_LENGTHS: Final = (0.165, 0.205)  # hands of most adults [m]


def synthetic_recordings(
    side: Side, seed: int = 0
) -> tuple[list[HandRecording], list[HandRecording]]:
    """Recordings of several people with hands of several sizes.

    Returns:
        ``TRAINING_OPERATORS`` recordings to train on, and ``HELD_OUT_OPERATORS`` of other
        people to validate on; their names hold the seeds.
    """
    count = TRAINING_OPERATORS + HELD_OUT_OPERATORS
    low, high = _LENGTHS
    recordings = [
        SyntheticOperator(
            seed=FIRST_SEED + count * seed + i,
            side=side,
            # every size among those trained on, and the held-out ones in between
            hand_length=low + (high - low) * (i % TRAINING_OPERATORS + 0.5) / TRAINING_OPERATORS,
            rate_hz=RATE_HZ,
        ).record(DURATION_S)
        for i in range(count)
    ]
    return recordings[:TRAINING_OPERATORS], recordings[TRAINING_OPERATORS:]

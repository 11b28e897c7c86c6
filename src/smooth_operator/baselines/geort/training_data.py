"""Settings and data of GeoRT's training: human points and pinches, and reachable fingertips."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from smooth_operator.baselines.geort.method import finger_joints
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.targets import tips_of
from smooth_operator.settings import check_numbers, check_range
from smooth_operator.synthetic.operator import SyntheticOperator
from smooth_operator.types import HandRecording, Side

VOXEL: Final = 1e-3
"""Edge length of the cells that contribute one point each [m]."""
STEP_RANGE: Final = (1e-3, 11e-3)
"""Range of the lengths of human steps, whose direction the robot must keep [m]."""
BEND: Final = 2e-3
"""Half the length of the straight human path on which curvature is measured [m]."""


@dataclass(frozen=True)
class GeortTraining:
    """Settings of GeoRT's training.

    Losses, sizes of the networks and weights of direction, coverage and curvature are published
    (Yin et al., "Geometric Retargeting"). These departures let two CPU cores find a useful optimum
    in minutes:

    - the networks have SiLU between their layers and no normalisation, instead of LeakyReLU and
      batch normalisation, because the robot would follow a kink;
    - many small steps: a batch of 512 instead of 2048, and a learning rate that rises to 3e-3 and
      falls along a cosine, instead of a constant 1e-4;
    - ``ramp``: coverage starts slowly. Otherwise it pulls random networks to the robot's reach in
      any order, which the direction loss can't correct;
    - ``margin``: the robot must cover the operator's motion, not everything that it can reach;
    - ``surround``: direction is also trained near the recorded points, for other operators;
    - ``pinch``: published without a scale; with 200 /m^2, a gap of 10 mm costs 0.02;
    - curvature is relative to the length of the path, because its square in metres is negligible.

    Attributes:
        epochs: number of passes over the points.
        batch: number of points per finger in a step.
        reach: number of reachable robot fingertips in a step.
        learning_rate: highest learning rate of AdamW.
        weight_decay: weight decay of AdamW.
        direction: weight of the motion's direction.
        coverage: weight of the Chamfer distance to the robot's reachable fingertips [1/m^2].
        curvature: weight of the bend of straight paths.
        pinch: weight of the squared distance of the robot's tips while the human pinches [1/m^2].
        pinch_distance: human thumb tip to fingertip distance, after alignment, below which it is a
            pinch [m].
        margin: largest distance of a reachable fingertip from an aligned human fingertip at which
            it counts for coverage [m]; None for all, as published.
        surround: standard deviation of the displacement from recorded points to the points where
            direction and curvature are measured [m]; 0 for the points themselves, as published.
        ramp: fraction of the epochs over which the weight of coverage rises to its full value; 0
            for none, as published.
        validation: fraction at the end of each recording that is used only for validation.
        seed: seed of all random numbers.
        alignment: alignment of human landmarks to the palm frame.
    """

    epochs: int = 120
    batch: int = 512
    reach: int = 512
    learning_rate: float = 3e-3
    weight_decay: float = 1e-2
    direction: float = 1.0
    coverage: float = 80.0
    curvature: float = 0.1
    pinch: float = 200.0
    pinch_distance: float = 0.015
    margin: float | None = 0.01
    surround: float = 0.01
    ramp: float = 0.4
    validation: float = 0.1
    seed: int = 0
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)

    def __post_init__(self) -> None:
        positive = ("epochs", "batch", "reach", "learning_rate", "pinch_distance", "margin")
        check_numbers(self, positive=positive)
        for name in ("epochs", "batch", "reach", "seed"):
            if type(getattr(self, name)) is not int:
                raise ConfigError(f"{name} must be a whole number, not {getattr(self, name)!r}")
        for name, most in (("learning_rate", 1.0), ("pinch_distance", 0.1), ("margin", 1.0)):
            check_range(name, getattr(self, name), 0.0, most)
        for name in ("ramp", "validation"):
            if not getattr(self, name) < 1:
                raise ConfigError(f"{name} must be below 1, not {getattr(self, name)!r}")


REACH_POSES: Final = 65_536
"""Number of random robot poses whose fingertips represent its reach."""
FEWEST_POINTS: Final = 50
"""Smallest number of occupied cells of a hand that moves enough."""


@dataclass(frozen=True, eq=False)
class PointSet:
    """Human fingertips in the palm frame.

    Attributes:
        points: (F, 3, N) points of each finger, one per occupied cell [m]; a row is filled up with
            the finger's first point.
        counts: (F,) number of each finger's own points.
        pinches: (F, 3, P) fingertips of the frames in which the human pinches [m].
        pinched: (F - 1, P) True for fingers that pinch with the thumb.
    """

    points: Float[np.ndarray, "F 3 N"]
    counts: Int[np.ndarray, " F"]
    pinches: Float[np.ndarray, "F 3 P"]
    pinched: Bool[np.ndarray, "f P"]


@dataclass(frozen=True, eq=False)
class TrainingData:
    """Data with which GeoRT is trained and validated.

    Attributes:
        train: points of training.
        validation: points of validation; None without validation.
        reach: (F, 3, R) robot fingertips of random poses, for coverage [m].
        sources: names of the recordings, and of those that are used only for validation.
        frames: numbers of usable frames of training and validation.
    """

    train: PointSet
    validation: PointSet | None
    reach: Float[np.ndarray, "F 3 R"]
    sources: dict[str, list[str]]
    frames: dict[str, int]

    @property
    def digest(self) -> str:
        """Digest of the data. A training can be resumed only with data of the same digest."""
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
    """Prepares training data from recordings: aligns the recordings, thins them out and splits
    them.

    Args:
        recordings: recordings of the model's users, of the hand's side.
        settings: ``alignment``, ``validation``, ``pinch_distance``, ``margin`` and ``seed`` are
            used.
        held_out: recordings for validation only; without them, the end of each recording is used.

    Raises:
        RecordingError: there is no recording, one is of the other hand, or a finger hardly moves.
    """
    if not recordings:
        raise RecordingError("training needs at least one recording")
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
            f"{', '.join(names['train'])}: the tips of {', '.join(few)} hardly move: they "
            f"visit {points.counts.tolist()} cells of {VOXEL * 1e3:g} mm (fingers "
            f"{hand.fingers}), expected at least {FEWEST_POINTS}; record a hand that opens, "
            "closes, spreads and pinches for half a minute"
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
            f"{recording.name}: it shows a {recording.side} hand, but {hand.name!r} is a "
            f"{hand.spec.side} one; load the {recording.side} robot hand"
        )
    return align_recording(recording, hand, alignment)[:, list(tips_of(hand.fingers))]


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
    # a fingertip that was not tracked does not pinch, but its network gets an input
    together = np.where(np.isfinite(together), together, points[:, :, :1])
    return PointSet(
        points.astype(np.float32), counts, together.astype(np.float32), pinched[at].T.copy()
    )


def _reach(
    hand: Hand, seed: int, human: PointSet, margin: float | None
) -> Float[np.ndarray, "F 3 R"]:
    """Fingertips of random positions of the joints that the networks command; the other joints are
    at neutral. With a margin, only fingertips near the human's are drawn, up to the same number."""
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
            if len(near) < FEWEST_POINTS:  # the operator is far from the robot's reach
                near = np.argsort(away)[:FEWEST_POINTS]
            tips[finger] = reachable[:, rng.choice(near, REACH_POSES)]
    return np.ascontiguousarray(tips, np.float32)


FIRST_SEED: Final = 9000
"""Smallest seed of the operators for training. A model must be evaluated on others."""
TRAINING_OPERATORS: Final = 12
HELD_OUT_OPERATORS: Final = 2
DURATION_S: Final = 40.0
"""Length of a recording [s], about two rounds of all gestures."""
RATE_HZ: Final = 50.0
_LENGTHS: Final = (0.165, 0.205)  # hands of most adults [m]


def synthetic_recordings(
    side: Side, seed: int = 0
) -> tuple[list[HandRecording], list[HandRecording]]:
    """Returns ``TRAINING_OPERATORS`` recordings for training, and ``HELD_OUT_OPERATORS`` recordings
    of other synthetic operators for validation, with hands of several sizes. The names contain the
    seeds."""
    count = TRAINING_OPERATORS + HELD_OUT_OPERATORS
    low, high = _LENGTHS
    recordings = [
        SyntheticOperator(
            seed=FIRST_SEED + count * seed + i,
            side=side,
            # all sizes in training; those of validation lie in between
            hand_length=low + (high - low) * (i % TRAINING_OPERATORS + 0.5) / TRAINING_OPERATORS,
            rate_hz=RATE_HZ,
        ).record(DURATION_S)
        for i in range(count)
    ]
    return recordings[:TRAINING_OPERATORS], recordings[TRAINING_OPERATORS:]

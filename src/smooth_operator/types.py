"""Data types from tracker to robot: hand frames, recordings, joint commands, results.

Units are metres, seconds and radians; quaternions are wxyz. Arrays are NumPy's and not changed
after construction.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias, cast, get_args, overload

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from smooth_operator.errors import ConfigError, RecordingError, brief
from smooth_operator.landmarks import NUM_LANDMARKS

Side: TypeAlias = Literal["right", "left"]
"""Chirality of a hand."""


def as_side(value: str) -> Side:
    """Converts a side label, such as ``right``, ``R`` or ``LEFT``, to ``right`` or ``left``;
    ConfigError for anything else."""
    sides = {label: name for name in get_args(Side) for label in (name, name[0])}
    try:
        return cast(Side, sides[value.strip().lower()])
    except (KeyError, AttributeError):  # AttributeError: a file had something else than text
        raise ConfigError(f"side must be 'right' or 'left', not {brief(value)}") from None


class Status(enum.IntEnum):
    """Status of a command. A command whose status is not ``OK`` repeats the last good command."""

    OK = 0
    INVALID_LANDMARKS = 1
    """A landmark that the method needs is missing, flagged invalid, or not finite."""
    DEGENERATE_PALM = 2
    """The palm landmarks are collinear or coincident: no rotation can be found."""
    SOLVER_FAILED = 3
    """The solver's result was not finite."""
    IMPLAUSIBLE_HAND = 4
    """The landmarks do not have the size [m] or shape of a human hand of the robot's side."""

    def __str__(self) -> str:
        """The name, ``OK``, instead of the ``0`` of an integer."""
        return self.name

    @property
    def reason(self) -> str:
        """Human-readable explanation of the status, one sentence."""
        return _REASONS[self]


_REASONS = {
    Status.OK: "ok",
    Status.INVALID_LANDMARKS: (
        "a required landmark is missing or not finite; last good command held"
    ),
    Status.DEGENERATE_PALM: "palm landmarks are collinear or coincident; last good command held",
    Status.SOLVER_FAILED: "the solver found no finite command; last good command held",
    Status.IMPLAUSIBLE_HAND: (
        "the landmarks do not have the size in metres or the shape of a hand of this side (unit, "
        "order or side may be wrong); last good command held"
    ),
}


@dataclass(frozen=True, eq=False)
class HandFrame:
    """A tracked human hand at one moment.

    Attributes:
        landmarks: (21, 3) positions [m], in the order of ``LANDMARKS``, in any right-handed frame.
        stamp: timestamp of the measurement [s]; None for a tracker without timestamps.
        side: side of the hand.
        valid: (21,) False for landmarks without a trustworthy value. Default: finite landmarks are
            valid.
        metacarpals: (4, 3) metacarpal bases of index .. pinky [m], if the tracker has them.
        orientations: (21, 4) landmark orientations, quaternion wxyz, if known.
        T_world_wrist: (7,) pose of the wrist in the world, x y z [m] and unit quaternion wxyz, with
            axes as in docs/reference/conventions.md. All NaN if the wrist is not valid in this
            frame; None if the tracker does not measure it.
        world: name of that world frame.
        forearm: (3,) unit vector from elbow to wrist in the wrist's frame; NaN, None as the wrist.

    Raises:
        RecordingError: an array has the wrong shape, or the type of the timestamp has a resolution
            coarser than 1 ms at this time.
    """

    landmarks: Float[np.ndarray, "21 3"]
    stamp: float | None = None
    side: Side = "right"
    valid: Bool[np.ndarray, "21"] | None = None
    metacarpals: Float[np.ndarray, "4 3"] | None = None
    orientations: Float[np.ndarray, "21 4"] | None = None
    T_world_wrist: Float[np.ndarray, "7"] | None = None
    world: str | None = None
    forearm: Float[np.ndarray, "3"] | None = None

    def __post_init__(self) -> None:
        _set(self, "landmarks", _shaped(self.landmarks, (NUM_LANDMARKS, 3), "landmarks"))
        stamp: object = self.stamp
        if isinstance(stamp, np.floating) and (step := np.spacing(stamp)) > 1e-3:
            raise RecordingError(
                f"the timestamp is a {stamp.dtype}, which near {stamp:g} s has a resolution "
                f"of {step:g} s: store timestamps as float64, or count from the start of the "
                "recording"
            )
        _set(self, "stamp", None if self.stamp is None else float(self.stamp))
        _set(self, "side", as_side(self.side))
        finite = np.isfinite(self.landmarks).all(axis=-1)
        valid = finite if self.valid is None else np.asarray(self.valid, bool)
        if valid.shape != (NUM_LANDMARKS,):
            raise RecordingError(f"valid must have shape (21,), not {valid.shape}")
        _set(self, "valid", valid & finite)
        _set_optional(self)

    def __repr__(self) -> str:
        assert self.valid is not None  # filled in on construction
        stamp = "no stamp" if self.stamp is None else f"stamp {self.stamp:g} s"
        return f"<HandFrame: {self.side}, {stamp}, {self.valid.sum()} of 21 landmarks valid>"

    @property
    def time(self) -> float:
        """Timestamp of the frame [s]; RecordingError if it has none."""
        if self.stamp is None:
            raise RecordingError(
                "the hand frame has no timestamp; set the time of the measurement in "
                "seconds: HandFrame(landmarks, stamp=...)"
            )
        return self.stamp


@dataclass(frozen=True, eq=False)
class HandRecording:
    """A sequence of frames of one hand, as arrays. Indexing gives frames; slicing gives recordings.

    Attributes:
        landmarks: (T, 21, 3) positions [m].
        stamps: (T,) strictly increasing timestamps [s].
        side: side of the hand.
        valid: (T, 21) False for a missing landmark. Default: finite landmarks are valid.
        metacarpals: (T, 4, 3) metacarpal bases [m] or None.
        orientations: (T, 21, 4) quaternions wxyz or None.
        T_world_wrist, forearm: (T, 7) and (T, 3), or None, as in ``HandFrame``.
        world: name of their world frame.
        name: origin of the recording, for reports.
    """

    landmarks: Float[np.ndarray, "T 21 3"]
    stamps: Float[np.ndarray, " T"]
    side: Side = "right"
    valid: Bool[np.ndarray, "T 21"] | None = None
    metacarpals: Float[np.ndarray, "T 4 3"] | None = None
    orientations: Float[np.ndarray, "T 21 4"] | None = None
    name: str = "recording"
    meta: dict[str, Any] = field(default_factory=dict)
    T_world_wrist: Float[np.ndarray, "T 7"] | None = None
    world: str | None = None
    forearm: Float[np.ndarray, "T 3"] | None = None

    def __post_init__(self) -> None:
        landmarks = np.asarray(self.landmarks, np.float64)
        stamps = np.asarray(self.stamps, np.float64)
        count = len(landmarks) if landmarks.ndim else 0
        _set(self, "landmarks", _shaped(landmarks, (count, NUM_LANDMARKS, 3), "landmarks"))
        _set(self, "stamps", _shaped(stamps, (count,), "stamps"))
        _set(self, "side", as_side(self.side))
        finite = np.isfinite(landmarks).all(axis=-1)
        valid = finite if self.valid is None else np.asarray(self.valid, bool)
        if valid.shape != finite.shape:
            raise RecordingError(f"valid must have shape {finite.shape}, not {valid.shape}")
        _set(self, "valid", valid & finite)
        _set_optional(self, count)

    def __repr__(self) -> str:
        assert self.valid is not None  # filled in on construction
        return (
            f"<HandRecording {self.name!r}: {self.side}, {len(self)} frames, "
            f"{self.duration:.4g} s, {self.rate_hz:.4g} Hz, "
            f"{self.valid.sum()} of {self.valid.size} landmarks valid>"
        )

    def __len__(self) -> int:
        return len(self.stamps)

    @overload
    def __getitem__(self, key: int) -> HandFrame: ...
    @overload
    def __getitem__(self, key: slice) -> HandRecording: ...
    def __getitem__(self, key: int | slice) -> HandFrame | HandRecording:
        optional: dict[str, Any] = {
            name: None if getattr(self, name) is None else getattr(self, name)[key]
            for name in ("valid", *_OPTIONAL)
        }
        if isinstance(key, slice):
            return replace(self, landmarks=self.landmarks[key], stamps=self.stamps[key], **optional)
        optional["world"] = self.world
        return HandFrame(self.landmarks[key], float(self.stamps[key]), self.side, **optional)

    def __iter__(self) -> Iterator[HandFrame]:
        return (self[i] for i in range(len(self)))

    @property
    def rate_hz(self) -> float:
        """Median frame rate [Hz]; NaN for fewer than two frames."""
        return float(1.0 / np.median(np.diff(self.stamps))) if len(self) > 1 else float("nan")

    @property
    def duration(self) -> float:
        """Time from the first to the last timestamp [s]."""
        return float(self.stamps[-1] - self.stamps[0]) if len(self) else 0.0


@dataclass(frozen=True, eq=False)
class JointCommand:
    """Joint positions for a robot hand at one moment.

    Attributes:
        joint_positions: (n,) joint positions [rad] of all joints, coupled ones included.
        joint_names: (n,) joint names, in the model's own order, wrist joints last.
        stamp: timestamp of the hand frame from which the command was computed [s].
    """

    joint_positions: Float[np.ndarray, " n"]
    joint_names: tuple[str, ...]
    stamp: float = 0.0

    def __repr__(self) -> str:
        pairs = zip(self.joint_names, self.joint_positions, strict=False)
        joints = [f"{name} {q:+.3f}" for name, q in pairs]
        return (
            f"<JointCommand: stamp {self.stamp:g} s, {len(self.joint_positions)} joints [rad]: "
            f"{', '.join(joints[:3] + ['...'] * (len(joints) > 3))}>"
        )


@dataclass(frozen=True, eq=False)
class Result:
    """Result of retargeting one hand frame.

    Attributes:
        command: joint positions; those of the last good command unless the status is OK.
        status: ``OK`` if the command was computed from this frame, otherwise the reason why not.
        latency_ms: time from landmarks to command [ms].
        tracking_loss: weighted keyvector loss of the command, first term of Eq. (1).
        scale: ratio of robot size to human size in this frame's alignment.
    """

    command: JointCommand
    status: Status
    latency_ms: float
    tracking_loss: float
    scale: float

    def __repr__(self) -> str:
        return (
            f"<Result: {self.status}, latency {self.latency_ms:.3g} ms, tracking loss "
            f"{self.tracking_loss:.3g}, scale {self.scale:.3g}, {self.command!r}>"
        )


@dataclass(frozen=True, eq=False)
class CommandTrajectory:
    """A sequence of joint commands with timestamps, latencies and status.

    Attributes:
        joint_positions: (T, n) positions of all joints in the model's order, coupled ones included
            [rad].
        joint_names: (n,) joint names.
        stamps: (T,) timestamps of the hand frames [s].
        latency_ms: (T,) time from landmarks to command [ms].
        status: (T,) ``Status`` values.
    """

    joint_positions: Float[np.ndarray, "T n"]
    joint_names: tuple[str, ...]
    stamps: Float[np.ndarray, " T"]
    latency_ms: Float[np.ndarray, " T"]
    status: Int[np.ndarray, " T"]

    def __repr__(self) -> str:
        seconds = self.stamps[-1] - self.stamps[0] if len(self) else 0.0
        return (
            f"<CommandTrajectory: {len(self)} commands, {len(self.joint_names)} joints, "
            f"{seconds:.4g} s, {np.count_nonzero(np.equal(self.status, Status.OK))} with status OK>"
        )

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, rows: slice | Bool[np.ndarray, " T"]) -> CommandTrajectory:
        """Returns some of the commands."""
        times = self.stamps[rows], self.latency_ms[rows], self.status[rows]
        return CommandTrajectory(self.joint_positions[rows], self.joint_names, *times)


def _set(obj: object, name: str, value: object) -> None:
    object.__setattr__(obj, name, value)  # normalising a frozen dataclass in __post_init__


def _shaped(value: ArrayLike, shape: tuple[int, ...], name: str) -> np.ndarray:
    array = np.asarray(value, np.float64)
    if array.shape != shape:
        raise RecordingError(f"{name} must have shape {shape}, not {array.shape}")
    return array


_OPTIONAL = {"metacarpals": (4, 3), "orientations": (21, 4), "forearm": (3,), "T_world_wrist": (7,)}


def _set_optional(obj: HandFrame | HandRecording, *count: int) -> None:
    for name, shape in _OPTIONAL.items():
        if (value := getattr(obj, name)) is not None:
            value = _shaped(value, (*count, *shape), name)
            _set(obj, name, unit_poses(value) if name == "T_world_wrist" else value)


def unit_poses(poses: Float[np.ndarray, "*n 7"]) -> Float[np.ndarray, "*n 7"]:
    """Normalises the quaternions of poses. A pose with a number that is not finite, or with a zero
    quaternion, becomes NaN."""
    size = np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    good = (size > 1e-6) & (size < 1e6) & np.isfinite(poses).all(axis=-1, keepdims=True)
    other = good & (np.abs(size - 1.0) > 1e-12)  # a unit one stays as it is, to the last bit
    unit = np.concatenate([poses[..., :3], poses[..., 3:] / np.where(other, size, 1.0)], axis=-1)
    return np.where(good, unit, np.nan)

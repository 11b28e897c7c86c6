"""Episodes: a hand recording, its commands and configuration, independent of the file format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.errors import RecordingError, brief, listed
from smooth_operator.extras import UPGRADE
from smooth_operator.formats.checks import check_span, check_times
from smooth_operator.types import CommandTrajectory, HandRecording, Status, unit_poses


@dataclass(frozen=True, eq=False)
class StateTrajectory:
    """Measured states of a real or simulated robot hand, and the efforts of its actuators.

    Attributes:
        stamps: (S,) increasing times of the measurements [s], on the clock of the episode's
            commands.
        positions: (S, n) measured joint positions [rad]; NaN if the hand does not measure them.
        names: (n,) joint names.
        actuators: (a,) names of the actuators; empty if they have no names.
        currents: (S, a) current or force of the actuators, in the driver's unit, or None.
        touch: (S, k) touch or force sensors, in the driver's unit, or None.
        contact: (S, f) contact of the robot's fingers, thumb first, 0 to 1, or None.
        newtons: (S, f) force on each of them [N], NaN if unknown, or None.

    Raises:
        RecordingError: the arrays do not fit each other.
    """

    stamps: Float[np.ndarray, " S"]
    positions: Float[np.ndarray, "S n"]
    names: tuple[str, ...]
    actuators: tuple[str, ...] = ()
    currents: Float[np.ndarray, "S a"] | None = None
    touch: Float[np.ndarray, "S k"] | None = None
    contact: Float[np.ndarray, "S f"] | None = None
    newtons: Float[np.ndarray, "S f"] | None = None

    def __post_init__(self) -> None:
        count = len(self.stamps)
        shapes = {
            "positions": (self.positions, (count, len(self.names))),
            "currents": (self.currents, (count, len(self.actuators))),
        }
        for name, (values, shape) in shapes.items():
            if values is not None and np.shape(values) != shape:
                raise RecordingError(
                    f"measured {name} must have shape {shape}, not {np.shape(values)}"
                )
        for name in ("touch", "contact", "newtons"):
            values = getattr(self, name)
            if values is not None and len(values) != count:
                raise RecordingError(f"{name} must have {count} rows, not {len(values)}")
        if not (np.isfinite(self.stamps).all() and (np.diff(self.stamps) >= 0).all()):
            raise RecordingError(
                "the timestamps of measured joints must be finite and must not decrease"
            )

    def __len__(self) -> int:
        return len(self.stamps)

    def at(self, stamps: Float[np.ndarray, " T"]) -> tuple[np.ndarray, np.ndarray]:
        """Returns the newest measurement at each time; before the first measurement, returns the
        first.

        Returns:
            (T, n) positions [rad] and (T,) stamps [s]; NaN without any measurement.
        """
        if not len(self):
            empty = np.full(len(stamps), np.nan)
            return np.full((len(stamps), len(self.names)), np.nan), empty
        rows = np.searchsorted(self.stamps, stamps, side="right") - 1
        rows = np.maximum(rows, 0)
        return self.positions[rows], self.stamps[rows]


@dataclass(frozen=True, eq=False)
class ArmTrack:
    """Commands and states of an arm, with one row for each command of the hand's fingers.

    Attributes:
        name: name of the arm.
        joint_names: (n,) names of the joints, from the base.
        positions: (C, n) commanded positions [rad]; NaN for a command without them.
        measured: (C, n) positions measured when the command was sent [rad]; NaN if unknown.
        poses: (C, 7) poses of the hand's wrist at the commanded positions, in the arm's base: x y z
            [m] and unit quaternion w x y z; NaN for a command without one.

    Raises:
        RecordingError: the arrays do not fit each other.
    """

    name: str
    joint_names: tuple[str, ...]
    positions: Float[np.ndarray, "C n"]
    measured: Float[np.ndarray, "C n"]
    poses: Float[np.ndarray, "C 7"]

    def __post_init__(self) -> None:
        count, joints = len(self.positions), len(self.joint_names)
        shapes = {"positions": (count, joints), "measured": (count, joints), "poses": (count, 7)}
        for name, shape in shapes.items():
            actual = np.shape(getattr(self, name))
            if actual != shape:
                raise RecordingError(f"{name} of the arm must have shape {shape}, not {actual}")

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, rows: slice | Bool[np.ndarray, " C"]) -> ArmTrack:
        """Returns the rows of some commands."""
        parts = self.positions[rows], self.measured[rows], self.poses[rows]
        return ArmTrack(self.name, self.joint_names, *parts)


MOST_RAD: Final = 100.0
"""Largest joint position that is accepted as a command [rad]: 16 turns."""

BASE = "base"
"""Default name of the frame of wrist commands: the robot's base."""


@dataclass(frozen=True, eq=False)
class WristTrack:
    """Commanded poses of a robot hand's wrist, one row for each command of its fingers.

    Attributes:
        poses: (C, 7) x y z [m] and unit quaternion w x y z in ``world``; NaN for a command without
            one.
        engaged: (C,) True if the operator's wrist moved the robot's wrist.
        valid: (C,) True if the operator's wrist was known.
        world: name of the frame.

    Raises:
        RecordingError: the arrays do not fit each other.
    """

    poses: Float[np.ndarray, "C 7"]
    engaged: Bool[np.ndarray, " C"]
    valid: Bool[np.ndarray, " C"]
    world: str = BASE

    def __post_init__(self) -> None:
        count = len(self.poses)
        for name, shape in (("poses", (count, 7)), ("engaged", (count,)), ("valid", (count,))):
            actual = np.shape(getattr(self, name))
            if actual != shape:
                raise RecordingError(
                    f"{name} of the commanded wrist must have shape {shape}, not {actual}"
                )
        object.__setattr__(self, "poses", unit_poses(np.asarray(self.poses, np.float64)))

    def __len__(self) -> int:
        return len(self.poses)

    def __getitem__(self, rows: slice | Bool[np.ndarray, " C"]) -> WristTrack:
        """Returns the rows of some commands."""
        return WristTrack(self.poses[rows], self.engaged[rows], self.valid[rows], self.world)


STAMP_TOLERANCE_S: Final = 1e-6
"""Largest difference between the timestamps of a command and of its frame [s].

Commands have the timestamps of their frames, so they are normally equal. The tolerance is for files
that were stored in whole microseconds.
"""

DERIVED_META: Final = (
    *("format", "truncated", "side_assumed", "implausible_frames", "layout"),
    *("damaged_lines", "repeated_frames", "ignored"),
)
"""Entries of ``HandRecording.meta`` that every reader computes and that are not stored in files."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One demonstration, in the common form through which file formats are converted.

    Attributes:
        recording: the hand, or None.
        commands: the commands to the robot, or None. An episode has a recording, commands or both.
            There may be frames without commands.
        config: the resolved configuration that the commands were computed with, as JSON values, or
        None.
        stages_ms: (C,) time of each stage of the loop [ms] by name, one value per command, NaN if a
            command did not have the stage.
        task: description of the task, or None.
        name: name of the episode, for files and reports.
        notes: human-readable notes on how the episode was read.
        states: the measured joints of the robot hand, or None.
        wrist: the commanded wrist of the robot hand, with each of the commands, or None.
        arm: the states of the arm that carried the hand, one row per command, or None.
        live: True if the commands come from a live loop, which also sends commands between frames.

    Raises:
        RecordingError: there are neither frames nor commands, arrays do not match, or a timestamp
            or status is invalid.
    """

    recording: HandRecording | None = None
    commands: CommandTrajectory | None = None
    config: dict[str, Any] | None = None
    stages_ms: Mapping[str, Float[np.ndarray, " C"]] = field(default_factory=dict)
    task: str | None = None
    name: str = "episode"
    notes: tuple[str, ...] = ()
    states: StateTrajectory | None = None
    wrist: WristTrack | None = None
    arm: ArmTrack | None = None
    live: bool = False

    def __post_init__(self) -> None:
        if self.recording is None and self.commands is None:
            raise RecordingError(f"{self.name}: it contains neither hand frames nor commands")
        if self.commands is not None:
            check_commands(self.commands, self.name)
        count = 0 if self.commands is None else len(self.commands)
        if self.wrist is not None and len(self.wrist) != count:
            raise RecordingError(
                f"{self.name}: it has {len(self.wrist)} commands for the wrist, but {count} for "
                "the fingers"
            )
        for stage, values in self.stages_ms.items():
            if np.shape(values) != (count,):
                raise RecordingError(
                    f"{self.name}: stage {stage!r} must have one time for each of the {count} "
                    f"commands, not shape {np.shape(values)}"
                )

    def __len__(self) -> int:
        """Number of frames, or of commands if there is no hand."""
        part = self.commands if self.recording is None else self.recording
        assert part is not None  # one is always there
        return len(part)

    @property
    def stamps(self) -> Float[np.ndarray, " T"]:
        """(T,) timestamps [s] of the frames, or of the commands if there is no hand."""
        part = self.commands if self.recording is None else self.recording
        assert part is not None
        return part.stamps

    @property
    def meta(self) -> dict[str, Any]:
        """Metadata from the recording's source, without the entries that every reader computes."""
        meta = {} if self.recording is None else self.recording.meta
        return {key: value for key, value in meta.items() if key not in DERIVED_META}

    def answered(self) -> Int[np.ndarray, " C"]:
        """Index of the frame from which each command was computed, found by its timestamp; -1 if no
        frame has that timestamp.

        Without a hand, each command is its own frame.
        """
        if self.commands is None:
            return np.zeros(0, np.int64)
        if self.recording is None:
            return np.arange(len(self.commands))
        frames, stamps = self.recording.stamps, self.commands.stamps
        if not len(frames):
            return np.full(len(stamps), -1)
        right = np.clip(np.searchsorted(frames, stamps), 0, len(frames) - 1)
        left = np.maximum(right - 1, 0)
        nearest = np.where(
            np.abs(frames[left] - stamps) < np.abs(frames[right] - stamps), left, right
        )
        return np.where(np.abs(frames[nearest] - stamps) <= STAMP_TOLERANCE_S, nearest, -1)

    def sliced(self, frames: slice) -> Episode:
        """Returns the episode with some of its frames and the commands from the same time.

        Args:
            frames: without a step; not empty.
        """
        stamps = self.stamps[frames]
        recording = None if self.recording is None else self.recording[frames]
        if self.commands is None:
            return replace(self, recording=recording)
        if self.recording is None:
            rows: Any = frames
        else:
            first, last = stamps[0] - STAMP_TOLERANCE_S, stamps[-1] + STAMP_TOLERANCE_S
            rows = (self.commands.stamps >= first) & (self.commands.stamps <= last)
        return replace(
            self,
            recording=recording,
            commands=self.commands[rows],
            stages_ms={name: np.asarray(each)[rows] for name, each in self.stages_ms.items()},
            wrist=None if self.wrist is None else self.wrist[rows],
            arm=None if self.arm is None else self.arm[rows],
        )

    def joined(self, other: Episode, where: str) -> Episode:
        """Returns this recording with the commands of another file. Raises RecordingError if
        ``other`` contains no commands, if this episode already has commands or has no hand, or if a
        command belongs to none of the frames."""
        if other.commands is None:
            raise RecordingError(
                f"{where}: it contains no commands; name the OUT.npz that retarget wrote"
            )
        if self.recording is None or self.commands is not None:
            raise RecordingError(
                f"{self.name}: commands from another file can only be added to a recording of a "
                "hand, but this "
                + ("contains no hand frames" if self.recording is None else "already has commands")
            )
        both = replace(
            self,
            commands=other.commands,
            config=other.config,
            stages_ms=other.stages_ms,
            wrist=other.wrist,
            arm=other.arm,
            task=other.task if self.task is None else self.task,
            notes=(*self.notes, *other.notes),
        )
        answered = both.answered() >= 0
        if not answered.all():
            raise RecordingError(
                f"{where} was not made from {self.name}: {int(answered.sum())} of its "
                f"{len(answered)} timestamps match frames of the recording; name the "
                "recording that it was made from, with the same --rate if it has no "
                "timestamps"
            )
        return both


def check_commands(commands: CommandTrajectory, where: str) -> None:
    """Refuses a trajectory that no robot can follow, or whose arrays do not match.

    Its stamps must increase and span at most ``LONGEST_S``; its positions must be finite and at
    most ``MOST_RAD``, but may be NaN where the status is not OK.

    Raises:
        RecordingError: names the array, the expected value and the actual value.
    """
    shapes = {
        "joint_positions": np.shape(commands.joint_positions),
        "joint_names": (len(commands.joint_names),),
        "timestamps": np.shape(commands.stamps),
        "latency_ms": np.shape(commands.latency_ms),
        "status": np.shape(commands.status),
    }
    check_command_shapes(shapes, where)
    if len(set(commands.joint_names)) != len(commands.joint_names):
        raise RecordingError(f"{where}: a joint name occurs twice: {listed(commands.joint_names)}")
    stamps = np.asarray(commands.stamps, np.float64)
    check_times(stamps, where, "command")
    check_span(stamps, where)
    codes = {int(status) for status in Status}
    unknown = sorted(set(np.asarray(commands.status).tolist()) - codes)
    if unknown:
        raise RecordingError(
            f"{where}: status {brief(unknown)} is not one of "
            f"{[f'{s.name}={int(s)}' for s in Status]}; if a newer version "
            f"wrote it, upgrade: {UPGRADE}"
        )
    _check_positions(commands, where)


def check_command_shapes(shapes: Mapping[str, tuple[int, ...]], where: str) -> None:
    """Refuses arrays of commands whose shapes do not match.

    Args:
        shapes: shapes of ``joint_positions``, ``joint_names``, ``timestamps``, ``latency_ms`` and
            ``status``.

    Raises:
        RecordingError: names the array, the expected and the actual shape.
    """
    positions = shapes["joint_positions"]
    if len(positions) != 2:
        raise RecordingError(
            f"{where}: joint_positions must have shape (frames, joints), not {positions}"
        )
    expected = dict.fromkeys(("timestamps", "latency_ms", "status"), positions[:1])
    for name, shape in {"joint_names": positions[1:], **expected}.items():
        if shapes[name] != shape:
            raise RecordingError(
                f"{where}: {name} must have shape {shape} to fit joint_positions {positions}, "
                f"not {shapes[name]}"
            )


def _check_positions(commands: CommandTrajectory, where: str) -> None:
    """Checks that joint positions are finite, except where the status says that there is no
    command. RecordingError names the first command and joint with a wrong position."""
    positions = np.asarray(commands.joint_positions, np.float64)
    good = np.abs(positions) <= MOST_RAD  # NaN compares as False
    unanswered = (np.asarray(commands.status) != Status.OK)[:, None]
    bad = ~(good | (np.isnan(positions) & unanswered))
    if not bad.any():
        return
    row, joint = (int(index) for index in np.argwhere(bad)[0])
    raise RecordingError(
        f"{where}: command {row} has {commands.joint_names[joint]!r} at "
        f"{positions[row, joint]:g} rad ({int(bad.any(axis=1).sum())} of {len(bad)} commands "
        f"have such a joint); expected finite numbers up to {MOST_RAD:g} rad, or NaN with a "
        "status other than OK"
    )

"""Reads this project's own logs, even if they were cut off."""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.errors import RecordingError, brief, listed
from smooth_operator.extras import UPGRADE
from smooth_operator.formats.arrays import ARRAYS_RATIO, FREE_BYTES, LOG_RATIO, Allowance
from smooth_operator.formats.checks import check_side
from smooth_operator.formats.episode import ArmTrack, StateTrajectory, WristTrack
from smooth_operator.formats.registry import file_kind
from smooth_operator.io.documents import parse_json
from smooth_operator.landmarks import FINGERS, NUM_LANDMARKS
from smooth_operator.teleop.recording.messages import (
    ARM,
    COMMAND,
    CONFIG,
    HAND,
    LOOP,
    METHOD,
    ORIGIN,
    SCHEMAS,
    STATE,
    STATUS,
    TIMING,
    VERSION,
    WRIST,
    DecodeError,
    LoopTrack,
    McapError,
    lz4_frame,
    mcap_reader,
    mcap_records,
    mcap_stream,
    message_class,
    zstandard,
)
from smooth_operator.types import CommandTrajectory, HandRecording, Side, Status

_MOST_BYTES: Final = 1 << 20
"""Largest size of a message, except for the configuration [bytes]. A typical message has 1 kB."""
_MOST_STAGES: Final = 64  # each takes a number for every command
_MOST_ARM_JOINTS: Final = 64
_FLOAT_BYTES: Final = 8

# Exceptions of the MCAP library and the decompressors on cut-off or damaged bytes (lz4 raises
# RuntimeError; a wrong checksum and bad UTF-8 are ValueErrors).
_DAMAGE: Final = (
    McapError,
    struct.error,
    ValueError,
    EOFError,
    RuntimeError,
    MemoryError,
    zlib.error,
    zstandard.ZstdError,
)


class DamagedError(Exception):
    """The rest of a log is missing or damaged."""


@dataclass(frozen=True, eq=False)
class MethodUse:
    """A method that drove a hand, and the time from which it did.

    Attributes:
        stamp: stamp of its first command [s].
        method: name of the method.
        preset: name of its preset.
        config: its configuration as JSON values.
    """

    stamp: float
    method: str
    preset: str
    config: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Log:
    """Content of a log.

    Attributes:
        recording: the hand frames; None if the log contains none.
        commands: the commands with their latencies and status; None if the log contains none.
        config: the resolved configuration, or None.
        truncated: True if the end is missing or damaged; the content is the part before it.
        stages_ms: name of a stage of the loop -> (T,) its duration for each command [ms], NaN for
            a command without the stage.
        origin: where the log came from: ``name``, ``task``, ``meta`` (JSON).
        loop: mode, events and more for each command, in the log of a live loop.
        states: measured joints of the robot hand, if there are any.
        wrist: wrist commands that belong to the commands, if there are any.
        arm: arm commands that belong to the commands, if there are any.
        methods: methods that drove the hand, in order, in the log of a live loop. Each applies
            until the stamp of the next.
    """

    recording: HandRecording | None
    commands: CommandTrajectory | None
    config: dict[str, Any] | None
    truncated: bool
    stages_ms: dict[str, Float[np.ndarray, " T"]] = field(default_factory=dict)
    origin: dict[str, str] = field(default_factory=dict)
    loop: LoopTrack | None = None
    methods: tuple[MethodUse, ...] = ()
    states: StateTrajectory | None = None
    wrist: WristTrack | None = None
    arm: ArmTrack | None = None

    def __repr__(self) -> str:
        end = "truncated" if self.truncated else "whole"
        return f"<Log: {end}, {self.recording!r}, {self.commands!r}>"


def read_log(path: str | os.PathLike[str]) -> Log:
    """Reads a log that ``LogWriter`` wrote.

    The file is read from the front, so every complete chunk of a file without its end (after a
    crash, on a full disk) is read. Landmarks are exact, or NaN if they were not finite.

    Args:
        path: the log.

    Returns:
        its content. ``read_recording`` also checks the units.

    Raises:
        RecordingError: the file does not exist, is not an MCAP log, was written by another program
            or version, or contains invalid messages.
    """
    path = Path(path)
    if file_kind(path) != "log":
        raise RecordingError(
            f"{path}: this is not a log, but a file in another format; expected the .mcap that "
            "`smooth-operator teleop --sink record:take.mcap` writes"
        )
    tables, metadata, truncated = _read_tables(path)
    try:
        commands = tables[COMMAND]
        trajectory, stages = _read_commands(commands, tables[TIMING], tables[STATUS])
        loop = _read_loop_track(commands.numbers, tables[LOOP])
        configs = tables[CONFIG].column("configuration")
        config = _object(configs[0]) if configs else None
        recording = _read_hands(tables[HAND], path, truncated)
        wrist = _read_wrist_track(commands.numbers, tables[WRIST])
        arm = _read_arm_track(commands.numbers, tables[ARM])
        states = _read_states(tables[STATE])
        methods = tuple(_method(one.metadata) for one in metadata if one.name == METHOD)
    except RecordingError:
        raise  # a ValueError with its own message
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise _not_ours(path, error) from error
    origin: dict[str, str] = next(
        (one.metadata for one in reversed(metadata) if one.name == ORIGIN), {}
    )
    return Log(
        recording, trajectory, config, truncated, stages, origin, loop, methods, states, wrist, arm
    )


def read_log_recording(
    path: Path, rate: float | None, side: Side | None, layout: str | None = None
) -> HandRecording:
    """Reads the hand frames of a log.

    Raises:
        RecordingError: as ``read_log``; or there are no frames, or their side is not ``side``.
    """
    log = read_log(path)
    if log.recording is None:
        cut = "; it was cut off before its first frames were written" if log.truncated else ""
        raise RecordingError(f"{path}: the log contains no hand frames{cut}")
    check_side([log.recording.side], side, str(path))
    return log.recording


def log_topics(path: Path) -> Mapping[str, int] | None:
    """Reads the topics of a log and their numbers of messages, from the summary at the end of the
    file.

    Returns:
        None if the log was cut off or has no summary.

    Raises:
        OSError: the file can't be read.
    """
    try:
        with path.open("rb") as stream:
            whole: Any = _WholeReads(stream, path.stat().st_size)
            summary = mcap_reader.make_reader(whole).get_summary()
    except _DAMAGE:
        return None
    if summary is None or summary.statistics is None:
        return None
    counts = summary.statistics.channel_message_counts
    topics = dict.fromkeys((channel.topic for channel in summary.channels.values()), 0)
    for channel in summary.channels.values():
        topics[channel.topic] += counts.get(channel.id, 0)
    return topics


# --- records of the file -------------------------------------------------------------------------


class _WholeReads:
    """Stream that returns all requested bytes or raises EOFError, which the library does not do."""

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream, self._size = stream, size
        self.seek, self.seekable = stream.seek, stream.seekable

    def read(self, count: int) -> bytes:
        if self._stream.tell() + count > self._size:  # a damaged length must not allocate memory
            raise EOFError
        return self._stream.read(count)


def log_records(path: Path) -> Iterator[Any]:
    """Yields the schemas, channels, metadata and messages of a log, in order.

    Raises:
        DamagedError: the following bytes are missing or damaged.
        RecordingError: the log would take too much memory, or is compressed in another way.
    """
    size = path.stat().st_size
    allowance = Allowance.of(path, size, LOG_RATIO)
    unpacked = 0
    with path.open("rb") as stream:
        whole: Any = _WholeReads(stream, size)
        records = mcap_stream.StreamReader(whole, emit_chunks=True).records
        while True:
            try:
                record = next(records, None)
                if record is None:
                    return
                inner = [record]
                if isinstance(record, mcap_records.Chunk):
                    unpacked += _stated_size(record)
                    allowance.take("its chunks", unpacked)
                    record.data, record.compression = _unpacked(record, path), ""
                    inner = mcap_stream.breakup_chunk(record, validate_crc=True)
            except RecordingError:
                raise
            except _DAMAGE as error:
                raise DamagedError from error
            yield from inner


def _stated_size(chunk: mcap_records.Chunk) -> int:
    """Uncompressed size of a chunk [bytes], according to its record or its Zstandard frame."""
    if chunk.compression != "zstd":
        return max(chunk.uncompressed_size, len(chunk.data) if not chunk.compression else 0)
    return max(chunk.uncompressed_size, zstandard.frame_content_size(chunk.data))


def _unpacked(chunk: mcap_records.Chunk, path: Path) -> bytes:
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        data = zstandard.decompress(chunk.data, max_output_size=size)
    elif chunk.compression == "lz4":
        # One byte more than stated, so that a larger chunk is detected.
        data = lz4_frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise RecordingError(
            f"{path}: the log's compression {brief(chunk.compression)} is not supported; use "
            "zstd, lz4 or none"
        )
    if len(data) != size:
        raise DamagedError
    return bytes(data)


def _read_tables(path: Path) -> tuple[dict[str, _Table], list[Any], bool]:
    """Reads messages by topic, metadata, and True if the end of the file is missing."""
    tables = {topic: _Table(topic) for topic in SCHEMAS}
    channels: dict[int, _Table] = {}
    foreign: set[str] = set()
    metadata: list[Any] = []
    truncated = False
    try:
        for record in log_records(path):
            if isinstance(record, mcap_records.Message):
                if (table := channels.get(record.channel_id)) is not None:
                    table.add(record, path)
            elif isinstance(record, mcap_records.Channel):
                if _is_own(record, path):
                    channels[record.id] = tables[record.topic]
                else:
                    channels.pop(record.id, None)
                    foreign.add(record.topic)
            elif isinstance(record, mcap_records.Metadata):
                metadata.append(record)
    except DamagedError:
        truncated = True
    except OSError as error:
        raise RecordingError(f"{path}: can't be read: {error.strerror or error}") from error
    if foreign and not any(tables.values()):
        raise RecordingError(
            f"{path}: an MCAP file from another program, with the topics "
            f"{listed(sorted(foreign))}; if it is a ROS 2 bag, play it (ros2 bag play) and read "
            "the topic of the hand live: smooth-operator teleop --source ros2"
        )
    return tables, metadata, truncated


def _is_own(channel: Any, path: Path) -> bool:
    """True for a channel of this program."""
    version = channel.metadata.get("version")
    if channel.topic not in SCHEMAS or version is None:
        return False
    if version != VERSION:
        raise RecordingError(
            f"{path}: the log has version {version[:20]}, but this program reads version "
            f"{VERSION}; if a newer version wrote it, upgrade: {UPGRADE}"
        )
    return True


def _method(texts: dict[str, str]) -> MethodUse:
    stamp = float(texts["stamp"])
    if not math.isfinite(stamp):
        raise ValueError(
            f"a method change in the log has the timestamp {stamp}, which is not a finite number"
        )
    return MethodUse(stamp, texts["method"], texts["preset"], _object(texts["config"]))


def _object(text: str) -> dict[str, Any]:
    value = parse_json(text)
    if not isinstance(value, dict):
        raise ValueError(f"a configuration must be a JSON object, not {brief(value)}")
    return value


def _not_ours(path: Path, error: Exception) -> RecordingError:
    missing = f"it has no {error}" if isinstance(error, KeyError) else str(error)
    return RecordingError(
        f"{path}: a message of the log lacks a field, or a field is wrong ({missing[:200]}); it "
        "was not written by this program, or is damaged"
    )


# --- columns of a topic --------------------------------------------------------------------------


class _Table:
    """The messages of a topic, and their sequence numbers."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._parse = message_class(SCHEMAS[topic]).FromString
        self.numbers: list[int] = []
        self.messages: list[Any] = []

    def __len__(self) -> int:
        return len(self.messages)

    def add(self, record: Any, path: Path) -> None:
        topic, size = self._topic, len(record.data)
        if size > _MOST_BYTES and topic != CONFIG:
            wrong = f"a message on {topic} has {size} bytes, more than {_MOST_BYTES}"
            raise _not_ours(path, ValueError(wrong))
        try:
            self.messages.append(self._parse(record.data))
        except DecodeError as error:
            wrong = f"a message on {topic} is not a valid {SCHEMAS[topic]}: {error}"
            raise _not_ours(path, ValueError(wrong)) from error
        self.numbers.append(record.sequence)

    def column(self, name: str) -> list[Any]:
        """The values of a field; lists for a repeated field."""
        return [getattr(message, name) for message in self.messages]

    def floats(self, name: str) -> Float[np.ndarray, " T"]:
        """The values of a numeric field; NaN for values that are not finite."""
        return _finite(np.array(self.column(name), np.float64))

    def stamps(self) -> Float[np.ndarray, " T"]:
        stamps = np.array(self.column("stamp"), np.float64)
        if not np.isfinite(stamps).all():
            raise ValueError("a timestamp is not finite")
        return stamps

    def matrix(self, name: str, *shape: int) -> Float[np.ndarray, "T ..."]:
        """The values of a field that is an array of this shape, or empty; NaN if not finite."""
        rows, size = self.column(name), math.prod(shape)
        for row in rows:
            if len(row) not in (0, size):
                raise ValueError(f"{name} has {len(row)} numbers, not {size}")
        present = [len(row) == size for row in rows]
        values = np.full((len(rows), size), np.nan)
        count = sum(map(len, rows))
        values[present] = np.fromiter(chain.from_iterable(rows), float, count).reshape(-1, size)
        return _finite(values).reshape(len(rows), *shape)

    def optional(self, name: str, *shape: int) -> Float[np.ndarray, "T ..."] | None:
        """Like ``matrix``, but None if the field is empty in all messages."""
        return self.matrix(name, *shape) if any(map(len, self.column(name))) else None

    def present(self, name: str, *shape: int) -> Float[np.ndarray, "T ..."]:
        """Like ``matrix``, for a field that must not be empty."""
        if all(shape) and not all(map(len, self.column(name))):
            raise ValueError(f"a message has no {name}")
        return self.matrix(name, *shape)

    def same(self, name: str, what: str) -> Any:
        """The value of a field that must be equal in all messages."""
        values = self.column(name)
        other = next((value for value in values if value != values[0]), None)
        if other is not None:
            raise ValueError(f"{what} changes from {_brief(values[0])} to {_brief(other)}")
        return values[0] if isinstance(values[0], str) else tuple(values[0])

    def places(self, commands: Sequence[int]) -> Int[np.ndarray, " C"]:
        """Row of the table for each command: the last row with its sequence number, or -1."""
        rows = {number: row for row, number in enumerate(self.numbers)}
        return np.array([rows.get(number, -1) for number in commands], np.int64)


def _brief(value: Any) -> str:
    return brief(value if isinstance(value, str) else tuple(value))


def _spread(values: np.ndarray, places: Int[np.ndarray, " C"], absent: Any) -> np.ndarray:
    """Value for each command, from the rows of ``_Table.places``; ``absent`` without a row."""
    spread = np.full((len(places), *values.shape[1:]), absent, values.dtype)
    there = places >= 0
    spread[there] = values[places[there]]
    return spread


def _finite(values: np.ndarray) -> np.ndarray:
    values[np.isinf(values)] = np.nan
    return values


# --- recording and tracks ------------------------------------------------------------------------


def _read_hands(table: _Table, path: Path, truncated: bool) -> HandRecording | None:
    """Reads the hand frames; None if there are none."""
    if not table:
        return None
    side, _ = check_side(set(table.column("side")), None, str(path))
    flags = table.column("valid")
    if any(len(row) != NUM_LANDMARKS for row in flags):
        raise ValueError(f"valid has {len(flags[0])} flags, not {NUM_LANDMARKS}")
    return HandRecording(
        table.present("landmarks", NUM_LANDMARKS, 3),
        table.stamps(),
        side,
        valid=np.array([list(row) for row in flags], bool),
        metacarpals=table.optional("metacarpals", 4, 3),
        orientations=table.optional("orientations", NUM_LANDMARKS, 4),
        forearm=table.optional("forearm", 3),
        name=path.stem,
        meta={"format": "log", "truncated": truncated, "side_assumed": False},
        **_world_wrists(table),
    )


def _world_wrists(table: _Table) -> dict[str, Any]:
    """Reads the wrists in the world frame of the first one; NaN for wrists in another frame."""
    rows = table.optional("wrist", 7)
    if rows is None:
        return {}
    worlds = table.column("world")
    world = next(name for name, wrist in zip(worlds, table.column("wrist"), strict=True) if wrist)
    rows[[name != world for name in worlds]] = np.nan
    return {"T_world_wrist": rows, "world": world or None}


def _read_commands(
    table: _Table, timings: _Table, statuses: _Table
) -> tuple[CommandTrajectory | None, dict[str, np.ndarray]]:
    """Reads the commands, and the stages of those that have a timing with the same number."""
    if not table:
        return None, {}
    names = table.same("names", "the list of joint names")
    for one in (timings, statuses):
        if len(set(one.numbers)) != len(one):
            raise ValueError("two timings, or two statuses, have the same sequence number")
    latency = np.full(len(table), np.nan)
    stages: dict[str, np.ndarray] = {}
    times = timings.places(table.numbers)
    if timings:
        latency = _spread(timings.floats("latency_ms"), times, np.nan)
        spent = timings.column("stages")
        for i in np.flatnonzero(times >= 0):
            for stage in spent[times[i]]:
                if stage.name not in stages:
                    if len(stages) == _MOST_STAGES:
                        raise ValueError(f"more than {_MOST_STAGES} stages of the loop")
                    stages[stage.name] = np.full(len(table), np.nan)
                stages[stage.name][i] = stage.ms
    places = statuses.places(table.numbers)
    if (places < 0).any():
        raise ValueError(f"command {table.numbers[int(np.argmin(places))]} has no status")
    codes = np.array(statuses.column("status"), np.int64)[places]
    for code in np.unique(codes).tolist():
        Status(code)
    trajectory = CommandTrajectory(
        joint_positions=table.matrix("positions", len(names)),
        joint_names=names,
        stamps=table.stamps(),
        latency_ms=latency,
        status=codes.astype(np.int8),
    )
    return trajectory, stages


def _read_wrist_track(commands: Sequence[int], table: _Table) -> WristTrack | None:
    """Reads the commanded wrist at each command; None if there is no message."""
    if not table:
        return None
    places = table.places(commands)
    return WristTrack(
        _spread(table.present("pose", 7), places, np.nan),
        _spread(np.array(table.column("engaged"), bool), places, False),
        _spread(np.array(table.column("valid"), bool), places, False),
        table.same("world", "the frame of the commanded wrist"),
    )


def _read_arm_track(commands: Sequence[int], table: _Table) -> ArmTrack | None:
    """Reads the arm command at each command of the hand; None if there is no message."""
    if not table:
        return None
    name = table.same("name", "the arm")
    joints = table.same("names", "the list of the arm's joints")
    if len(joints) > _MOST_ARM_JOINTS:
        raise ValueError(f"an arm has {len(joints)} joints")
    places = table.places(commands)
    columns = (
        table.present("positions", len(joints)),
        table.matrix("measured", len(joints)),
        table.present("pose", 7),
    )
    positions, measured, poses = (_spread(values, places, np.nan) for values in columns)
    return ArmTrack(name, joints, positions, measured, poses)


def _read_states(table: _Table) -> StateTrajectory | None:
    """Reads the measured joints; None if there is no message."""
    if not table:
        return None
    names = table.same("names", "the list of measured joints")
    actuators = table.same("actuators", "the list of actuators")
    sizes = [_FLOAT_BYTES * len(row) for row in table.column("touch")]
    fingers = max(map(len, table.column("contact")))
    if fingers > len(FINGERS):
        raise ValueError(f"a hand with {fingers} fingers in contact")
    # Many short messages and a long one must not make a large array.
    if len(sizes) * max(sizes) > FREE_BYTES + ARRAYS_RATIO * sum(sizes):
        raise ValueError("few of the measured states have touch values, and these have too many")
    return StateTrajectory(
        table.stamps(),
        table.present("positions", len(names)),
        names,
        actuators,
        table.optional("currents", len(actuators)),
        table.optional("touch", max(sizes) // _FLOAT_BYTES),
        *(table.optional(name, fingers) for name in ("contact", "newtons")),
    )


def _read_loop_track(commands: Sequence[int], table: _Table) -> LoopTrack | None:
    """Reads the states of the loop; None if there is no message, as in a log without a loop."""
    if not table:
        return None
    places = table.places(commands)
    modes, events = table.column("mode"), table.column("events")

    def numbers(key: str) -> np.ndarray:
        return _spread(table.floats(key), places, np.nan)

    return LoopTrack(
        numbers=_spread(np.array(table.column("number"), np.int64), places, -1),
        modes=tuple("" if row < 0 else modes[row] for row in places),
        times=numbers("time"),
        received=numbers("received"),
        tracker_stamps=numbers("tracker_stamp"),
        tracking_loss=numbers("tracking_loss"),
        scale=numbers("scale"),
        events={i: tuple(events[row]) for i, row in enumerate(places) if row >= 0 and events[row]},
    )

"""Reading the project's own log, whole or cut off."""

from __future__ import annotations

import contextlib
import json
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np
import zstandard
from jaxtyping import Float
from mcap.exceptions import McapError, UnsupportedCompressionError
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from smooth_operator.errors import RecordingError
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.recording.checks import check_side
from smooth_operator.recording.loop_state import LoopTrack, read_loop_track
from smooth_operator.recording.schemas import (
    COMMAND,
    CONFIG,
    HAND,
    LOOP,
    METHOD,
    ORIGIN,
    READABLE_VERSIONS,
    SCHEMAS,
    STATUS,
    TIMING,
    VERSION,
)
from smooth_operator.recording.sniff import READABLE, file_kind
from smooth_operator.types import CommandTrajectory, HandRecording, Status

# What cut-off or damaged bytes raise on their way through the MCAP library and the decompressors
# (lz4 raises RuntimeError; a wrong checksum and bad UTF-8 are ValueErrors).
_DAMAGE = (
    McapError,
    struct.error,
    ValueError,
    EOFError,
    RuntimeError,
    MemoryError,
    zlib.error,
    zstandard.ZstdError,
)

_POINTS = {"landmarks": "xyz", "metacarpals": "xyz", "orientations": "wxyz"}

_Messages: TypeAlias = list[tuple[int, dict[str, Any]]]  # with their sequence numbers
_Notes: TypeAlias = list[tuple[str, dict[str, str]]]  # metadata records with their names


@dataclass(frozen=True, eq=False)
class MethodUse:
    """What drove a hand from some time on.

    Attributes:
        stamp: of the first command that it gave [s].
        method: its name.
        preset: that of its preset.
        config: its configuration, as JSON has it.
    """

    stamp: float
    method: str
    preset: str
    config: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Log:
    """What a log holds.

    Attributes:
        recording: the hand frames, or None if there are none.
        commands: the commands with their latencies and status, or None.
        config: the resolved configuration, or None.
        truncated: the end is missing or damaged, and what is here is what came before.
        stages_ms: (T,) time of each stage of the loop [ms] by name, one value per command, NaN
            where a command did not have the stage.
        origin: what the log says of where it came from: ``name``, ``task``, ``meta`` (JSON).
        loop: mode, events and more of each command, where a live loop wrote the log.
        methods: what drove the hand, in order, where a live loop wrote the log; each until the
            next one's stamp.
    """

    recording: HandRecording | None
    commands: CommandTrajectory | None
    config: dict[str, Any] | None
    truncated: bool
    stages_ms: dict[str, Float[np.ndarray, " T"]] = field(default_factory=dict)
    origin: dict[str, str] = field(default_factory=dict)
    loop: LoopTrack | None = None
    methods: tuple[MethodUse, ...] = ()


def read_log(path: str | os.PathLike[str]) -> Log:
    """Read a log that :class:`~smooth_operator.recording.LogWriter` wrote.

    The file is read from the front, so that one whose end is missing (a crash, a full disk) gives
    every chunk that was completed. Landmarks come back bit for bit, NaN where they were not finite.
    Logs of version 1, whose commands carry their status themselves, are read as well.

    Args:
        path: the log.

    Returns:
        What it holds; units are not checked here
        (:func:`~smooth_operator.recording.read_recording` does).

    Raises:
        RecordingError: no such file, not an MCAP log, one of another program or a newer version, or
            messages that can't be understood.
    """
    path = Path(path)
    if file_kind(path) != "log":
        raise RecordingError(f"{path}: not a log; read it with read_recording or read_commands")
    messages, notes, truncated = _read_messages(path)
    try:
        trajectory, stages = _commands(messages[COMMAND], messages[TIMING], messages[STATUS])
        loop = read_loop_track([n for n, _ in messages[COMMAND]], dict(messages[LOOP]))
        configs = [json.loads(message["configuration"]) for _, message in messages[CONFIG]]
        recording = _recording([message for _, message in messages[HAND]], path, truncated)
        methods = tuple(_method(texts) for name, texts in notes if name == METHOD)
    except RecordingError:
        raise  # it is a ValueError too, but has its own message
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise RecordingError(
            f"{path}: a message of the log lacks a field or has a wrong one "
            f"({type(error).__name__}: {error}); it was not written by this program's LogWriter"
        ) from error
    config = configs[0] if configs else None
    origin = next((texts for name, texts in reversed(notes) if name == ORIGIN), {})
    return Log(recording, trajectory, config, truncated, stages, origin, loop, methods)


class _DamagedError(Exception):
    """The bytes end, or make no sense, from here on."""


def _read_messages(path: Path) -> tuple[dict[str, _Messages], _Notes, bool]:
    """The messages by topic, the metadata, and whether the end of the file is missing."""
    messages: dict[str, _Messages] = {topic: [] for topic in SCHEMAS}
    topics: dict[int, str] = {}
    foreign: set[str] = set()
    notes: _Notes = []
    truncated = False
    try:
        with path.open("rb") as stream:
            for record in _records(stream, path.stat().st_size):
                if isinstance(record, Channel):
                    if _is_ours(record, path):
                        topics[record.id] = record.topic
                    else:
                        foreign.add(record.topic)
                elif isinstance(record, Metadata):
                    notes.append((record.name, dict(record.metadata)))
                elif isinstance(record, Message) and record.channel_id in topics:
                    topic = topics[record.channel_id]
                    message = _decode(record.data, topic, path)
                    messages[topic].append((record.sequence, _compact(message)))
    except _DamagedError:
        truncated = True
    if foreign and not any(messages.values()):
        raise RecordingError(
            f"{path}: an MCAP file of another program, with the topics "
            f"{', '.join(sorted(foreign))}. What is read: {READABLE}"
        )
    return messages, notes, truncated


def _records(stream: IO[bytes], size: int) -> Iterator[Any]:
    """The records of an MCAP stream; _DamagedError where they stop before their end."""
    # Chunks are opened here and with their checksum: a chunk cut in its middle can still look
    # complete to the library, which takes a short read for the whole. No record is larger than the
    # file, so a damaged length can't ask for the memory.
    reader = StreamReader(stream, emit_chunks=True, record_size_limit=size)
    try:
        for record in reader.records:
            if isinstance(record, Chunk):
                yield from breakup_chunk(record, validate_crc=True)
            else:
                yield record
    except UnsupportedCompressionError as error:
        raise RecordingError(f"{stream.name}: {error}; write it with zstd, lz4 or none") from error
    except _DAMAGE as error:
        raise _DamagedError from error


def _is_ours(channel: Channel, path: Path) -> bool:
    version = channel.metadata.get("version")
    if channel.topic not in SCHEMAS or version is None:
        return False
    if version not in READABLE_VERSIONS:
        raise RecordingError(
            f"{path}: the log is of version {version}, this program reads up to version {VERSION}; "
            "upgrade it: python -m pip install --upgrade smooth-operator"
        )
    return True


def _method(texts: dict[str, str]) -> MethodUse:
    config = json.loads(texts["config"])
    return MethodUse(float(texts["stamp"]), texts["method"], texts["preset"], config)


def _decode(data: bytes, topic: str, path: Path) -> dict[str, Any]:
    try:
        message = json.loads(data)
    except ValueError as error:
        raise RecordingError(f"{path}: a message on {topic} is not JSON ({error})") from error
    if not isinstance(message, dict):
        raise RecordingError(f"{path}: a message on {topic} is not an object")
    return message


def _compact(message: dict[str, Any]) -> dict[str, Any]:
    """With points as arrays, where they are points: a tenth of the memory, which hours of frames
    need."""
    for key, axes in _POINTS.items():
        if key in message:
            with contextlib.suppress(KeyError, TypeError, ValueError):  # said by whoever wants it
                message[key] = _points(message[key], axes)
    return message


def _points(points: Any, axes: str) -> np.ndarray:
    if isinstance(points, np.ndarray):
        return points
    # float64 makes NaN of None
    return np.array([[p[a] for a in axes] for p in points], np.float64)


def _recording(messages: list[dict[str, Any]], path: Path, truncated: bool) -> HandRecording | None:
    if not messages:
        return None
    stamps = np.array([m["stamp"] for m in messages], np.float64)
    side, _ = check_side({m["side"] for m in messages}, None, str(path))
    return HandRecording(
        _rows(messages, "landmarks", NUM_LANDMARKS),
        stamps,
        side,
        valid=np.array([m["valid"] for m in messages], bool),
        metacarpals=_optional(messages, "metacarpals", 4),
        orientations=_optional(messages, "orientations", NUM_LANDMARKS),
        name=path.stem,
        meta={"format": "log", "truncated": truncated, "side_assumed": False},
    )


def _optional(messages: list[dict[str, Any]], key: str, count: int) -> np.ndarray | None:
    return _rows(messages, key, count) if any(key in m for m in messages) else None


def _rows(messages: list[dict[str, Any]], key: str, count: int) -> np.ndarray:
    """(T, count, axes), NaN where a value is null or a frame has none."""
    axes = _POINTS[key]
    rows = np.full((len(messages), count, len(axes)), np.nan)
    for row, message in zip(rows, messages, strict=True):
        if key in message:
            row[:] = _points(message[key], axes)
    return rows


def _commands(
    messages: _Messages, timings: _Messages, statuses: _Messages
) -> tuple[CommandTrajectory | None, dict[str, np.ndarray]]:
    """The commands, and the stages of those that have a timing with the same sequence number."""
    if not messages:
        return None, {}
    count = len(messages)
    commands = [message for _, message in messages]
    names = tuple(commands[0]["names"])
    if any(tuple(m["names"]) != names for m in commands):
        raise ValueError("the joint names change")
    by_number, status_of = dict(timings), dict(statuses)
    if len(by_number) != len(timings) or len(status_of) != len(statuses):
        raise ValueError("two timings, or two statuses, have the same sequence number")
    latency = np.full(count, np.nan)
    stages: dict[str, np.ndarray] = {}
    for i, (number, _) in enumerate(messages):
        timing = by_number.get(number)
        if timing is None:
            continue
        latency[i] = _float(timing["latency_ms"])
        for stage in timing["stages"]:
            column = stages.setdefault(stage["name"], np.full(count, np.nan))
            column[i] = _float(stage["ms"])
    positions = np.array([m["positions"] for m in commands], np.float64)
    trajectory = CommandTrajectory(
        joint_positions=positions.reshape(count, len(names)),
        joint_names=names,
        stamps=np.array([m["stamp"] for m in commands], np.float64),
        latency_ms=latency,
        # In version 1 a command carries its own.
        status=np.array(
            [Status(status_of.get(number, m)["status"]) for number, m in messages], np.int8
        ),
    )
    return trajectory, stages


def _float(value: float | None) -> float:
    return float("nan") if value is None else float(value)

"""Reader of the project's own log, complete or cut off."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import UPGRADE, DocumentError, RecordingError, brief, listed
from smooth_operator.formats.arm_track import ArmTrack
from smooth_operator.formats.checks import check_side
from smooth_operator.formats.registry import readable
from smooth_operator.formats.sniff import file_kind
from smooth_operator.formats.states import StateTrajectory
from smooth_operator.formats.wrist_track import WristTrack
from smooth_operator.io.documents import parse_json
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.teleop.recording.log_arms import decode_arm, read_arm_track
from smooth_operator.teleop.recording.log_records import DamagedError, read_records, read_summary
from smooth_operator.teleop.recording.log_states import decode_state, read_states
from smooth_operator.teleop.recording.log_wrists import (
    decode_pose,
    decode_wrist,
    read_wrist_track,
    world_wrists,
)
from smooth_operator.teleop.recording.loop_state import LoopTrack, read_loop_track
from smooth_operator.teleop.recording.mcap_library import Channel, Metadata
from smooth_operator.teleop.recording.schemas import (
    ARM,
    COMMAND,
    CONFIG,
    HAND,
    LOOP,
    METHOD,
    ORIGIN,
    READABLE_VERSIONS,
    SCHEMAS,
    STATE,
    STATUS,
    TIMING,
    VERSION,
    WRIST,
)
from smooth_operator.types import CommandTrajectory, HandRecording, Side, Status

_POINTS: Final = {
    "landmarks": (NUM_LANDMARKS, "xyz"),
    "metacarpals": (4, "xyz"),
    "orientations": (NUM_LANDMARKS, "wxyz"),
}
_MOST_STAGES: Final = 64  # each takes a number for every command

_KEPT: Final = {topic: frozenset(schema["properties"]) for topic, (_, schema) in SCHEMAS.items()}

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
        states: the measured joints of the robot hand, where a live loop had them.
        wrist: the commanded wrist, with each of the commands, where there was one.
        arm: the same of the arm.
        methods: what drove the hand, in order, each until the next one's stamp, in a live log.
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
    """Read a log that ``LogWriter`` wrote.

    The file is read from the front, so that one whose end is missing (a crash, a full disk) gives
    every chunk that was completed. Landmarks come back bit for bit, NaN where they were not finite.
    Logs of version 1, whose commands carry their status themselves, are read as well.

    Args:
        path: the log.

    Returns:
        What it holds; units are not checked here (``read_recording`` does).

    Raises:
        RecordingError: no such file, not an MCAP log, one of another program or a newer version, or
            messages that can't be understood.
    """
    path = Path(path)
    if file_kind(path) != "log":
        raise RecordingError(
            f"{path}: not a log, but a file of another format; expected the .mcap that "
            "`smooth-operator teleop --sink record:take.mcap` writes"
        )
    messages, notes, truncated = _read_messages(path)
    try:
        trajectory, stages = _commands(messages[COMMAND], messages[TIMING], messages[STATUS])
        numbers = [number for number, _ in messages[COMMAND]]
        loop = read_loop_track(numbers, dict(messages[LOOP]))
        config = _object(messages[CONFIG][0][1]["configuration"]) if messages[CONFIG] else None
        recording = _recording([message for _, message in messages[HAND]], path, truncated)
        wrist = read_wrist_track(numbers, dict(messages[WRIST]))
        arm = read_arm_track(numbers, dict(messages[ARM]))
        states = read_states([message for _, message in messages[STATE]])
        methods = tuple(_method(texts) for name, texts in notes if name == METHOD)
    except RecordingError:
        raise  # it is a ValueError too, but has its own message
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise _not_ours(path, error) from error
    origin = next((texts for name, texts in reversed(notes) if name == ORIGIN), {})
    return Log(
        recording, trajectory, config, truncated, stages, origin, loop, methods, states, wrist, arm
    )


def read_log_recording(
    path: Path, rate: float | None, side: Side | None, layout: str | None = None
) -> HandRecording:
    """The hand frames of a log, which has stamps, a side and its own order of landmarks.

    Raises:
        RecordingError: as ``read_log``; no frames in it; another side than ``side``.
    """
    log = read_log(path)
    if log.recording is None:
        cut = "; it was cut off before its first frames were written" if log.truncated else ""
        raise RecordingError(f"{path}: the log holds no hand frames{cut}")
    check_side([log.recording.side], side, str(path))
    return log.recording


def count_log_frames(path: Path) -> int | None:
    """Hand frames, from the summary at the end of the log; None where it was cut off."""
    summary = read_summary(path)
    if summary is None or summary.counts is None:
        return None
    channels = [number for number, topic in summary.topics.items() if topic == HAND]
    return sum(summary.counts.get(channel, 0) for channel in channels)


def _read_messages(path: Path) -> tuple[dict[str, _Messages], _Notes, bool]:
    """The messages by topic, the metadata, and whether the end of the file is missing."""
    messages: dict[str, _Messages] = {topic: [] for topic in SCHEMAS}
    topics: dict[int, str] = {}
    foreign: set[str] = set()
    notes: _Notes = []
    truncated = False
    names: dict[tuple[str, ...], tuple[str, ...]] = {}  # each command has the same ones
    try:
        for record in read_records(path):
            if isinstance(record, Channel):
                if _is_ours(record, path):
                    topics[record.id] = record.topic
                else:
                    foreign.add(record.topic)
            elif isinstance(record, Metadata):
                notes.append((record.name, dict(record.metadata)))
            elif record.channel in topics:
                topic = topics[record.channel]
                message = _decode(record.data, topic, path)
                if "names" in message:
                    message["names"] = names.setdefault(message["names"], message["names"])
                messages[topic].append((record.sequence, message))
    except DamagedError:
        truncated = True
    except OSError as error:
        raise RecordingError(f"{path}: can't be read: {error.strerror or error}") from error
    if foreign and not any(messages.values()):
        raise RecordingError(
            f"{path}: an MCAP file of another program, with the topics "
            f"{listed(sorted(foreign))}. What is read: {readable()}"
        )
    return messages, notes, truncated


def _is_ours(channel: Channel, path: Path) -> bool:
    version = channel.metadata.get("version")
    if channel.topic not in SCHEMAS or version is None:
        return False
    if version not in READABLE_VERSIONS:
        raise RecordingError(
            f"{path}: the log is of version {version[:20]}, this program reads up to version "
            f"{VERSION}; upgrade it: {UPGRADE}"
        )
    return True


def _method(texts: dict[str, str]) -> MethodUse:
    stamp = float(texts["stamp"])
    if not math.isfinite(stamp):
        raise ValueError(f"the stamp of a method is {stamp}")
    return MethodUse(stamp, texts["method"], texts["preset"], _object(texts["config"]))


def _object(text: str) -> dict[str, Any]:
    value = parse_json(text)
    if not isinstance(value, dict):
        raise ValueError(f"a configuration is no object, but {brief(value)}")
    return value


def _not_ours(path: Path, error: Exception) -> RecordingError:
    missing = f"it has no {error}" if isinstance(error, KeyError) else str(error)
    return RecordingError(
        f"{path}: a message of the log lacks a field or has a wrong one ({missing[:200]}); it was "
        "not written by this program, or is damaged"
    )


def _decode(data: bytes, topic: str, path: Path) -> dict[str, Any]:
    """A message as it is kept: the fields of its schema, with points as arrays, where hours of
    frames need a tenth of the memory."""
    try:
        found = parse_json(data)
    except DocumentError as error:
        raise RecordingError(
            f"{path}: a message on {topic} is not JSON ({error}); copy or record it again"
        ) from error
    if not isinstance(found, dict):
        raise RecordingError(f"{path}: a message on {topic} is not an object")
    kept = _KEPT[topic]
    message = {key: value for key, value in found.items() if key in kept}
    try:
        if "stamp" in message:
            message["stamp"] = _number(message["stamp"], "stamp")
        if topic == HAND:
            for key, (count, axes) in _POINTS.items():
                if key in message:
                    message[key] = _points(message[key], key, count, axes)
            message["valid"] = _flags(message["valid"])
            if "wrist" in message:
                message["wrist"] = decode_pose(message["wrist"])
        elif topic == COMMAND:
            message["names"] = tuple(map(_text, message["names"]))
            message["positions"] = np.array(message["positions"], np.float64)
            if "status" in found:  # of version 1
                message["status"] = found["status"]
        elif topic in _DECODE:
            _DECODE[topic](message)
        elif topic == TIMING:
            stages = [(_text(at["name"]), _float(at["ms"])) for at in message["stages"]]
            message["stages"] = stages[: _MOST_STAGES + 1]
            message["latency_ms"] = _float(message["latency_ms"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _not_ours(path, error) from error
    return message


_DECODE: Final = {WRIST: decode_wrist, ARM: decode_arm, STATE: decode_state}


def _points(points: Any, key: str, count: int, axes: str) -> np.ndarray:
    # float64 makes NaN of None
    found = np.array([[p[a] for a in axes] for p in points], np.float64)
    if found.shape != (count, len(axes)):
        raise ValueError(f"{key} has {len(points)} points, not {count}")
    return found


def _flags(valid: Any) -> np.ndarray:
    if not isinstance(valid, list) or not {type(flag) for flag in valid} <= {bool}:
        raise ValueError(f"valid must be true or false for each landmark, not {brief(valid)}")
    if len(valid) != NUM_LANDMARKS:
        raise ValueError(f"valid has {len(valid)} flags, not {NUM_LANDMARKS}")
    return np.array(valid, bool)


def _recording(messages: list[dict[str, Any]], path: Path, truncated: bool) -> HandRecording | None:
    if not messages:
        return None
    stamps = np.array([m["stamp"] for m in messages], np.float64)
    side, _ = check_side({_text(m["side"]) for m in messages}, None, str(path))
    return HandRecording(
        _rows(messages, "landmarks"),
        stamps,
        side,
        valid=np.array([m["valid"] for m in messages], bool),
        metacarpals=_optional(messages, "metacarpals"),
        orientations=_optional(messages, "orientations"),
        name=path.stem,
        meta={"format": "log", "truncated": truncated, "side_assumed": False},
        **world_wrists(messages),
    )


def _optional(messages: list[dict[str, Any]], key: str) -> np.ndarray | None:
    return _rows(messages, key) if any(key in m for m in messages) else None


def _rows(messages: list[dict[str, Any]], key: str) -> np.ndarray:
    """(T, count, axes), NaN where a value is null or a frame has none."""
    count, axes = _POINTS[key]
    rows = np.full((len(messages), count, len(axes)), np.nan)
    for row, message in zip(rows, messages, strict=True):
        if key in message:
            row[:] = message[key]
    return rows


def _commands(
    messages: _Messages, timings: _Messages, statuses: _Messages
) -> tuple[CommandTrajectory | None, dict[str, np.ndarray]]:
    """The commands, and the stages of those that have a timing with the same sequence number."""
    if not messages:
        return None, {}
    count = len(messages)
    commands = [message for _, message in messages]
    names = commands[0]["names"]
    if any(m["names"] != names for m in commands):
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
        latency[i] = timing["latency_ms"]
        for stage, time in timing["stages"]:
            if stage not in stages:
                stages[stage] = np.full(count, np.nan)
            stages[stage][i] = time
        if len(stages) > _MOST_STAGES:
            raise ValueError(f"more than {_MOST_STAGES} stages of the loop")
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


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{what} must be a number, not {brief(value)}")
    return float(value)


def _float(value: Any) -> float:
    return math.nan if value is None else _number(value, "a time")


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"a name must be text, not {brief(value)}")
    return value

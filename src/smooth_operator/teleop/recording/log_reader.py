"""Reader of the project's own log, complete or cut off."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import UPGRADE, RecordingError, brief, listed
from smooth_operator.formats.arm_track import ArmTrack
from smooth_operator.formats.checks import check_side
from smooth_operator.formats.registry import readable
from smooth_operator.formats.sniff import file_kind
from smooth_operator.formats.states import StateTrajectory
from smooth_operator.formats.wrist_track import WristTrack
from smooth_operator.io.documents import parse_json
from smooth_operator.teleop.recording.log_protobuf import protobuf_rows
from smooth_operator.teleop.recording.log_records import (
    DamagedError,
    LogMessages,
    read_records,
    read_summary,
)
from smooth_operator.teleop.recording.log_tables import Table
from smooth_operator.teleop.recording.log_tracks import (
    read_arm_track,
    read_commands,
    read_hands,
    read_states,
    read_wrist_track,
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
    READ,
    SCHEMAS,
    STATE,
    STATUS,
    TIMING,
    VERSION,
    WRIST,
)
from smooth_operator.types import CommandTrajectory, HandRecording, Side

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

    Args:
        path: the log.

    Returns:
        What it holds; units are not checked here (``read_recording`` does).

    Raises:
        RecordingError: no such file, not an MCAP log, one of another program or version, or
            messages that can't be understood.
    """
    path = Path(path)
    if file_kind(path) != "log":
        raise RecordingError(
            f"{path}: not a log, but a file of another format; expected the .mcap that "
            "`smooth-operator teleop --sink record:take.mcap` writes"
        )
    tables, notes, truncated = _read_tables(path)
    try:
        commands = tables[COMMAND]
        trajectory, stages = read_commands(commands, tables[TIMING], tables[STATUS])
        loop = read_loop_track(commands.numbers, tables[LOOP])
        configs = tables[CONFIG].column("configuration")
        config = _object(configs[0]) if configs else None
        recording = read_hands(tables[HAND], path, truncated)
        wrist = read_wrist_track(commands.numbers, tables[WRIST])
        arm = read_arm_track(commands.numbers, tables[ARM])
        states = read_states(tables[STATE])
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


def _read_tables(path: Path) -> tuple[dict[str, Table], _Notes, bool]:
    """The messages by topic, the metadata, and whether the end of the file is missing."""
    tables = {topic: Table(fields) for topic, fields in READ.items()}
    topics: dict[int, str] = {}  # of the channels of this program
    foreign: set[str] = set()
    notes: _Notes = []
    truncated = False
    try:
        for record in read_records(path, topics):
            if isinstance(record, Channel):
                if _is_ours(record, path):
                    topics[record.id] = record.topic
                else:
                    topics.pop(record.id, None)
                    foreign.add(record.topic)
            elif isinstance(record, Metadata):
                notes.append((record.name, dict(record.metadata)))
            elif record.channel in topics:
                _take(tables[topics[record.channel]], record, topics[record.channel], path)
    except DamagedError:
        truncated = True
    except OSError as error:
        raise RecordingError(f"{path}: can't be read: {error.strerror or error}") from error
    if foreign and not any(tables.values()):
        raise RecordingError(
            f"{path}: an MCAP file of another program, with the topics "
            f"{listed(sorted(foreign))}. What is read: {readable()}"
        )
    return tables, notes, truncated


def _is_ours(channel: Channel, path: Path) -> bool:
    """True if the messages of a channel are of this program, False if of another one.

    Raises:
        RecordingError: they are of another version.
    """
    version = channel.metadata.get("version")
    if channel.topic not in SCHEMAS or version is None:
        return False
    if version != VERSION:
        raise RecordingError(
            f"{path}: the log is of version {version[:20]}, this program reads version "
            f"{VERSION}; if a newer version wrote it, upgrade: {UPGRADE}"
        )
    return True


def _take(table: Table, messages: LogMessages, topic: str, path: Path) -> None:
    """Adds messages to the table of their topic."""
    try:
        table.rows += protobuf_rows(messages.data, topic)
        table.numbers += messages.numbers
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _not_ours(path, error) from error


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

"""Reads and writes episodes as this project's own log (MCAP)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from smooth_operator.episode_files.staging import staged_file
from smooth_operator.errors import RecordingError
from smooth_operator.formats.checks import check_rate, check_side, check_stamps
from smooth_operator.formats.episode import (
    ArmTrack,
    Episode,
    StateTrajectory,
    WristTrack,
    check_commands,
)
from smooth_operator.io.documents import json_object
from smooth_operator.io.jsonable import to_json
from smooth_operator.teleop.recording.log import LogWriter
from smooth_operator.teleop.recording.log_reader import log_topics, read_log
from smooth_operator.teleop.recording.messages import FOXGLOVE, SCHEMAS
from smooth_operator.teleop.sinks.tick import ArmCommand, Contact, HandState, WristCommand
from smooth_operator.types import HandRecording, JointCommand, Side, Status

_CHUNK_BYTES = 1 << 20  # a crash loses the whole new file anyway, and larger chunks are smaller


def read_log_episode(path: Path, *, rate: float | None = None, side: Side | None = None) -> Episode:
    """Reads a log as an episode.

    Raises:
        RecordingError: as ``read_log``; the log contains neither frames nor commands, its stamps do
            not increase, or ``side`` or ``rate`` contradicts it.
    """
    log = read_log(path)
    name = log.origin.get("name") or path.stem
    recording = log.recording
    if recording is not None:
        check_side([recording.side], side, str(path))
        check_stamps(recording.stamps, str(path))
        check_rate(recording.stamps, rate, str(path))
        meta = json_object(log.origin.get("meta", "")) or {}
        recording = replace(recording, name=name, meta={**meta, **recording.meta})
    if log.commands is not None:
        check_commands(log.commands, str(path))
    notes: tuple[str, ...] = ()
    if log.truncated:
        notes = (f"{path}: the end of the log is missing; the part before it is converted",)
    if log.loop is not None:
        notes += (f"{path}: loop modes and events are not exported (they remain in the log)",)
    task = log.origin.get("task")
    return Episode(
        recording,
        log.commands,
        log.config,
        log.stages_ms,
        task,
        name,
        notes,
        log.states,
        log.wrist,
        log.arm,
        live=log.loop is not None,
    )


def write_log_episode(path: Path, episode: Episode) -> None:
    """Writes an episode as a log: each frame, followed by the commands up to the next frame.

    Raises:
        OutputError: it can't be written.
        RecordingError: the stamps of the frames do not increase.
    """
    origin = {"name": episode.name, "meta": to_json(episode.meta)}
    if episode.task is not None:
        origin["task"] = episode.task
    recording, commands = episode.recording, episode.commands
    with (
        staged_file(path) as temporary,
        LogWriter(temporary, chunk_bytes=_CHUNK_BYTES, flush_seconds=3600.0) as log,
    ):
        log.write_origin(origin)
        if episode.config is not None:
            log.write_config(episode.config)
        written = shown = 0
        states = () if episode.states is None else _states(episode.states, recording)
        for i in range(0 if commands is None else len(commands)):
            assert commands is not None
            stamp = float(commands.stamps[i])
            while recording is not None and written < len(recording):
                if recording.stamps[written] > stamp:
                    break
                log.write_hand(recording[written])
                written += 1
            while shown < len(states) and states[shown].stamp <= stamp:
                log.write_state(states[shown])
                shown += 1
            log.write_command(
                JointCommand(commands.joint_positions[i], commands.joint_names, stamp),
                Status(int(commands.status[i])),
                float(commands.latency_ms[i]),
                {name: float(values[i]) for name, values in episode.stages_ms.items()},
                wrist=_wrist(episode.wrist, i),
                arm=_arm(episode.arm, i),
            )
        if recording is not None:
            for frame in recording[written:]:
                log.write_hand(frame)
        for state in states[shown:]:
            log.write_state(state)


def _wrist(track: WristTrack | None, row: int) -> WristCommand | None:
    if track is None or np.isnan(track.poses[row]).any():
        return None
    flags = bool(track.engaged[row]), bool(track.valid[row])
    return WristCommand(track.poses[row], *flags, track.world)


def _arm(track: ArmTrack | None, row: int) -> ArmCommand | None:
    if track is None or np.isnan(track.positions[row]).any():
        return None
    measured = track.measured[row]
    return ArmCommand(
        track.name,
        track.joint_names,
        track.positions[row],
        np.full(len(track.joint_names), np.nan),  # velocities follow from the positions
        track.poses[row],
        measured=None if np.isnan(measured).all() else measured,
    )


def _states(states: StateTrajectory, recording: HandRecording | None) -> tuple[HandState, ...]:
    """Converts measured states to one object per measurement."""
    side: Side = "right" if recording is None else recording.side
    currents, touch = states.currents, states.touch
    return tuple(
        HandState(
            side,
            "",
            float(stamp),
            states.names,
            states.positions[k],
            actuators=states.actuators,
            currents=None if currents is None else currents[k],
            touch=None if touch is None else touch[k],
            contact=None
            if states.contact is None or states.newtons is None
            else Contact(states.contact[k], states.newtons[k]),
        )
        for k, stamp in enumerate(states.stamps)
    )


def log_losses(episode: Episode) -> list[str]:
    """Describes the values of an episode that a log can't store, which are infinities; they become
    NaN."""
    parts: list[tuple[str, np.ndarray | None]] = []
    if episode.recording is not None:
        recording = episode.recording
        parts += [(n, getattr(recording, n)) for n in ("landmarks", "metacarpals", "orientations")]
    if episode.commands is not None:
        parts.append(("joint_positions", episode.commands.joint_positions))
        parts.append(("latency_ms", episode.commands.latency_ms))
    parts += list(episode.stages_ms.items())
    return [
        f"{episode.name}: {int(np.isinf(values).sum())} infinite values of {name} become "
        "NaN, which marks unknown numbers"
        for name, values in parts
        if values is not None and np.isinf(values).any()
    ]


def is_own_log(path: Path) -> bool:
    """True if a file is a log of this program. Uses the log's index if that is complete."""
    try:
        topics = log_topics(path)
        if topics:
            return bool(topics.keys() & SCHEMAS.keys()) and topics.keys() <= {*SCHEMAS, *FOXGLOVE}
        return read_log(path) is not None  # refuses a log of another program
    except (RecordingError, OSError):
        return False

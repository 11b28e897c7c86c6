"""The messages of the log as bytes; the fields and their numbers are those of ``schemas.py``."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

from smooth_operator.teleop.recording.loop_state import LoopState
from smooth_operator.teleop.recording.wire import (
    double_key,
    doubles,
    flags,
    head,
    pack_double,
    part,
    text,
    texts,
    varint,
    whole,
)
from smooth_operator.teleop.sinks.tick import ArmCommand, HandState, WristCommand
from smooth_operator.types import HandFrame, Status

_MAX_LOG_TIME: Final = 2**64 - 1
_STAMP: Final = double_key(1)
_TWO: Final = struct.Struct("<BdBd").pack
_THREE: Final = struct.Struct("<BdBdBd").pack
_SIX: Final = struct.Struct("<" + "Bd" * 6).pack
_NUMBER: Final = whole(2, 0)[:1]  # what stands before the number of a tick
_LATENCY: Final = double_key(2)
_STAGE_MS: Final = double_key(2)
_LOOP: Final = tuple(double_key(number) for number in (4, 5, 6, 8, 9))
_ARM: Final = tuple(double_key(number) for number in (9, 10, 11))


def nanoseconds(stamp: float) -> int:
    """A stamp as MCAP has it: whole, and none before zero; the message keeps it exactly."""
    return min(round(min(max(stamp * 1e9, 0.0), float(_MAX_LOG_TIME))), _MAX_LOG_TIME)


def hand_message(stamp: float, frame: HandFrame) -> bytes:
    """A hand frame, for ``/hand``."""
    parts = [
        pack_double(_STAMP, stamp),
        text(2, frame.side),
        doubles(3, frame.landmarks),
        flags(4, frame.valid),
    ]
    if frame.metacarpals is not None:
        parts.append(doubles(5, frame.metacarpals))
    if frame.orientations is not None:
        parts.append(doubles(6, frame.orientations))
    if frame.T_world_wrist is not None:
        parts.append(doubles(7, frame.T_world_wrist))
        if frame.world is not None:
            parts.append(text(8, frame.world))
    return b"".join(parts)


def command_message(stamp: float, names: tuple[str, ...], positions: Any) -> bytes:
    """A command, for ``/command``."""
    return pack_double(_STAMP, stamp) + texts(2, names) + doubles(3, positions)


def status_message(stamp: float, status: Status) -> bytes:
    """Why a command is what it is, for ``/status``."""
    return pack_double(_STAMP, stamp) + _reason(status)


@lru_cache
def _reason(status: Status) -> bytes:
    return whole(2, status) + text(3, status.reason)


def timing_message(stamp: float, latency_ms: float | None, stages: Mapping[str, Any]) -> bytes:
    """How long a command took, for ``/timing``; None is not known."""
    parts = [_TWO(_STAMP, stamp, _LATENCY, _known(latency_ms))]
    for name, ms in stages.items():
        parts += (_stage(name), pack_double(_STAGE_MS, _known(ms)))
    return b"".join(parts)


@lru_cache(maxsize=256)
def _stage(name: str) -> bytes:
    """What stands before the time of a stage, which is its last field of 9 bytes."""
    named = text(1, name)
    return head(3, len(named) + 9) + named


def loop_message(stamp: float, loop: LoopState) -> bytes:
    """The loop at a command, for ``/loop``."""
    time, received, tracker_stamp, tracking_loss, scale = _LOOP
    received_at, tracker_at = loop.received, loop.tracker_stamp
    parts = [
        _SIX(
            *(_STAMP, stamp, time, loop.time),
            *(received, math.nan if received_at is None else received_at),
            *(tracker_stamp, math.nan if tracker_at is None else tracker_at),
            *(tracking_loss, loop.tracking_loss, scale, loop.scale),
        ),
        _NUMBER,
        varint(loop.number),
        _mode_and_session(loop.mode, loop.session),
    ]
    if loop.events:
        parts += [part(10, event.encode()) for event in loop.events]
    return b"".join(parts)


@lru_cache(maxsize=256)
def _mode_and_session(mode: str, session: int | None) -> bytes:
    return text(3, mode) + (b"" if session is None else whole(7, session))


def wrist_message(stamp: float, wrist: WristCommand) -> bytes:
    """The commanded wrist, for ``/wrist``; ``stamp`` is that of the command [s]."""
    return b"".join(
        (
            pack_double(_STAMP, stamp),
            doubles(2, wrist.pose),
            whole(3, wrist.engaged),
            whole(4, wrist.valid),
            text(5, wrist.world),
        )
    )


def arm_message(stamp: float, arm: ArmCommand) -> bytes:
    """The command of an arm, for ``/arm``; ``stamp`` is that of the hand's command [s]."""
    clearance, position_error, rotation_error = _ARM
    return b"".join(
        (
            pack_double(_STAMP, stamp),
            text(2, arm.name),
            texts(3, tuple(arm.joint_names)),
            doubles(4, arm.positions),
            doubles(5, arm.velocity),
            b"" if arm.measured is None else doubles(6, arm.measured),
            doubles(7, arm.pose),
            text(8, arm.state),
            _THREE(
                clearance,
                arm.clearance,
                position_error,
                arm.position_error,
                rotation_error,
                arm.rotation_error,
            ),
        )
    )


def state_message(state: HandState) -> bytes:
    """A measured state, for ``/state``."""
    parts = [
        pack_double(_STAMP, state.stamp),
        texts(2, tuple(state.names)),
        doubles(3, state.positions),
    ]
    if state.velocities is not None:
        parts.append(doubles(4, state.velocities))
    if state.actuators:
        parts.append(texts(5, tuple(state.actuators)))
    for number, values in ((6, state.currents), (7, state.temperatures), (8, state.touch)):
        if values is not None:
            parts.append(doubles(number, values))
    return b"".join(parts)


def config_message(configuration: str) -> bytes:
    """The configuration as JSON, for ``/config``."""
    return part(1, configuration.encode())


def _known(value: float | None) -> float:
    return math.nan if value is None else float(value)

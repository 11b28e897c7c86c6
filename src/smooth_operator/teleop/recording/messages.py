"""Values as the log's messages have them: JSON, in which what is not finite is null."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator.teleop.sinks.hand_state import HandState
from smooth_operator.teleop.sinks.tick import WristCommand
from smooth_operator.types import HandFrame

_MAX_LOG_TIME = 2**64 - 1


def hand_message(frame: HandFrame) -> dict[str, Any]:
    """A hand frame as a message of ``/hand``."""
    assert frame.valid is not None  # filled in by HandFrame
    message: dict[str, Any] = {
        "stamp": frame.stamp,
        "side": frame.side,
        "landmarks": points(frame.landmarks),
        "valid": frame.valid.tolist(),
    }
    if frame.metacarpals is not None:
        message["metacarpals"] = points(frame.metacarpals)
    if frame.orientations is not None:
        message["orientations"] = quaternions(frame.orientations)
    if frame.T_world_wrist is not None:
        message["wrist"] = pose(frame.T_world_wrist)
        if frame.world is not None:
            message["world"] = frame.world
    return message


def wrist_message(stamp: float, wrist: WristCommand) -> dict[str, Any]:
    """The commanded wrist as a message of ``/wrist``; ``stamp`` is that of the command [s]."""
    return {
        "stamp": stamp,
        "pose": pose(wrist.pose),
        "engaged": wrist.engaged,
        "valid": wrist.valid,
        "world": wrist.world,
    }


def pose(array: Float[np.ndarray, "7"]) -> dict[str, Any]:
    """A pose as an object of position and orientation."""
    return {
        "position": points(array[None, :3])[0],
        "orientation": quaternions(array[None, 3:])[0],
    }


def state_message(state: HandState) -> dict[str, Any]:
    """A measured state as a message of ``/state``."""
    message: dict[str, Any] = {
        "stamp": state.stamp,
        "names": state.names,
        "positions": numbers(state.positions),
    }
    for name in ("velocities", "currents", "temperatures", "touch"):
        values = getattr(state, name)
        if values is not None:
            message[name] = numbers(values)
    if state.actuators:
        message["actuators"] = state.actuators
    return message


def points(array: Float[np.ndarray, "N 3"]) -> list[dict[str, float | None]]:
    """Rows x, y, z as objects."""
    return [{"x": x, "y": y, "z": z} for x, y, z in _rows(array)]


def quaternions(array: Float[np.ndarray, "N 4"]) -> list[dict[str, float | None]]:
    """Rows w, x, y, z as objects."""
    return [{"w": w, "x": x, "y": y, "z": z} for w, x, y, z in _rows(array)]


def number(value: float | None) -> float | None:
    """A number, None where it is not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def numbers(array: Float[np.ndarray, " k"]) -> list[float | None]:
    """A row of numbers."""
    (row,) = _rows(array[None])
    return row


def nanoseconds(stamp: float) -> int:
    """A stamp as MCAP has it: whole, and none before zero; the message keeps it exactly."""
    return min(round(min(max(stamp * 1e9, 0.0), float(_MAX_LOG_TIME))), _MAX_LOG_TIME)


def _rows(array: Float[np.ndarray, "N K"]) -> list[list[float | None]]:
    rows: list[list[float | None]] = array.tolist()
    return rows if np.isfinite(array).all() else [[number(x) for x in row] for row in rows]

"""The wrists in a log, read back: the human one of frames, the commanded one of the robot hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator.formats.wrist_track import WristTrack


def decode_pose(pose: Any) -> Float[np.ndarray, "7"]:
    """The numbers of a pose; NaN where they are null.

    Raises:
        KeyError, TypeError, ValueError: a field is missing or wrong.
    """
    place, turn = pose["position"], pose["orientation"]
    # float64 makes NaN of None
    return np.array([*(place[k] for k in "xyz"), *(turn[k] for k in "wxyz")], np.float64)


def decode_wrist(message: dict[str, Any]) -> None:
    """Turn the pose of a message of ``/wrist`` into an array, in place.

    Raises:
        KeyError, TypeError, ValueError: a field is missing or wrong.
    """
    message["pose"] = decode_pose(message["pose"])
    if not (type(message["engaged"]) is type(message["valid"]) is bool):
        raise ValueError("engaged and valid must be true or false")
    _name(message["world"])


def world_wrists(messages: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """``T_world_wrist`` and ``world`` of a recording, from messages of ``/hand``.

    A recording has one world: frames whose wrist is in another than the first one's have none.
    """
    found = [message for message in messages if "wrist" in message]
    if not found:
        return {}
    world = found[0].get("world")
    if world is not None:
        _name(world)
    rows = np.full((len(messages), 7), np.nan)
    for row, message in zip(rows, messages, strict=True):
        if "wrist" in message and message.get("world") == world:
            row[:] = message["wrist"]
    return {"T_world_wrist": rows, "world": world}


def read_wrist_track(
    commands: Sequence[int], messages: Mapping[int, Mapping[str, Any]]
) -> WristTrack | None:
    """Put together what the messages of ``/wrist`` hold.

    Args:
        commands: sequence numbers of the commands.
        messages: sequence number -> message.

    Returns:
        None where there is no message.

    Raises:
        ValueError: the frame changes.
    """
    if not messages:
        return None
    worlds = {message["world"] for message in messages.values()}
    if len(worlds) > 1:
        raise ValueError(f"the frame of the commanded wrist changes: {sorted(worlds)}"[:200])
    found = [messages.get(number) for number in commands]
    nowhere = np.full(7, np.nan)
    return WristTrack(
        np.array([nowhere if m is None else m["pose"] for m in found]).reshape(-1, 7),
        np.array([m is not None and m["engaged"] for m in found], bool),
        np.array([m is not None and m["valid"] for m in found], bool),
        worlds.pop(),
    )


def _name(value: Any) -> None:
    if not isinstance(value, str):
        raise ValueError("the name of a world must be text")

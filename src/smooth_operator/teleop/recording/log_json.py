"""Messages of logs of versions 1 and 2, which are JSON: read, no longer written.

A point was an object ``{x, y, z}``, a stage of the loop ``{name, ms}``, and a number that is not
finite null. They become rows of the same columns as the messages of today.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from smooth_operator.errors import brief
from smooth_operator.io.documents import parse_json
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.teleop.recording.schemas import (
    ARM,
    COMMAND,
    CONFIG,
    HAND,
    LOOP,
    READ,
    STATE,
    STATUS,
    TIMING,
    WRIST,
)


def json_row(data: bytes, topic: str) -> tuple[tuple[Any, ...], int | None]:
    """A message as a row of its topic's table.

    Args:
        data: the message.
        topic: its topic, one of ``READ``.

    Returns:
        Its values, in the order of the fields; and the status of a command that has its own, as in
        version 1.

    Raises:
        DocumentError: it is not JSON.
        KeyError, TypeError, ValueError, OverflowError: a field is missing or wrong.
    """
    found = parse_json(data)
    if not isinstance(found, dict):
        raise ValueError(f"a message on {topic} is not an object")
    values: dict[str, Any] = _DECODE[topic](found)
    if "stamp" in READ[topic]:
        values["stamp"] = _number(found["stamp"], "stamp")
    own = found.get("status") if topic == COMMAND else None
    return (
        tuple(values.get(name, _ABSENT.get(name, b"")) for name in READ[topic]),
        None if own is None else _whole(own, "status"),
    )


_ABSENT: Final = {"world": ""}
"""What stands for a field that a message does not have; no numbers otherwise."""


def _hand(found: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {
        "side": _text(found["side"]),
        "landmarks": _points(found["landmarks"], "landmarks", NUM_LANDMARKS, "xyz"),
        "valid": _flags(found["valid"]),
    }
    for key, count, axes in (("metacarpals", 4, "xyz"), ("orientations", NUM_LANDMARKS, "wxyz")):
        if key in found:
            values[key] = _points(found[key], key, count, axes)
    if "wrist" in found:
        values["wrist"] = _pose(found["wrist"])
        if found.get("world") is not None:
            values["world"] = _text(found["world"])
    return values


def _command(found: Mapping[str, Any]) -> dict[str, Any]:
    names = _texts(found["names"])
    return {"names": names, "positions": _floats(found["positions"], "positions")}


def _status(found: Mapping[str, Any]) -> dict[str, Any]:
    return {"status": _whole(found["status"], "status")}


def _timing(found: Mapping[str, Any]) -> dict[str, Any]:
    stages = tuple((_text(at["name"]), _float(at["ms"])) for at in found["stages"])
    return {"latency_ms": _float(found["latency_ms"]), "stages": stages}


def _loop(found: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {
        key: _float(found.get(key))
        for key in ("time", "received", "tracker_stamp", "tracking_loss", "scale")
    }
    return {
        **values,
        "number": _whole(found["number"], "number"),
        "mode": _text(found["mode"]),
        "events": _texts(found["events"]),
    }


def _wrist(found: Mapping[str, Any]) -> dict[str, Any]:
    if not (type(found["engaged"]) is type(found["valid"]) is bool):
        raise ValueError("engaged and valid must be true or false")
    return {
        "pose": _pose(found["pose"]),
        "engaged": found["engaged"],
        "valid": found["valid"],
        "world": _text(found["world"]),
    }


def _arm(found: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {
        key: _floats(found[key], key) for key in ("positions", "measured") if key in found
    }
    return {
        **values,
        "name": _text(found["name"]),
        "names": _texts(found["names"]),
        "pose": _pose(found["pose"]),
    }


def _state(found: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {
        key: _floats(found[key], key) for key in ("positions", "currents", "touch") if key in found
    }
    return {
        **values,
        "names": _texts(found["names"]),
        "actuators": _texts(found.get("actuators", [])),
    }


def _config(found: Mapping[str, Any]) -> dict[str, Any]:
    return {"configuration": _text(found["configuration"])}


_DECODE: Final[dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]]] = {
    HAND: _hand,
    COMMAND: _command,
    STATUS: _status,
    TIMING: _timing,
    LOOP: _loop,
    WRIST: _wrist,
    ARM: _arm,
    STATE: _state,
    CONFIG: _config,
}


def _points(points: Any, key: str, count: int, axes: str) -> bytes:
    if len(points) != count:
        raise ValueError(f"{key} has {len(points)} points, not {count}")
    return _floats([p[a] for p in points for a in axes], key)


def _pose(pose: Any) -> bytes:
    place, turn = pose["position"], pose["orientation"]
    return _floats([*(place[k] for k in "xyz"), *(turn[k] for k in "wxyz")], "a pose")


def _floats(values: Any, key: str) -> bytes:
    row = np.array(values, "<f8")  # which makes NaN of None
    if row.ndim != 1:
        raise ValueError(f"{key} must be a list of numbers")
    return row.tobytes()


def _flags(valid: Any) -> bytes:
    if not isinstance(valid, list) or not {type(flag) for flag in valid} <= {bool}:
        raise ValueError(f"valid must be true or false for each landmark, not {brief(valid)}")
    return bytes(valid)


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{what} must be a number, not {brief(value)}")
    return float(value)


def _whole(value: Any, what: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{what} must be a whole number, not {brief(value)}")
    return value


def _float(value: Any) -> float:
    return math.nan if value is None else _number(value, "a time")


def _texts(values: Any) -> tuple[str, ...]:
    if not isinstance(values, list):
        raise ValueError(f"names must be a list of texts, not {brief(values)}")
    return tuple(map(_text, values))


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"a name must be text, not {brief(value)}")
    return value

"""The measured states of a robot hand in a log, read back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from smooth_operator.formats.states import StateTrajectory


def decode_state(message: dict[str, Any]) -> None:
    """Turn the lists of a message of ``/state`` into arrays and tuples, in place.

    Raises:
        KeyError, TypeError, ValueError: a field is missing or wrong.
    """
    for key in ("names", "actuators"):
        names = message["names"] if key == "names" else message.get(key, [])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError(f"{key} must be a list of texts")
        message[key] = tuple(names)
    for key in ("positions", "velocities", "currents", "temperatures", "touch"):
        if key in message or key == "positions":
            row = np.array(message[key], np.float64)  # which makes NaN of None
            if row.ndim != 1:
                raise ValueError(f"{key} must be a list of numbers")
            message[key] = row


def read_states(messages: Sequence[dict[str, Any]]) -> StateTrajectory | None:
    """Put together what the messages of a log hold.

    Returns:
        None where there is no message.

    Raises:
        KeyError, TypeError, ValueError: a field is missing or wrong, or the names change.
    """
    if not messages:
        return None
    first = messages[0]
    for key in ("names", "actuators"):
        if any(message[key] != first[key] for message in messages):
            raise ValueError(f"the {key} of measured joints change")

    def rows(key: str, width: int) -> np.ndarray | None:
        if not any(key in message for message in messages):
            return None
        found = np.full((len(messages), width), np.nan)
        for row, message in zip(found, messages, strict=True):
            if key in message:
                row[:] = message[key]
        return found

    touch = next((len(m["touch"]) for m in messages if "touch" in m), 0)
    positions = rows("positions", len(first["names"]))
    assert positions is not None  # every message has them
    return StateTrajectory(
        np.array([message["stamp"] for message in messages], np.float64),
        positions,
        first["names"],
        first["actuators"],
        rows("currents", len(first["actuators"])),
        rows("touch", touch),
    )

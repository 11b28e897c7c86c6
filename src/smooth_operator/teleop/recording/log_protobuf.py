"""Messages of a log in Protocol Buffers as rows of the tables of their topics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, Final

from smooth_operator.teleop.recording.mcap_library import DecodeError
from smooth_operator.teleop.recording.protobuf_types import readers
from smooth_operator.teleop.recording.schemas import (
    ARM,
    COMMAND,
    CONFIG,
    HAND,
    LOOP,
    READ,
    SCHEMAS,
    STATE,
    STATUS,
    TIMING,
    TYPES,
    WRIST,
)

_MOST_BYTES: Final = 1 << 20
"""Longest message that is read, the configuration left out; an usual one has 1 kB."""

_CLASSES: Final = readers(TYPES)


def protobuf_rows(messages: Sequence[bytes], topic: str) -> list[tuple[Any, ...]]:
    """Messages of a topic as rows of its table.

    Args:
        messages: encoded.
        topic: one of ``READ``.

    Raises:
        ValueError: they are damaged, or too long.
    """
    longest = max(map(len, messages), default=0)
    if longest > _MOST_BYTES and topic != CONFIG:
        raise ValueError(f"a message on {topic} has {longest} bytes, more than {_MOST_BYTES}")
    try:
        return list(map(_ROW[topic], map(_CLASSES[SCHEMAS[topic]].FromString, messages)))
    except DecodeError as error:
        raise ValueError(f"a message on {topic} is no {SCHEMAS[topic]}: {error}") from error


_LOOP: Final[Callable[[Any], tuple[Any, ...]]] = attrgetter(*READ[LOOP][:-1])
_ROW: Final[dict[str, Callable[[Any], tuple[Any, ...]]]] = {
    HAND: attrgetter(*READ[HAND]),
    COMMAND: lambda m: (m.stamp, tuple(m.names), m.positions),
    STATUS: lambda m: (m.status,),
    TIMING: lambda m: (m.latency_ms, [(stage.name, stage.ms) for stage in m.stages]),
    LOOP: lambda m: (*_LOOP(m), tuple(m.events)),
    STATE: lambda m: (
        *(m.stamp, tuple(m.names), m.positions),
        *(tuple(m.actuators), m.currents, m.touch),
    ),
    WRIST: attrgetter(*READ[WRIST]),
    ARM: lambda m: (m.name, tuple(m.names), m.positions, m.measured, m.pose),
    CONFIG: lambda m: (m.configuration,),
}

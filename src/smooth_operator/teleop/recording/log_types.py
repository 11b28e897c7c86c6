"""Topics of a log and the types of their messages, as Protocol Buffers.

The types stand in ``proto/*.proto``, their descriptors in ``proto/messages.binpb``. A number that
is not known is NaN, a list or text that is not known is empty; lists of points are flat.

Raises:
    MissingExtraError: on import, where a library of the extra ``teleop`` is missing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.errors import MissingExtraError

try:
    import lz4.frame as lz4_frame  # type: ignore[import-untyped]
    import zstandard as zstandard
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message import DecodeError as DecodeError
    from google.protobuf.message_factory import GetMessageClass
    from mcap import reader as mcap_reader
    from mcap import records as mcap_records
    from mcap import stream_reader as mcap_stream
    from mcap import writer as mcap_writer
    from mcap.exceptions import McapError as McapError
except ModuleNotFoundError as error:
    raise MissingExtraError("an MCAP log", "teleop") from error

__all__ = ["lz4_frame", "mcap_reader", "mcap_records", "mcap_stream", "mcap_writer"]

VERSION: Final = "3"
"""Version of the messages, in the metadata of every channel; raised when a reader must change."""

HAND: Final = "/hand"
COMMAND: Final = "/command"
STATUS: Final = "/status"
TIMING: Final = "/timing"
LOOP: Final = "/loop"
"""Only in logs of a live loop."""
STATE: Final = "/state"
"""Only in logs of a live loop whose hand is measured."""
ARM: Final = "/arm"
"""Only where an arm carries the robot hand."""
WRIST: Final = "/wrist"
"""Only where the wrist of the robot hand was commanded, too."""
CONFIG: Final = "/config"

HAND_SCENE: Final = "/foxglove/hand"
ROBOT_SCENE: Final = "/foxglove/robot"
JOINTS: Final = "/foxglove/joints"
FRAMES: Final = "/foxglove/frames"
HUMAN_WRIST: Final = "/foxglove/human_wrist"
WRIST_TARGET: Final = "/foxglove/wrist_target"
"""The wrist of the operator in the tracker's world, that of the robot hand in the robot's base."""

ORIGIN: Final = "smooth_operator.origin"
"""Name of the metadata record of the log's origin: ``name``, ``task``, ``meta``."""

METHOD: Final = "smooth_operator.method"
"""Name of the metadata records of the method from some time on: ``stamp`` of its first command,
``method``, ``preset``, ``config`` (JSON)."""

LIVE: Final = (ARM, LOOP, STATE, WRIST)
"""Topics that only the logs of a live loop have."""

OF_COMMANDS: Final = frozenset((TIMING, STATUS, LOOP, WRIST, ARM))
"""Topics with one message for a command at most, of the same number."""

SCHEMAS: Final = {
    topic: f"smooth_operator.{topic[1:].capitalize()}"
    for topic in (HAND, COMMAND, STATUS, TIMING, LOOP, STATE, WRIST, ARM, CONFIG)
}
"""Topic -> full name of its messages."""

FOXGLOVE: Final = {
    FRAMES: "foxglove.FrameTransforms",
    HAND_SCENE: "foxglove.SceneUpdate",
    ROBOT_SCENE: "foxglove.SceneUpdate",
    JOINTS: "foxglove.JointStates",
    HUMAN_WRIST: "foxglove.PoseInFrame",
    WRIST_TARGET: "foxglove.PoseInFrame",
}
"""The same for the topics that Foxglove draws. Nothing reads them back."""

_FILES: Final = FileDescriptorSet.FromString(
    files("smooth_operator.teleop.recording").joinpath("proto/messages.binpb").read_bytes()
)
_POOL: Final = DescriptorPool()  # not the common one, where another package may have Foxglove's
for _file in _FILES.file:
    _POOL.AddSerializedFile(_file.SerializeToString())


@cache
def message_class(name: str) -> Any:
    """The class of a message; ``name`` is its full name."""
    return GetMessageClass(_POOL.FindMessageTypeByName(name))


def schema_data(name: str) -> bytes:
    """The file that defines a message and those that it needs: a ``FileDescriptorSet``."""
    by_name = {file.name: file for file in _FILES.file}
    needed = [by_name[message_class(name).DESCRIPTOR.file.name]]
    for file in needed:  # which grows
        needed += [by_name[other] for other in file.dependency]
    return bytes(FileDescriptorSet(file=reversed(needed)).SerializeToString(deterministic=True))


@dataclass(frozen=True)
class LoopState:
    """The loop at one command.

    Attributes:
        number: number of the tick, counted from 0.
        mode: what the loop did, as ``tracking`` or ``holding``.
        time: when the command was ready, by the loop's clock [s].
        received: when the frame that it answers came in, by the loop's clock [s]; None where the
            command answers none.
        tracker_stamp: stamp of that frame by the tracker's own clock [s].
        session: which start of the tracker it belongs to.
        tracking_loss: loss of the frame; NaN where none is answered.
        scale: robot size over human size; NaN where none is answered.
        events: what happened, a sentence each.
    """

    number: int
    mode: str
    time: float
    received: float | None = None
    tracker_stamp: float | None = None
    session: int | None = None
    tracking_loss: float = math.nan
    scale: float = math.nan
    events: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class LoopTrack:
    """The loop over all commands of a log; T is their number.

    Attributes:
        numbers: (T,) numbers of the ticks; -1 where the log does not say.
        modes: (T,) what the loop did; empty where the log does not say.
        times: (T,) when each command was ready, by the loop's clock [s].
        received: (T,) when the frame that it answers came in [s]; NaN where it answers none.
        tracker_stamps: (T,) the frame's stamp by the tracker's own clock [s], or NaN.
        tracking_loss: (T,) loss of the frame, or NaN.
        scale: (T,) robot size over human size, or NaN.
        events: index of a command -> what happened at it.
    """

    numbers: Int[np.ndarray, " T"]
    modes: tuple[str, ...]
    times: Float[np.ndarray, " T"]
    received: Float[np.ndarray, " T"]
    tracker_stamps: Float[np.ndarray, " T"]
    tracking_loss: Float[np.ndarray, " T"]
    scale: Float[np.ndarray, " T"]
    events: Mapping[int, tuple[str, ...]]

    @property
    def answers(self) -> Bool[np.ndarray, " T"]:
        """(T,) true where the command answers a frame."""
        return np.asarray(np.isfinite(self.received))

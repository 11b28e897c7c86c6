"""Writes this project's own log, an MCAP file that grows chunk by chunk.

MCAP was chosen because it is append-only, supports many topics, opens in Foxglove, and can be read
from the front without its index, so that a crash leaves a readable recording.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Literal

import numpy as np

from smooth_operator.atomic_files import open_locked, output_error
from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.io.jsonable import to_json
from smooth_operator.teleop.recording.messages import (
    ARM,
    COMMAND,
    CONFIG,
    FOXGLOVE,
    HAND,
    LIVE,
    LOOP,
    METHOD,
    OF_COMMANDS,
    ORIGIN,
    SCHEMAS,
    STATE,
    STATUS,
    TIMING,
    VERSION,
    WRIST,
    FoxgloveMessages,
    Keypoints,
    LoopState,
    mcap_writer,
    message_class,
    schema_data,
)
from smooth_operator.teleop.sinks.tick import ArmCommand, HandState, WristCommand
from smooth_operator.types import HandFrame, JointCommand, Side, Status

_MAX_LOG_TIME: Final = 2**64 - 1
_COMPRESSIONS: Final = ("zstd", "lz4", "none")
_HEAD_BYTES: Final = 31
"""Size of a message in a chunk without its data [bytes]."""


class LogWriter:
    """A crash-safe log of hand frames, commands, their status and timing, and the configuration.

    Messages are collected in chunks. A chunk is passed to the operating system when it is full,
    when it is older than ``flush_seconds`` at the next write, on ``flush`` and on ``close``. After
    a crash, ``read_log`` reads every complete chunk.

    One log stores one hand and one robot. Use it as a context manager; it is not thread-safe.

    Attributes:
        path: the file.
        commands_flushed: number of commands in chunks that have reached the operating system.

    Args:
        path: the file; its folder must exist.
        overwrite: replace an existing file.
        compression: compression of each chunk.
        chunk_bytes: size of a chunk before compression, which bounds the memory.
        flush_seconds: longest time that a message waits for the disk while others arrive [s].
        keypoints: computes the robot's landmarks for Foxglove; None draws no robot.

    Raises:
        OutputError: there is no such folder, no permission or no space, or the file exists. After
            an error in writing, the log accepts no more messages; earlier ones stay readable.
        ConfigError: the compression is unknown, or a size or time is not positive.

    Example:
        >>> with LogWriter("session.mcap") as log:  # doctest: +SKIP
        ...     log.write_config({"method": "sbr"})
        ...     log.write_hand(frame)
        ...     log.write_command(command, Status.OK, latency_ms=0.8)
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        overwrite: bool = False,
        compression: Literal["zstd", "lz4", "none"] = "zstd",
        chunk_bytes: int = 64 * 1024,
        flush_seconds: float = 1.0,
        keypoints: Keypoints | None = None,
    ) -> None:
        if compression not in _COMPRESSIONS:
            raise ConfigError(f"compression must be zstd, lz4 or none, not {compression!r}")
        if not (chunk_bytes > 0 and flush_seconds > 0.0):
            raise ConfigError(
                "chunk_bytes and flush_seconds must be positive, "
                f"not {chunk_bytes} and {flush_seconds}"
            )
        self.path = Path(path)
        self.commands_flushed = 0
        self._whole_bytes = 0  # size of the file up to the last complete chunk
        self._chunk_bytes = chunk_bytes
        self._flush_seconds = flush_seconds
        self._waiting_since: float | None = None
        self._config: str | None = None
        self._config_written = False
        self._hand_stamp = -math.inf
        self._side: Side | None = None
        self._names: tuple[str, ...] | None = None
        self._sequence = dict.fromkeys((*SCHEMAS, *FOXGLOVE), 0)
        self._foxglove = FoxgloveMessages(keypoints)
        self._log_time = 0
        self._stream: IO[bytes] | None = None
        self._writer: Any = None
        self._pending = 0  # bytes of the messages that are in no chunk yet
        self._channels: dict[str, int] = {}
        self._classes = {topic: message_class(name) for topic, name in SCHEMAS.items()}
        with self._writing():
            self._stream = open_locked(self.path, overwrite)
            self._writer = mcap_writer.Writer(
                self._stream,
                chunk_size=sys.maxsize,  # only _end_chunk ends chunks
                compression=mcap_writer.CompressionType[compression.upper()],
            )
            self._writer.start("", "smooth-operator")
            self._schemas: dict[str, int] = {}
            for topic in SCHEMAS:
                if topic not in LIVE:
                    self._channel(topic)
            self._end_chunk()  # so that a process that is killed now leaves an empty log

    def write_hand(self, frame: HandFrame, stamp: float | None = None) -> None:
        """Appends a hand frame.

        Args:
            stamp: stamp in the log [s]; None for the stamp of the frame.

        Raises:
            RecordingError: the frame is of the other hand, or its stamp is missing, not finite or
                not later than the last one.
            OutputError: as for the class.
        """
        stamp = frame.time if stamp is None else stamp
        if not (math.isfinite(stamp) and stamp > self._hand_stamp):
            raise RecordingError(
                f"{self.path}: a hand frame with timestamp {stamp!r} s can't follow one with "
                f"{self._hand_stamp!r} s; timestamps must increase, so skip repeated frames"
            )
        if self._side not in (None, frame.side):
            raise RecordingError(
                f"{self.path}: this is the log of a {self._side} hand, but the frame is of a "
                f"{frame.side} hand; write each hand to its own log"
            )
        wrist = frame.T_world_wrist
        world = None if wrist is None else frame.world
        message = _message(self._classes[HAND], stamp, frame, wrist=wrist, world=world)
        at = _nanoseconds(stamp)
        self._append(at, (HAND, message), *self._foxglove.hand(frame, at))
        self._hand_stamp = stamp
        self._side = frame.side

    def write_command(
        self,
        command: JointCommand,
        status: Status,
        latency_ms: float,
        stages: Mapping[str, float] | None = None,
        loop: LoopState | None = None,
        wrist: WristCommand | None = None,
        arm: ArmCommand | None = None,
    ) -> None:
        """Appends a command and its timing.

        Args:
            latency_ms: time from landmarks to command [ms].
            stages: name of a stage -> its share of that time [ms].
            loop: state of the live loop, if any.
            wrist: command to the wrist, if any.
            arm: command to the arm that carries the hand, if any.

        Raises:
            RecordingError: the joints differ from those of the previous command, the number of
                positions differs from that of the joints, or the stamp is not finite.
            OutputError: as for the class.
        """
        positions = np.asarray(command.joint_positions, np.float64)
        names = tuple(command.joint_names)
        if positions.shape != (len(names),):
            raise RecordingError(
                f"{self.path}: a command needs one position for each of its {len(names)} joints, "
                f"not shape {positions.shape}"
            )
        if self._names not in (None, names):
            raise RecordingError(
                f"{self.path}: the joints of the command differ from those of the previous "
                f"command; write each robot hand to a separate log (were {self._names}, are "
                f"{names})"
            )
        stamp = float(command.stamp)
        if not math.isfinite(stamp):
            raise RecordingError(
                f"{self.path}: the timestamp of a command must be finite, not {stamp}"
            )
        # The command comes last, so that it has its timing and status even in a truncated log.
        new = self._classes
        status = Status(status)
        messages = [
            (TIMING, _timing(new[TIMING], stamp, latency_ms, stages or {})),
            (STATUS, new[STATUS](stamp=stamp, status=int(status), reason=status.reason)),
        ]
        if loop is not None:
            times = {name: _or_nan(getattr(loop, name)) for name in ("received", "tracker_stamp")}
            messages.append((LOOP, _message(new[LOOP], stamp, loop, **times)))
        if wrist is not None:
            messages.append((WRIST, _message(new[WRIST], stamp, wrist)))
        if arm is not None:
            rows = {"names": arm.joint_names, "velocities": arm.velocity}
            messages.append((ARM, _message(new[ARM], stamp, arm, **rows)))
        message = new[COMMAND](stamp=stamp, names=names, positions=positions.tolist())
        messages.append((COMMAND, message))
        at = _nanoseconds(stamp)
        self._append(at, *messages)
        self._names = names
        if wrist is not None:
            self._append(at, *self._foxglove.wrist(wrist, at))
        self._append(at, *self._foxglove.command(names, positions, at))

    def write_state(self, state: HandState) -> None:
        """Appends a measured state of the robot hand.

        Raises:
            OutputError: as for the class.
        """
        levels, newtons = (
            (None, None) if state.contact is None else (state.contact.levels, state.contact.newtons)
        )
        kind = self._classes[STATE]
        message = _message(kind, state.stamp, state, contact=levels, newtons=newtons)
        self._append(_nanoseconds(state.stamp), (STATE, message))

    def write_config(self, config: Mapping[str, Any]) -> None:
        """Appends the resolved configuration; allowed once.

        It gets the time of the first frame, at which the time line of viewers begins.

        Raises:
            ConfigError: it was already written, or can't be written as JSON.
            OutputError: as for the class.
        """
        if self._config is not None or self._config_written:
            raise ConfigError(f"{self.path}: the log already has its configuration")
        self._config = to_json(dict(config))
        if any(self._sequence.values()):
            with self._writing():
                self._add_config()

    def write_origin(self, origin: Mapping[str, str]) -> None:
        """Appends a metadata record that states where the log came from.

        Args:
            origin: texts by name; ``smooth-operator convert`` writes ``name``, ``task`` and
                ``meta`` (JSON).

        Raises:
            OutputError: as for the class.
        """
        self._metadata(ORIGIN, origin)

    def write_method(self, stamp: float, method: str, preset: str, config: Any) -> None:
        """Appends a metadata record about the method that drives the hand from now on.

        Args:
            stamp: stamp of its first command [s].

        Raises:
            ConfigError: the configuration can't be written as JSON.
            OutputError: as for the class.
        """
        self._metadata(
            METHOD,
            {
                "stamp": repr(float(stamp)),
                "method": method,
                "preset": preset,
                "config": to_json(config),
            },
        )

    def flush(self, *, sync: bool = False) -> None:
        """Passes all messages so far to the operating system, as a separate chunk.

        Args:
            sync: also wait until they are on the disk and survive a power cut; takes milliseconds.

        Raises:
            OutputError: as for the class.
        """
        with self._writing():
            self._end_chunk(sync=sync)

    def close(self) -> None:
        """Writes pending messages and the index, and closes the file; a second call does nothing.

        Raises:
            OutputError: as for the class.
        """
        if self._stream is None:
            return
        with self._writing():
            self._add_config()  # if there was no frame
            self._end_chunk()
            self._writer.finish()
            self._stream.flush()
            os.fsync(self._stream.fileno())
            stream, self._stream = self._stream, None
            stream.close()

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        # An error in closing must not hide the error of the block.
        with contextlib.suppress(OutputError) if error else contextlib.nullcontext():
            self.close()

    def _metadata(self, name: str, texts: Mapping[str, str]) -> None:
        with self._writing():
            self._end_chunk()
            self._writer.add_metadata(name, texts)
            self._end_chunk()

    def _append(self, at: int, *messages: tuple[str, Any]) -> None:
        """Add messages to the chunk, with a time [ns]."""
        if self._stream is None:
            self._check_open()
        self._log_time = at
        if self._config is not None:
            self._add_config()
        self._add(at, *((topic, message.SerializeToString()) for topic, message in messages))
        now = time.monotonic()
        if self._waiting_since is None:
            self._waiting_since = now
        late = now - self._waiting_since >= self._flush_seconds
        if late or self._pending >= self._chunk_bytes:
            with self._writing():
                self._end_chunk()

    def _add(self, at: int, *messages: tuple[str, bytes]) -> None:
        sequence = self._sequence
        command = sequence[COMMAND]
        for topic, data in messages:
            channel = self._channels.get(topic) or self._channel(topic)
            # The reader joins a command and its status, timing, ... by their number.
            number = command if topic in OF_COMMANDS else sequence[topic]
            self._writer.add_message(channel, at, data, at, number)
            self._pending += _HEAD_BYTES + len(data)
            sequence[topic] += 1

    def _add_config(self) -> None:
        if self._config is not None:
            message = self._classes[CONFIG](configuration=self._config)
            self._config, self._config_written = None, True
            self._add(self._log_time, (CONFIG, message.SerializeToString()))

    def _end_chunk(self, *, sync: bool = False) -> None:
        assert self._stream is not None
        self._writer.flush()
        self._pending = 0
        if sync:
            os.fsync(self._stream.fileno())
        self._waiting_since = None
        self.commands_flushed = self._sequence[COMMAND]
        self._whole_bytes = self._stream.tell()

    def _channel(self, topic: str) -> int:
        """Register a topic, and return its channel."""
        name = SCHEMAS.get(topic) or FOXGLOVE[topic]
        if name not in self._schemas:
            data = schema_data(name)
            self._schemas[name] = self._writer.register_schema(name, "protobuf", data)
        channel: int = self._writer.register_channel(
            topic, "protobuf", self._schemas[name], {"version": VERSION}
        )
        self._channels[topic] = channel
        return channel

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn an error of the operating system into an OutputError, and close the file."""
        self._check_open()
        try:
            yield
        except OSError as error:
            stream, self._stream = self._stream, None
            if stream is not None:
                _close_at(stream, self._whole_bytes)
            raise output_error(self.path, error) from error

    def _check_open(self) -> None:
        if self._writer is not None and self._stream is None:
            raise OutputError(
                f"can't write {str(self.path)!r}: the log is closed, or writing has stopped after "
                "an error; open a new log"
            )


def _nanoseconds(stamp: float) -> int:
    """Time for MCAP: whole nanoseconds, not below zero. The message contains the exact stamp."""
    return min(round(min(max(stamp * 1e9, 0.0), float(_MAX_LOG_TIME))), _MAX_LOG_TIME)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _timing(new: Any, stamp: float, latency_ms: float | None, stages: Mapping[str, Any]) -> Any:
    message = new(stamp=stamp, latency_ms=_or_nan(latency_ms))
    for name, ms in stages.items():
        message.stages.add(name=name, ms=_or_nan(ms))
    return message


def _message(kind: Any, stamp: float, values: object, **other: Any) -> Any:
    """Message with the attributes of an object, or ``other`` values; arrays become flat lists."""
    fields: dict[str, Any] = {}
    for name in _names(kind):
        value = other[name] if name in other else getattr(values, name, None)
        if value is not None:
            fields[name] = value.ravel().tolist() if isinstance(value, np.ndarray) else value
    return kind(**{**fields, "stamp": stamp})


@functools.cache
def _names(kind: Any) -> tuple[str, ...]:
    return tuple(kind.DESCRIPTOR.fields_by_name)


def _close_at(stream: IO[bytes], size: int) -> None:
    """Close a file after an error, and truncate it to a size."""
    with contextlib.suppress(OSError):
        file = os.dup(stream.fileno())
        try:
            with contextlib.suppress(OSError):
                stream.close()
            os.ftruncate(file, size)
        finally:
            os.close(file)

"""Writing the project's own log: an MCAP file that grows chunk by chunk.

MCAP was chosen because it is append-only, keeps many topics, opens in Foxglove, and can be read
from the front without its index; so what a crash leaves is a recording and not debris.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal

import numpy as np

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.io.jsonable import to_json
from smooth_operator.teleop.recording import foxglove
from smooth_operator.teleop.recording import messages as as_json
from smooth_operator.teleop.recording.log_arms import arm_message
from smooth_operator.teleop.recording.loop_state import LoopState
from smooth_operator.teleop.recording.mcap_library import (
    CompressionType,
    MessageEncoding,
    SchemaEncoding,
    Writer,
)
from smooth_operator.teleop.recording.schemas import (
    ARM,
    COMMAND,
    CONFIG,
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
)
from smooth_operator.teleop.sinks.hand_state import HandState
from smooth_operator.teleop.sinks.tick import ArmCommand, WristCommand
from smooth_operator.types import HandFrame, JointCommand, Side, Status

_COMPRESSION = {kind.name.lower(): kind for kind in CompressionType}
_ENCODER = json.JSONEncoder(allow_nan=False, separators=(",", ":"))
_UNLIMITED = 2**62  # chunks are ended here, not by the MCAP writer, so that each reaches the disk


class LogWriter:
    """A crash-safe log of hand frames, commands, their status and timing, and the configuration.

    Messages are gathered into chunks; a chunk goes to the operating system when it is full, when it
    is older than ``flush_seconds`` at the next write, on ``flush`` and on ``close``. If the
    process dies, ``read_log`` reads every chunk that was ended.

    One log holds one hand and one robot. Use as a context manager; not thread-safe.

    Attributes:
        path: the file.
        commands_flushed: commands in the chunks that have reached the operating system.

    Args:
        path: where to write; the folder must exist.
        overwrite: replace a file that stands there.
        compression: of each chunk.
        chunk_bytes: size of a chunk before compression, and so the bound on what is in memory.
        flush_seconds: how long a message may wait for the disk while others come.
        keypoints: where the robot's landmarks are, to be drawn by Foxglove; None draws none.

    Raises:
        OutputError: no folder, no permission, no space, or a file stands there already. After an
            error in writing the log takes no more; what was written before stays readable.
        ConfigError: an unknown compression, or a size or time that is not positive.

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
        keypoints: foxglove.Keypoints | None = None,
    ) -> None:
        if compression not in _COMPRESSION:
            raise ConfigError(f"compression must be zstd, lz4 or none, not {compression!r}")
        if not (chunk_bytes > 0 and flush_seconds > 0.0):
            raise ConfigError(
                "chunk_bytes and flush_seconds must be positive, "
                f"not {chunk_bytes} and {flush_seconds}"
            )
        self.path = Path(path)
        self.commands_flushed = 0
        self._whole_bytes = 0  # the file up to the last chunk that was written
        self._chunk_bytes = chunk_bytes
        self._flush_seconds = flush_seconds
        self._pending_bytes, self._pending_since = 0, 0.0
        self._config: str | None = None
        self._config_written = False
        self._hand_stamp = -math.inf
        self._side: Side | None = None
        self._names: tuple[str, ...] | None = None
        self._sequence = dict.fromkeys((*SCHEMAS, *foxglove.SCHEMAS), 0)
        self._foxglove = foxglove.FoxgloveMessages(keypoints)
        self._log_time = 0
        self._stream: IO[bytes] | None = None
        # mcap's signatures are only partly annotated
        self._writer: Any = None
        self._channels: dict[str, int] = {}
        with self._writing():
            self._stream = self.path.open("wb" if overwrite else "xb")
            self._writer = Writer(
                self._stream, chunk_size=_UNLIMITED, compression=_COMPRESSION[compression]
            )
            self._writer.start(library="smooth-operator")
            for topic in SCHEMAS:
                if topic not in LIVE:
                    self._register(topic)
            self._end_chunk()  # a log that is killed now is an empty log, not an empty file

    def write_hand(self, frame: HandFrame) -> None:
        """Append a hand frame.

        Raises:
            RecordingError: it has no stamp, or one that is not finite or not after the last one's,
                or it is of the other hand.
            OutputError: as for the class.
        """
        if not (math.isfinite(frame.time) and frame.time > self._hand_stamp):
            raise RecordingError(
                f"{self.path}: a hand frame with stamp {frame.stamp!r} s can't follow one with "
                f"{self._hand_stamp!r} s; stamps must increase, so skip frames that repeat"
            )
        if self._side not in (None, frame.side):
            raise RecordingError(
                f"{self.path}: this is the log of a {self._side} hand, the frame is of a "
                f"{frame.side} one; write each hand to its own log"
            )
        shown = self._foxglove.hand(frame, as_json.nanoseconds(frame.time))
        self._append((HAND, as_json.hand_message(frame)), *shown)
        self._hand_stamp = frame.time
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
        """Append a command and how long it took.

        Args:
            command: what was sent.
            status: why it is what it is.
            latency_ms: from landmarks to command [ms].
            stages: parts of that time [ms] by name.
            loop: what the live loop did, where one sent it.
            wrist: where the wrist of the hand was sent with it, if it was.
            arm: where the arm that carries it was sent, if there is one.

        Raises:
            RecordingError: the joints differ from those of the command before, their number from
                that of the positions, or the stamp is not finite.
            OutputError: as for the class.
        """
        positions = np.asarray(command.positions, np.float64)
        names = tuple(command.names)
        if positions.shape != (len(names),):
            raise RecordingError(
                f"{self.path}: a command needs one position for each of its {len(names)} joints, "
                f"not shape {positions.shape}"
            )
        if self._names not in (None, names):
            raise RecordingError(
                f"{self.path}: the joints of the command are not those of the one before; write "
                f"each robot hand to its own log (were {self._names}, are {names})"
            )
        stamp = float(command.stamp)
        if not math.isfinite(stamp):
            raise RecordingError(f"{self.path}: the stamp of a command must be finite, not {stamp}")
        parts = [{"name": k, "ms": as_json.number(v)} for k, v in (stages or {}).items()]
        timing = {"stamp": stamp, "latency_ms": as_json.number(latency_ms), "stages": parts}
        why = {"stamp": stamp, "status": int(status), "reason": Status(status).reason}
        # The command last, so that in a log that is cut off it never lacks its timing and status.
        records: list[tuple[str, dict[str, Any]]] = [(TIMING, timing), (STATUS, why)]
        if loop is not None:
            records.append((LOOP, loop.message(stamp)))
        if wrist is not None:
            records.append((WRIST, as_json.wrist_message(stamp, wrist)))
            records += self._foxglove.wrist(wrist, as_json.nanoseconds(stamp))
        if arm is not None:
            records.append((ARM, arm_message(stamp, arm)))
        records += self._foxglove.command(names, positions, as_json.nanoseconds(stamp))
        message = {"stamp": stamp, "names": names, "positions": as_json.numbers(positions)}
        self._append(*records, (COMMAND, message))
        self._names = names

    def write_state(self, state: HandState) -> None:
        """Append where the robot hand was measured to be.

        Raises:
            OutputError: as for the class.
        """
        self._append((STATE, as_json.state_message(state)))

    def write_config(self, config: Mapping[str, Any]) -> None:
        """Append the resolved configuration, once.

        It takes the time of the first frame that follows (or came before), since viewers draw the
        time line from the first message on.

        Raises:
            ConfigError: it was written already, or holds what JSON can't.
            OutputError: as for the class.
        """
        if self._config is not None or self._config_written:
            raise ConfigError(f"{self.path}: the log already has its configuration")
        self._config = to_json(dict(config))
        if any(self._sequence.values()):
            self._append()

    def write_origin(self, origin: Mapping[str, str]) -> None:
        """Append where the log came from, as a metadata record.

        Args:
            origin: texts by name; ``name``, ``task`` and ``meta`` (JSON) are those that
                ``smooth-operator convert`` writes.

        Raises:
            OutputError: as for the class.
        """
        self._metadata(ORIGIN, origin)

    def write_method(self, stamp: float, method: str, preset: str, config: Any) -> None:
        """Append what drives the hand from now on, as a metadata record.

        Args:
            stamp: of the first command that it gives [s].
            method: its name.
            preset: that of its preset.
            config: its configuration.

        Raises:
            ConfigError: the configuration holds what JSON can't.
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
        """Hand everything written so far to the operating system, as a separate chunk.

        Args:
            sync: also wait until it is on the disk, against a power cut (milliseconds).

        Raises:
            OutputError: as for the class.
        """
        with self._writing():
            self._end_chunk(sync=sync)

    def close(self) -> None:
        """Write what is pending and the index, and close the file. A second call does nothing.

        Raises:
            OutputError: as for the class.
        """
        if self._stream is None:
            return
        with self._writing():
            if self._config is not None:  # no frame ever came
                self._message(CONFIG, {"configuration": self._config})
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
        # An error on the way out must not hide the one that led here.
        with contextlib.suppress(OutputError) if error else contextlib.nullcontext():
            self.close()

    def _metadata(self, name: str, texts: Mapping[str, str]) -> None:
        with self._writing():
            self._writer.add_metadata(name, dict(texts))
            self._pending_bytes = 0

    def _append(self, *messages: tuple[str, dict[str, Any]]) -> None:
        with self._writing():
            now = time.monotonic()
            if not self._pending_bytes:
                self._pending_since = now
            if messages:
                self._log_time = as_json.nanoseconds(messages[0][1]["stamp"])
            if self._config is not None:
                self._message(CONFIG, {"configuration": self._config})
                self._config, self._config_written = None, True
            for topic, message in messages:
                self._message(topic, message)
            if (
                self._pending_bytes >= self._chunk_bytes
                or now - self._pending_since >= self._flush_seconds
            ):
                self._end_chunk()

    def _end_chunk(self, *, sync: bool = False) -> None:
        assert self._stream is not None
        self._writer.flush()
        if sync:
            os.fsync(self._stream.fileno())
        self._pending_bytes = 0
        self.commands_flushed = self._sequence[COMMAND]
        self._whole_bytes = self._stream.tell()

    def _message(self, topic: str, message: dict[str, Any]) -> None:
        data = _ENCODER.encode(message).encode()
        if topic not in self._channels:
            self._register(topic)
        # What is said of a command has its number, by which the reader joins them.
        number = self._sequence[COMMAND if topic in OF_COMMANDS else topic]
        self._writer.add_message(
            self._channels[topic], self._log_time, data, self._log_time, number
        )
        self._sequence[topic] += 1
        self._pending_bytes += len(data)

    def _register(self, topic: str) -> None:
        name, schema = (SCHEMAS | foxglove.SCHEMAS)[topic]
        schema_id = self._writer.register_schema(
            name, SchemaEncoding.JSONSchema, json.dumps(schema).encode()
        )
        self._channels[topic] = self._writer.register_channel(
            topic, MessageEncoding.JSON, schema_id, {"version": VERSION}
        )

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn what the operating system says into an OutputError, and give the file up."""
        if self._writer is not None and self._stream is None:
            raise OutputError(
                f"can't write {str(self.path)!r}: the log is closed, or gave up on an error; "
                "open a new one"
            )
        try:
            yield
        except OSError as error:
            stream, self._stream = self._stream, None
            if stream is not None:
                self._give_up(stream)
            raise output_error(self.path, error) from error

    def _give_up(self, stream: IO[bytes]) -> None:
        """Close the file without the chunk that is written in part."""
        with contextlib.suppress(OSError):
            file = os.dup(stream.fileno())
            try:
                with contextlib.suppress(OSError):
                    stream.close()
                os.ftruncate(file, self._whole_bytes)
            finally:
                os.close(file)

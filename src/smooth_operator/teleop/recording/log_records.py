"""The records of an MCAP file, read in order and within bounds.

The MCAP library unpacks a chunk to whatever size its bytes give, and takes a chunk that was cut in
its middle for a whole one. So the framing of records and the chunks are read here; the library
reads the records within.
"""

from __future__ import annotations

import importlib
import io
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, NamedTuple, TypeAlias

from smooth_operator.errors import RecordingError, brief
from smooth_operator.formats.bounds import LOG_RATIO, Allowance
from smooth_operator.formats.registry import MCAP_MAGIC
from smooth_operator.teleop.recording.mcap_library import (
    Channel,
    McapError,
    Metadata,
    Opcode,
    ReadDataStream,
    Statistics,
    zstandard,
)

_HEAD: Final = struct.Struct("<BQ")  # opcode, length
_CHUNK: Final = struct.Struct("<QQQII")  # times, unpacked size, checksum, length of a name
_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence number, times
_FOOTER: Final = struct.Struct("<QQI")  # where the summary starts, and more
_END: Final = _HEAD.size + _FOOTER.size + len(MCAP_MAGIC)

# What cut-off or damaged bytes raise on their way through the MCAP library and the decompressors
# (lz4 raises RuntimeError; a wrong checksum and bad UTF-8 are ValueErrors).
_DAMAGE: Final = (
    McapError,
    struct.error,
    ValueError,
    EOFError,
    RuntimeError,
    MemoryError,
    zlib.error,
    zstandard.ZstdError,
)


class DamagedError(Exception):
    """The bytes end, or make no sense, from here on."""


class LogMessage(NamedTuple):
    """A message, in whatever encoding its channel has."""

    channel: int
    sequence: int
    data: bytes


Record: TypeAlias = Channel | Metadata | LogMessage


@dataclass(frozen=True)
class Summary:
    """What stands at the end of a log that was closed.

    Attributes:
        topics: of the channels, by number.
        counts: messages of the channels; None where the file does not say.
    """

    topics: Mapping[int, str]
    counts: Mapping[int, int] | None


def read_records(path: Path) -> Iterator[Record]:
    """The channels, metadata and messages of a log, in order.

    Raises:
        RecordingError: a chunk's compression is not known here, or it unpacks to more than a file
            of this size may.
        DamagedError: where the records stop before their end.
        OSError: the file can't be read.
    """
    size = path.stat().st_size
    allowance = Allowance.of(path, size, LOG_RATIO)
    unpacked = 0
    with path.open("rb") as stream:
        if stream.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            raise DamagedError
        for opcode, body in _framed(stream, size):
            if opcode != Opcode.CHUNK:
                yield from _parsed(opcode, body)
                continue
            chunk = _Chunk.of(body)
            unpacked += chunk.stated_size
            allowance.take("its chunks", unpacked)
            data = io.BytesIO(chunk.unpacked(path))
            for inner, content in _framed(data, chunk.size, footer=False):
                yield from _parsed(inner, content)


def read_summary(path: Path) -> Summary | None:
    """The summary of a log; None where it was cut off or has none.

    Raises:
        OSError: the file can't be read.
    """
    size = path.stat().st_size
    topics: dict[int, str] = {}
    counts: Mapping[int, int] | None = None
    try:
        with path.open("rb") as stream:
            stream.seek(max(size - _END, 0))
            opcode, _ = _HEAD.unpack(stream.read(_HEAD.size))
            start, _, _ = _FOOTER.unpack(stream.read(_FOOTER.size))
            if opcode != Opcode.FOOTER or not len(MCAP_MAGIC) <= start < size:
                return None
            stream.seek(start)
            for opcode, body in _framed(stream, size):
                if opcode == Opcode.STATISTICS:
                    statistics = _read(Statistics.read, body)
                    counts = statistics.channel_message_counts
                for record in _parsed(opcode, body) if opcode == Opcode.CHANNEL else ():
                    if isinstance(record, Channel):
                        topics[record.id] = record.topic
    except (DamagedError, struct.error):
        return None
    return Summary(topics, counts)


def _framed(stream: IO[bytes], size: int, *, footer: bool = True) -> Iterator[tuple[int, bytes]]:
    """(opcode, content) of the records from here on, empty for those that are not wanted.

    Args:
        stream: the file, or what a chunk unpacks to.
        size: its size, which no record exceeds: a damaged length can't ask for the memory.
        footer: whether a footer ends it; otherwise its own end does.
    """
    at = stream.tell()
    while footer or at < size:
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise DamagedError
        opcode, length = _HEAD.unpack(head)
        at += len(head) + length
        if at > size:
            raise DamagedError
        if opcode in _READ:
            yield opcode, stream.read(length)
        else:
            stream.seek(at)
        if footer and opcode == Opcode.FOOTER:
            if stream.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise DamagedError
            return


_READ: Final = {Opcode.CHANNEL, Opcode.METADATA, Opcode.MESSAGE, Opcode.CHUNK, Opcode.STATISTICS}


def _parsed(opcode: int, body: bytes) -> Iterator[Record]:
    if opcode == Opcode.MESSAGE:
        if len(body) < _MESSAGE.size:
            raise DamagedError
        channel, sequence, _, _ = _MESSAGE.unpack_from(body)
        yield LogMessage(channel, sequence, body[_MESSAGE.size :])
    elif opcode == Opcode.CHANNEL:
        yield _read(Channel.read, body)
    elif opcode == Opcode.METADATA:
        yield _read(Metadata.read, body)


def _read(parse: Callable[[ReadDataStream], Any], body: bytes) -> Any:
    try:
        return parse(ReadDataStream(io.BytesIO(body)))
    except _DAMAGE as error:
        raise DamagedError from error


@dataclass(frozen=True)
class _Chunk:
    """A chunk that is still packed."""

    size: int
    checksum: int
    compression: str
    data: bytes

    @classmethod
    def of(cls, body: bytes) -> _Chunk:
        if len(body) < _CHUNK.size:
            raise DamagedError
        _, _, size, checksum, length = _CHUNK.unpack_from(body)
        name = body[_CHUNK.size : _CHUNK.size + length]
        at = _CHUNK.size + length + 8
        if at > len(body) or int.from_bytes(body[at - 8 : at], "little") != len(body) - at:
            raise DamagedError
        return cls(size, checksum, name.decode("utf-8", "replace"), body[at:])

    @property
    def stated_size(self) -> int:
        """What it says that it unpacks to; its Zstandard frame may say more [bytes]."""
        if self.compression != "zstd":
            return max(self.size, len(self.data) if not self.compression else 0)
        try:
            return max(self.size, zstandard.frame_content_size(self.data))
        except zstandard.ZstdError as error:
            raise DamagedError from error

    def unpacked(self, path: Path) -> bytes:
        try:
            if self.compression == "zstd":
                data = zstandard.decompress(self.data, max_output_size=self.size)
            elif self.compression == "lz4":
                # One byte more than it should be: if that comes, the chunk is larger than it says.
                data = _lz4(path).decompress(self.data, max_length=self.size + 1)
            elif not self.compression:
                data = self.data
            else:
                raise RecordingError(
                    f"{path}: the log's compression {brief(self.compression)} is not read here; "
                    "write it with zstd, lz4 or none"
                )
        except RecordingError:
            raise
        except _DAMAGE as error:
            raise DamagedError from error
        if len(data) != self.size or (self.checksum and zlib.crc32(data) != self.checksum):
            raise DamagedError
        return data


def _lz4(path: Path) -> Any:
    try:  # by name, since it comes without types; the MCAP library brings it
        frames = importlib.import_module("lz4.frame")
    except ImportError:
        raise RecordingError(
            f"{path}: the log is compressed with lz4; install that: python -m pip install lz4"
        ) from None
    return frames.LZ4FrameDecompressor()

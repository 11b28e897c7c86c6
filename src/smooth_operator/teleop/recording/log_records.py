"""The records of an MCAP file, read in order and within bounds.

The MCAP library unpacks a chunk to whatever size its bytes give, and takes a chunk that was cut in
its middle for a whole one. So the framing of records and the chunks are read here; the library
reads the records within.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Container, Iterator, Mapping
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
    lz4_frames,
    zstandard,
)

_HEAD: Final = struct.Struct("<BQ")  # opcode, length
_CHUNK: Final = struct.Struct("<QQQII")  # times, unpacked size, checksum, length of a name
_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence number, times
_OF_MESSAGE: Final = struct.Struct("<HI")  # channel, sequence number
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


class LogMessages(NamedTuple):
    """Messages of one channel that follow each other in a chunk, in whatever encoding it has."""

    channel: int
    numbers: list[int]
    data: list[bytes]


Record: TypeAlias = Channel | Metadata | LogMessages


@dataclass(frozen=True)
class Summary:
    """What stands at the end of a log that was closed.

    Attributes:
        topics: of the channels, by number.
        counts: messages of the channels; None where the file does not say.
    """

    topics: Mapping[int, str]
    counts: Mapping[int, int] | None


def read_records(path: Path, wanted: Container[int]) -> Iterator[Record]:
    """The channels, metadata and messages of a log, in order.

    Args:
        path: the log.
        wanted: numbers of the channels whose messages are taken; looked up on the way, so that
            the caller decides when it gets a channel.

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
            yield from _inner(chunk.unpacked(path), wanted)


def _inner(data: bytes, wanted: Container[int]) -> Iterator[Record]:
    """The records of a chunk, messages of one channel together."""
    at, size = 0, len(data)
    groups: dict[int, LogMessages] = {}
    while at < size:
        whole = at + _HEAD.size <= size
        opcode, length = _HEAD.unpack_from(data, at) if whole else (0, 0)
        start = at + _HEAD.size
        at = start + length
        if not whole or at > size or (opcode == Opcode.MESSAGE and length < _MESSAGE.size):
            yield from groups.values()
            raise DamagedError
        if opcode == Opcode.MESSAGE:
            channel, number = _OF_MESSAGE.unpack_from(data, start)
            if channel in wanted:
                group = groups.get(channel)
                if group is None:
                    group = groups[channel] = LogMessages(channel, [], [])
                group.numbers.append(number)
                group.data.append(data[start + _MESSAGE.size : at])
        elif opcode in _READ:
            yield from groups.values()  # a channel may change what its messages are
            groups = {}
            yield from _parsed(opcode, data[start:at])
    yield from groups.values()


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


def _framed(stream: IO[bytes], size: int) -> Iterator[tuple[int, bytes]]:
    """(opcode, content) of the records that are read, from here to the footer.

    Args:
        stream: the file.
        size: its size, which no record exceeds: a damaged length can't ask for the memory.
    """
    at = stream.tell()
    while True:
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
        if opcode == Opcode.FOOTER:
            if stream.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise DamagedError
            return


_READ: Final = {Opcode.CHANNEL, Opcode.METADATA, Opcode.MESSAGE, Opcode.CHUNK, Opcode.STATISTICS}


def _parsed(opcode: int, body: bytes) -> Iterator[Record]:
    if opcode == Opcode.MESSAGE:
        if len(body) < _MESSAGE.size:
            raise DamagedError
        channel, number = _OF_MESSAGE.unpack_from(body)
        yield LogMessages(channel, [number], [body[_MESSAGE.size :]])
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
                unpacker = lz4_frames.LZ4FrameDecompressor()
                data = unpacker.decompress(self.data, max_length=self.size + 1)
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

"""Writing an MCAP file whose messages come many times a second.

The MCAP library's writer makes an object of each message and takes several times as long as the
rest of a log. Messages are therefore framed here; all other records are the library's.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import IO, Any, Final

import numpy as np

from smooth_operator.formats.registry import MCAP_MAGIC
from smooth_operator.teleop.recording.mcap_library import (
    Channel,
    Metadata,
    Opcode,
    RecordBuilder,
    Schema,
    Statistics,
    lz4_frames,
    records,
    zstandard,
)

COMPRESSIONS: Final = ("zstd", "lz4", "none")

_MESSAGE: Final = struct.Struct("<BQHIQQ")  # opcode, length; channel, number, two times
_IS_MESSAGE: Final = int(Opcode.MESSAGE)
_MESSAGE_HEAD: Final = 22  # [bytes] of a message that are not its data
_IS_INDEX: Final = int(Opcode.MESSAGE_INDEX)
_INDEX: Final = struct.Struct("<BQHI")  # opcode, length; channel, bytes of pairs
_FOOTER: Final = struct.Struct("<BQQQ")
_LEVEL: Final = 1
"""Of Zstandard: noisy numbers get no smaller at higher ones."""


class OpenChannel:
    """A channel of a file that is being written.

    Attributes:
        number: of the channel.
        count: its messages in the chunks that were ended.
        index: time [ns] and place of each of its messages in the chunk that is being gathered.
    """

    __slots__ = ("count", "index", "number")

    def __init__(self, number: int) -> None:
        self.number, self.count = number, 0
        self.index: list[int] = []


class McapWriter:
    """Writes schemas, channels, chunks of messages, metadata and the summary.

    Args:
        stream: where to; nothing was written to it.
        compression: of the chunks, one of ``COMPRESSIONS``.
        library: what the file says that wrote it.

    Attributes:
        pending: bytes of the messages that are in no chunk yet.

    Raises:
        OSError: the stream can't be written; from any method that writes.
    """

    def __init__(self, stream: IO[bytes], compression: str, library: str) -> None:
        self._stream = stream
        self._name = "" if compression == "none" else compression
        self._packer = zstandard.ZstdCompressor(level=_LEVEL) if compression == "zstd" else None
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._open: list[OpenChannel] = []
        self._chunks: list[records.ChunkIndex] = []
        self._notes: list[records.MetadataIndex] = []
        self._parts: list[bytes] = []  # of the chunk that is being gathered
        self.pending = 0
        self._first, self._last = 0, 0  # times of all messages
        stream.write(MCAP_MAGIC)
        self._write(records.Header("", library))

    def register(
        self, topic: str, schema: str, types: bytes, metadata: Mapping[str, str]
    ) -> OpenChannel:
        """A channel of messages of Protocol Buffers.

        Args:
            topic: its name.
            schema: full name of the message.
            types: a ``FileDescriptorSet`` of it.
            metadata: of the channel.

        Returns:
            What its messages are added to.
        """
        known = self._schemas.get(schema)
        if known is None:
            known = Schema(len(self._schemas) + 1, types, "protobuf", schema)
            self._schemas[schema] = known
            self._gather(known)
        number = len(self._channels) + 1
        channel = Channel(number, topic, "protobuf", dict(metadata), known.id)
        self._channels.append(channel)
        self._open.append(OpenChannel(number))
        self._gather(channel)
        return self._open[-1]

    def add(self, channel: OpenChannel, number: int, at: int, data: bytes) -> None:
        """A message, for the chunk that is being gathered.

        Args:
            channel: its channel.
            number: its sequence number.
            at: its time [ns].
            data: its bytes.
        """
        size, pending = len(data), self.pending
        channel.index += (at, pending)
        head = _MESSAGE.pack(_IS_MESSAGE, _MESSAGE_HEAD + size, channel.number, number, at, at)
        self._parts += (head, data)
        self.pending = pending + _MESSAGE.size + size

    def end_chunk(self) -> None:
        """Write the messages gathered so far, with their index, and flush the stream."""
        pairs: dict[int, np.ndarray] = {}
        for channel in self._open:
            if channel.index:
                pairs[channel.number] = np.array(channel.index, "<u8").reshape(-1, 2)
                channel.count += len(channel.index) // 2
                channel.index = []
        if pairs:
            data = b"".join(self._parts)
            self._parts, self.pending = [], 0
            self._write_chunk(data, pairs)
        self._stream.flush()

    def add_metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Write a metadata record, after what was gathered before."""
        self.end_chunk()
        start = self._stream.tell()
        length = self._write(Metadata(name=name, metadata=dict(texts)))
        self._notes.append(records.MetadataIndex(start, length, name))
        self._stream.flush()

    def finish(self) -> None:
        """Write what was gathered, and the summary; the stream stays open."""
        self.end_chunk()
        self._write(records.DataEnd(0))
        start = self._stream.tell()
        summary: Any = RecordBuilder()  # whose signatures are partly annotated
        offsets = []
        for opcode, group in self._summary():
            begin = summary.count
            for record in group:
                record.write(summary)
            offsets.append(records.SummaryOffset(opcode, start + begin, summary.count - begin))
        offset_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        data = summary.end()
        # The checksum covers the footer up to itself.
        footer = _FOOTER.pack(Opcode.FOOTER, 20, start, offset_start)
        self._stream.write(data)
        self._write(records.Footer(start, offset_start, zlib.crc32(footer, zlib.crc32(data))))
        self._stream.write(MCAP_MAGIC)

    def _summary(self) -> Iterable[tuple[int, Iterable[records.McapRecord]]]:
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={one.number: one.count for one in self._open if one.count},
            chunk_count=len(self._chunks),
            message_count=sum(one.count for one in self._open),
            message_start_time=self._first,
            message_end_time=self._last,
            metadata_count=len(self._notes),
            schema_count=len(self._schemas),
        )
        yield Opcode.SCHEMA, self._schemas.values()
        yield Opcode.CHANNEL, self._channels
        yield Opcode.STATISTICS, [statistics]
        yield Opcode.CHUNK_INDEX, self._chunks
        yield Opcode.METADATA_INDEX, self._notes

    def _gather(self, record: records.McapRecord) -> None:
        data = _bytes(record)
        self._parts.append(data)
        self.pending += len(data)

    def _write_chunk(self, data: bytes, pairs: Mapping[int, np.ndarray]) -> None:
        times = np.concatenate([found[:, 0] for found in pairs.values()])
        first, last = int(times.min()), int(times.max())
        if self._chunks:
            self._first, self._last = min(self._first, first), max(self._last, last)
        else:
            self._first, self._last = first, last
        packed = self._packed(data)
        start = self._stream.tell()
        chunk = records.Chunk(
            compression=self._name,
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        parts = [_bytes(chunk)]
        length = len(parts[0])
        offsets, at = {}, start + length
        for channel, found in pairs.items():
            offsets[channel] = at
            content = found.tobytes()
            size = len(content)
            parts += (_INDEX.pack(_IS_INDEX, size + 6, channel, size), content)
            at += _INDEX.size + size
        self._stream.write(b"".join(parts))
        self._chunks.append(
            records.ChunkIndex(
                chunk_start_offset=start,
                chunk_length=length,
                message_start_time=first,
                message_end_time=last,
                message_index_offsets=offsets,
                message_index_length=at - start - length,
                compression=self._name,
                compressed_size=len(packed),
                uncompressed_size=len(data),
            )
        )

    def _packed(self, data: bytes) -> bytes:
        if self._packer is not None:
            return bytes(self._packer.compress(data))
        return bytes(lz4_frames.compress(data)) if self._name else data

    def _write(self, record: records.McapRecord) -> int:
        data = _bytes(record)
        self._stream.write(data)
        return len(data)


def _bytes(record: records.McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def close_at(stream: IO[bytes], size: int) -> None:
    """Close a file that can't be written any more, as far as it goes, and cut it to a size."""
    with contextlib.suppress(OSError):
        file = os.dup(stream.fileno())
        try:
            with contextlib.suppress(OSError):
                stream.close()
            os.ftruncate(file, size)
        finally:
            os.close(file)

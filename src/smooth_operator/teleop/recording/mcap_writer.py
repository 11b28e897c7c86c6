"""Writer of MCAP files whose messages come many times a second.

The library's own writer takes 7 us for each message, which is more than everything else that is
done with it (a frame has five to nine). So messages and their index are packed here; all other
records are the library's.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import IO, Any, Final

import numpy as np

from smooth_operator.formats.registry import MCAP_MAGIC
from smooth_operator.teleop.recording.log_types import Opcode, RecordBuilder, lz4_frame, zstandard
from smooth_operator.teleop.recording.log_types import mcap_records as records

COMPRESSIONS: Final = ("zstd", "lz4", "none")

_MESSAGE: Final = struct.Struct("<BQHIQQ")  # opcode, length; channel, number, two times
_MESSAGE_OPCODE: Final = int(Opcode.MESSAGE)
_MESSAGE_HEAD: Final = 22  # bytes of a message that are not its data
_INDEX: Final = struct.Struct("<BQHI")  # opcode, length; channel, bytes of pairs
_FOOTER: Final = struct.Struct("<BQQQ")
_LEVEL: Final = 1
"""Level of Zstandard: noisy numbers get no smaller at higher ones."""


class McapWriter:
    """Writes schemas, channels, chunks of messages, metadata and the summary.

    Args:
        stream: the file, empty.
        compression: compression of the chunks, one of ``COMPRESSIONS``.
        library: name of the program, for the header of the file.

    Attributes:
        pending: bytes of the messages that are in no chunk yet.

    Raises:
        OSError: the stream can't be written; from any method that writes.
    """

    def __init__(self, stream: IO[bytes], compression: str, library: str) -> None:
        self._stream = stream
        self._compression = "" if compression == "none" else compression
        self._packer = zstandard.ZstdCompressor(level=_LEVEL)
        self._schemas: dict[str, records.Schema] = {}
        self._channels: list[records.Channel] = []
        self._counts: list[int] = []  # messages of each channel
        self._index: list[list[int]] = []  # time and place in the chunk of each channel's messages
        self._chunks: list[records.ChunkIndex] = []
        self._metadata: list[records.MetadataIndex] = []
        self._parts: list[bytes] = []  # of the chunk that is being gathered
        self.pending = 0
        stream.write(MCAP_MAGIC)
        self._write(records.Header("", library))

    def register(self, topic: str, schema: str, types: bytes, metadata: Mapping[str, str]) -> int:
        """Open a channel of messages of Protocol Buffers.

        Args:
            topic: its name.
            schema: full name of the message.
            types: a ``FileDescriptorSet`` of the message.
            metadata: texts by name.

        Returns:
            The number of the channel.
        """
        if schema not in self._schemas:
            number = len(self._schemas) + 1
            self._schemas[schema] = records.Schema(number, types, "protobuf", schema)
            self._gather(self._schemas[schema])
        number = len(self._channels) + 1
        channel = records.Channel(
            number, topic, "protobuf", dict(metadata), self._schemas[schema].id
        )
        self._channels.append(channel)
        self._counts.append(0)
        self._index.append([])
        self._gather(channel)
        return number

    def add(self, channel: int, number: int, at: int, data: bytes) -> None:
        """Put a message into the chunk that is being gathered.

        Args:
            channel: number of its channel.
            number: its sequence number.
            at: its time [ns].
            data: its bytes.
        """
        size, pending = len(data), self.pending
        self._index[channel - 1] += (at, pending)
        head = _MESSAGE.pack(_MESSAGE_OPCODE, _MESSAGE_HEAD + size, channel, number, at, at)
        self._parts += (head, data)
        self.pending = pending + _MESSAGE.size + size

    def end_chunk(self) -> None:
        """Write the messages gathered so far, with their index, and flush the stream."""
        if any(self._index):
            data = b"".join(self._parts)
            self._parts, self.pending = [], 0
            pairs = {}
            for place, index in enumerate(self._index):
                if index:
                    pairs[place + 1] = np.array(index, "<u8").reshape(-1, 2)
                    self._counts[place] += len(index) // 2
                    self._index[place] = []
            self._write_chunk(data, pairs)
        self._stream.flush()

    def add_metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Write a metadata record, after the messages gathered before."""
        self.end_chunk()
        start = self._stream.tell()
        length = self._write(records.Metadata(name=name, metadata=dict(texts)))
        self._metadata.append(records.MetadataIndex(start, length, name))
        self._stream.flush()

    def finish(self) -> None:
        """Write the messages gathered so far, and the summary; the stream stays open."""
        self.end_chunk()
        self._write(records.DataEnd(0))
        start = self._stream.tell()
        summary, offsets = b"", []
        for group in self._summary():
            data = b"".join(map(_bytes, group))
            offsets.append(records.SummaryOffset(data[0], start + len(summary), len(data)))
            summary += data
        offset_start = start + len(summary)
        summary += b"".join(map(_bytes, offsets))
        # The checksum covers the footer up to itself.
        footer = _FOOTER.pack(Opcode.FOOTER, 20, start, offset_start)
        self._stream.write(summary)
        checksum = zlib.crc32(footer, zlib.crc32(summary))
        self._write(records.Footer(start, offset_start, checksum))
        self._stream.write(MCAP_MAGIC)

    def _summary(self) -> Iterable[list[Any]]:
        statistics = records.Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={i + 1: n for i, n in enumerate(self._counts) if n},
            chunk_count=len(self._chunks),
            message_count=sum(self._counts),
            message_start_time=min((one.message_start_time for one in self._chunks), default=0),
            message_end_time=max((one.message_end_time for one in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        schemas = list(self._schemas.values())
        groups = (schemas, self._channels, [statistics], self._chunks, self._metadata)
        return filter(None, groups)

    def _gather(self, record: records.McapRecord) -> None:
        data = _bytes(record)
        self._parts.append(data)
        self.pending += len(data)

    def _write_chunk(self, data: bytes, pairs: Mapping[int, np.ndarray]) -> None:
        times = np.concatenate([index[:, 0] for index in pairs.values()])
        first, last = int(times.min()), int(times.max())
        packed = self._packed(data)
        start = self._stream.tell()
        chunk = records.Chunk(
            compression=self._compression,
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        parts = [_bytes(chunk)]
        length = len(parts[0])
        offsets, at = {}, start + length
        for channel, index in pairs.items():
            offsets[channel] = at
            content = index.tobytes()
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, len(content) + 6, channel, len(content))
            parts += (head, content)
            at += len(head) + len(content)
        self._stream.write(b"".join(parts))
        self._chunks.append(
            records.ChunkIndex(
                chunk_start_offset=start,
                chunk_length=length,
                message_start_time=first,
                message_end_time=last,
                message_index_offsets=offsets,
                message_index_length=at - start - length,
                compression=self._compression,
                compressed_size=len(packed),
                uncompressed_size=len(data),
            )
        )

    def _packed(self, data: bytes) -> bytes:
        if self._compression == "zstd":
            return bytes(self._packer.compress(data))
        return bytes(lz4_frame.compress(data)) if self._compression else data

    def _write(self, record: records.McapRecord) -> int:
        data = _bytes(record)
        self._stream.write(data)
        return len(data)


def _bytes(record: records.McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())

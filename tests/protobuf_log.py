"""Logs read with the MCAP and Protocol Buffers libraries alone, by the types that the file has."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader
from mcap.records import Message, Schema
from mcap.writer import CompressionType, Writer


def message_class(schema: Schema) -> Any:
    """The class of a schema's messages."""
    assert schema.encoding == "protobuf"
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.AddSerializedFile(file.SerializeToString())  # which refuses a missing dependency
    return GetMessageClass(pool.FindMessageTypeByName(schema.name))


def decoded(
    path: Path, topics: Iterable[str] | None = None, *, in_order: bool = True
) -> Iterator[tuple[str, Message, Any]]:
    """(topic, MCAP message, message of Protocol Buffers)."""
    classes: dict[int, Any] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        wanted = None if topics is None else list(topics)
        for schema, channel, message in reader.iter_messages(wanted, log_time_order=in_order):
            assert channel.message_encoding == "protobuf"
            if schema.id not in classes:
                classes[schema.id] = message_class(schema)
            yield channel.topic, message, classes[schema.id].FromString(message.data)


def plain(message: Any) -> Any:
    """A message as dictionaries and lists; a field that tells absence and is absent is left out."""
    if not hasattr(message, "DESCRIPTOR"):
        return message
    found = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if hasattr(value, "extend"):
            found[field.name] = [plain(one) for one in value]
        elif not field.has_presence or message.HasField(field.name):
            found[field.name] = plain(value)
    return found


def rewritten(
    path: Path, target: Path, change: Callable[[str, Any], Any], *, keep: Iterable[str] = ()
) -> Path:
    """A copy of a log with other messages, written by the MCAP library.

    Args:
        path: the log.
        target: the copy.
        change: topic and message -> the message that stands there instead, or its bytes, or None
            to leave it out.
        keep: topics that stay; none for all.
    """
    wanted = list(keep) or None
    with path.open("rb") as source, target.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        numbers: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages(wanted):
            new = change(channel.topic, message_class(schema).FromString(message.data))
            if new is None:
                continue
            if channel.id not in numbers:
                about = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, about, channel.metadata
                )
            data = new if isinstance(new, bytes) else new.SerializeToString()
            writer.add_message(
                numbers[channel.id], message.log_time, data, message.log_time, message.sequence
            )
        writer.finish()
    return target

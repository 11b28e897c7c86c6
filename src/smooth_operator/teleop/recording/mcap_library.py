"""The libraries of the MCAP log, which are an extra: imported here, so that one place says so.

Raises:
    MissingExtraError: on import, where one is missing.
"""

import importlib

from smooth_operator.errors import MissingExtraError

try:
    import zstandard as zstandard
    from google.protobuf import duration_pb2 as duration_pb2
    from google.protobuf import timestamp_pb2 as timestamp_pb2
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto as FieldDescriptorProto
    from google.protobuf.descriptor_pb2 import FileDescriptorProto as FileDescriptorProto
    from google.protobuf.descriptor_pb2 import FileDescriptorSet as FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool as DescriptorPool
    from google.protobuf.message import DecodeError as DecodeError
    from google.protobuf.message_factory import GetMessageClass as GetMessageClass
    from mcap import records as records
    from mcap.data_stream import ReadDataStream as ReadDataStream
    from mcap.data_stream import RecordBuilder as RecordBuilder
    from mcap.exceptions import McapError as McapError
    from mcap.opcode import Opcode as Opcode
    from mcap.records import Channel as Channel
    from mcap.records import Metadata as Metadata
    from mcap.records import Schema as Schema
    from mcap.records import Statistics as Statistics
    from mcap.well_known import MessageEncoding as MessageEncoding
    from mcap.well_known import SchemaEncoding as SchemaEncoding

    lz4_frames = importlib.import_module("lz4.frame")  # by name, since it comes without types
except ModuleNotFoundError as error:
    raise MissingExtraError("an MCAP log", "teleop") from error

"""The libraries of the MCAP log, which are an extra: imported here, so that one place says so.

Raises:
    MissingExtraError: on import, where one is missing.
"""

from smooth_operator.errors import MissingExtraError

try:
    import zstandard as zstandard
    from mcap.data_stream import ReadDataStream as ReadDataStream
    from mcap.exceptions import McapError as McapError
    from mcap.opcode import Opcode as Opcode
    from mcap.records import Channel as Channel
    from mcap.records import Metadata as Metadata
    from mcap.records import Statistics as Statistics
    from mcap.well_known import MessageEncoding as MessageEncoding
    from mcap.well_known import SchemaEncoding as SchemaEncoding
    from mcap.writer import CompressionType as CompressionType
    from mcap.writer import Writer as Writer
except ModuleNotFoundError as error:
    raise MissingExtraError("an MCAP log", "teleop") from error

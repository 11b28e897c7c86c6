"""ROS 2 messages by CycloneDDS (extra ``ros2``), with or without a ROS 2 installation."""

from __future__ import annotations

from smooth_operator.errors import require
from smooth_operator.teleop.ros2.transport import Endpoint, Transport


def open_transport(endpoint: Endpoint) -> Transport:
    """Open a transport.

    Raises:
        MissingExtraError: CycloneDDS is not installed.
        SinkError, SourceError: as ``endpoint.error`` says; the domain can't be joined.
        ConfigError: a variable of the environment can't be read, or another part of this process
            is in the domain with another network.
    """
    require(endpoint.feature, "ros2", "cyclonedds")
    from smooth_operator.teleop.ros2.cyclone_transport import CycloneTransport

    return CycloneTransport(endpoint)

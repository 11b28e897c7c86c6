"""Which library carries ROS 2 messages: rclpy where it can be imported, else CycloneDDS."""

from __future__ import annotations

import importlib

from smooth_operator.errors import MissingExtraError
from smooth_operator.teleop.ros2.transport import Endpoint, Transport


def open_transport(endpoint: Endpoint) -> Transport:
    """Open a transport.

    Raises:
        MissingExtraError: neither library is there.
        SinkError, SourceError: as ``endpoint.error`` says; the library that is asked for can't be
            loaded, or does not start.
        ConfigError: a setting does not fit the library.
    """
    if endpoint.backend == "rclpy" or (endpoint.backend == "auto" and _imports("rclpy")):
        from smooth_operator.teleop.ros2.rclpy_transport import RclpyTransport

        return RclpyTransport(endpoint)
    if not _imports("cyclonedds"):
        without = " without rclpy, which comes with ROS 2" if endpoint.backend == "auto" else ""
        raise MissingExtraError(f"{endpoint.feature}{without},", "ros2")
    from smooth_operator.teleop.ros2.cyclone_transport import CycloneTransport

    return CycloneTransport(endpoint)


def _imports(name: str) -> bool:
    """Whether a module can be imported: an rclpy of another Python is found, but can't."""
    try:
        importlib.import_module(name)
    except ImportError:
        return False
    return True

"""The sinks, by the word that a user writes."""

from __future__ import annotations

from typing import Final, cast

from smooth_operator.components import Component, build_component
from smooth_operator.teleop.sinks.sink import Sink

_HERE: Final = "smooth_operator.teleop.sinks"

SINKS: Final[dict[str, Component]] = {
    "mujoco": Component(
        f"{_HERE}.simulation", "Simulation", "physics with position actuators, seen in the page"
    ),
    "zmq": Component(f"{_HERE}.zmq_sink", "ZmqSink", "commands over ZeroMQ (extra zmq)"),
    "ros2": Component(f"{_HERE}.ros2", "Ros2Sink", "sensor_msgs/JointState, where rclpy is"),
    "record": Component(f"{_HERE}.record", "RecordSink", "an MCAP log: record:FILE"),
    "table": Component(f"{_HERE}.table", "TableSink", "a table in the terminal"),
}
"""Word -> sink."""


def build_sink(text: str) -> Sink:
    """A sink from its text, such as ``zmq:tcp://127.0.0.1:5556``.

    Raises:
        UnknownNameError: there is no such sink or setting.
        ConfigError: a setting can't be read.
    """
    return cast(Sink, build_component("sink", text, SINKS))

"""The sinks, by the name that a user writes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, cast

from smooth_operator.plugins import Entry, Registry
from smooth_operator.teleop.components import build_component

if TYPE_CHECKING:  # --help names the sinks, and needs no NumPy
    from smooth_operator.teleop.sinks.sink import Sink

_HERE: Final = "smooth_operator.teleop.sinks"
_HANDS: Final = "smooth_operator.teleop.hardware.drivers"

SINKS: Final = Registry(
    "sink",
    {
        "mujoco": Entry(
            f"{_HERE}.simulation:Simulation", "physics with position actuators, seen in the page"
        ),
        "zmq": Entry(f"{_HERE}.zmq_sink:ZmqSink", "commands over ZeroMQ (extra zmq)"),
        "ros2": Entry(
            "smooth_operator.teleop.ros2.sink:Ros2Sink",
            "ROS 2 topics, without a ROS 2 installation too (extra ros2)",
        ),
        "record": Entry(f"{_HERE}.record:RecordSink", "an MCAP log: record:FILE"),
        "table": Entry(f"{_HERE}.table:TableSink", "a table in the terminal"),
        "dynamixel": Entry(
            f"{_HANDS}.dynamixel:DynamixelSink",
            "a hand of Dynamixel servos, by a table (extra dynamixel)",
        ),
        "leap": Entry(f"{_HANDS}.dynamixel:LeapSink", "the LEAP hand (extra dynamixel)"),
        "orca": Entry(f"{_HANDS}.orca:OrcaSink", "the ORCA hand (extra orca)"),
        "inspire": Entry(f"{_HANDS}.inspire:InspireSink", "an Inspire RH56 hand (extra inspire)"),
        "linker": Entry(f"{_HANDS}.linker:LinkerSink", "a LinkerHand L10 or L20 (extra linker)"),
        "allegro": Entry(
            f"{_HANDS}.allegro:AllegroSink", "an Allegro Hand V4 or V5 (extra allegro)"
        ),
        "ability": Entry(f"{_HANDS}.ability:AbilitySink", "an Ability Hand (extra ability)"),
        "wuji": Entry(f"{_HANDS}.wuji:WujiSink", "a Wuji Hand (extra wuji)"),
        "revo2": Entry(f"{_HANDS}.revo2:Revo2Sink", "a BrainCo Revo2 (extra revo2)"),
    },
    needs=("label", "open", "send", "stalled", "close", "simulation"),
    advice="derive it from smooth_operator.teleop.Sink",
)
"""Name -> sink, a dataclass of its settings (``Sink``)."""


def build_sink(text: str) -> Sink:
    """A sink from its text, such as ``zmq:tcp://127.0.0.1:5556`` or ``mylab.driver:MySink,port=7``.

    Raises:
        UnknownNameError: there is no such sink or setting.
        ConfigError: a setting can't be read, or the class can't be imported or is no sink.
    """
    return cast("Sink", build_component(SINKS, text))

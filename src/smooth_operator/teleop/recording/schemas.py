"""The topics of the log and the types of their messages, in Protocol Buffers.

A number that is not known is NaN, a list or text that is not known is empty. Lists of points are
flat, so that they are packed and NumPy takes their bytes as they are.
"""

from __future__ import annotations

from typing import Any, Final

from smooth_operator.teleop.recording.protobuf_types import parse_types
from smooth_operator.types import Status

VERSION: Final = "3"
"""Version of the messages, in the metadata of every channel; raised when a reader must change."""

HAND: Final = "/hand"
COMMAND: Final = "/command"
STATUS: Final = "/status"
TIMING: Final = "/timing"
LOOP: Final = "/loop"
"""Only in logs of a live loop; readers that do not know it pass over it."""
STATE: Final = "/state"
"""Only in logs of a live loop whose hand is measured."""
ARM: Final = "/arm"
"""Only where an arm carries the robot hand."""
WRIST: Final = "/wrist"
"""Only where the wrist of the robot hand was commanded, too."""
CONFIG: Final = "/config"

ORIGIN: Final = "smooth_operator.origin"
"""Name of the metadata record that says where the log came from: ``name``, ``task``, ``meta``."""

METHOD: Final = "smooth_operator.method"
"""Name of the metadata records that say what drove the hand from when on: ``stamp`` of the first
command, ``method``, ``preset``, ``config`` (JSON)."""

LIVE: Final = (ARM, LOOP, STATE, WRIST)
"""Topics that only the logs of a live loop have."""

OF_COMMANDS: Final = frozenset((TIMING, STATUS, LOOP, WRIST, ARM))
"""Topics with one message for a command at most, of the same number."""

_CODES: Final = "\n".join(f"    {status.name} = {int(status)};" for status in Status)

# The numbers of the fields are those that log_messages.py writes.
_TEXT: Final = f"""
message Hand {{ // A tracked human hand.
  double stamp = 1; // time of the hand frame [s], exact
  string side = 2; // right or left
  // 21 times x y z [m]: wrist, then thumb to pinky, each from base to tip
  repeated double landmarks = 3;
  repeated bool valid = 4; // 21: false where the tracker lost the landmark
  // metacarpal bases, index to pinky: 4 times x y z [m]; empty if untracked
  repeated double metacarpals = 5;
  repeated double orientations = 6; // of the landmarks: 21 times w x y z; empty if untracked
  // in the world: x y z [m], w x y z; NaN while lost, empty if untracked
  repeated double wrist = 7;
  string world = 8; // name of the frame of the wrist
}}
message Command {{ // A command to the robot hand.
  double stamp = 1; // time of the hand frame [s], exact
  repeated string names = 2; // joint names, in the model's order
  repeated double positions = 3; // joint positions [rad]
}}
message Status {{ // Why the command of the same number is what it is.
  enum Code {{
{_CODES}
  }}
  double stamp = 1; // of the command [s]
  Code status = 2;
  string reason = 3; // the same for a person
}}
message Timing {{ // How long the command of the same number took.
  message Stage {{ // A stage of the loop.
    string name = 1;
    double ms = 2;
  }}
  double stamp = 1; // of the command [s]
  double latency_ms = 2; // from landmarks to command [ms]
  repeated Stage stages = 3; // its parts
}}
message Loop {{ // What the live loop did when it sent the command of the same number.
  double stamp = 1; // of the command [s]
  uint64 number = 2; // of the tick, counted from 0
  string mode = 3; // waiting, tracking, holding, ...
  double time = 4; // when the command was ready [s], loop's clock
  // when the frame that it answers came [s], loop's clock; NaN if it answers none
  double received = 5;
  double tracker_stamp = 6; // the frame's own [s]
  optional int64 session = 7; // which start of the tracker
  double tracking_loss = 8; // of the frame
  double scale = 9; // robot over human size
  repeated string events = 10; // what happened, a sentence each
}}
message State {{ // The measured state of the robot hand.
  double stamp = 1; // of the measurement [s], loop's clock
  repeated string names = 2; // joint names, in the model's order
  repeated double positions = 3; // measured joint positions [rad]
  repeated double velocities = 4; // measured joint velocities [rad/s]; empty if unknown
  repeated string actuators = 5; // names of the actuators; empty if none
  repeated double currents = 6; // of the actuators, mA or the driver's unit of force
  repeated double temperatures = 7; // of the actuators [degrees Celsius]
  repeated double touch = 8; // touch or force sensors, in the driver's unit
}}
message Wrist {{ // Where the wrist of the robot hand is sent with the command of the same number.
  double stamp = 1; // of the command [s]
  repeated double pose = 2; // x y z [m], w x y z
  bool engaged = 3; // whether the operator's wrist moves it
  bool valid = 4; // whether the operator's wrist is known
  string world = 5; // name of the frame, the robot's base
}}
message Arm {{ // Where the arm is sent with the command of the same number, and where it is.
  double stamp = 1; // of the command [s]
  string name = 2; // of the arm
  repeated string names = 3; // joint names, from the base
  repeated double positions = 4; // commanded joint positions [rad]
  repeated double velocities = 5; // their velocities [rad/s]
  repeated double measured = 6; // measured joint positions [rad]; empty if unknown
  repeated double pose = 7; // of the hand's wrist there, in the arm's base: x y z [m], w x y z
  string state = 8; // following, holding, braking or stopped
  double clearance = 9; // smallest distance [m]
  double position_error = 10; // to the wanted pose [m]
  double rotation_error = 11; // the same [rad]
}}
message Config {{ // The resolved configuration, once.
  string configuration = 1; // as JSON
}}
"""

TYPES: Final[dict[str, Any]] = parse_types("smooth_operator", _TEXT)
"""Full name -> ``FileDescriptorProto``."""

SCHEMAS: Final = {
    topic: f"smooth_operator.{topic[1:].capitalize()}"
    for topic in (HAND, COMMAND, STATUS, TIMING, LOOP, STATE, WRIST, ARM, CONFIG)
}
"""Topic -> full name of its messages."""

READ: Final[dict[str, tuple[str, ...]]] = {
    HAND: (
        *("stamp", "side", "landmarks", "valid"),
        *("metacarpals", "orientations", "wrist", "world"),
    ),
    COMMAND: ("stamp", "names", "positions"),
    STATUS: ("status",),
    TIMING: ("latency_ms", "stages"),
    LOOP: (
        *("number", "mode", "time", "received", "tracker_stamp"),
        *("tracking_loss", "scale", "events"),
    ),
    STATE: ("stamp", "names", "positions", "actuators", "currents", "touch"),
    WRIST: ("pose", "engaged", "valid", "world"),
    ARM: ("name", "names", "positions", "measured", "pose"),
    CONFIG: ("configuration",),
}
"""Topic -> fields that are read back, in the order of the columns of its table."""

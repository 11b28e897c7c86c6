"""The topics of the log and the JSON schemas of their messages.

The schemas keep to what Foxglove's viewer parses: objects whose fields are scalars, objects, or
arrays of these; no arrays of arrays, no unions of types. So a point is an object ``{x, y, z}``, a
stage of the loop ``{name, ms}``, and the configuration, whose fields are not known here, a text.
JSON has no NaN: a number that is not finite is written as ``null``.
"""

from __future__ import annotations

from typing import Any, Final

from smooth_operator.types import Status

VERSION: Final = "2"
"""Version of the messages, in the metadata of every channel; raised when a reader must change."""

READABLE_VERSIONS: Final = ("1", VERSION)
"""Versions that are read. In version 1 the status was a field of the command."""

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

_NUMBER = {"type": "number"}
_STAMP = {"type": "number", "description": "time of the hand frame [s], exact"}


def _object(description: str, required: tuple[str, ...], **properties: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "description": description,
        "properties": properties,
        "required": list(required),
    }


def _array(items: dict[str, Any], description: str) -> dict[str, Any]:
    return {"type": "array", "items": items, "description": description}


_POINT = _object("a position [m]; null where unknown", (), x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object(
    "an orientation; null where unknown", (), w=_NUMBER, x=_NUMBER, y=_NUMBER, z=_NUMBER
)
_POSE = _object("a pose", (), position=_POINT, orientation=_QUATERNION)
_STAGE = _object("a stage of the loop", (), name={"type": "string"}, ms=_NUMBER)

LIVE: Final = (ARM, LOOP, STATE, WRIST)
"""Topics that only the logs of a live loop have."""

OF_COMMANDS: Final = (TIMING, STATUS, LOOP, WRIST, ARM)
"""Topics with one message for a command at most, of the same number."""

SCHEMAS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    HAND: (
        "smooth_operator.Hand",
        _object(
            "A tracked human hand.",
            ("stamp", "side", "landmarks", "valid"),
            stamp=_STAMP,
            side={"type": "string", "description": "right or left"},
            landmarks=_array(_POINT, "21: wrist, then thumb to pinky, each from base to tip"),
            valid=_array({"type": "boolean"}, "21: false where the tracker lost the landmark"),
            metacarpals=_array(_POINT, "4 metacarpal bases, index to pinky; absent if untracked"),
            orientations=_array(_QUATERNION, "21, one per landmark; absent if untracked"),
            wrist={**_POSE, "description": "in the world; null while lost, absent if untracked"},
            world={"type": "string", "description": "name of the frame of the wrist"},
        ),
    ),
    COMMAND: (
        "smooth_operator.Command",
        _object(
            "A command to the robot hand.",
            ("stamp", "names", "positions"),
            stamp=_STAMP,
            names=_array({"type": "string"}, "joint names, in the model's order"),
            positions=_array(_NUMBER, "joint positions [rad]"),
        ),
    ),
    STATUS: (
        "smooth_operator.Status",
        _object(
            "Why the command with the same stamp is what it is.",
            ("stamp", "status", "reason"),
            stamp=_STAMP,
            # Foxglove's form of an enumeration.
            status={"oneOf": [{"title": s.name, "const": int(s)} for s in Status]},
            reason={"type": "string", "description": "the same for a person"},
        ),
    ),
    TIMING: (
        "smooth_operator.Timing",
        _object(
            "How long the command with the same stamp took.",
            ("stamp", "latency_ms", "stages"),
            stamp=_STAMP,
            latency_ms={"type": "number", "description": "from landmarks to command [ms]"},
            stages=_array(_STAGE, "its parts [ms]"),
        ),
    ),
    LOOP: (
        "smooth_operator.Loop",
        _object(
            "What the live loop did when it sent the command with the same stamp.",
            ("stamp", "number", "mode", "time", "events"),
            stamp=_STAMP,
            number={"type": "integer", "description": "of the tick, counted from 0"},
            mode={"type": "string", "description": "waiting, tracking, holding, ..."},
            time={"type": "number", "description": "when the command was ready [s], loop's clock"},
            received={"type": "number", "description": "of the frame [s], loop's clock; or null"},
            tracker_stamp={"type": "number", "description": "the frame's own [s]; or null"},
            session={"type": "integer", "description": "which start of the tracker; or null"},
            tracking_loss={"type": "number", "description": "of the frame; or null"},
            scale={"type": "number", "description": "robot over human size; or null"},
            events=_array({"type": "string"}, "what happened, a sentence each"),
        ),
    ),
    STATE: (
        "smooth_operator.State",
        _object(
            "The measured state of the robot hand.",
            ("stamp", "names", "positions"),
            stamp={"type": "number", "description": "of the measurement [s], loop's clock"},
            names=_array({"type": "string"}, "joint names, in the model's order"),
            positions=_array(_NUMBER, "measured joint positions [rad]; null where unknown"),
            velocities=_array(_NUMBER, "measured joint velocities [rad/s]; absent if unknown"),
            actuators=_array({"type": "string"}, "names of the actuators; absent if none"),
            currents=_array(_NUMBER, "of the actuators, mA or the driver's unit of force"),
            temperatures=_array(_NUMBER, "of the actuators [degrees Celsius]"),
            touch=_array(_NUMBER, "touch or force sensors, in the driver's unit"),
        ),
    ),
    WRIST: (
        "smooth_operator.Wrist",
        _object(
            "Where the wrist of the robot hand is sent with the command of the same stamp.",
            ("stamp", "pose", "engaged", "valid", "world"),
            stamp=_STAMP,
            pose=_POSE,
            engaged={"type": "boolean", "description": "whether the operator's wrist moves it"},
            valid={"type": "boolean", "description": "whether the operator's wrist is known"},
            world={"type": "string", "description": "name of the frame, the robot's base"},
        ),
    ),
    ARM: (
        "smooth_operator.Arm",
        _object(
            "Where the arm is sent with the command of the same stamp, and where it is.",
            ("stamp", "name", "names", "positions", "pose", "state"),
            stamp=_STAMP,
            name={"type": "string", "description": "of the arm"},
            names=_array({"type": "string"}, "joint names, from the base"),
            positions=_array(_NUMBER, "commanded joint positions [rad]"),
            velocities=_array(_NUMBER, "their velocities [rad/s]"),
            measured=_array(_NUMBER, "measured joint positions [rad]; absent if unknown"),
            pose={**_POSE, "description": "of the hand's wrist there, in the arm's base"},
            state={"type": "string", "description": "following, holding, braking or stopped"},
            clearance={"type": "number", "description": "smallest distance [m]; or null"},
            position_error={"type": "number", "description": "to the wanted pose [m]; or null"},
            rotation_error={"type": "number", "description": "the same [rad]; or null"},
        ),
    ),
    CONFIG: (
        "smooth_operator.Config",
        _object(
            "The resolved configuration, once.",
            ("configuration",),
            configuration={"type": "string", "description": "the configuration as JSON"},
        ),
    ),
}
"""Topic -> (schema name, JSON schema)."""

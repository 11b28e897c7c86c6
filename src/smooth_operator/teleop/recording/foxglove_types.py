"""Foxglove's well-known messages, as far as a log has them: types and topics.

Names and types of the fields are those of https://github.com/foxglove/foxglove-sdk. A viewer knows
the messages by their full names, and reads the fields that the log defines.
"""

from __future__ import annotations

from typing import Any, Final

from smooth_operator.teleop.recording.protobuf_types import parse_types

HAND_SCENE: Final = "/foxglove/hand"
ROBOT_SCENE: Final = "/foxglove/robot"
JOINTS: Final = "/foxglove/joints"
FRAMES: Final = "/foxglove/frames"
HUMAN_WRIST: Final = "/foxglove/human_wrist"
WRIST_TARGET: Final = "/foxglove/wrist_target"
"""The wrist of the operator in the tracker's world, that of the robot hand in the robot's base."""

_TEXT: Final = """
message Vector3 {
  double x = 1;
  double y = 2;
  double z = 3;
}
message Point3 {
  double x = 1;
  double y = 2;
  double z = 3;
}
message Quaternion {
  double x = 1;
  double y = 2;
  double z = 3;
  double w = 4;
}
message Pose {
  Vector3 position = 1;
  Quaternion orientation = 2;
}
message Color {
  double r = 1;
  double g = 2;
  double b = 3;
  double a = 4;
}
message KeyValuePair {
  string key = 1;
  string value = 2;
}
message ArrowPrimitive {
  Pose pose = 1;
  double shaft_length = 2;
  double shaft_diameter = 3;
  double head_length = 4;
  double head_diameter = 5;
  Color color = 6;
}
message CubePrimitive {
  Pose pose = 1;
  Vector3 size = 2;
  Color color = 3;
}
message SpherePrimitive {
  Pose pose = 1;
  Vector3 size = 2;
  Color color = 3;
}
message CylinderPrimitive {
  Pose pose = 1;
  Vector3 size = 2;
  double bottom_scale = 3;
  double top_scale = 4;
  Color color = 5;
}
message LinePrimitive {
  enum Type {
    LINE_STRIP = 0;
    LINE_LOOP = 1;
    LINE_LIST = 2;
  }
  Type type = 1;
  Pose pose = 2;
  double thickness = 3;
  bool scale_invariant = 4;
  repeated Point3 points = 5;
  Color color = 6;
  repeated Color colors = 7;
  repeated fixed32 indices = 8;
}
message TriangleListPrimitive {
  Pose pose = 1;
  repeated Point3 points = 2;
  Color color = 3;
  repeated Color colors = 4;
  repeated fixed32 indices = 5;
}
message TextPrimitive {
  Pose pose = 1;
  bool billboard = 2;
  double font_size = 3;
  bool scale_invariant = 4;
  Color color = 5;
  string text = 6;
}
message ModelPrimitive {
  Pose pose = 1;
  Vector3 scale = 2;
  Color color = 3;
  bool override_color = 4;
  string url = 5;
  string media_type = 6;
  bytes data = 7;
}
message SceneEntityDeletion {
  enum Type {
    MATCHING_ID = 0;
    ALL = 1;
  }
  google.protobuf.Timestamp timestamp = 1;
  Type type = 2;
  string id = 3;
}
message SceneEntity {
  google.protobuf.Timestamp timestamp = 1;
  string frame_id = 2;
  string id = 3;
  google.protobuf.Duration lifetime = 4;
  bool frame_locked = 5;
  repeated KeyValuePair metadata = 6;
  repeated ArrowPrimitive arrows = 7;
  repeated CubePrimitive cubes = 8;
  repeated SpherePrimitive spheres = 9;
  repeated CylinderPrimitive cylinders = 10;
  repeated LinePrimitive lines = 11;
  repeated TriangleListPrimitive triangles = 12;
  repeated TextPrimitive texts = 13;
  repeated ModelPrimitive models = 14;
}
message SceneUpdate {
  repeated SceneEntityDeletion deletions = 1;
  repeated SceneEntity entities = 2;
}
message JointState {
  string name = 1;
  optional double position = 2;
  optional double velocity = 3;
  optional double acceleration = 4;
  optional double effort = 5;
}
message JointStates {
  google.protobuf.Timestamp timestamp = 1;
  repeated JointState joints = 2;
}
message FrameTransform {
  google.protobuf.Timestamp timestamp = 1;
  string parent_frame_id = 2;
  string child_frame_id = 3;
  Vector3 translation = 4;
  Quaternion rotation = 5;
}
message FrameTransforms {
  repeated FrameTransform transforms = 1;
}
message PoseInFrame {
  google.protobuf.Timestamp timestamp = 1;
  string frame_id = 2;
  Pose pose = 3;
}
"""

TYPES: Final[dict[str, Any]] = parse_types("foxglove", _TEXT)
"""Full name -> ``FileDescriptorProto``."""

SCHEMAS: Final = {
    FRAMES: "foxglove.FrameTransforms",
    HAND_SCENE: "foxglove.SceneUpdate",
    ROBOT_SCENE: "foxglove.SceneUpdate",
    JOINTS: "foxglove.JointStates",
    HUMAN_WRIST: "foxglove.PoseInFrame",
    WRIST_TARGET: "foxglove.PoseInFrame",
}
"""Topic -> full name of its messages."""

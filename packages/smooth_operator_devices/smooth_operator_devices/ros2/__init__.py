"""ROS 2 messages by CycloneDDS (extra ``ros2``), with or without a ROS 2 installation."""

from smooth_operator.errors import require

require("a ROS 2 topic", "ros2", "cyclonedds")

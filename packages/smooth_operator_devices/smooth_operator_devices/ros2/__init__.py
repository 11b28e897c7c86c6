"""Source and sink for ROS 2 topics through CycloneDDS; needs no ROS 2 installation."""

from smooth_operator.errors import require

require("a ROS 2 topic", "ros2", "cyclonedds")

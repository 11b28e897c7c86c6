"""ROS 2 messages by CycloneDDS (extra ``ros2``), with or without a ROS 2 installation."""

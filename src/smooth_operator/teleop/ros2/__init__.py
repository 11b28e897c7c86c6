"""ROS 2 messages, with a ROS 2 installation (rclpy) or without one (CycloneDDS, extra ``ros2``)."""
